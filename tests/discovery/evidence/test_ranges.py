"""Signs of effects and limits of suspects, against sums over draws."""

import numpy as np
import pytest
from scipy.stats import norm

from bayes_greybox.discovery.evidence.columns import Column
from bayes_greybox.discovery.evidence.ranges import EXPECTED, SMALL, limited, log_ranges, small
from bayes_greybox.discovery.suspects.channels import GAIN, ChannelSuspect


def suspect(sd=0.1):
    return Column("suspect", None, 1.0, sd, suspect=ChannelSuspect(GAIN, "y", sd))


def test_a_limit_is_the_posterior_probability_of_being_within_it():
    for mean in (0.0, 0.45, 0.5, 0.7):
        found = log_ranges([suspect()], np.array([mean]), np.array([[0.04**2]]))
        assert found == pytest.approx(norm.logcdf((SMALL * 0.1 - mean) / 0.04))
    assert limited(suspect()) and not limited(Column("free", None, 1.0, 1.0))


def test_sets_whose_suspects_would_be_large_are_not_weighed():
    rng = np.random.default_rng(0)
    X = rng.standard_normal((200, 2))
    for gain, possible in ((0.02, True), (0.3, True), (0.9, False)):
        y = X @ [1.0, gain] + 0.05 * rng.standard_normal(200)
        products = (X.T @ X)[None], (X.T @ y)[None], float(y @ y), 200.0
        found = small(*products, np.array([[np.inf, 0.1]]), np.array([[False, True]]))
        assert bool(found[0]) is possible


def test_what_data_say_nothing_of_may_be_anything():
    x = np.random.default_rng(1).standard_normal(50)
    X = np.column_stack([x, x])
    y = x + 0.1 * np.random.default_rng(2).standard_normal(50)
    found = small(
        (X.T @ X)[None], (X.T @ y)[None], float(y @ y), 50.0, np.array([[10.0, 0.1]]), np.array([[False, True]])
    )
    assert bool(found[0])


@pytest.mark.parametrize(("mean", "sd"), [(1.0, 0.01), (0.02, 0.014), (0.6, 0.3), (-0.5, 0.2)])
def test_a_coefficient_that_is_about_as_large_as_another_has_that_prior_in_place_of_its_own(mean, sd):
    expected, wide = 0.8, 1.0
    column = Column("effect", None, 1.0, wide, expected=expected)
    # On the other side of zero it is another thing: a lead, and no lag.
    x = np.linspace(0.0, 6.0, 200_001)
    ratio = norm.pdf(x, expected, EXPECTED * expected) / norm.cdf(1 / EXPECTED) / norm.pdf(x, 0.0, wide)
    total = np.trapezoid(norm.pdf(x, mean, sd) * ratio, x)
    assert log_ranges([column], np.array([mean]), np.array([[sd**2]])) == pytest.approx(np.log(total), abs=1e-6)
    assert limited(column)
