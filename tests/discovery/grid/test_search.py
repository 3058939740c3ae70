"""Prior of sets and the search over them, against all sets that there are."""

from dataclasses import replace
from itertools import combinations, product

import numpy as np
import pytest
from scipy.special import logsumexp

from bayes_greybox.discovery.grid.log_evidence import Gram, log_evidences
from bayes_greybox.discovery.grid.points import NO_DISCREPANCY, NoisePoint
from bayes_greybox.discovery.grid.sets import Reach, SetPrior, search
from bayes_greybox.discovery.grid.table import CORRECTION, EFFECT, FREE, SENSOR, Regressor
from bayes_greybox.discovery.odds import Odds

CATALOGUE = (
    Regressor(FREE, "free:x", "x", 10.0),
    Regressor(CORRECTION, "correction:y", "y", 0.3), Regressor(CORRECTION, "correction:v", "v", 0.3),
    # One name on two columns, and one with three values of a nonlinear parameter.
    Regressor(EFFECT, "cube(r=y)", "cube", 1.0), Regressor(EFFECT, "cube(r=v)", "cube", 1.0),
    *(Regressor(EFFECT, "zone(r=y)", "zone", 1.0, bends=True, log_weight=np.log(w)) for w in (0.5, 0.3, 0.2)),
    Regressor(EFFECT, "drag(r=v)", "drag", 1.0),
    Regressor(SENSOR, "sensor:gain", "gain", 0.1),
)  # fmt: skip


def all_sets(regressors, most):
    """Every set with at most so many effects, and one of each group."""
    groups = {}
    for i, each in enumerate(regressors):
        groups.setdefault(each.group, []).append(i)
    choices = [[i] if regressors[i].kind == FREE else [None, *own] for own in groups.values() for i in own[:1]]
    found = [tuple(sorted(i for i in each if i is not None)) for each in product(*choices)]
    return [s for s in found if sum(regressors[i].kind == EFFECT for i in s) <= most]


@pytest.mark.parametrize("most", [1, 2, 4])
def test_probabilities_of_all_sets_add_up_to_one(most):
    odds = Odds()
    logs = SetPrior.of(CATALOGUE, odds, most).logs(all_sets(CATALOGUE, most))
    # Odds of sensor errors are relative to none of them.
    total = np.exp(logsumexp(logs) + np.log1p(-odds.suspect))
    assert total == pytest.approx(1.0)


def test_each_kind_has_its_odds_and_names_share_equally():
    odds, sets = Odds(), all_sets(CATALOGUE, 1)
    p = np.exp(SetPrior.of(CATALOGUE, odds, 1).logs(sets) + np.log1p(-odds.suspect))

    def held(s, kind):
        return [CATALOGUE[i] for i in s if CATALOGUE[i].kind == kind]

    plain = [k for k, s in enumerate(sets) if not held(s, EFFECT)]
    right = [k for k in plain if not held(sets[k], CORRECTION)]
    off = [k for k in plain if held(sets[k], CORRECTION)]
    assert p[right, 0].sum() == pytest.approx(odds.no_gap) and p[off, 0].sum() == pytest.approx(odds.recalibrate)
    assert p[plain, 1].sum() == pytest.approx(odds.unknown)
    with_one = {k: held(s, EFFECT)[0] for k, s in enumerate(sets) if held(s, EFFECT)}
    for name in ("cube", "zone", "drag"):
        own = [k for k, each in with_one.items() if each.name == name]
        assert p[own].sum() == pytest.approx(odds.effects / 3)
        assert p[own, 1].sum() == pytest.approx(odds.remainder * odds.effects / 3)
    places = {g: p[[k for k, e in with_one.items() if e.group == g]].sum() for g in ("cube(r=y)", "cube(r=v)")}
    assert len(set(np.round(list(places.values()), 12))) == 1
    of_sensor = [k for k, s in enumerate(sets) if held(s, SENSOR)]
    assert p[of_sensor].sum() == pytest.approx(odds.suspect)


@pytest.mark.parametrize("names", [("one",), ("one", "other")])
def test_sets_without_an_error_that_is_sure_are_a_millionth_as_likely(names):
    pair = tuple(Regressor(SENSOR, f"sensor:{name}", name, 0.1, sure="pair") for name in names)
    bare = tuple(Regressor(SENSOR, each.group, each.name, 0.1) for each in pair)
    sets = [(), (0,), (4,), (9,), *([(10,), (4, 10), (9, 10)] if len(names) > 1 else [])]
    prior = SetPrior.of((*CATALOGUE[:9], *pair), Odds(), 3)
    change = prior.logs(sets) - SetPrior.of((*CATALOGUE[:9], *bare), Odds(), 3).logs(sets)
    missing = [not {9, 10} & set(s) for s in sets]
    np.testing.assert_allclose(change, np.where(missing, np.log(1e-6), 0.0)[:, None] * np.ones(2))
    # It is known no less once the other one has been left out.
    alone = replace(prior, regressors=prior.regressors[:10]).logs([()])
    np.testing.assert_allclose(alone, prior.logs([()]))


