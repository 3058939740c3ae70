"""Ranks with autocorrelated draws and ties, and the reliability of inclusion probabilities."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binomtest

from bayes_greybox.criticism.calibration.ranks import rank_truths
from bayes_greybox.criticism.calibration.reliability import poisson_binomial_p, reliability
from bayes_greybox.criticism.calibration.uniformity import uniformity_p

# A right implementation fails each of these tests at most once in a thousand seeds.
LEVEL = 1e-3


def test_ranks_of_independent_draws_are_uniform_and_few_are_thinned_away():
    rng = np.random.default_rng(0)
    ranks = rank_truths(rng.standard_normal(500), rng.standard_normal((500, 200)), rng)
    assert uniformity_p(ranks.pit) > LEVEL
    assert np.median(ranks.kept) >= 100
    assert np.all((ranks.rank >= 0) & (ranks.rank <= ranks.kept))


def test_autocorrelated_draws_are_thinned():
    rng = np.random.default_rng(1)
    noise = rng.standard_normal((500, 1100))
    chains = lfilter([np.sqrt(1 - 0.9**2)], [1.0, -0.9], noise, axis=1)[:, 100:]
    ranks = rank_truths(rng.standard_normal(500), chains, rng)
    # τ = (1 + 0.9)/(1 − 0.9) = 19
    assert 30 < np.median(ranks.ess) < 90
    assert np.all(ranks.kept <= np.ceil(ranks.ess))
    assert uniformity_p(ranks.pit) > LEVEL


def test_ties_and_constants_are_ranked_at_random():
    rng = np.random.default_rng(2)
    p = rng.random(500)
    truth = (rng.random(500) < p).astype(float)
    draws = (rng.random((500, 200)) < p[:, None]).astype(float)
    assert uniformity_p(rank_truths(truth, draws, rng).pit) > LEVEL
    constant = rank_truths(np.zeros(500), np.zeros((500, 200)), rng)
    assert np.all(constant.kept == 200) and uniformity_p(constant.pit) > LEVEL


def test_poisson_binomial_is_binomial_for_equal_probabilities():
    for hits in (0, 7, 20):
        tail = min(binomtest(hits, 40, 0.3, side).pvalue for side in ("less", "greater"))
        assert poisson_binomial_p(hits, np.full(40, 0.3)) == pytest.approx(min(1.0, 2 * tail))


def _patterns(rng, sharpen=1.0, n=400):
    """Patterns of three terms of which the last two go together, and probabilities that may be too sure."""
    p = rng.beta(0.5, 0.5, (n, 3))
    p[:, 2] = p[:, 1]

    def draw(*shape):
        u = rng.random((n, *shape, 3))
        u[..., 2] = u[..., 1]
        return (u < p.reshape(n, *(1 for _ in shape), 3)).astype(float)

    stated = p**sharpen / (p**sharpen + (1 - p) ** sharpen)
    return draw(), stated, draw(300)


def test_reliability_of_right_probabilities_is_left_alone():
    rng = np.random.default_rng(6)
    found = reliability(*_patterns(rng), ["a", "b", "c"], rng)
    assert found.p > LEVEL and (found.terms["p"] > LEVEL).all()
    assert found.bins["count"].sum() == 1200
    assert (found.bins["observed"] <= 1).all() and (found.bins["lower"] <= found.bins["upper"]).all()
    assert found.ece == pytest.approx(found.expected_ece, abs=0.03)


def test_probabilities_that_are_too_sure_or_too_high_are_found():
    rng = np.random.default_rng(7)
    gamma, stated, draws = _patterns(rng, sharpen=3.0)
    sharp = (rng.random(draws.shape) < stated[:, None]).astype(float)
    assert reliability(gamma, stated, sharp, ["a", "b", "c"], rng).p < 1e-3
    gamma, stated, draws = _patterns(rng)
    high = reliability(gamma, np.sqrt(stated), draws, ["a", "b", "c"], rng)
    assert (high.terms["p"] < 1e-3).all()
