import json
import os
from dataclasses import replace
from html import escape
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from shell import refuse
from tiny_study import judged

import bayes_greybox as bg
from bayes_greybox import cli
from bayes_greybox.config import load_config
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.stages import announce

CONFIGS = Path(__file__).parents[1] / "configs"

CONFIG = """
[data]
path = "run.csv"
time = "t"
states = ["y", "ydot"]
derivatives = { ydot = "a" }
test_fraction = 0.25

[simulation]
y = "ydot"
ydot = "-y"

[study]
catalogue = ["mechanical", "own.toml"]
roles = { position = "y" }
effects_at_most = 2
odds = { no_gap = 0.5, effects = 0.2 }

[output]
folder = "out"
"""

PLAIN = CONFIG + "figures = false\n"


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with a table and a configuration, to run in."""
    t = np.linspace(0.0, 6.0, 40)
    frame = pd.DataFrame({"t": t, "y": np.sin(t), "ydot": np.cos(t), "a": -np.sin(t)})
    frame.to_csv(tmp_path / "run.csv", index=False)
    (tmp_path / "case.toml").write_text(CONFIG)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def found(study, monkeypatch):
    """What the command asked the study for; the study itself is of other data.

    It has no figures and was not sampled, which is most of what a folder takes, unless "study" is said.
    """
    bare = replace(study, fit=None, maps={}, traces={}, paths={})
    asked = {}

    def find(model, train, test=None, **settings):
        asked.update(model=model, train=train, test=test, **settings)
        return asked.get("study") or bare

    monkeypatch.setattr("bayes_greybox.fleet.run.find_missing_effects", find)
    return asked


def test_the_folder_has_the_report_the_record_the_study_the_figures_and_the_configuration(here, study, found, capsys):
    found["study"] = study
    assert cli.main(["discover", "case.toml", "--no-progress"]) == 0
    assert sorted(os.listdir("out")) == ["config.toml", "figures", "gap.html", "study.nc", "summary.json"]
    assert Path("out/config.toml").read_text().endswith(f'copied_from = "../case.toml"\n\n{CONFIG}')
    assert escape(study.sentence) in Path("out/gap.html").read_text(encoding="utf-8")
    assert "effects_at_most = 2" in Path("out/gap.html").read_text(encoding="utf-8")
    assert {"gap_map.png", "ranking.png", "free_run_y.png"} <= set(os.listdir("out/figures"))
    out = capsys.readouterr().out
    assert out.startswith("NAMED: ") and "cubic stiffness" in out and "out/gap.html" in out
    assert "What was checked" in out and "Residuals are white" in out
    assert "What to do now\nAdd what was found" in out and "  bayes-greybox export out/study.nc amended.c\n" in out
    page = Path("out/gap.html").read_text(encoding="utf-8")
    assert "<title>case: missing-effect study: named</title>" in page
    assert "<code>bayes-greybox export study.nc amended.c</code>" in page


def test_the_verdict_is_told_once(here, study, monkeypatch, capsys):
    (here / "case.toml").write_text(PLAIN)

    def find(*_, **__):
        # As `find_missing_effects` does before it samples.
        announce(f"{study.verdict.upper()}: {study.sentence}", answer=True)
        return replace(study, fit=None, maps={}, traces={}, paths={})

    monkeypatch.setattr("bayes_greybox.fleet.run.find_missing_effects", find)
    assert cli.main(["discover", "case.toml"]) == 0
    out, err = capsys.readouterr()
    assert f"{out}{err}".count("NAMED: ") == 1 and out.startswith("NAMED: ")


def test_the_record_is_plain_json(here, study, found):
    (here / "case.toml").write_text(PLAIN)
    found["study"] = replace(study, maps={}, traces={}, paths={})
    cli.main(["discover", "case.toml", "--quiet", "--seed", "7"])
    record = json.loads(Path("out/summary.json").read_text())
    assert (record["config"], record["verdict"], record["sentence"]) == ("case.toml", "named", study.sentence)
    assert record["convergence"] == {"ok": True, "short": False, "reasons": []}
    assert record["sampling"]["seed"] == 7
    counted = {"train": study.train.n_obs, "test": study.test.n_obs}
    assert record["data"] == {**counted, "of": "measured rates", "remarks": []}
    best = record["effects"][0]
    assert (best["slug"], best["status"], best["tied_with"]) == ("cubic-stiffness", "added", [])
    assert {row["metric"] for row in record["gap"]} >= {"derivative NMSE", "free-run NRMSE"}
    assert [(row["check"], row["ok"]) for row in record["checks"]] == [("whiteness", True), ("LOO-PIT", True)]
    assert (record["against"], [each["against"] for each in record["doubts"] if each["against"]]) == ([], [])
    assert [row["text"] for row in record["instrument"]] == list(study.instrument["text"])
    # Infinite and missing numbers, which JSON lacks.
    assert record["rounds"][0]["added"] == "" and "NaN" not in Path("out/summary.json").read_text()


def test_the_study_gets_what_the_file_and_the_options_say(here, found):
    (here / "case.toml").write_text(PLAIN)
    cli.main(["discover", "case.toml", "--quiet", "--draws", "30", "--seed", "5"])
    assert found["catalogue"] == ["mechanical", str(Path("own.toml"))]
    assert found["roles"] == {"position": "y"}
    assert found["odds"] == bg.Odds(no_gap=0.5, effects=0.2)
    settings = ("effects_at_most", "draws", "tune", "chains", "seed", "progress")
    assert [found[name] for name in settings] == [2, 30, 1000, 4, 5, False]
    assert not {"settle", "free_runs", "target_accept"} & set(found)
    assert dict(found["model"].dictionary) == {} and found["model"].simulation == {"y": "ydot", "ydot": "-y"}
    assert (found["train"].n_obs, found["test"].n_obs) == (30, 10)


def test_a_catalogue_is_found_beside_the_file(here):
    (here / "sub").mkdir()
    (here / "sub" / "case.toml").write_text(CONFIG.replace('["mechanical", "own.toml"]', '"own.toml"'))
    assert load_config("sub/case.toml").study_arguments()["catalogue"] == str(Path("sub/own.toml"))


def test_a_fit_that_did_not_converge_ends_with_code_3(here, study, found, capsys):
    (here / "case.toml").write_text(PLAIN)
    found["study"] = replace(study, fit=judged(study.fit, False), maps={}, traces={}, paths={})
    assert cli.main(["discover", "case.toml", "--no-progress"]) == 3
    assert "Not converged; do not rely on this fit" in capsys.readouterr().out
    assert json.loads(Path("out/summary.json").read_text())["convergence"]["ok"] is False
    assert (here / "out" / "gap.html").exists()


def test_a_study_that_was_not_sampled_is_saved_and_shown_without_a_posterior(here, found, capsys):
    (here / "case.toml").write_text(PLAIN)
    assert cli.main(["discover", "case.toml", "--quiet", "-o", "other"]) == 0
    assert sorted(os.listdir("other")) == ["config.toml", "gap.html", "study.nc", "summary.json"]
    assert json.loads(Path("other/summary.json").read_text())["convergence"] is None
    page = Path("other/gap.html").read_bytes()
    Path("other/gap.html").unlink()
    assert cli.main(["report", "other", "--quiet"]) == 0
    assert Path("other/gap.html").read_bytes() == page
    capsys.readouterr()
    assert "not sampled" in refuse(capsys, "compare", "other/study.nc", "other/study.nc")


def test_quiet_prints_where_the_results_are_and_figures_can_be_left_out(here, found, capsys):
    (here / "case.toml").write_text(PLAIN)
    assert cli.main(["discover", "case.toml", "--quiet"]) == 0
    assert capsys.readouterr() == ("out\n", "")
    assert not (here / "out" / "figures").exists()


def test_a_failure_leaves_no_folder(here, monkeypatch, capsys):
    def fail(*_, **__):
        raise InputError("There is no catalogue 'x'; there are mechanical.")

    monkeypatch.setattr("bayes_greybox.fleet.run.find_missing_effects", fail)
    assert "no catalogue 'x'" in refuse(capsys, "discover", "case.toml")
    assert sorted(os.listdir(here)) == ["case.toml", "run.csv"]


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('[simulation]\ny = "ydot"\nydot = "-y"\n', "", "has neither [simulation] nor [dictionary]"),
        ("[output]", "[sampling]\ntarget_accept = 0.9\n[output]", "target_accept does not apply to discover"),
        ("effects_at_most = 2", "effect_at_most = 2", "did you mean 'effects_at_most'?"),
        ("no_gap = 0.5", "no_gap = 1.5", "[study.odds] no_gap = 1.5 cannot be used"),
        ('"run.csv"', '"absent.csv"', "There is no file"),
    ],
)
def test_bad_input_is_refused_before_the_study(here, found, capsys, old, new, sentence):
    assert old in CONFIG
    (here / "case.toml").write_text(CONFIG.replace(old, new))
    assert sentence in refuse(capsys, "discover", "case.toml")
    assert not found and sorted(os.listdir(here)) == ["case.toml", "run.csv"]


@pytest.mark.slow
def test_a_real_study_finds_the_hidden_spring(tmp_path, capsys):
    text = (CONFIGS / "discover_spring.toml").read_text()
    text = text.replace("points = 601", "points = 201").replace("[study]", "[study]\nsettle = false\nfree_runs = false")
    (tmp_path / "case.toml").write_text(text)
    assert cli.main(["discover", str(tmp_path / "case.toml"), "-o", str(tmp_path / "out"), "--no-progress"]) == 0
    record = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert (record["verdict"], record["convergence"]) == ("named", None)
    added = [row for row in record["effects"] if row["status"] == "added"]
    assert [row["slug"] for row in added] == ["cubic-stiffness"]
    # One seed: four standard deviations fail once in 16,000.
    assert abs(added[0]["mean"] + 40.0) < 4 * added[0]["sd"]
    html = (tmp_path / "out" / "gap.html").read_text(encoding="utf-8")
    assert html.index("</span> Named") < html.index("The gap before and after, on held-out data")
    assert capsys.readouterr().out.startswith("NAMED: ")


@pytest.mark.slow
def test_the_shipped_study_converges_and_its_posterior_can_be_reported(tmp_path):
    words = ["discover", str(CONFIGS / "discover_spring.toml"), "-o", str(tmp_path / "out"), "--quiet"]
    assert cli.main(words) == 0
    record = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert record["verdict"] == "named" and record["convergence"]["ok"]
    assert cli.main(["report", str(tmp_path / "out" / "study.nc"), "--quiet"]) == 0
    assert record["sentence"] in (tmp_path / "out" / "study.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("command", ["fit", "compare"])
def test_fitting_without_a_dictionary_is_refused_and_points_to_discover(here, capsys, command):
    models = "[models]\na = {}\nb = {}\n" if command == "compare" else ""
    (here / "case.toml").write_text(CONFIG + models)
    assert "bayes-greybox discover" in refuse(capsys, command, "case.toml")


def test_a_saved_fit_is_reported_beside_itself_or_where_asked(here, study, monkeypatch, capsys):
    asked = []

    def saved_html(files, path, folds, progress):
        asked.append((files, path, folds, progress))
        return {"run": judged(study.fit, False)}, path or files[0].with_suffix(".html")

    monkeypatch.setattr("bayes_greybox.report.folders.saved.saved_html", saved_html)
    assert cli.main(["report", "runs/first/run.nc"]) == 3
    assert cli.main(["report", "run.nc", "-o", "page.html", "--quiet"]) == 3
    assert asked == [
        ([Path("runs/first/run.nc")], None, {}, True),
        ([Path("run.nc")], Path("page.html"), {}, False),
    ]
    assert capsys.readouterr().out == "The report is runs/first/run.html.\npage.html\n"


def test_a_fit_that_is_not_there_cannot_be_reported(here, capsys):
    assert "absent.nc" in refuse(capsys, "report", "absent.nc")


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["discover"], "Missing argument"),
        (["report"], "Missing argument"),
    ],
)
def test_wrong_use_is_refused_in_one_sentence(here, capsys, words, sentence):
    assert sentence in refuse(capsys, *words)


def test_every_command_explains_itself(capsys):
    for command in ("discover", "report"):
        assert cli.main([command, "--help"]) == 0
        assert f"Usage: bayes-greybox {command}" in capsys.readouterr().out


def test_results_of_another_command_are_left_alone(here, found, capsys):
    (here / "case.toml").write_text(PLAIN)
    held = here / "out"
    held.mkdir()
    (held / "summary.json").write_text('{"command": "fit"}')
    assert cli.main(["discover", "case.toml", "--quiet"]) == 0
    assert capsys.readouterr().out == "out-discover\n"
    assert os.listdir(held) == ["summary.json"] and (held / "summary.json").read_text() == '{"command": "fit"}'
    assert json.loads(Path("out-discover/summary.json").read_text())["command"] == "discover"
    found.clear()
    assert "holds results of fit" in refuse(capsys, "discover", "case.toml", "-o", "out")
    assert not found


def test_a_study_is_reported_from_its_folder_its_copy_s_folder_or_its_file(here, study, found, capsys):
    (here / "case.toml").write_text(PLAIN)
    # With figures, of which maps are enough.
    found["study"] = replace(study, traces={}, paths={})
    assert cli.main(["discover", "case.toml", "--quiet"]) == 0
    made = Path("out/gap.html").read_text(encoding="utf-8")
    # The verdict on a hundred draws was made up; all else is that of the file.
    assert cli.main(["report", "out", "--quiet"]) in (0, 3)
    assert cli.main(["report", "out/study.nc", "-o", "page.html", "--quiet"]) in (0, 3)
    assert Path("page.html").read_bytes() == Path("out/gap.html").read_bytes()
    shown = Path("out/gap.html").read_text(encoding="utf-8")
    figures = [page.count('class="drawing"') for page in (made, shown)]
    assert figures[0] == figures[1] > 0 and escape(study.sentence) in shown and "effects_at_most = 2" in shown
    found.clear()
    os.chdir("out")
    assert cli.main(["discover", "config.toml", "--quiet"]) == 0
    assert found["train"].n_obs == 30 and found["catalogue"] == ["mechanical", str(here / "own.toml")]
    assert sorted(os.listdir(".")) == ["config.toml", "gap.html", "study.nc", "summary.json"]
    assert Path("config.toml").read_text().endswith(f'copied_from = "../case.toml"\n\n{PLAIN}')
    capsys.readouterr()
    assert "one study at a time" in refuse(capsys, "report", "study.nc", "study.nc")
    Path("study.nc").unlink()
    assert "study.nc is missing" in refuse(capsys, "report", ".")
