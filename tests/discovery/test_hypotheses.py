"""Weighing explanations: prior shares, sums by name, finalists, and the grid over an inner parameter."""

from types import SimpleNamespace

import numpy as np
import pytest
from tiny_equation import CUBE, DEAD_ZONE, on, tiny_evaluations

from bayes_greybox.discovery.evaluations import Evaluations, Parametric
from bayes_greybox.discovery.evidence.with_discrepancy import Integrated
from bayes_greybox.discovery.hypotheses import FINALISTS, REACH, SURE, ZOOM_NODES, ZOOMS, Contest, Explanation, Round
from bayes_greybox.discovery.odds import Odds
from bayes_greybox.discovery.sufficient_statistics import nodes

# A round


def explanation(name, log_weight, **fields):
    return Explanation(name, (), log_weight, log_evidence=fields.pop("log_evidence", log_weight), **fields)


def a_round():
    """b by two bindings, 0.2 and 0.3; a 0.4; enough 0.1, all times an arbitrary constant."""
    weights = [("b", 0.2), ("enough", 0.1), ("a", 0.4), ("b", 0.3)]
    return Round((), tuple(explanation(name, 700 + np.log(p), share_left=p) for name, p in weights))


def test_probabilities_are_summed_by_name():
    assert a_round().probabilities()["b"] == pytest.approx(0.5)


def test_probabilities_add_up_to_one_whatever_the_evidence_is_measured_from():
    assert sum(a_round().probabilities().values()) == pytest.approx(1.0)


def test_probabilities_come_largest_first():
    assert list(a_round().probabilities()) == ["b", "a", "enough"]


def test_the_best_of_a_name_is_its_likeliest_explanation():
    assert a_round().best("b").share_left == 0.3


# Prior shares and evidence, on evidences written down by hand


class Written(Evaluations):
    """Evaluations read off tables by the slugs of the effects, "" for none: without f, with f, and in time.

    Effects are letters; a letter that occurs twice is bound in two ways. What is in no table has evidence 1.
    """

    def __init__(self, slugs, alone=None, with_f=None, in_time=None, corrections=True, odds=None, se=0.0):
        self.slugs, self.odds, self.se = slugs, odds or Odds(), se
        self.alone, self.with_f, self.in_time = alone or {}, with_f or {}, in_time or {}
        self.looked_at, self.chains = [], []
        kinds = {"effect": list(range(len(slugs))), "correction": [99] if corrections else [], "free": []}
        column = SimpleNamespace(inner={}, effect=None, log_weight=0.0)
        self.statistics = SimpleNamespace(of_kind=kinds.get, columns=[column] * len(slugs))
        self.evaluator = SimpleNamespace(at=lambda key, mode: self.with_f.get(key, 0.0))

    def key(self, indices):
        return "".join(sorted(self.slugs[i] for i in indices))

    def parametric(self, choices):
        logs = [self.alone.get(self.key(choice), 0.0) for choice in choices]
        return [Parametric(log, log, log, np.array([log]), None, None) for log in logs]

    def with_features(self, effects):
        return self.key(effects)

    def integrated(self, effects):
        self.looked_at.append(self.key(effects))
        return Integrated(self.with_f.get(self.key(effects), 0.0), self.se, 0.0, np.zeros(3), np.eye(3))

    def bridged(self, effects, sure, seed):
        self.chains.append((self.key(effects), sure, seed))

    def correlation(self, effects):
        return self.in_time.get(self.key(effects), -np.inf) if self.in_time else 0.0

    def share(self, indices, f):
        return 0.25

    def name(self, index):
        return self.slugs[index]

    def binding(self, index):
        return f"{self.slugs[index]}{self.slugs[:index].count(self.slugs[index])}"


def weighed(slugs, base=(), **tables):
    return Contest(Written(slugs, **tables)).round(base)


ODDS = Odds()


