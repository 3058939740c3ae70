import gc
import json
import logging
import os
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from shell import refuse

import bayes_greybox as bg
from bayes_greybox import cli
from bayes_greybox.cli.ending import log_to_stderr, show

ROOT = Path(__file__).parents[1]
CONFIGS = ROOT / "configs"
SHORT = ["--draws", "50", "--tune", "100", "--chains", "2", "--no-progress"]

CONFIG = """
[data]
path = "run.csv"
time = "t"
states = ["y", "ydot"]
derivatives = { ydot = "a" }

[dictionary]
ydot = ["y", "ydot"]

[output]
folder = "out"

[discrepancy]
features = 6
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with a table and a configuration, to run in."""
    t = np.linspace(0.0, 6.0, 40)
    noise = 0.02 * np.random.default_rng(0).standard_normal(len(t))
    frame = pd.DataFrame({"t": t, "y": np.sin(t), "ydot": np.cos(t), "a": -np.sin(t) + noise})
    frame.to_csv(tmp_path / "run.csv", index=False)
    (tmp_path / "case.toml").write_text(CONFIG)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run_python(*words: str) -> subprocess.CompletedProcess:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run([sys.executable, *words], env=environment, capture_output=True, text=True, check=True)


def test_help_takes_less_than_half_a_second():
    command = "import sys; from bayes_greybox.cli import main; sys.exit(main(['--help']))"
    seconds = []
    for _ in range(5):
        start = time.perf_counter()
        done = run_python("-c", command)
        seconds.append(time.perf_counter() - start)
    assert all(name in done.stdout for name in ("fit", "compare", "datasets", "Exit codes"))
    # The least disturbed run says how long it takes; the others say how busy the machine is.
    assert min(seconds) <= 0.5


def test_the_command_line_imports_nothing_heavy_before_a_command_runs():
    listing = run_python("-c", "import sys, bayes_greybox.cli; print(*sys.modules)").stdout.split()
    assert not {"jax", "numpy", "pandas", "matplotlib", "arviz_base", "pydantic"} & set(listing)


