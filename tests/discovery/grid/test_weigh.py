"""Hypotheses of a small table of rates: what of them is told better, and what an effect and a discrepancy share."""

import numpy as np
import pytest

from bayes_greybox.data.noise.weighted import WhiteNoise
from bayes_greybox.discovery.grid.latent_force import ForcedRates, KnownNoise
from bayes_greybox.discovery.grid.sets import Reach
from bayes_greybox.discovery.grid.table import EFFECT, FREE, Features, Regressor, RegressorTable
from bayes_greybox.discovery.grid.weigh import weigh
from bayes_greybox.discovery.odds import Odds

N = 300
TIME = 0.05 * np.arange(N)


def weighed(target, *columns):
    X = np.column_stack(columns)
    nothing = Features(np.zeros((N, 0)), np.zeros((N, 0)))
    table = RegressorTable(
        tuple(Regressor(EFFECT, f"e{k}", f"e{k}", 1.0) for k in range(X.shape[1])), target, X, X,
        ForcedRates(TIME, np.zeros(N), 2.0, np.ones(N), 0.1), np.arange(N) * 8 // N, nothing, np.zeros((0, 1)),
    )  # fmt: skip
    return weigh(table, Odds(), Reach(), 1e-12)


@pytest.fixture(scope="module")
def two():
    rng = np.random.default_rng(0)
    a, b = np.sin(3 * TIME), np.sin(3 * TIME) + 0.3 * np.cos(7 * TIME)
    return weighed(0.8 * a + 0.3 * rng.standard_normal(N), a, b)


def test_probabilities_and_blocks_belong_to_each_hypothesis(two):
    logs = np.array([h.log_weight for h in two.hypotheses])
    p = np.exp(logs - np.logaddexp.reduce(logs))
    np.testing.assert_allclose([h.probability for h in two.hypotheses], p, rtol=1e-12)
    assert two.blocks.shape == (len(p), 8) and two.hypotheses[0].members == (0,)


def test_what_is_not_kept_is_bounded_by_the_window_and_the_model_without_effects_is_not(two):
    # The data are far from the empty set, which is kept all the same.
    best, least = two.hypotheses[0].log_weight, min(h.log_weight for h in two.hypotheses)
    assert two.outside == pytest.approx(best - Reach().window) and least == two.before.log_weight < two.outside
    assert all(h.log_weight >= two.outside for h in two.hypotheses if h is not two.before)


def test_what_is_told_better_moves_probabilities_order_and_agreement(two):
    first = two.hypotheses[0]
    shifts = [-30.0 * (h is first) for h in two.hypotheses]
    told = two.reweighted(shifts, 0)
    assert told.hypotheses[0].members == two.hypotheses[1].members
    assert next(h.log_weight for h in told.hypotheses if h.members == first.members) == first.log_weight - 30.0
    assert sum(h.probability for h in told.hypotheses) == pytest.approx(1.0)
    assert sum(h.agreement for h in told.hypotheses) == pytest.approx(1.0)
    places = {h.members: k for k, h in enumerate(two.hypotheses)}
    for h, block in zip(told.hypotheses, told.blocks, strict=True):
        np.testing.assert_array_equal(block, two.blocks[places[h.members]])
    assert two.reweighted([0.0] * len(shifts), 0) is two


def test_what_an_effect_and_the_force_share_is_their_mean_product():
    # A slow force of time beside an effect that is orthogonal to it, and one that the force takes half of.
    rng = np.random.default_rng(1)
    effect, force = np.sin(11 * TIME), np.sin(0.9 * TIME + 0.4)
    found = weighed(effect + 2 * force + 0.05 * rng.standard_normal(N), effect)
    best = next(h for h in found.hypotheses if h.members == (0,))
    w = found.latent_force(best)[0]
    assert best.against[0] == pytest.approx(best.mean[0] * np.mean(effect * w), abs=1e-9)
    assert abs(best.against[0]) < 0.05 * best.sizes[0] * best.left
    assert best.left == pytest.approx(np.sqrt(np.mean(w**2)), rel=1e-6)


def test_hypotheses_that_leave_nothing_are_weighed_among_themselves():
    # Beside a slow force of time one effect leaves something, and none that is weighed alone may.
    rng = np.random.default_rng(2)
    effect, force = np.sin(11 * TIME), np.sin(0.9 * TIME + 0.4)
    target = effect + 2 * force + 0.05 * rng.standard_normal(N)
    every = weighed(target, effect, effect**3)
    alone = every.without_discrepancy(Reach(), 0)
    assert not every.hypotheses[0].complete and not any(point.unnamed for point in alone.grid.points)
    assert all(h.complete for h in alone.hypotheses)
    assert sum(h.probability for h in alone.hypotheses) == pytest.approx(1.0)
    assert alone.hypotheses[0].log_weight < every.hypotheses[0].log_weight - 100


def test_what_the_users_own_terms_can_do_is_no_discrepancy():
    # All that a law can do is nearly the own term: what is left is the difference of two that cancel.
    rng = np.random.default_rng(2)
    own, effect, rest = np.cos(0.9 * TIME + 0.4), np.sin(11 * TIME), np.cos(0.7 * TIME + 0.2)
    target = effect + 3 * own + 0.3 * rest + 0.02 * rng.standard_normal(N)
    X = np.column_stack([own, effect])
    features = (own + 0.3 * rest)[:, None]
    table = RegressorTable(
        (Regressor(FREE, "own", "free:own", 10.0), Regressor(EFFECT, "e", "e", 1.0)), target, X, X,
        KnownNoise(WhiteNoise((N,)), 2.0, 0.05, 0.02), np.arange(N) * 8 // N, Features(features, features),
        np.zeros((1, 1)),
    )  # fmt: skip
    best = weigh(table, Odds(), Reach(), 1e-12).hypotheses[0]
    apart = 0.3 * (rest - own * (own @ rest) / (own @ own))
    assert best.members == (0, 1) and best.kinds["law"] > 0.9
    assert best.left == pytest.approx(float(np.sqrt(np.mean(apart**2))), rel=0.05)