def test_without_effects_or_corrections_the_rest_is_as_likely_as_it_was():
    only = (Regressor(FREE, "free:x", "x", 10.0),)
    logs = SetPrior.of(only, Odds(), 3).logs([(0,), ()])
    np.testing.assert_allclose(np.exp(logs), [[0.3, 0.1]] * 2)


def problem(seed, n=60):
    """Correlated columns of which two act, and one set's log weight by evidence and prior."""
    rng = np.random.default_rng(seed)
    X = rng.standard_normal((n, len(CATALOGUE))) + 0.8 * rng.standard_normal((n, 1))
    y = 0.5 * X[:, 4] - 0.4 * X[:, 6] + 0.2 * X[:, 1] + 0.4 * rng.standard_normal(n)
    Z = np.column_stack([y, X])
    gram = Gram((NoisePoint(NO_DISCREPANCY),), (Z.T @ Z)[None], np.zeros(1), float(n))
    return weight_of(gram)


def weight_of(gram, regressors=CATALOGUE, most=3):
    prior = SetPrior.of(regressors, Odds(), most)
    precision = np.array([each.sd**-2.0 for each in regressors])
    return lambda sets: log_evidences(gram, precision, sets, 1e-12)[:, 0] + logsumexp(prior.logs(sets), axis=1)


@pytest.mark.parametrize("seed", range(6))
def test_the_search_finds_the_best_sets_that_there_are(seed):
    weight = problem(seed)
    sets = all_sets(CATALOGUE, 3)
    logs = weight(sets)
    exact = {s: log for s, log in zip(sets, logs, strict=True) if log > logs.max() - 6}
    found = search(CATALOGUE, weight, Reach(effects=3))
    assert found[0] == max(exact, key=exact.get)
    # Six nats of the window's twelve: neighbours of the best are reached, whatever leads to them.
    assert set(exact) <= set(found)
    np.testing.assert_array_less(np.diff(weight(found)), 2e-6)


def test_no_set_has_two_values_of_one_effect_or_more_than_is_allowed():
    reach = Reach(effects=2, sensors=0, members=3, window=1e9)
    for members in search(CATALOGUE, problem(0), reach):
        own = [CATALOGUE[i] for i in members]
        assert len({each.group for each in own}) == len(own) and own[0].kind == FREE
        assert sum(each.kind == EFFECT for each in own) <= 2 and len(own) <= 4
        assert not any(each.kind == SENSOR for each in own)


def test_an_effect_is_found_beside_three_errors_of_sensors_that_act_at_once():
    """With two of them at most, stand-ins for the third were named: a constant force for an offset."""
    rng = np.random.default_rng(5)
    errors = tuple(Regressor(SENSOR, f"{SENSOR}:{name}", name, 1.0) for name in ("delay", "drift", "offset"))
    effects = tuple(Regressor(EFFECT, name, name, 1.0) for name in ("cube", "constant", "square"))
    X = rng.standard_normal((200, 6))
    # The constant is nearly the offset.
    X[:, 4] = X[:, 2] + 0.2 * rng.standard_normal(200)
    Z = np.column_stack([X[:, :4].sum(axis=1) + 0.05 * rng.standard_normal(200), X])
    gram, own = Gram((NoisePoint(NO_DISCREPANCY),), (Z.T @ Z)[None], np.zeros(1), 200.0), errors + effects
    assert search(own, weight_of(gram, own), Reach())[0] == (0, 1, 2, 3)


def test_sets_far_behind_the_likeliest_are_not_kept():
    weight = problem(1)
    found = search(CATALOGUE, weight, Reach(window=3.0))
    logs = weight(found)
    assert np.all(logs > logs.max() - 3.0)
    assert len(search(CATALOGUE, weight, Reach(kept=5))) == 5


@pytest.mark.parametrize("rounding", [-1e-12, 0.0, 1e-12])
@pytest.mark.parametrize("at", [-3.0, -3.0000005, -2.9999995])
def test_of_two_columns_that_are_one_the_first_is_likeliest_whatever_rounding_does(rounding, at):
    pair = (Regressor(EFFECT, "a", "a", 1.0), Regressor(EFFECT, "b", "b", 1.0))
    logs = {(): -9.0, (0,): at, (1,): at + rounding, (0, 1): -20.0}
    found = search(pair, lambda sets: np.array([logs[s] for s in sets]), Reach(window=30.0))
    assert found == [(0,), (1,), (), (0, 1)]


def test_two_columns_that_do_nothing_alone_are_found_together():
    """Their difference is what acts; either alone explains a hundredth of it."""
    rng = np.random.default_rng(3)
    common, apart = rng.standard_normal((2, 200))
    own = tuple(Regressor(EFFECT, f"e{k}", f"e{k}", 1.0) for k in range(5))
    X = np.column_stack([common, common + 0.1 * apart, rng.standard_normal((200, 3))])
    Z = np.column_stack([X[:, 1] - X[:, 0] + 0.01 * rng.standard_normal(200), X])
    gram = Gram((NoisePoint(NO_DISCREPANCY),), (Z.T @ Z)[None], np.zeros(1), 200.0)
    assert search(own, weight_of(gram, own), Reach(effects=3))[0] == (0, 1)
    assert list(combinations(range(2), 2)) == [(0, 1)]