def test_a_mistake_in_a_file_without_parts_of_models_is_found_without_importing_jax(here):
    (here / "case.toml").write_text(CONFIG.split("[discrepancy]")[0] + "[smpling]\n")
    run = "import sys; from bayes_greybox.cli import main; code = main(['fit', 'case.toml'])"
    assert run_python("-c", f"{run}; print(code, 'jax' in sys.modules)").stdout.strip() == "2 False"


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["fti"], "No such command 'fti'"),
        (["fit"], "Missing argument"),
        (["fit", "case.toml", "--drws", "3"], "No such option: --drws"),
        (["fit", "case.toml", "--draws", "many"], "Invalid value for '--draws'"),
        (["fit", "case.toml", "--draws", "0"], "draws = 0 cannot be used"),
        (["fit", "absent.toml"], 'There is no configuration file "absent.toml"'),
        (["fit", "case.toml", "-o", "run.csv/out"], 'Cannot write to the folder "run.csv/out"'),
        (["compare", "case.toml"], "compare needs two or more models, and case.toml has 0"),
        (
            ["compare", "case.toml", "case.toml"],
            "compare takes one configuration file, or two or more saved fits",
        ),
        (["compare", "a.nc"], "compare takes one configuration file, or two or more saved fits"),
        (["compare", "a.nc", "b.nc", "--seed", "1"], "--seed does not apply to saved fits"),
        (["compare", "a.nc", "b.nc"], ""),
        (["report"], "Missing argument"),
        (["report", "a.nc"], "There is no file 'a.nc'"),
        (["report", "a.nc", "b.nc"], "There is no file 'a.nc'"),
        (["report", "."], '"." is not a folder that fit, discover or compare wrote'),
        (["report", ".", "a.nc"], "report takes one saved fit or study (*.nc), several fits, or one folder"),
        (["report", ".", "--scheme", "block"], "--scheme applies where several saved fits are compared"),
        (["report", "a.nc", "--block", "5"], "--block applies where several saved fits are compared"),
        (["report", "a.nc", "--max-refits", "5"], "--max-refits applies where several saved fits are compared"),
        (["export", "a.nc"], "Missing argument 'OUTPUT'"),
        (["export", "a.nc", "a.f90"], '"a.f90" has no ending of a language that models are exported to: use one of'),
        (["export", "a.nc", "a.c"], "There is no file 'a.nc'"),
        (["export", "run.csv", "a.c"], "run.csv"),
    ],
)
def test_wrong_use_is_refused_in_one_sentence(here, capsys, words, sentence):
    assert sentence in refuse(capsys, *words)
    assert sorted(os.listdir(here)) == ["case.toml", "run.csv"]


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('"run.csv"', '"absent.csv"', "There is no file"),
        ('a"', 'acc"', 'has no column "acc"'),
        ('states = ["y", "ydot"]', 'states = ["y", "ydot", "t"]', 'The name "t" is taken'),
        ('= ["y", "ydot"]\n\n[output]', '= ["y", "ydt"]\n\n[output]', "uses the unknown name 'ydt'"),
        ('= ["y", "ydot"]\n\n[output]', '= ["y", "2*y"]\n\n[output]', "are the same up to a constant factor"),
        ('= ["y", "ydot"]\n\n[output]', '= ["y", "__import__(\'os\')"]\n\n[output]', "The formula"),
        ("ydot = [", "z = [", "not a state of the data"),
        ("[output]", "[simulation]\nydot = '-k*y'\n[output]", "unknown name 'k'"),
        ("features = 6", "variables = ['w']", "names 'w', which is neither a state nor"),
        ("features = 6", "variant = 'printed'", "use variant='projected'"),
    ],
)
def test_bad_input_is_refused_before_sampling_and_leaves_no_file(here, capsys, old, new, sentence):
    assert old in CONFIG
    (here / "case.toml").write_text(CONFIG.replace(old, new))
    assert sentence in refuse(capsys, "fit", "case.toml", "--no-progress")
    assert sorted(os.listdir(here)) == ["case.toml", "run.csv"]


@pytest.mark.parametrize(
    ("column", "row", "value", "sentence"),
    [
        ("y", 3, np.nan, "missing or infinite values"),
        ("t", 3, 0.0, "is not increasing"),
        ("t", 1, 0.0, "twice"),
        ("ydot", slice(None), 1.0, "is constant"),
    ],
)
def test_bad_measurements_are_refused(here, capsys, column, row, value, sentence):
    frame = pd.read_csv("run.csv")
    frame.loc[row, column] = value
    frame.to_csv("run.csv", index=False)
    assert sentence in refuse(capsys, "fit", "case.toml", "--no-progress")


def test_an_unforeseen_error_is_not_hidden(here, monkeypatch):
    def fail(*_, **__):
        raise RuntimeError("a bug")

    monkeypatch.setattr("bayes_greybox.greybox.GreyBox", fail)
    with pytest.raises(RuntimeError, match="a bug"):
        cli.main(["fit", "case.toml"])
    assert not (here / "out").exists()


