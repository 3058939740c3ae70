"""Shapes of the noise ring where they are the truth, and stay quiet where noise is white and normal."""

import numpy as np
import pytest

from bayes_greybox.discovery.linearise.near import noise_shapes
from bayes_greybox.discovery.odds import Odds
from bayes_greybox.model.noise.noise_model import HEAVY, VARYING

N = 300
X = np.sin(0.07 * np.arange(N))


def shapes(white):
    return noise_shapes(white / np.std(white), {"x": X, "other": np.cos(0.4 * np.arange(N))}, Odds())


def test_white_noise_has_no_shape():
    """A Bayes factor of one against prior odds of nineteen is near the threshold: one of ten records may pass it."""
    found = [shapes(np.random.default_rng(seed).standard_normal(N)) for seed in range(10)]
    assert sum(bool(each) for each in found) <= 3
    # What passes is unlikely all the same: its prior and its parameters' cost are counted.
    assert all(shape.log_prior < 0 for each in found for shape in each)


def test_outliers_ring():
    shape = next(each for each in shapes(np.random.default_rng(0).standard_t(2, N)) if each.name == HEAVY)
    assert shape.about[HEAVY]["degrees"] <= 4
    # Rows far off have a larger standard deviation, those near the middle hardly one.
    white = np.random.default_rng(0).standard_t(2, N)
    assert np.corrcoef(np.abs(white), shape.spread)[0, 1] > 0.8


def test_noise_that_grows_with_something_rings_and_says_with_what():
    found = shapes(X * np.random.default_rng(1).standard_normal(N))
    first = next(shape for shape in found if shape.name == VARYING)
    assert first.about[VARYING]["variable"] == "x" and first.about[VARYING]["exponent"] >= 0.75
    assert np.corrcoef(np.abs(X), first.spread)[0, 1] > 0.9


def test_both_at_once_are_one_shape_of_both():
    rng = np.random.default_rng(2)
    found = shapes((0.1 + X**2) * rng.standard_t(2, N))
    assert any(HEAVY in shape.name and VARYING in shape.name for shape in found)
    (both,) = [shape for shape in found if "+" in shape.name]
    # Two suspects have the odds of two.
    alone = min(shape.log_prior for shape in found if shape is not both) if len(found) > 1 else 0.0
    assert set(both.about) == {HEAVY, VARYING} and np.isfinite(alone)


@pytest.mark.parametrize("white", [np.ones(10), np.full(N, np.nan)], ids=["few", "not finite"])
def test_what_says_nothing_has_no_shape(white):
    assert noise_shapes(white, {}, Odds()) == ()
