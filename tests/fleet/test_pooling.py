"""One coefficient in many assets, against sums on a grid of both unknowns and on data made from known ones."""

import numpy as np
import pytest
from scipy.stats import norm

from bayes_greybox.discovery.fleet.pooling import DIFFER, pooled
from bayes_greybox.running.errors import InputError

SCHOOLS = [28, 8, -3, 7, -1, 1, 18, 12], [15, 10, 16, 11, 9, 11, 10, 18]
"""Eight schools (Gelman et al. 2013, Table 5.2)."""


def on_a_grid(b, s):
    """Mean and standard deviation of μ, quantiles of τ, own means: by sums over μ and τ, nothing in closed form."""
    b, s = np.array(b, float), np.array(s, float)
    scale = DIFFER * np.sqrt(np.mean(b**2))
    mu, tau = np.linspace(-60, 80, 351), np.linspace(0, 8 * scale, 1201)
    spread = np.sqrt(s**2 + tau[:, None, None] ** 2)
    log_p = norm.logpdf(b, mu[None, :, None], spread).sum(axis=2) + norm.logpdf(tau, 0, scale)[:, None]
    p = np.exp(log_p - log_p.max())
    p[0] /= 2
    p /= p.sum()
    # As likely beforehand: one coefficient for all.
    one = norm.logpdf(b, mu[:, None], s).sum(axis=1)
    area = np.exp(log_p - log_p.max()).sum() * (tau[1] - tau[0]) * 2
    same = np.exp(one - log_p.max()).sum() / (np.exp(one - log_p.max()).sum() + area)
    p *= 1 - same
    p[0] += same * np.exp(one - one.max()) / np.exp(one - one.max()).sum()
    mean = (p.sum(axis=0) * mu).sum()
    sd = np.sqrt((p.sum(axis=0) * (mu - mean) ** 2).sum())
    quantiles = np.interp([0.05, 0.5, 0.95], np.cumsum(p.sum(axis=1)), tau)
    share = s**2 / (s**2 + tau[:, None] ** 2)
    own = [(p * ((1 - share[:, i : i + 1]) * b[i] + share[:, i : i + 1] * mu)).sum() for i in range(len(b))]
    return mean, sd, quantiles, own


def test_eight_schools_agree_with_sums_over_both_unknowns():
    found = pooled(*SCHOOLS)
    mean, sd, quantiles, own = on_a_grid(*SCHOOLS)
    assert found.mean == pytest.approx(mean, abs=0.02) and found.sd == pytest.approx(sd, rel=5e-3)
    assert (found.between_lower, found.between, found.between_upper) == pytest.approx(tuple(quantiles), abs=0.03)
    np.testing.assert_allclose(found.each, own, atol=0.03)
    assert found.lower < found.mean < found.upper


def test_one_coefficient_is_known_as_well_as_all_data_tell_it():
    found = pooled([-40.003, -40.01, -39.996], [0.01, 0.01, 0.01])
    assert found.same > 0.99 and found.between_upper == 0
    assert found.mean == pytest.approx(-40.003, abs=1e-3)
    assert found.upper - found.lower < 5 * 0.01


def test_the_probability_of_one_coefficient_is_a_ratio_of_densities():
    b, s = np.array(SCHOOLS[0], float), np.array(SCHOOLS[1], float)
    mu, scale = np.linspace(-200, 200, 801), DIFFER * np.sqrt(np.mean(b**2))
    one = np.exp(norm.logpdf(b, mu[:, None], s).sum(axis=1)).sum()
    tau = np.linspace(0, 8 * scale, 1501)
    each = [np.exp(norm.logpdf(b, mu[:, None], np.hypot(s, t)).sum(axis=1)).sum() for t in tau]
    differ = np.trapezoid(np.array(each) * 2 * norm.pdf(tau, 0, scale), tau)
    assert pooled(b, s).same == pytest.approx(one / (one + differ), abs=2e-3)


@pytest.mark.parametrize(("between", "low", "high"), [(0.0, 0.9, 1.0), (2.0, 0.0, 0.01)])
def test_it_tells_one_coefficient_from_many(between, low, high):
    rng = np.random.default_rng(0)
    own = -40 + between * rng.standard_normal(30)
    found = pooled(own + 0.5 * rng.standard_normal(30), np.full(30, 0.5))
    assert low <= found.same <= high
    assert found.lower < -40 < found.upper


def test_intervals_hold_the_whole_and_the_spread_as_often_as_they_say():
    """200 fleets of 12: 0.9 of the intervals hold, up to four standard errors."""
    rng, held = np.random.default_rng(1), np.zeros(2)
    for _ in range(200):
        mu, tau = 10.0, abs(rng.normal(0, DIFFER * 10))
        s = rng.uniform(0.5, 2.0, 12)
        found = pooled(mu + tau * rng.standard_normal(12) + s * rng.standard_normal(12), s)
        held += found.lower < mu < found.upper, found.between_lower < tau < found.between_upper
    assert np.all(np.abs(held / 200 - 0.9) < 4 * np.sqrt(0.09 / 200))


def test_in_other_units_it_is_the_same():
    found, other = pooled(*SCHOOLS), pooled(*(np.array(each) * -1e6 if k == 0 else np.array(each) * 1e6
                                              for k, each in enumerate(SCHOOLS)))  # fmt: skip
    assert other.mean == pytest.approx(-1e6 * found.mean) and other.between == pytest.approx(1e6 * found.between)
    assert other.same == pytest.approx(found.same)


@pytest.mark.parametrize(
    ("mean", "sd"), [([1.0], [0.1]), ([1.0, 2.0], [0.1]), ([1.0, np.nan], [0.1, 0.1]), ([1.0, 2.0], [0.1, 0.0])]
)
def test_what_cannot_be_pooled_is_refused(mean, sd):
    with pytest.raises(InputError, match="asset"):
        pooled(mean, sd)