def test_datasets_are_listed(capsys):
    assert cli.main(["datasets"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in ("silverbox", "cascaded_tanks", "falling_balls", "hudson_bay"))
    assert "silverbox/SNLS80mV.mat" in out


def test_no_words_mean_help(capsys):
    assert cli.main([]) == 0
    assert "Usage: bayes-greybox" in capsys.readouterr().out


COMMANDS = ["fit", "discover", "compare", "report", "next", "export", "datasets"]


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_a_short_way_to_its_help(command, capsys):
    assert cli.main([command, "-h"]) == 0
    short = capsys.readouterr().out
    assert cli.main([command, "--help"]) == 0
    assert capsys.readouterr().out == short and f"Usage: bayes-greybox {command}" in short
    if command != "datasets":
        assert all(option in short for option in ("-q, --quiet", "-v, --verbose"))


@pytest.mark.parametrize("command", [*COMMANDS, "init", "schema"])
def test_the_help_of_every_command_ends_with_an_example_and_the_next_command(command, capsys):
    assert cli.main([command, "--help"]) == 0
    *_, example, _, after = capsys.readouterr().out.rstrip().splitlines()
    assert example.strip().startswith(f"Example: bayes-greybox {command}") and len(example) < 80
    assert after.strip().startswith("Then: bayes-greybox ") and len(after) < 80
    assert after.split()[2] in [*COMMANDS, "init", "schema"]


def test_the_whole_has_a_short_way_to_its_help_and_lists_every_command(capsys):
    assert cli.main(["-h"]) == 0
    out = capsys.readouterr().out
    assert all(f"  {command}" in out for command in COMMANDS) and "--install-completion" in out


def test_the_version_is_that_of_the_package(capsys):
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"bayes-greybox {bg.__version__}\n"


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_words_are_completed(shell):
    command = "import sys; from bayes_greybox.cli import main; sys.exit(main())"
    words = {"bash": "bayes-greybox d", "zsh": "bayes-greybox d", "fish": "bayes-greybox d"}[shell]
    asked = {
        "_BAYES_GREYBOX_COMPLETE": f"complete_{shell}", "COMP_WORDS": words, "COMP_CWORD": "1",
        "_TYPER_COMPLETE_ARGS": words, "_TYPER_COMPLETE_FISH_ACTION": "get-args",
    }  # fmt: skip
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **asked}
    done = subprocess.run([sys.executable, "-c", command], env=environment, capture_output=True, text=True)
    assert "discover" in done.stdout and "datasets" in done.stdout and "compare" not in done.stdout


def test_verbose_says_on_stderr_what_is_done_and_only_where_it_is_asked_for(capsys):
    log = logging.getLogger("bayes_greybox.data")
    said = {}
    for verbose in (0, 1, 2, 0):
        log_to_stderr(verbose)
        log.debug("a detail")
        log.info("a stage")
        out, said[verbose] = capsys.readouterr()
        assert out == ""
    assert said[0] == "" and "INFO bayes_greybox.data: a stage" in said[1] and "detail" not in said[1]
    assert "DEBUG bayes_greybox.data: a detail" in said[2] and said[2].count("a stage") == 1


COLOURED = "from bayes_greybox.cli.ending import show; from rich.text import Text; show(Text('shown', style='bold'))"
"""Program that prints a bold word as every command prints."""


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="needs a terminal that can be made up")
@pytest.mark.parametrize("plain", [True, False])
def test_a_terminal_gets_colours_unless_no_color_is_set(plain):
    # NO_COLOR counts where it is not empty, by its own convention.
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TERM": "xterm-256color", "NO_COLOR": "1" if plain else ""}
    master, terminal = os.openpty()
    with subprocess.Popen([sys.executable, "-c", COLOURED], env=environment, stdout=terminal) as running:
        os.close(terminal)
        seen = b""
        while b"shown" not in seen:
            seen += os.read(master, 4096)
        running.kill()
    os.close(master)
    assert (b"\x1b[" not in seen) is plain


def test_a_pipe_gets_no_colours():
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TERM": "xterm-256color"}
    done = subprocess.run([sys.executable, "-c", COLOURED], env=environment, capture_output=True, check=True)
    assert b"shown" in done.stdout and b"\x1b[" not in done.stdout


