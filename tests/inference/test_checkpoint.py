"""A run that was stopped goes on to the same draws, and to no others."""

import json
import os
import shutil
import threading
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from tiny_equation import tiny_data

import bayes_greybox as bg
from bayes_greybox.inference.checkpoint import Checkpoint, checkpoint_in
from bayes_greybox.inference.sampler import chain_file
from bayes_greybox.running.errors import InputError

SETTINGS = {"draws": 60, "tune": 120, "chains": 2, "progress": False}


def model(**changes) -> bg.GreyBox:
    plain = {"dictionary": {"x": ["x"]}, "prior": bg.priors.Normal(), "discrepancy": bg.OrthogonalGP(features=4)}
    return bg.GreyBox(**(plain | changes))


@pytest.fixture(scope="module")
def data():
    return tiny_data(n=20)


@pytest.fixture(scope="module")
def reference(data):
    return model().fit(data, **SETTINGS)


class Stopped(BaseException):
    """As Ctrl-C."""


def interrupted(monkeypatch, pieces: int, run) -> None:
    """Stop a run after some pieces of its chains."""
    seen, lock = [0], threading.Lock()
    write = chain_file.ChainFile.write

    def counted(self, chain, *, now=False):
        write(self, chain, now=now)
        with lock:
            seen[0] += 1
            if seen[0] == pieces:
                raise Stopped

    with monkeypatch.context() as patch, pytest.raises(Stopped):
        patch.setattr(chain_file.ChainFile, "write", counted)
        run()


@pytest.fixture(scope="module")
def stopped_once(data, tmp_path_factory):
    """A folder in which a run was stopped after so many pieces of its chains; run once for each number."""

    @cache
    def at(pieces: int) -> Path:
        folder = tmp_path_factory.mktemp("stopped") / "kept"
        kept = {"checkpoint": folder, "checkpoint_every": 0}
        with pytest.MonkeyPatch.context() as patch:
            interrupted(patch, pieces, lambda: model().fit(data, **SETTINGS, **kept))
        return folder

    return at


@pytest.fixture
def stopped(stopped_once, tmp_path):
    """A copy of such a folder, which a test may go on in."""

    def at(pieces: int) -> str:
        return str(shutil.copytree(stopped_once(pieces), tmp_path / "kept"))

    return at


def contents(folder: str) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in Path(folder).iterdir()}


def same(fit: bg.Fit, other: bg.Fit) -> bool:
    return all(
        fit.idata[group].to_dataset().equals(other.idata[group].to_dataset()) for group in ("posterior", "sample_stats")
    )


@pytest.mark.parametrize("pieces", [1, 5, 9])
def test_a_stopped_run_goes_on_to_the_same_draws_and_leaves_nothing(data, reference, stopped, pieces):
    folder = stopped(pieces)
    assert "of-fit.json" in os.listdir(folder) and any(name.endswith(".npz") for name in os.listdir(folder))
    assert same(model().fit(data, **SETTINGS, checkpoint=folder, resume=True), reference)
    assert not os.path.exists(folder)


def test_how_iterations_are_divided_changes_no_draw(data, reference, monkeypatch):
    monkeypatch.setattr("bayes_greybox.inference.sampler.nuts._next_length", lambda length, seconds: length % 7 + 1)
    assert same(model().fit(data, **SETTINGS), reference)


def test_another_run_is_refused_with_what_differs(data, reference, stopped):
    folder = stopped(5)
    for changes, settings, said in (
        ({}, {"draws": 70}, "draws is 70 and was 60"),
        ({}, {"seed": 1}, "seed is 1 and was 0"),
        ({"prior": bg.priors.Laplace()}, {}, "model.prior.kind is Laplace and was Normal"),
        ({"discrepancy": None}, {}, "model.discrepancy is null and was"),
    ):
        with pytest.raises(InputError, match=f"are of another run: {said}.*start anew without resuming"):
            model(**changes).fit(data, **{**SETTINGS, **settings}, checkpoint=folder, resume=True)
    # The draws are still there for who asked for them.
    assert same(model().fit(data, **SETTINGS, checkpoint=folder, resume=True), reference)


def test_other_data_are_refused(stopped):
    with pytest.raises(InputError, match=r"data is 20 rows \(\w+\) and was 20 rows"):
        model().fit(tiny_data(n=20, seed=2), **SETTINGS, checkpoint=stopped(5), resume=True)


