"""Priors that are no plain normal densities, against sums over a fine grid."""

import numpy as np
import pytest
from scipy.stats import norm

from bayes_greybox.discovery.grid.sets import EXPECTED_SPREAD, WRONG_SIGN, log_ranges
from bayes_greybox.discovery.grid.table import EFFECT, SENSOR, Regressor

X = np.linspace(-12.0, 12.0, 2_000_000)
"""Zero, where signs change, is half-way between two of them."""

CASES = pytest.mark.parametrize(("mean", "sd"), [(1.0, 0.01), (0.02, 0.014), (0.6, 0.3), (-0.5, 0.2), (0.0, 0.9)])


def summed(ratio, mean, sd):
    """Log posterior mean of the ratio of two priors."""
    return np.log(np.maximum(np.trapezoid(norm.pdf(X, mean, sd) * ratio, X), 1e-300))


def found(regressor, mean, sd):
    return log_ranges(regressor, np.array([mean]), np.array([sd])).item()


@CASES
@pytest.mark.parametrize("sign", [-1, 1])
def test_an_expected_sign_is_nine_times_as_likely_as_the_other(mean, sd, sign):
    ratio = 2 * np.where(np.sign(X) == sign, 1 - WRONG_SIGN, WRONG_SIGN)
    assert found(Regressor(EFFECT, "e", "e", 1.0, sign=sign), mean, sd) == pytest.approx(
        summed(ratio, mean, sd), abs=1e-5
    )


@CASES
def test_an_error_of_a_sensor_is_within_its_limit(mean, sd):
    expected = norm.logcdf((1.5 - abs(mean)) / sd)
    assert found(Regressor(SENSOR, "s", "s", 0.3, limits=(-5.0, 5.0)), mean, sd) == pytest.approx(expected, abs=1e-9)


@CASES
@pytest.mark.parametrize("expected", [0.8, -0.8])
def test_a_coefficient_that_is_about_as_large_as_another_has_that_prior_in_place_of_its_own(mean, sd, expected):
    # On the other side of zero it is another thing: a lead, and no lag.
    near = np.where(np.sign(X) == np.sign(expected), norm.pdf(X, expected, EXPECTED_SPREAD * abs(expected)), 0.0)
    ratio = near / norm.cdf(1 / EXPECTED_SPREAD) / norm.pdf(X, 0.0, 1.0)
    effect = Regressor(EFFECT, "e", "e", 1.0, expected=expected)
    # Where there is nothing left sums have no digits.
    assert max(found(effect, mean, sd), np.log(1e-300)) == pytest.approx(summed(ratio, mean, sd), abs=1e-4)


def test_what_has_a_plain_prior_adds_nothing():
    plain = Regressor(EFFECT, "e", "e", 1.0)
    assert not plain.ranged and found(plain, 3.0, 0.1) == 0.0
    for ranged in (Regressor(EFFECT, "e", "e", 1.0, sign=1), Regressor(SENSOR, "s", "s", 1.0, limits=(-5.0, 5.0))):
        assert ranged.ranged


def test_what_is_known_exactly_is_no_division_by_zero():
    assert np.isfinite(found(Regressor(EFFECT, "e", "e", 1.0, sign=1, expected=0.5), 0.5, 0.0))
    assert np.isfinite(found(Regressor(SENSOR, "s", "s", 1.0, limits=(-5.0, 5.0)), 1.0, 0.0))
    # The priors' ratio there, without what rounding makes of 1/sd².
    effect = Regressor(EFFECT, "e", "e", 1.0, expected=0.8)
    ratio = norm.logpdf(0.7, 0.8, EXPECTED_SPREAD * 0.8) - norm.logcdf(1 / EXPECTED_SPREAD) - norm.logpdf(0.7)
    for sd in (1e-6, 1e-12, 0.0):
        assert found(effect, 0.7, sd) == pytest.approx(ratio, abs=1e-5)
