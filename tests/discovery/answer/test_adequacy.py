"""Checks of the answer before its verdict: quiet under the model, loud where the noise is another; and odds."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest
from tiny_equation import tiny_model

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.answer.checks import (
    LOO_PIT,
    WHITENESS,
    _loo_pit,
    _whiteness,
    check_hypothesis,
)
from bayes_greybox.discovery.decision.criteria import CRITERIA
from bayes_greybox.discovery.grid.points import NO_DISCREPANCY
from bayes_greybox.discovery.grid.sets import Reach
from bayes_greybox.discovery.grid.weigh import weigh
from bayes_greybox.discovery.linearise.near import Near, Point, noise_shapes
from bayes_greybox.discovery.linearise.rates import RateRows
from bayes_greybox.discovery.linearise.visits import table_of
from bayes_greybox.discovery.odds import Odds

N = 200


def checks_of(noise, shapes=True):
    """The checks of ẋ = −x + noise with nothing beside it, by name."""
    t = np.arange(len(noise)) * 0.1
    x = np.sin(0.9 * t) + 0.4 * np.cos(2.1 * t)
    data = Trajectories.from_arrays(t, states={"x": x}, derivatives={"x": -x + noise})
    rows = RateRows(tiny_model(), data, "x", []).near(Point())
    near = Near(rows, weigh(table_of(rows), Odds(), Reach(), rows.floor))
    if shapes:
        white = near.weighed.white(near.weighed.before)
        found = noise_shapes(white, {"x": x}, Odds())
        near = Near(replace(rows, point=replace(rows.point, shapes=found)), weigh(
            table_of(rows), Odds(), Reach(), rows.floor, [(rows.force.weighted(s.spread), s.log_prior) for s in found]
        ))  # fmt: skip
    plain = [k for k, point in enumerate(near.weighed.grid.points) if point.kind == NO_DISCREPANCY]
    h = near.weighed.before
    point = max(plain, key=lambda k: h.points[k])
    return {check.name: check for check in check_hypothesis(near, replace(h, point=point), "s")}


def test_the_statistics_keep_their_level():
    rng = np.random.default_rng(0)
    white, pit = [], []
    for _ in range(200):
        z = rng.standard_normal(N)
        white.append(_whiteness(z, (120, 80))[0])
        pit.append(_loo_pit(z).p)
    for p in (white, pit):
        assert kstest(p, "uniform").pvalue > 1e-3
        assert sum(value < CRITERIA.level for value in p) <= 2


def test_right_explanations_are_not_called_into_doubt():
    for seed in range(6):
        checks = checks_of(0.1 * np.random.default_rng(seed).standard_normal(N))
        assert set(checks) == {WHITENESS, LOO_PIT}
        assert all(check.ok and check.text == "" for check in checks.values())


def test_correlated_noise_is_seen():
    e = np.random.default_rng(0).standard_normal(N)
    for i in range(1, N):
        e[i] = 0.8 * e[i - 1] + 0.6 * e[i]
    check = checks_of(0.1 * e)[WHITENESS]
    assert not check.ok and check.p < 1e-6
    assert check.text.startswith("residuals are correlated over 0.") and check.text.endswith(" s")


def test_outliers_are_seen_and_weighted_ones_are_the_claim():
    noise = 0.05 * np.random.default_rng(1).standard_t(2, N)
    check = checks_of(noise, shapes=False)[LOO_PIT]
    assert not check.ok and check.text == "the noise has heavier tails than the model's"
    heavy = checks_of(noise)
    # Weights were found on these very residuals: their tails are no test.
    assert set(heavy) == {WHITENESS} and heavy[WHITENESS].ok


def test_few_rows_are_not_checked():
    assert checks_of(0.1 * np.random.default_rng(0).standard_normal(39)) == {}


@pytest.mark.parametrize("n", [1, 2, 5])
def test_odds_of_each_equation_are_those_of_the_system(n):
    odds = Odds()
    each = odds.of_each(n)
    assert each.no_gap**n == pytest.approx(odds.no_gap)
    assert each.no_gap + each.recalibrate + each.unknown + each.effects == pytest.approx(1)
    assert each.effects / each.unknown == pytest.approx(odds.effects / odds.unknown)
    assert each.recalibrate / each.unknown == pytest.approx(odds.recalibrate / odds.unknown)
    assert (each.another, each.correction, each.suspect, each.noise) == (0.3, 0.1, 0.02, 0.05)
