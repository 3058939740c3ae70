"""The runner: stopped runs go on, and what cannot be run is refused."""

import json
from collections import Counter

import pandas as pd
import pytest
from hidden_cases import SILENT, effect

from bayes_greybox.running.errors import InputError
from benchmarks.hidden_effects.cases import HiddenCase
from benchmarks.hidden_effects.run import HIDDEN_EFFECTS, Ways, to_solve
from benchmarks.runner import RESULTS, Asked, perform


def knows_all(data):
    """A solver that peeks."""
    verdict = {"null": "no gap", "mis-calibrated": "recalibrate", "off-catalogue": "unknown"}.get(data.case.family)
    effects = [effect(t.slug, mean=t.coefficient, sd=abs(t.coefficient) / 100) for t in data.effects]
    return {"verdict": verdict or "named", "effects": [] if verdict else effects, "seconds": 0.1}


def run(folder, cases, solve, workers=1):
    return perform(HIDDEN_EFFECTS, to_solve(cases, Ways(solve)), Asked(folder, workers=workers, progress=False))


SIMPLE = HiddenCase("catalogue", "rl", ("cubic-resistor",), (2.0,), 0.05, 1)
FEW = (SIMPLE, SILENT, HiddenCase("mis-calibrated", "rc", (), (), 0.05, 4))


def test_a_stopped_run_goes_on(tmp_path):
    calls = []

    def fails_once(data):
        calls.append(data.case.key)
        if data.case == SILENT and calls.count(data.case.key) == 1:
            raise RuntimeError("no luck")
        return knows_all(data)

    def go():
        return run(tmp_path, FEW, fails_once)

    scores = go()
    assert len(calls) == 3
    assert scores["families"].loc["null", "study"] == 0.0
    file = tmp_path / RESULTS
    assert "no luck" in json.loads(file.read_text().splitlines()[1])["error"]

    # Only what failed is run again, and a line that was cut off while it was written.
    lines = file.read_text().splitlines()
    file.write_text("\n".join([*lines[:2], lines[2][:40]]))
    scores = go()
    assert Counter(calls) == {SIMPLE.key: 1, SILENT.key: 2, FEW[2].key: 2}
    assert scores["families"].loc["all", "study"] == 1.0
    go()
    assert len(calls) == 5
    assert all(json.loads(line) for line in file.read_text().splitlines())

    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["cases"] == 3
    assert {entry["family"] for entry in summary["families"]} >= {"catalogue", "null", "all"}
    assert len(pd.read_csv(tmp_path / "cases.csv")) == 3


def test_results_of_another_version_are_not_mixed_in(tmp_path):
    run(tmp_path, FEW[1:2], knows_all)
    file = tmp_path / RESULTS
    file.write_text(json.dumps({**json.loads(file.read_text()), "version": "0.0.0"}) + "\n")
    calls = []
    run(tmp_path, FEW[1:2], lambda d: calls.append(1) or knows_all(d))
    assert calls == [1]


@pytest.mark.slow
def test_two_workers(tmp_path):
    scores = run(tmp_path, FEW[:2], knows_all, workers=2)
    assert scores["families"].loc["all", "study"] == 1.0


def test_bad_settings_are_refused(tmp_path):
    with pytest.raises(InputError, match="at least one case"):
        run(tmp_path, (), knows_all)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="Cannot write"):
        run(tmp_path / "file", FEW, knows_all)