def test_with_equal_evidence_the_first_round_is_the_prior():
    found = weighed("ab").probabilities()
    expected = {"no gap": ODDS.no_gap, "recalibrate": ODDS.recalibrate, "unknown": ODDS.unknown}
    assert found == pytest.approx(expected | {"a": ODDS.effects / 2, "b": ODDS.effects / 2})


def test_effects_share_their_prior_by_name_and_a_name_by_its_bindings():
    found = weighed("aaab")
    assert found.probabilities()["a"] == pytest.approx(ODDS.effects / 2)
    assert [np.exp(e.log_weight) for e in found.explanations if e.name == "a"] == pytest.approx([ODDS.effects / 6] * 3)


def test_nothing_can_be_recalibrated_in_a_simulation_without_terms():
    found = weighed("ab", corrections=False).probabilities()
    assert "recalibrate" not in found
    assert found["no gap"] == pytest.approx(ODDS.no_gap / (1 - ODDS.recalibrate))


def test_with_equal_evidence_a_later_round_is_the_prior_of_one_more_effect():
    found = weighed("abc", base=(0,)).probabilities()
    expected = {"enough": 1 - ODDS.another - ODDS.unknown, "unknown": ODDS.unknown}
    assert found == pytest.approx(expected | {"b": ODDS.another / 2, "c": ODDS.another / 2})


def test_an_effect_that_is_in_is_not_offered_again_but_its_other_bindings_are():
    found = weighed("aab", base=(0,))
    assert [e.candidate for e in found.explanations if e.candidate] == [(1,), (2,)]


def test_evidence_beside_the_base_is_what_counts_in_a_later_round():
    found = weighed("abc", base=(0,), alone={"b": 50.0, "ac": 3.0, "bc": 50.0}, with_f={"ab": -30, "ac": -30})
    weights = {e.name: e.log_weight for e in found.explanations}
    assert weights["c"] - weights["b"] == pytest.approx(3.0)


def test_the_unknown_is_half_of_the_states_and_half_of_the_time():
    found = weighed("a", with_f={"": 2.0}, alone={"": 0.5}, in_time={"": 1.0})
    # Evidence in time is a factor on that without f.
    assert found.best("unknown").log_evidence == pytest.approx(np.log(0.5 * np.exp(2.0) + 0.5 * np.exp(1.5)))


def test_an_effect_is_weighed_with_and_without_a_remainder_by_their_odds():
    found = weighed("a", alone={"a": 3.0}, with_f={"a": 2.0}, in_time={"": -np.inf}).best("a")
    without, remainder = (1 - ODDS.remainder) * np.exp(3.0), ODDS.remainder * 0.5 * np.exp(2.0)
    assert found.log_evidence == pytest.approx(np.log(without + remainder))
    assert found.remainder == pytest.approx(remainder / (without + remainder))
    assert found.share_left == pytest.approx(0.25 * found.remainder)
    assert found.alone == pytest.approx(3.0)


def test_what_hangs_together_in_time_beside_an_effect_is_a_remainder():
    quiet = weighed("a", alone={"a": 3.0}, with_f={"a": -20.0}, in_time={"": 0.0}).best("a")
    loud = weighed("a", alone={"a": 3.0}, with_f={"a": -20.0}, in_time={"a": 10.0}).best("a")
    assert quiet.remainder < 1e-6 and loud.remainder > 0.99


@pytest.fixture
def dominated():
    """f remains beside every effect; with it b is ahead by 2, alone a is ahead by 1."""
    return {"alone": {"a": 2.0, "b": 1.0}, "with_f": {"a": 20.0, "b": 22.0}, "in_time": {"": -np.inf}}


def test_where_f_remains_effects_are_told_apart_by_what_they_explain_alone(dominated):
    found = weighed("ab", **dominated)
    assert found.best("a").log_weight - found.best("b").log_weight == pytest.approx(1.0)