COUNTED = """
import json, os, sys
import jax
from bayes_greybox.cli import main

programs = []
jax.monitoring.register_event_duration_secs_listener(
    lambda event, *_, **__: programs.append(event) if event.endswith("backend_compile_duration") else None
)
code = main()
with open(os.environ["COUNTED"], "w") as file:
    json.dump({"programs": len(programs), "modules": sorted(sys.modules)}, file)
sys.exit(code)
"""
"""The command, and how many programs it compiled or read, and which modules it imported."""


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """The bundled example, sampled briefly; what it printed, its folder, and what it took."""
    home = tmp_path_factory.mktemp("first")
    folder, counted = home / "run", home / "counted.json"
    words = [sys.executable, "-c", COUNTED, "fit", str(CONFIGS / "first.toml"), "-o", str(folder), *SHORT]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "COUNTED": str(counted)}
    done = subprocess.run([*words, "--seed", "3"], env=environment, capture_output=True, text=True)
    took = json.loads(counted.read_text()) if counted.exists() else {}
    return SimpleNamespace(code=done.returncode, out=done.stdout, err=done.stderr, folder=folder, took=took)


@pytest.fixture(scope="module")
def fit(first):
    """That fit, from its file."""
    return bg.load(first.folder / "run.nc")


def test_a_run_that_is_too_short_ends_with_code_3_and_says_so_first(first):
    assert first.code == 3
    assert first.out.startswith("Not converged; do not rely on this fit:")
    assert "Traceback" not in first.err


def test_a_fit_with_its_checks_and_figures_takes_few_programs(first):
    # Of the sampler, draws, densities, checks and the free run, two that ask for options, and keys. An array that is
    # indexed or made step by step takes one for each operation and shape; there were 119.
    assert 11 <= first.took["programs"] <= 30


def test_a_fit_and_its_figures_import_no_study(first):
    modules = set(first.took["modules"])
    assert modules >= {"bayes_greybox.cli.fitting", "bayes_greybox.report.plots.fits"}
    # A configuration's defaults are a study's criteria: numbers, and no more of it.
    numbers = "bayes_greybox.discovery.decision.criteria"
    assert {name for name in modules if name.startswith("bayes_greybox.discovery")} <= {
        numbers[:end] for end in (len("bayes_greybox.discovery"), len("bayes_greybox.discovery.decision"), len(numbers))
    }


def test_the_folder_has_the_fit_the_record_the_figures_and_the_configuration(first):
    assert sorted(os.listdir(first.folder)) == ["config.toml", "figures", "run.nc", "summary.json"]
    copy, given = (first.folder / "config.toml").read_bytes(), (CONFIGS / "first.toml").read_bytes()
    # All that its author wrote, below the line that says where its paths start.
    assert copy.endswith(b"\n\n" + given) and copy.removesuffix(given).count(b"\n") == 3
    figures = list((first.folder / "figures").iterdir())
    assert figures and all(path.suffix == ".png" and path.stat().st_size > 5000 for path in figures)


def test_the_record_says_what_the_saved_fit_says(first, fit):
    record = json.loads((first.folder / "summary.json").read_text())
    assert record["verdict"] == {"ok": fit.verdict.ok, "short": False, "reasons": list(fit.verdict.reasons)}
    assert record["sampling"] == {"draws": 50, "tune": 100, "chains": 2, "seed": 3, "target_accept": 0.9}
    inclusion = fit.inclusion()
    rows = pd.DataFrame(record["coefficients"]).set_index(["equation", "term"])
    np.testing.assert_allclose(rows["mean"], inclusion["mean"])
    np.testing.assert_allclose(rows["inclusion"], inclusion["inclusion"])
    assert record["seconds"] > 0 and record["versions"]["numpyro"]
    assert record["data"] == {"rows": 320, "of": "measured rates", "runs": 1, "dropped": 0}


def test_even_a_short_run_finds_the_two_terms_and_predicts_held_out_data(first):
    record = json.loads((first.folder / "summary.json").read_text())
    included = {row["term"] for row in record["coefficients"] if row["inclusion"] > 0.9}
    assert included == {"y**3", "ydot**3"}
    # The noise is 2 % of the acceleration's SD over the whole record, whose amplitude halves by its end.
    assert 0 < record["held_out_nmse"]["ydot"] < 0.01


def test_the_terminal_shows_units_intervals_inclusion_shares_and_held_out_error(first):
    for text in ("y³", "1/(m²·s²)", "P(included)", "lower", "discrepancy", "held-out data"):
        assert text in first.out
    # Long paths are wrapped.
    assert str(first.folder) in first.out.replace("\n", "")


