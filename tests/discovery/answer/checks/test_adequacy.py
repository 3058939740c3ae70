"""Checks of the answer before its verdict: quiet under the model, loud where the noise is another; and odds."""

import numpy as np
import pytest
from scipy.stats import kstest
from tiny_equation import tiny_model

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.answer.checks.adequacy import (
    LEVEL,
    LOO_PIT,
    WHITENESS,
    _loo_pit,
    _whiteness,
    check_explanation,
)
from bayes_greybox.discovery.evidence.evaluations import Evaluations
from bayes_greybox.discovery.evidence.odds import Odds
from bayes_greybox.discovery.evidence.of_equation import sufficient_statistics
from bayes_greybox.discovery.evidence.with_discrepancy import Evaluator
from bayes_greybox.discovery.weighing.sets import Sets
from bayes_greybox.discovery.weighing.worlds import worlds
from bayes_greybox.model.noise.noise_model import HEAVY

N = 200


def world_of(noise, names=None):
    """The world whose noise has these suspects, of ẋ = −x + noise; with `names` None, white noise."""
    t = np.arange(len(noise)) * 0.1
    x = np.sin(0.9 * t) + 0.4 * np.cos(2.1 * t)
    data = Trajectories.from_arrays(t, states={"x": x}, derivatives={"x": -x + noise})
    statistics = sufficient_statistics(tiny_model(), data, "x", [])
    evaluator = Evaluator(statistics.prior, statistics.kernel, np.asarray(statistics.basis.frequency))
    found = worlds(Sets(Evaluations(statistics, Odds(), evaluator), 1), {"x": x})
    return next(w for w in found if w.model.names == tuple(names or ()))


def checks_of(world):
    return {check.name: check for check in check_explanation(world, world.bare, "s")}


def test_the_statistics_keep_their_level():
    rng = np.random.default_rng(0)
    white, pit = [], []
    for _ in range(200):
        z = rng.standard_normal(N)
        white.append(_whiteness(z, (120, 80))[0])
        pit.append(_loo_pit(z).p)
    for p in (white, pit):
        assert kstest(p, "uniform").pvalue > 1e-3
        assert sum(value < LEVEL for value in p) <= 2


def test_right_explanations_are_not_called_into_doubt():
    for seed in range(6):
        world = world_of(0.1 * np.random.default_rng(seed).standard_normal(N))
        checks = checks_of(world)
        assert set(checks) == {WHITENESS, LOO_PIT}
        assert all(check.ok and check.text == "" for check in checks.values())


def test_correlated_noise_is_seen():
    e = np.random.default_rng(0).standard_normal(N)
    for i in range(1, N):
        e[i] = 0.8 * e[i - 1] + 0.6 * e[i]
    check = checks_of(world_of(0.1 * e))[WHITENESS]
    assert not check.ok and check.p < 1e-6
    assert check.text.startswith("residuals hang together over 0.") and check.text.endswith(" s")


def test_outliers_are_seen_and_weighted_ones_are_the_claim():
    noise = 0.05 * np.random.default_rng(1).standard_t(2, N)
    check = checks_of(world_of(noise))[LOO_PIT]
    assert not check.ok and check.text == "the noise has heavier tails than the model's"
    heavy = checks_of(world_of(noise, (HEAVY,)))
    assert heavy[LOO_PIT].ok and heavy[WHITENESS].ok


def test_few_rows_are_not_checked():
    assert checks_of(world_of(0.1 * np.random.default_rng(0).standard_normal(39))) == {}


@pytest.mark.parametrize("n", [1, 2, 5])
def test_odds_of_each_equation_are_those_of_the_system(n):
    odds = Odds()
    each = odds.of_each(n)
    assert each.no_gap**n == pytest.approx(odds.no_gap)
    assert each.no_gap + each.recalibrate + each.unknown + each.effects == pytest.approx(1)
    assert each.effects / each.unknown == pytest.approx(odds.effects / odds.unknown)
    assert each.recalibrate / each.unknown == pytest.approx(odds.recalibrate / odds.unknown)
    assert (each.another, each.correction, each.suspect, each.noise) == (0.3, 0.1, 0.02, 0.05)
