"""The benchmark of the exact trajectory posterior: what its tables say, and the reference itself."""

import os

import numpy as np
import pandas as pd
import pytest

from bayes_greybox.data.datasets import load_hudson_bay
from benchmarks.hudson_bay.run import BY_HAND, HUDSON_BAY, REFERENCE, REFINED, compared, refined, speed


def drawn(shift=0.0, widen=1.0):
    """Normal draws about the reference's means."""
    rng = np.random.default_rng(0)
    moments = {name: (mean, sd) for name, (mean, sd, *_) in REFERENCE.items()}
    return {name: mean + sd * (shift + widen * rng.standard_normal((4, 4000))) for name, (mean, sd) in moments.items()}


def test_errors_are_over_the_references_standard_deviations():
    rows = [{"sampler": name, **speed(drawn(), 10.0)} for name in (REFINED, BY_HAND)]
    rows[0]["quantities"] = compared(drawn(shift=0.5, widen=1.2))
    table = HUDSON_BAY.score(rows)["quantities"]
    np.testing.assert_allclose(table["mean"], 0.5, atol=0.05)
    np.testing.assert_allclose(table["sd"], 1.2, atol=0.05)
    # Quantiles of a normal posterior move with both; the reference's own is a little skewed.
    np.testing.assert_allclose(table["50 %"], 0.5, atol=0.2)
    low, middle, high = table[["5 %", "50 %", "95 %"]].mean()
    assert low < middle - 0.1 < middle + 0.1 < high


def test_speed_is_that_of_the_slowest_quantity():
    draws = drawn()
    free = speed(draws, 10.0)
    assert free["a second"] == pytest.approx(free["effective draws"] / 10.0)
    assert free["effective draws"] > 8000
    slow = np.repeat(draws["alpha"][:, ::20], 20, axis=1)
    assert speed({**draws, "alpha": slow}, 10.0)["effective draws"] < 0.2 * free["effective draws"]


@pytest.mark.slow
@pytest.mark.skipif("BAYES_GREYBOX_DATA" not in os.environ, reason="needs the measured data")
def test_the_posterior_is_the_references():
    table = pd.DataFrame(compared(refined(load_hudson_bay(), seed=2, progress=False))).T
    assert np.all(np.abs(table["mean"]) < 0.1)
    assert np.all(np.abs(table["sd"] - 1) < 0.07)
    assert np.all(np.abs(table[["5 %", "50 %", "95 %"]]) < 0.15)