def test_where_f_remains_all_effects_together_keep_their_evidence(dominated):
    effects = [e.log_weight for e in weighed("ab", **dominated).explanations if e.candidate]
    both = [
        np.log((1 - ODDS.remainder) * np.exp(dominated["alone"][s]) + ODDS.remainder / 2 * np.exp(with_f))
        for s, with_f in dominated["with_f"].items()
    ]
    assert np.logaddexp.reduce(effects) == pytest.approx(np.logaddexp.reduce(both) + np.log(ODDS.effects / 2))


def test_where_f_does_not_remain_effects_keep_their_own_evidence():
    found = weighed("ab", alone={"a": 30.0, "b": 25.0}, with_f={"a": 20.0, "b": 25.0}, in_time={"": -np.inf})
    b = np.logaddexp(np.log(1 - ODDS.remainder) + 25.0, np.log(ODDS.remainder / 2) + 25.0)
    assert found.best("b").log_evidence == pytest.approx(b)


def test_whether_f_remains_is_asked_of_the_likeliest_effect_alone():
    # f remains beside b, which is far behind a.
    found = weighed("ab", alone={"a": 60.0, "b": 1.0}, with_f={"a": 20.0, "b": 22.0}, in_time={"": -np.inf})
    assert found.best("b").log_evidence == pytest.approx(np.log(ODDS.remainder / 2) + 22.0, abs=1e-6)


def finalists(**tables):
    known = Written("abcdefghij", **tables)
    found = Contest(known).round()
    return {e.name for e in found.explanations if e.candidate and e.with_discrepancy is not None}, known, found


def test_f_is_integrated_beside_as_many_effects_as_are_finalists():
    ranked = {slug: -float(i) for i, slug in enumerate("abcdefghij")}
    last, known, _ = finalists(with_f=ranked, alone=ranked)
    assert last == set("abcdefghij"[:FINALISTS])
    assert set(known.looked_at) == {"", *last}


@pytest.mark.parametrize(("behind", "expected"), [(0.9 * REACH, True), (1.1 * REACH, False)])
def test_an_effect_within_reach_of_the_best_without_f_is_a_finalist_too(behind, expected):
    with_f = {slug: -float(i) for i, slug in enumerate("abcdefghij")}
    alone = dict.fromkeys("abcdefghij", -100.0) | {"a": 0.0, "j": -behind}
    assert ("j" in finalists(with_f=with_f, alone=alone)[0]) == expected


def test_of_the_others_it_is_not_known_what_f_would_carry():
    *_, found = finalists(with_f={slug: -float(i) for i, slug in enumerate("abcdefghij")})
    assert found.best("a").share_left > 0 and np.isnan(found.best("j").share_left)


def test_chains_settle_explanations_that_are_in_the_running_only():
    tables = {"alone": {"a": 30.0, "b": 29.0, "c": 1.0}, "with_f": {"": 5.0}, "in_time": {"": -np.inf}}
    known = Written("abc", **tables)
    Contest(known).settle((), seed=3)
    assert known.chains == [("a", SURE, 3), ("b", SURE, 3)]


# The grid over an inner parameter, on rows of a dead zone


def dead(noise):
    """Rows with a dead zone of 0.43, sought among others in that shape only."""
    return tiny_evaluations([DEAD_ZONE], lambda x: -np.sign(x) * np.maximum(np.abs(x) - 0.43, 0), noise)


def values(known):
    return np.array([known.statistics.columns[i].inner["gap"] for i in known.statistics.of_kind("effect")])


def log_weights(known):
    return np.array([known.statistics.columns[i].log_weight for i in known.statistics.of_kind("effect")])


def posterior(known):
    effects = known.statistics.of_kind("effect")
    log_z = np.array([v.all for v in known.parametric([(i,) for i in effects])])
    return np.exp(log_z - np.logaddexp.reduce(log_z))


def test_an_effect_without_an_inner_parameter_has_no_grid_to_refine():
    known = tiny_evaluations([CUBE], lambda x: -(x**3), 0.1)
    (cube,) = known.statistics.of_kind("effect")
    assert Contest(known).refine((), [cube]) == (cube,)


