"""Fleets that lose a worker at a random moment say what they say one after another."""

import json
import random
import threading
import time

import psutil
import pytest
from pumps import pumps

from bayes_greybox.fleet.assets import assets_of
from bayes_greybox.fleet.run import study_fleet

FLEETS = 20


def workers():
    """Processes that study: the children of Dask's nannies are theirs, and have no children."""
    every = psutil.Process().children(recursive=True)
    return [p for p in every if "spawn_main" in " ".join(p.cmdline()) and not p.children()]


def kill_one(after, killed):
    """Kill a worker so many seconds after there are two."""
    while True:
        try:
            if len(found := workers()) >= 2:
                break
        except psutil.NoSuchProcess:
            pass
        time.sleep(0.1)
    time.sleep(after)
    for process in random.sample(found, len(found)):
        if process.is_running():
            process.kill()
            killed.append(process.pid)
            return


def said(folder):
    found = {}
    for k in range(3):
        record = json.loads((folder / "assets" / f"pump {k}" / "summary.json").read_text(encoding="utf-8"))
        del record["settings"]["seconds"]
        found[k] = record
    return found


@pytest.mark.slow
def test_fleets_that_lose_a_worker_say_the_same(tmp_path):
    folder, random_ = pumps(tmp_path), random.Random(0)
    assets = assets_of(folder / "pumps", folder / "all.toml")
    study_fleet(assets, folder / "serial", {}, workers=1, progress=False)
    serial, lost = said(folder / "serial"), 0
    for k in range(FLEETS):
        killed = []
        thread = threading.Thread(target=kill_one, args=(random_.uniform(0.5, 8.0), killed), daemon=True)
        thread.start()
        found = study_fleet(assets, folder / f"killed-{k}", {}, workers=2, progress=False)
        thread.join(timeout=60)
        assert not found.failed and said(folder / f"killed-{k}") == serial
        lost += len(killed)
    print(f"{FLEETS} of {FLEETS} fleets as one after another; {lost} workers killed")
    assert lost >= FLEETS // 2
