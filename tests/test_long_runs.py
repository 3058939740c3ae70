"""Runs that are stopped, killed, refused or short of room, as a user meets them at a shell."""

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import xarray as xr
from killed_runs import prepare, require_same, require_same_draws, require_whole
from shell import refuse
from tiny_study import SIMULATION, oscillator

import bayes_greybox as bg
from bayes_greybox import cli
from bayes_greybox.inference.sampler import chain_file
from bayes_greybox.running.locking import locked

ROOT = Path(__file__).parents[1]
FIT = ("fit", "case.toml", "--quiet", "--draws", "50", "--tune", "100")
ALL = ["config.toml", "run.nc", "summary.json"]


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with a table and a configuration, to run in."""
    prepare(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """The folder of that run, which nobody stopped."""
    folder = tmp_path_factory.mktemp("reference")
    prepare(folder)
    words = ["fit", str(folder / "case.toml"), *FIT[2:]]
    assert cli.main([*words, "-o", str(folder / "out")]) in (0, 3)
    return folder / "out"


def kills_survived(count: int, seed: int, draws: int, cache: Path) -> str:
    """What the script says of so many kills, each in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "BAYES_GREYBOX_CACHE": str(cache)}
    # Where JAX has a folder of its own no traces are kept.
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    command = [sys.executable, str(ROOT / "tests" / "killed_runs.py"), *map(str, (count, seed, draws))]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-1]


needs_forks = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="the script asks /proc for times")


@pytest.mark.slow
@needs_forks
def test_a_killed_fit_goes_on_to_the_same_draws(request):
    cache = Path(request.config.rootpath) / ".pytest_cache" / "killed"
    assert kills_survived(1, 0, 150, cache) == "1 of 1 kills: the same draws"


@needs_forks
@pytest.mark.slow
def test_fifty_killed_fits_go_on_to_the_same_draws(tmp_path):
    assert kills_survived(50, 1, 600, tmp_path) == "50 of 50 kills: the same draws"


@pytest.fixture
def interrupted(monkeypatch):
    """Ctrl-C once so many pieces of chains were kept, for as long as the context lasts."""

    @contextmanager
    def at(pieces: int) -> Iterator[None]:
        seen, lock, write = [0], threading.Lock(), chain_file.ChainFile.write

        def written(self, chain, *, now=False):
            write(self, chain, now=now)
            with lock:
                seen[0] += 1
                if seen[0] == pieces:
                    raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(chain_file.ChainFile, "write", written)
            yield

    return at


def test_ctrl_c_keeps_the_draws_and_says_how_to_go_on(here, reference, capsys, interrupted):
    capsys.readouterr()
    with interrupted(5):
        assert cli.main(FIT) == 130
    told = capsys.readouterr().err.strip()
    kept = Path("out", "checkpoint")
    assert told == f'Stopped: the draws so far are in "{kept}"; the same command with --resume goes on.'
    assert sorted(os.listdir("out")) == ["checkpoint"]
    require_whole(here / "out")
    # What is changed is named, and nothing is lost by it.
    assert "are of another run: seed is 1 and was 0." in refuse(capsys, *FIT, "--resume", "--seed", "1")
    assert cli.main([*FIT, "--resume"]) in (0, 3)
    require_same(here / "out", reference)


@pytest.mark.slow
def test_a_comparison_goes_on_with_the_model_that_it_was_at(here, capsys, interrupted):
    with (here / "case.toml").open("a") as file:
        # As many terms each, and one prior: all that is fitted here runs one program.
        file.write('[models.linear]\n[models.cubic]\ndictionary = { y = ["y**3"] }\n')
    words = ["compare", "case.toml", "--quiet", "--draws", "50", "--tune", "100", "--max-refits", "0"]
    assert cli.main([*words, "-o", "reference"]) in (0, 3)
    capsys.readouterr()
    # Each model has two chains of some eight pieces.
    with interrupted(22):
        assert cli.main(words) == 130
    kept = Path("out", "checkpoint", "cubic")
    assert capsys.readouterr().err.strip().splitlines() == [
        f'Stopped: the draws so far are in "{kept}"; the same command with --resume goes on.'
    ]
    assert (here / "out" / "linear.nc").is_file() and not (here / "out" / "cubic.nc").exists()
    assert cli.main([*words, "--resume"]) in (0, 3)
    assert sorted(os.listdir("out")) == sorted(os.listdir("reference"))
    for name in ("linear.nc", "cubic.nc"):
        require_same_draws(here / "out" / name, here / "reference" / name)


