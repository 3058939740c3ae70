"""Coefficients that change with time: their elements, and what a study makes of a machine that changes."""

import numpy as np
import pytest
from tiny_equation import CUBE, tiny_study_of

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.sensor_errors.memory import DRIFT, SETTLING, Memory, drift_columns

T = np.linspace(0, 30, 400)


def studied(path, hidden, noise=0.02):
    """ẋ = −x + hidden(t, x) along a path in order of time."""
    x = path(T)
    rate = -x + hidden(T, x) + noise * np.random.default_rng(5).standard_normal(len(T))
    return tiny_study_of([CUBE], Trajectories.from_arrays(T, states={"x": x}, derivatives={"x": rate}))


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
    study = studied(path, lambda t, x: -0.4 * shape(t) * x, noise=0.01)
    assert study.verdict.places == () and study.probabilities.by_effect["cube"].probability < 0.3
    assert study.verdict.code in ("unknown", "recalibrate")
    memory = study.memory().droplevel(0)["probability"]
    assert memory.get("drift of x", 0.0) == memory.drop("something that remembers").max()


@pytest.mark.parametrize("path", [swinging, dying])
def test_a_law_of_the_amplitude_is_none_of_the_time(path):
    study = studied(path, lambda t, x: -0.5 * x**3, noise=0.01)
    assert study.verdict.code == "named" and study.probabilities.by_memory["drift of x"] < 0.05


def test_one_instant_has_no_drift():
    data = Trajectories.from_arrays(np.arange(1.0), states={"x": np.ones(1)}, constant="keep")
    assert not list(drift_columns(data))