def test_the_grid_is_refined_until_the_posterior_spans_several_values():
    known = dead(noise=0.003)
    assert np.max(posterior(known)) > 0.9
    Contest(known).refine((), known.statistics.of_kind("effect"))
    assert np.max(posterior(known)) < 0.5


def test_the_refined_grid_is_densest_at_the_value_of_the_data():
    known = dead(noise=0.003)
    Contest(known).refine((), known.statistics.of_kind("effect"))
    mean = posterior(known) @ values(known)
    # The standard error of the gap is about 0.003/√30/1 = 6e-4; four of them and half a cell.
    assert mean == pytest.approx(0.43, abs=4e-3)
    gaps = np.diff(np.sort(values(known)))
    assert np.sort(values(known))[np.argmin(gaps)] == pytest.approx(0.43, abs=0.03)


@pytest.mark.parametrize(("noise", "refined"), [(0.3, True), (0.4, True), (1.0, False)])
def test_a_grid_is_refined_if_one_value_is_likelier_than_all_others(noise, refined):
    known = dead(noise)
    effects = known.statistics.of_kind("effect")
    assert (np.max(posterior(known)) > 0.5) == refined
    assert (Contest(known).refine((), effects) != tuple(effects)) == refined


def test_refining_returns_all_values_old_and_new():
    known = dead(noise=0.003)
    old = values(known)
    found = Contest(known).refine((), known.statistics.of_kind("effect"))
    assert list(found) == known.statistics.of_kind("effect")
    assert set(old) <= set(values(known))
    assert len(old) < len(found) <= len(old) + ZOOMS * ZOOM_NODES


def test_prior_weights_of_the_grid_add_up_to_one_before_and_after():
    known = dead(noise=0.003)
    assert np.sum(np.exp(log_weights(known))) == pytest.approx(1.0)
    Contest(known).refine((), known.statistics.of_kind("effect"))
    assert np.sum(np.exp(log_weights(known))) == pytest.approx(1.0)


def test_a_prior_weight_is_the_width_of_its_cell_on_the_logarithm():
    known = dead(noise=0.003)
    Contest(known).refine((), known.statistics.of_kind("effect"))
    order = np.argsort(values(known))
    # Largest |x| is 1, so the prior is log-uniform from 0.1 to 0.9; cells meet half-way and end at its ends.
    u = np.log(values(known)[order])
    edges = np.concatenate([[np.log(0.1)], (u[1:] + u[:-1]) / 2, [np.log(0.9)]])
    expected = np.diff(edges) / np.log(9)
    np.testing.assert_allclose(np.exp(log_weights(known)[order]), expected, rtol=1e-9)


def test_refining_brings_the_evidence_to_its_integral_over_the_prior():
    def summed(indices):
        return np.logaddexp.reduce([v.all for v in known.parametric([(i,) for i in indices])])

    known = dead(noise=0.1)
    effects = known.statistics.of_kind("effect")
    coarse, fine = summed(effects), summed(Contest(known).refine((), effects))
    start = len(known.statistics.columns)
    grid = np.geomspace(0.1, 0.9, 60)
    known.statistics.add("effect", nodes(on(DEAD_ZONE), known.statistics.rows.columns, grid))
    integral = summed(range(start, len(known.statistics.columns)))
    assert fine == pytest.approx(integral, abs=0.05)
    assert abs(coarse - integral) > 0.3


def test_a_column_that_has_one_value_of_its_inner_parameter_left_cannot_be_refined():
    known = dead(noise=0.003)
    first = known.statistics.of_kind("effect")[0]
    assert Contest(known).refine((), [first]) == (first,)


def test_a_round_on_real_rows_finds_the_hidden_effect():
    known = tiny_evaluations([DEAD_ZONE, CUBE], lambda x: -(x**3), 0.05)
    found = Contest(known).round()
    assert next(iter(found.probabilities())) == "cube"
    assert known.name(found.best("cube").best) == "cube"