@pytest.mark.slow
def test_a_study_goes_on_with_the_sampling_of_its_extended_model(study, tmp_path, interrupted):
    model = bg.GreyBox(simulation=SIMULATION, discrepancy=bg.OrthogonalGP(variables=("y", "ydot"), features=4))
    settings = {
        "draws": 60,
        "tune": 60,
        "chains": 2,
        "progress": False,
        "checkpoint": tmp_path / "kept",
        "checkpoint_every": 0,
    }
    data = oscillator(), oscillator(seed=1)
    with interrupted(5), pytest.raises(KeyboardInterrupt):
        bg.find_missing_effects(model, *data, **settings)
    assert {"of-study.json", "of-fit.json"} <= set(os.listdir(tmp_path / "kept"))
    assert list((tmp_path / "kept").glob("chain-1-*.npz"))
    with pytest.raises(bg.InputError, match="effects_at_most is 2 and was 3"):
        bg.find_missing_effects(model, *data, **settings, resume=True, effects_at_most=2)
    resumed = bg.find_missing_effects(model, *data, **settings, resume=True)
    for group in ("posterior", "sample_stats"):
        assert resumed.fit.idata[group].to_dataset().equals(study.fit.idata[group].to_dataset())
    assert not (tmp_path / "kept").exists()


def test_ctrl_c_before_there_are_draws_leaves_nothing(here, capsys, monkeypatch):
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("bayes_greybox.greybox.sample_posterior", interrupted)
    assert cli.main(FIT) == 130
    said = "Stopped: there were no draws yet, and nothing else is kept; the same command starts from the beginning."
    assert capsys.readouterr().err.strip() == said
    assert sorted(os.listdir(here)) == ["case.toml", "run.csv"]


def test_a_second_process_on_one_folder_is_refused(here, capsys):
    (here / "out").mkdir()
    with locked(here / "out"):
        sentence = refuse(capsys, *FIT)
    assert sentence.startswith(f'"out" is being written to by another process ({os.getpid()} on ')
    assert sentence.endswith("choose another folder.") and os.listdir("out") == []


def test_a_disk_that_gets_full_is_one_sentence_and_costs_no_draw(here, reference, capsys, monkeypatch):
    capsys.readouterr()
    to_netcdf = xr.DataTree.to_netcdf

    def full(self, path, **options):
        to_netcdf(self, path, **options)
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(xr.DataTree, "to_netcdf", full)
        sentence = refuse(capsys, *FIT)
    assert sentence == (
        'Cannot write to the folder "out" (No space left on device); make room, or choose another one. '
        "Then the same command with --resume goes on with the draws so far."
    )
    assert sorted(os.listdir("out")) == ["checkpoint"]
    assert cli.main([*FIT, "--resume"]) in (0, 3)
    assert sorted(os.listdir("out")) == ALL
    require_same(here / "out", reference)


@pytest.mark.parametrize("error", [(28, "No space left on device"), (30, "Read-only file system")])
def test_a_folder_without_room_is_refused_before_the_data_are_read(here, capsys, monkeypatch, error):
    def refused(*_: object) -> None:
        raise OSError(*error)

    monkeypatch.setattr("bayes_greybox.report.folders.writing.os.fsync", refused)
    (here / "run.csv").unlink()
    assert refuse(capsys, *FIT).startswith(f'Cannot write to the folder "out" ({error[1]}); ')
    assert os.listdir(here) == ["case.toml"]


def test_resuming_applies_to_no_saved_fits(here, capsys):
    assert "--resume does not apply to saved fits" in refuse(capsys, "compare", "a.nc", "b.nc", "--resume")
