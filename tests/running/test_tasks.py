"""Tasks here and on workers: the same comes of them, and one that fails or loses its worker costs itself alone."""

import os
import signal
import sys
import time
from pathlib import Path

import pytest

from bayes_greybox.running.errors import InputError
from bayes_greybox.running.tasks import SCHEDULER_LOST, Done, run_tasks


def squared(x):
    if x < 0:
        raise InputError("x is negative; give another one.")
    return x**2 if x else 1 // x


def dies_once(place, x):
    """Its worker is killed the first time, as by a machine that fails."""
    mark = Path(place) / str(x)
    if x == 2 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return x**2


@pytest.mark.parametrize("workers", [1, 2])
def test_what_fails_costs_itself_alone(workers):
    tasks = {"two": (2,), "negative": (-1,), "nought": (0,), "three": (3,)}
    found = {done.name: done for done in run_tasks(squared, tasks, workers=workers)}
    assert {name: done.result for name, done in found.items()} == {
        "two": 4,
        "three": 9,
        "negative": None,
        "nought": None,
    }
    assert found["negative"].failed == "x is negative; give another one."
    assert found["nought"].failed.startswith("ZeroDivisionError")
    assert not found["two"].failed


def test_a_worker_that_dies_costs_its_task_and_nothing_else(tmp_path):
    tasks = {str(x): (str(tmp_path), x) for x in range(6)}
    found = {done.name: done.result for done in run_tasks(dies_once, tasks, workers=2)}
    assert (tmp_path / "2").exists()
    assert found == {str(x): x**2 for x in range(6)}


def test_a_scheduler_that_is_lost_costs_what_is_not_done():
    distributed = pytest.importorskip("distributed")
    place = distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None, silence_logs=50
    )
    tasks = run_tasks(time.sleep, {"a": (0,), "b": (1,), "c": (0,)}, scheduler=place.scheduler_address)
    first = next(tasks)
    place.close()
    assert first == Done("a")
    assert {done.name: done.failed for done in tasks} == {"b": SCHEDULER_LOST, "c": SCHEDULER_LOST}


def test_bad_places_are_refused_in_a_sentence():
    with pytest.raises(InputError, match="workers of its own"):
        list(run_tasks(squared, {"a": (1,), "b": (2,)}, workers=2, scheduler="tcp://127.0.0.1:1"))
    with pytest.raises(InputError, match="No Dask scheduler answers"):
        list(run_tasks(squared, {"a": (1,), "b": (2,)}, scheduler="tcp://127.0.0.1:1"))


def test_without_dask_tasks_run_here(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert [done.result for done in run_tasks(squared, {"a": (1,), "b": (2,)})] == [1, 4]
    with pytest.raises(InputError, match="pip install"):
        list(run_tasks(squared, {"a": (1,), "b": (2,)}, workers=2))
