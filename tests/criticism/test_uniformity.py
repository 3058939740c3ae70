"""The band and the p-value against simulated uniform values, and values that are not."""

import numpy as np
import pytest
from scipy.stats import binom

from bayes_greybox.criticism.calibration.uniformity import ecdf_difference, simultaneous_band, uniformity_p


def _outside(values, band):
    difference = ecdf_difference(values)
    return bool(np.any((difference < band.lower - 1e-9) | (difference > band.upper + 1e-9)))


def _allowed(share, n):
    """Counts that a binomial with this share exceeds, either way, once in 10,000 runs."""
    return binom.ppf([5e-5, 1 - 5e-5], n, share)


@pytest.mark.parametrize(("n", "level"), [(20, 0.1), (60, 0.05), (250, 0.01), (250, 0.2)])
def test_uniform_values_leave_the_band_as_often_as_stated(n, level):
    rng, runs = np.random.default_rng(n), 4000
    band = simultaneous_band(n, level)
    left = sum(_outside(rng.random(n), band) for _ in range(runs))
    assert left <= _allowed(level, runs)[1]
    # Counts are whole, so the band can be somewhat too wide, but not by half.
    assert left >= _allowed(0.5 * level, runs)[0]


def test_p_values_of_uniform_values_are_below_a_level_as_often_as_that():
    rng, runs = np.random.default_rng(3), 400
    p = np.array([uniformity_p(rng.random(60)) for _ in range(runs)])
    for level in (0.02, 0.1, 0.5):
        assert np.sum(p <= level) <= _allowed(level, runs)[1]
        assert np.sum(p <= level) >= _allowed(0.6 * level, runs)[0]


def test_the_p_value_and_the_band_agree():
    rng = np.random.default_rng(4)
    band = simultaneous_band(100, 0.05)
    for power in np.linspace(0.6, 1.4, 60):
        values = rng.random(100) ** power
        assert _outside(values, band) == (uniformity_p(values) <= 0.05)


@pytest.mark.parametrize(
    "values",
    [
        lambda u: 0.9 * u,  # draws too large
        lambda u: 0.5 + 0.8 * (u - 0.5),  # draws too wide
        lambda u: 0.5 + 0.5 * np.sign(u - 0.5) * np.abs(2 * u - 1) ** 0.7,  # too narrow
        lambda u: np.round(u),
    ],
)
def test_values_that_are_not_uniform_are_found(values):
    u = np.random.default_rng(5).random(500)
    assert uniformity_p(values(u)) < 1e-3
    assert uniformity_p(u) > 1e-3