def test_saved_fits_are_compared_and_named_after_their_folders(first, tmp_path, capsys):
    other = tmp_path / "other" / "run.nc"
    other.parent.mkdir()
    other.write_bytes((first.folder / "run.nc").read_bytes())
    files = [str(first.folder / "run.nc"), str(other)]
    folds = ["--scheme", "block", "--block", "20", "--max-refits", "0"]
    assert cli.main(["compare", *files, "-o", str(tmp_path / "out"), *folds]) == 3
    out = capsys.readouterr().out
    assert "elpd" in out and "other" in out and "20 rows" in " ".join(out.split())
    record = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert (record["scheme"]["scheme"], record["scheme"]["block"]) == ("block", 20)
    assert {row["model"] for row in record["comparison"]} == {"run", "other"}
    assert [row["elpd_diff"] for row in record["comparison"]] == [0.0, 0.0]
    assert (tmp_path / "out" / "figures" / "comparison.png").exists()
    # The page again, from the folder alone; it holds the same until a fit is gone.
    page = (tmp_path / "out" / "comparison.html").read_bytes()
    assert cli.main(["report", str(tmp_path / "out"), "-o", str(tmp_path / "again.html")]) == 3
    assert (tmp_path / "again.html").read_bytes() == page
    other.unlink()
    capsys.readouterr()
    assert "is no longer there" in refuse(capsys, "report", str(tmp_path / "out"))


def test_a_saved_fit_is_exported_and_one_that_did_not_converge_says_so(first, fit, tmp_path, capsys):
    program = tmp_path / "spring.py"
    assert cli.main(["export", str(first.folder / "run.nc"), str(program), "--quiet"]) == 3
    assert capsys.readouterr().out == f"{program}\n"
    text, made = program.read_text(encoding="utf-8"), {}
    assert "Not converged" in text
    exec(text, made)
    x = np.random.default_rng(0).uniform(-1, 1, (20, 2))
    own = fit.to_callable()(0.0, x)
    np.testing.assert_allclose(made["rhs"](0.0, x.T, np.zeros((0, 20))).T, own, rtol=1e-8, atol=1e-12)
    absent = str(tmp_path / "absent" / "spring.c")
    assert "cannot be written" in refuse(capsys, "export", str(first.folder / "run.nc"), absent)


def test_a_damaged_fit_is_refused(first, tmp_path, capsys):
    damaged = tmp_path / "damaged.nc"
    damaged.write_bytes((first.folder / "run.nc").read_bytes()[:2000])
    assert "damaged.nc" in refuse(capsys, "compare", str(first.folder / "run.nc"), str(damaged))


def test_models_of_a_file_are_fitted_saved_and_compared(here, capsys):
    # As many terms each, and one prior: both run one program.
    models = "[prior]\nkind = 'normal'\n[models]\nlinear = {}\ncubic = { dictionary = { ydot = ['y', 'y**3'] } }\n"
    (here / "case.toml").write_text(CONFIG + "\n[compare]\nscheme = 'trajectory'\nmax_refits = 9\n" + models)
    assert "the data have one: use scheme='block'" in refuse(capsys, "compare", "case.toml", *SHORT)
    # What the file says gives way to the command line.
    folds = ["--scheme", "future", "--block", "5", "--max-refits", "0"]
    assert cli.main(["compare", "case.toml", *SHORT, *folds]) in (0, 3)
    pages = ["comparison.html", "config.toml", "cubic.nc", "figures", "linear.nc", "summary.json"]
    assert sorted(os.listdir("out")) == pages
    record = json.loads(Path("out/summary.json").read_text())
    assert record["scheme"]["folds"] == "4 steps of up to 5 time stamps into the future"
    assert {row["model"] for row in record["comparison"]} == {"linear", "cubic"} == set(record["verdicts"])
    assert {row["refits"] for row in record["comparison"]} == {0}
    assert {name: entry["file"] for name, entry in record["fits"].items()} == {n: f"{n}.nc" for n in record["verdicts"]}
    page = Path("out/comparison.html").read_bytes()
    assert b"[models]" in page
    os.rename("out", "moved")
    assert cli.main(["report", "moved", "--quiet"]) in (0, 3)
    assert Path("moved/comparison.html").read_bytes() == page


