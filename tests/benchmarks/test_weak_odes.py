"""Weak ODEs: the data, the scores, and what a draw records."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_greybox.physics.terms import Term
from bayes_greybox.running.errors import InputError
from benchmarks.runner import Asked, perform
from benchmarks.weak_odes.run import WEAK_ODES, cases, identified, score
from benchmarks.weak_odes.systems import weak_systems


def test_systems_are_those_that_were_published():
    known = weak_systems()
    assert {name: each.samples for name, each in known.items()} == {
        "duffing": 3001, "van-der-pol": 3001, "lotka-volterra": 1001, "pendulum": 501, "lorenz": 10_001,
    }  # fmt: skip
    assert {name: len(each.candidates) for name, each in known.items()} == {
        "duffing": 21, "van-der-pol": 21, "lotka-volterra": 21, "pendulum": 29, "lorenz": 56,
    }  # fmt: skip
    for each in known.values():
        assert all(term in each.candidates for own in each.truth.values() for term in own)


@pytest.mark.parametrize("name", ["duffing", "pendulum", "lotka-volterra"])
def test_samples_follow_the_true_terms(name):
    each = weak_systems()[name]
    rate = np.gradient(each.exact, each.time, axis=0)[2:-2]
    values = {state: each.exact[2:-2, k] for k, state in enumerate(each.states)}
    for k, state in enumerate(each.states):
        said = sum(b * Term(term).evaluate(values) for term, b in each.truth[state].items())
        # Central differences err by h²/6 of the third derivative.
        np.testing.assert_allclose(said, rate[:, k], atol=0.02 * np.max(np.abs(rate[:, k])))


def test_noise_is_over_the_size_of_all_states():
    each = weak_systems()["duffing"]
    data = each.sampled(0.1, 0, 0)
    left = data.matrix(each.states) - each.exact
    # Six thousand numbers: four standard errors.
    assert np.std(left) == pytest.approx(0.1 * np.sqrt(np.mean(each.exact**2)), rel=4 / np.sqrt(2 * left.size))
    again, other = each.sampled(0.1, 0, 0), each.sampled(0.1, 1, 0)
    np.testing.assert_array_equal(again.states["x"], data.states["x"])
    assert not np.allclose(other.states["x"], data.states["x"])


def test_scores():
    each = weak_systems()["lotka-volterra"]
    truth = {name: dict(own) for name, own in each.truth.items()}
    assert each.error(truth) == 0 and each.true_positives(truth) == 1
    off = {"x": {"x": 3.0, "x*y": -1.0, "y**2": 0.5}, "y": {"x*y": 1.0}}
    assert each.error(off) == pytest.approx(np.sqrt((0.25 + 36.0) / 47.0))
    assert each.true_positives(off) == pytest.approx(3 / 5)


@pytest.mark.slow
def test_a_draw_is_identified():
    row = {"system": "lotka-volterra", "noise": 0.05, **identified("lotka-volterra", 0.05, 0, 0)}
    assert row["tpr"] == 1.0 and row["error"] < 0.01 and len(row["holds"]) == 4
    table = score([row, {**row, "tpr": 0.8, "holds": [True]}])["systems"]
    found = table.loc[("lotka-volterra", 0.05)]
    assert found["draws"] == 2 and found["exact"] == 0.5 and found["TPR"] == pytest.approx(0.9)
    assert found["coverage"] == np.mean(row["holds"]) and found["intervals"] == 4
    # Half of the bound at twice the noise.
    each = weak_systems()["lotka-volterra"]
    assert found["efficient"] == pytest.approx(each.efficient(0.1) / 2, rel=1e-6)


def test_a_run_goes_on(tmp_path):
    row = {"coefficients": {}, "error": 1.0, "tpr": 0.0, "holds": [], "probability": 1.0, "rows": 1, "seconds": 0.0}
    asked = []

    def measured(name, noise, replicate, seed):
        asked.append((name, noise, replicate))
        return row

    def run(replicates):
        options = Asked(tmp_path, replicates=replicates, progress=False)
        chosen = cases(options, ["lotka-volterra"], noises=(0.1,))
        return perform(replace(WEAK_ODES, run=measured), chosen, options)["systems"]

    first, second = run(2), run(3)
    assert asked == [("lotka-volterra", 0.1, k) for k in range(3)]
    assert first.loc[("lotka-volterra", 0.1), "draws"] == 2 and second.loc[("lotka-volterra", 0.1), "draws"] == 3
    assert (tmp_path / "systems.csv").exists() and (tmp_path / "summary.json").exists()


def test_a_system_that_does_not_exist_is_refused(tmp_path):
    with pytest.raises(InputError, match="There is no system 'clock'"):
        cases(Asked(tmp_path, only=["clock"]))
