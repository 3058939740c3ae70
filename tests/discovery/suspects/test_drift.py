"""Coefficients that change with time: their elements, and what a study makes of a machine that changes."""

import numpy as np
import pytest
from tiny_equation import CUBE, on, tiny_model

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.evidence.evaluations import Evaluations
from bayes_greybox.discovery.evidence.odds import Odds
from bayes_greybox.discovery.evidence.of_equation import sufficient_statistics
from bayes_greybox.discovery.evidence.with_discrepancy import Evaluator
from bayes_greybox.discovery.suspects.drift import DRIFT, SETTLING, drift_columns
from bayes_greybox.discovery.suspects.memory import Memory
from bayes_greybox.discovery.weighing.sets import MEMORY, PLAIN, Sets

T = np.linspace(0, 30, 400)


def weighed(path, hidden, noise=0.02):
    """ẋ = −x + hidden(t, x) along a path in order of time."""
    x = path(T)
    rate = -x + hidden(T, x) + noise * np.random.default_rng(5).standard_normal(len(T))
    data = Trajectories.from_arrays(T, states={"x": x}, derivatives={"x": rate})
    statistics = sufficient_statistics(tiny_model(), data, "x", [on(CUBE)])
    statistics.remember(drift_columns(data))
    evaluator = Evaluator(statistics.prior, statistics.kernel, np.asarray(statistics.basis.frequency))
    known = Evaluations(statistics, Odds(), evaluator)
    return known, Sets(known, 2).weigh()


def swinging(t):
    return 0.7 * np.sin(t) + 0.3 * np.sin(2.3 * t + 1)


def dying(t):
    return np.exp(-t / 15) * np.sin(3 * t + 1)


def test_elements_settle_from_the_start_of_the_record_on():
    t = np.append(np.linspace(2, 5, 31), np.linspace(7, 12, 51))
    data = Trajectories.from_arrays([t[:31], t[31:]], states={"x": [np.cos(t[:31]), np.cos(t[31:])]})
    found = dict(drift_columns(data))
    assert list(found) == [Memory(DRIFT, "x", share) for share in SETTLING]
    np.testing.assert_allclose(found[Memory(DRIFT, "x", 0.8)][:, 0], np.cos(t) * np.exp(-(t - 2) / 8), rtol=1e-12)


@pytest.mark.parametrize("path", [swinging, dying])
@pytest.mark.parametrize("shape", [lambda t: np.exp(-t / 18), lambda t: np.exp(-t / 5), lambda t: t / 30])
def test_a_spring_that_changes_is_no_effect(path, shape):
    known, found = weighed(path, lambda t, x: -0.4 * shape(t) * x, noise=0.01)
    assert found[0].kind == MEMORY and not found[0].effects
    assert known.statistics.columns[found[0].memory[0]].memory.text == "drift of x"


@pytest.mark.parametrize("path", [swinging, dying])
def test_a_law_of_the_amplitude_is_none_of_the_time(path):
    _, found = weighed(path, lambda t, x: -0.5 * x**3, noise=0.01)
    assert found[0].kind == PLAIN and found[0].effects
    assert max(e.log_weight for e in found if e.kind == MEMORY) < found[0].log_weight - 3


def test_one_instant_has_no_drift():
    data = Trajectories.from_arrays(np.arange(1.0), states={"x": np.ones(1)}, constant="keep")
    assert not list(drift_columns(data))