def test_every_model_is_checked_before_the_first_is_sampled(here, capsys):
    models = '[models]\ngood = {}\nbad = { dictionary = { ydot = ["y", "ydt"] } }\n'
    (here / "case.toml").write_text(CONFIG + models)
    assert refuse(capsys, "compare", "case.toml").startswith("[models.bad] The formula 'ydt'")
    assert sorted(os.listdir(here)) == ["case.toml", "run.csv"]


def test_quiet_prints_where_the_results_are_and_nothing_else(here, fit, monkeypatch, capsys):
    monkeypatch.setattr(bg.GreyBox, "fit", lambda *_, **__: fit)
    (here / "case.toml").write_text(CONFIG.replace('"out"', '"out"\nfigures = false'))
    assert cli.main(["fit", "case.toml", *SHORT, "--quiet"]) == 3
    assert capsys.readouterr() == ("out\n", "")
    assert sorted(os.listdir("out")) == ["config.toml", "run.nc", "summary.json"]


def test_the_answer_comes_first_and_a_fit_that_cannot_be_shown_is_saved_all_the_same(here, fit, monkeypatch):
    monkeypatch.setattr(bg.GreyBox, "fit", lambda *_, **__: fit)

    def fail(*_):
        assert not list(here.glob("out/run.nc"))
        raise RuntimeError("a bug")

    monkeypatch.setattr("bayes_greybox.cli.fitting.fit_tables", fail)
    with pytest.raises(RuntimeError, match="a bug"):
        cli.main(["fit", "case.toml", *SHORT])
    assert bg.load(here / "out" / "run.nc").inclusion().equals(fit.inclusion())


def test_a_command_leaves_the_search_for_garbage_as_it_was(capsys):
    before = gc.get_threshold()
    assert cli.main(["datasets"]) == 0
    assert gc.get_threshold() == before


def test_a_process_that_ends_does_not_search_its_modules_for_garbage():
    frozen = "import atexit, gc, sys; atexit.register(lambda: print(gc.get_freeze_count() > 1000)); "
    done = run_python("-c", frozen + "sys.argv = ['x', '--version']; from bayes_greybox.cli import command; command()")
    assert done.stdout.splitlines()[-1] == "True"
    assert gc.get_freeze_count() == 0


def test_what_cannot_work_is_refused_before_the_work(here, first, tmp_path, monkeypatch, capsys):
    never = lambda *_, **__: pytest.fail("worked before it looked")  # noqa: E731
    monkeypatch.setattr(bg.GreyBox, "fit", never)
    models = "[models]\nnormal = { prior = { kind = 'normal' } }\nlaplace = { prior = { kind = 'laplace' } }\n"
    (here / "case.toml").write_text(CONFIG + models)
    assert "block=20 does not apply to scheme='loo'" in refuse(capsys, "compare", "case.toml", "--block", "20")
    monkeypatch.setattr("bayes_greybox.report.folders.saved.compare", never)
    files = [str(first.folder / "run.nc")] * 2
    assert "Cannot write" in refuse(capsys, "report", *files, "-o", str(tmp_path / "absent" / "page.html"))


def test_paths_are_no_markup(capsys):
    show("Results are in runs/[old]/x and [/x].")
    assert capsys.readouterr().out == "Results are in runs/[old]/x and [/x].\n"


def test_the_package_is_run_as_a_module_too():
    def run(*words):
        return subprocess.run([sys.executable, "-m", "bayes_greybox", *words], capture_output=True, text=True)

    assert run("--version").stdout.startswith("bayes-greybox ") and run("fit", "nowhere.toml").returncode == 2