def test_a_chain_that_starts_elsewhere_is_another_one(tmp_path):
    """Of a prior of one's own nothing tells what it is but what it computes."""
    state, argument = [np.zeros(2), np.float32(3.0)], {"x": np.arange(3)}
    names = {
        chain_file.name_of(argument, state, 10, 20),
        chain_file.name_of(argument, [np.zeros(2), np.float32(3.0000002)], 10, 20),
        chain_file.name_of({"x": np.arange(4)}, state, 10, 20),
        chain_file.name_of(argument, state, 20, 10),
    }
    assert len(names) == 4
    one, *others = (chain_file.ChainFile(tmp_path / "chain-1-0.npz", 0, name) for name in sorted(names))
    one.write(chain_file.SoFar(state, 7), now=True)
    found = one.read()
    assert found is not None and found.done == 7 and found.records == () and found.divergences == 0
    assert all(np.array_equal(kept, leaf) for kept, leaf in zip(found.state, state, strict=True))
    for other in others:
        with pytest.raises(InputError, match="is the chain of another model or other data"):
            other.read()


def test_without_resuming_a_run_begins_anew(data, reference, stopped):
    folder = stopped(5)
    with checkpoint_in(folder) as checkpoint:
        checkpoint.require("fit", {"seed": 3})
        assert sorted(os.listdir(folder)) == [".lock", "of-fit.json"]
    assert same(model().fit(data, **SETTINGS, checkpoint=folder), reference)


def test_nothing_to_resume_is_a_beginning_in_a_folder_and_a_mistake_without_one(data, reference, tmp_path):
    assert same(model().fit(data, **SETTINGS, checkpoint=tmp_path / "kept", resume=True), reference)
    with pytest.raises(InputError, match="resume=True needs checkpoint="):
        model().fit(data, **SETTINGS, resume=True)
    with pytest.raises(InputError, match="checkpoint_every=-1 must be"):
        model().fit(data, **SETTINGS, checkpoint=tmp_path / "kept", checkpoint_every=-1)


def test_what_is_not_ours_stays(tmp_path):
    (tmp_path / "mine.npz").touch()
    with checkpoint_in(tmp_path) as checkpoint:
        assert not checkpoint.holds_draws
        checkpoint.complete()
    assert os.listdir(tmp_path) == ["mine.npz"]


def test_a_full_disk_stops_no_sampling_and_keeps_what_was_kept(data, reference, stopped, monkeypatch):
    folder = stopped(5)
    before = contents(folder)

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    with checkpoint_in(folder, resume=True, every=0) as checkpoint:
        assert same(model().fit(data, **SETTINGS, checkpoint=checkpoint), reference)
    assert contents(folder) == before


def test_a_folder_that_cannot_be_written_to_or_is_taken_is_refused_before_sampling(data, tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="Cannot keep the draws in the folder .*Not a directory"):
        model().fit(data, **SETTINGS, checkpoint=tmp_path / "file" / "kept")
    with checkpoint_in(tmp_path / "kept"), pytest.raises(InputError, match="is being written to by another process"):
        model().fit(data, **SETTINGS, checkpoint=tmp_path / "kept")


def test_a_damaged_chain_is_named(data, stopped):
    folder = stopped(5)
    chain = next(Path(folder).glob("*.npz"))
    chain.write_bytes(chain.read_bytes()[:100])
    with pytest.raises(InputError, match=f"{chain.name}. is damaged .*: remove it"):
        model().fit(data, **SETTINGS, checkpoint=folder, resume=True)


def test_the_record_is_plain_text(stopped):
    record = json.loads(contents(stopped(5))["of-fit.json"])
    assert record["seed"] == 0 and record["model"]["prior"]["kind"] == "Normal" and "jax" in record["versions"]


def test_a_checkpoint_that_is_given_is_completed_by_who_gave_it(data, reference, tmp_path):
    with checkpoint_in(tmp_path / "kept") as checkpoint:
        assert isinstance(checkpoint, Checkpoint)
        model().fit(data, **SETTINGS, checkpoint=checkpoint)
        assert checkpoint.holds_draws
    with checkpoint_in(tmp_path / "kept", resume=True) as checkpoint:
        assert same(model().fit(data, **SETTINGS, checkpoint=checkpoint), reference)
        checkpoint.complete()
    assert not (tmp_path / "kept").exists()


@pytest.mark.slow
def test_an_exact_posterior_goes_on_to_the_same_draws_and_refuses_other_priors(tmp_path, monkeypatch):
    t, rng = np.linspace(0.0, 4.0, 12), np.random.default_rng(3)
    data = bg.Trajectories.from_arrays(t, states={"x": 2 * np.exp(-0.7 * t) + 0.1 * rng.standard_normal(12)})
    fit = bg.GreyBox({"x": ["x"]}, rows=bg.TrajectoryRows(), discrepancy=None).fit(data, **SETTINGS)
    whole = fit.refine(**SETTINGS)
    folder = tmp_path / "refined"
    interrupted(monkeypatch, 5, lambda: fit.refine(**SETTINGS, checkpoint=folder, checkpoint_every=0))
    with pytest.raises(bg.InputError, match="starts is"):
        fit.refine(**SETTINGS, starts={"x": (2.0, 1.0)}, checkpoint=folder, resume=True)
    assert same(fit.refine(**SETTINGS, checkpoint=folder, resume=True), whole)
    assert not folder.exists()
