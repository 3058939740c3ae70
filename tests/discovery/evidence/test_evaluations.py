"""Evidence of sets of effects: patterns of corrections, sums over them, f beside them, and what is remembered."""

from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from tiny_equation import CUBE, DEAD_ZONE, SQUARE, integrated, tiny_evaluations

from bayes_greybox.discovery.evidence import evaluations
from bayes_greybox.discovery.evidence.columns import Nearer
from bayes_greybox.discovery.evidence.evaluations import MOST_PATTERNS, _patterns, one_pattern
from bayes_greybox.discovery.evidence.odds import Odds
from bayes_greybox.discovery.evidence.sufficient_statistics import CORRECTION_SCALE
from bayes_greybox.discovery.suspects.memory import HYSTERESIS, Memory
from bayes_greybox.model.estimate.evidence import Spectrum, marginal
from bayes_greybox.physics.catalogue.effects import Effect

TWO_TERMS = {"simulation": {"x": "-x + 0.3*cos(x)"}}


@pytest.fixture(scope="module")
def known():
    """A free term, two corrections, and two effects of which the cube is hidden."""
    return tiny_evaluations([CUBE, SQUARE], lambda x: -(x**3), dictionary={"x": ["sin(3*x)"]}, **TWO_TERMS)


@pytest.fixture(scope="module")
def smooth():
    """What is missing is a function of x that f can be; nothing in the simulation can be off."""
    return tiny_evaluations([CUBE], lambda x: np.cos(2 * x), noise=0.01, simulation=lambda t, x, u: [-x[0]])


def dense_columns(known, effects):
    statistics = known.statistics
    indices = known.indices(effects)
    X = statistics.rows.whiten(statistics.evaluate(indices, statistics.rows.columns))
    return indices, X, statistics.rows.target / statistics.target_scale


def evidence_of(known, effects, pattern, together=False):
    """Log evidence of one pattern with the columns that it leaves out taken away, or added up to one."""
    indices, X, y = dense_columns(known, effects)
    sd = np.array([known.statistics.columns[i].sd for i in indices])
    corrections = known.statistics.of_kind("correction")
    if together:
        # The simulation itself, the change of a share of it: −x + 0.3 cos(x).
        first, *others = (indices.index(i) for i in corrections)
        x = known.statistics.rows.columns["x"]
        X, sd = X.copy(), sd.copy()
        X[:, first], sd[first] = (-x + 0.3 * np.cos(x)) / known.statistics.target_scale, CORRECTION_SCALE
        pattern = [1, *(0 for _ in others)]
    kept = [k for k, i in enumerate(indices) if i not in corrections or pattern[corrections.index(i)]]
    X, sd = X[:, kept], sd[kept]
    return float(marginal(Spectrum.of(X.T @ X, X.T @ y, float(y @ y), len(y), sd), known.statistics.noise).log_evidence)


# Patterns


def test_all_patterns_are_weighed_up_to_a_number_and_beyond_it_at_most_two_terms():
    at_most = int(np.log2(MOST_PATTERNS))
    assert len(_patterns(at_most, 0.1)[0]) == MOST_PATTERNS + 1
    *beyond, together = _patterns(at_most + 1, 0.1)[0]
    assert len(beyond) == 1 + 7 + 21 and np.sum(beyond, axis=1).max() == 2 and together.all()


def test_the_first_pattern_has_no_correction_and_each_pattern_occurs_once_but_for_all_by_one_factor():
    patterns, _ = _patterns(4, 0.1)
    assert not patterns[0].any() and len({tuple(row) for row in patterns[:-1]}) == 16 and patterns[-1].all()


@pytest.mark.parametrize("count", [0, 1])
def test_fewer_than_two_corrections_have_no_factor_in_common(count):
    patterns, log_prior = _patterns(count, 0.1)
    assert patterns.shape == (count + 1, count) and np.exp(log_prior).sum() == pytest.approx(1.0)


def test_each_correction_is_in_with_its_prior_probability():
    patterns, log_prior = _patterns(5, 0.3)
    each = np.exp(log_prior[:-1])
    np.testing.assert_allclose(each @ patterns[:-1] / each.sum(), 0.3)


def test_all_by_one_factor_are_as_likely_beforehand_as_one():
    _, log_prior = _patterns(3, 0.1)
    assert log_prior[-1] == log_prior[1] and np.exp(log_prior).sum() == pytest.approx(1.0)


def test_the_prior_of_patterns_that_were_cut_off_goes_to_the_others_in_proportion():
    patterns, log_prior = _patterns(8, 0.1)
    np.testing.assert_allclose(log_prior[1:9] - log_prior[0], np.log(0.1 / 0.9))
    assert np.exp(log_prior).sum() == pytest.approx(1.0)


def test_a_pattern_takes_corrections_out_and_neither_free_terms_nor_effects(known):
    inside = known.spectrum([known.statistics.of_kind("effect")]).back[0].any(axis=-1)
    patterns, _ = known.patterns()
    assert inside[:, 0].all() and inside[:, 3:].all()
    np.testing.assert_array_equal(inside[:, 1:3], patterns > 0)


# Without f


def test_the_evidence_of_a_pattern_is_that_of_its_columns_alone(known):
    (effect, _) = known.statistics.of_kind("effect")
    found = known.parametric([(effect,)])[0]
    patterns, log_prior = known.patterns()
    expected = [evidence_of(known, (effect,), pattern) for pattern in patterns[:-1]]
    expected.append(evidence_of(known, (effect,), patterns[-1], together=True))
    np.testing.assert_allclose(found.by_pattern, expected + log_prior, atol=1e-4)


def test_the_evidence_is_summed_over_patterns(known):
    found = known.parametric([()])[0]
    assert found.all == pytest.approx(np.logaddexp.reduce(found.by_pattern))


def test_sets_of_any_sizes_have_the_evidence_that_each_has_alone(known, monkeypatch):
    monkeypatch.setattr(evaluations, "TOGETHER", 2)
    one, other = known.statistics.of_kind("effect")
    sets = [(one, other), (), (other,), (one,), (one, other), (other,)]
    found = known.each_parametric(sets)
    for choice, each in zip(sets, found, strict=True):
        alone = known.parametric([choice])[0]
        np.testing.assert_allclose(each.by_pattern, alone.by_pattern, rtol=1e-12)
        assert each.spectrum.eigenvalues.shape == alone.spectrum.eigenvalues.shape


def test_curves_are_apart_by_what_their_own_fits_differ_in_beyond_the_models_terms():
    line = Effect(slug="line", name="Line", domain="test", expression="r**3 + 0.4*r")
    bent = Effect(slug="bent", name="Bent", domain="test", expression="r**3 + 0.02*sin(9*r)")
    known = tiny_evaluations([CUBE, line, bent, SQUARE], lambda x: -(x**3), noise=0.02)
    cube, line, bent, square = known.statistics.of_kind("effect")
    # A change of the simulation's own coefficient is all that these differ by.
    assert known.apart((), cube, line) < 1e-6
    for other, beside in ((bent, ()), (square, ()), (bent, (square,))):
        X = known.statistics.at_rows(known.indices(beside))
        y = known.statistics.rows.target / known.statistics.target_scale
        pair = known.statistics.at_rows((cube, other))
        every = [np.column_stack([X, column]) for column in pair.T]
        first, second = (A @ np.linalg.lstsq(A, y, rcond=None)[0] for A in every)
        sigma = np.std(y - first)
        expected = np.sum((first - second) ** 2) / sigma**2
        assert known.apart(beside, cube, other) == pytest.approx(expected, rel=0.2)


def test_no_correction_and_some_are_told_apart_without_the_prior_of_patterns(known):
    found = known.parametric([()])[0]
    _, log_prior = known.patterns()
    assert found.none == pytest.approx(found.by_pattern[0] - log_prior[0])
    given_some = np.exp(log_prior[1:]) / np.exp(log_prior[1:]).sum()
    expected = np.log(given_some @ np.exp(found.by_pattern[1:] - log_prior[1:]))
    assert found.some == pytest.approx(expected)


def test_without_corrections_there_is_no_evidence_for_some(smooth):
    assert smooth.parametric([()])[0].some == -np.inf


def test_several_sets_at_once_have_the_evidence_of_each_alone(known):
    sets = list(combinations(known.statistics.of_kind("effect"), 1))
    for together, choice in zip(known.parametric(sets), sets, strict=True):
        alone = known.parametric([choice])[0]
        assert together.all == pytest.approx(alone.all, abs=1e-6)
        np.testing.assert_allclose(together.by_pattern, alone.by_pattern, atol=1e-6)


def test_no_sets_have_no_evidence(known):
    assert known.parametric([]) == []


def test_the_order_of_effects_does_not_matter(known):
    first, second = known.statistics.of_kind("effect")
    forth, back = known.parametric([(first, second), (second, first)])
    assert forth.all == pytest.approx(back.all, abs=1e-6)


def test_the_prior_weight_of_an_inner_parameter_is_in_the_evidence():
    known = tiny_evaluations([DEAD_ZONE])
    index = known.statistics.of_kind("effect")[3]
    found = known.parametric([(index,)])[0]
    _, log_prior = known.patterns()
    assert known.inner_weight((index,)) == pytest.approx(np.log(1 / 8))
    assert found.by_pattern[0] == pytest.approx(found.none + log_prior[0])


def test_one_pattern_of_a_batch_is_that_pattern(known):
    found = known.parametric([()])[0]
    for pattern in range(len(found.by_pattern)):
        spectrum, single = one_pattern(found, pattern)
        assert float(marginal(spectrum, known.statistics.noise).log_evidence) == pytest.approx(
            float(single.log_evidence), abs=1e-6
        )


# With f


def test_the_features_of_f_are_what_the_columns_leave_of_them(known):
    effects = tuple(known.statistics.of_kind("effect"))
    hypothesis = known.with_features(effects)
    _, X, y = dense_columns(known, effects)
    psi = known.statistics.evaluate_features(known.statistics.rows.columns)
    Psi = psi - X @ np.linalg.lstsq(X, psi, rcond=None)[0]
    np.testing.assert_allclose(hypothesis.gram, Psi.T @ Psi, atol=1e-8)
    np.testing.assert_allclose(hypothesis.product, Psi.T @ y, atol=1e-8)


def test_an_effect_several_times_leaves_of_f_what_it_leaves_once():
    twins = [
        Effect(slug=f"again-{factor}", name="Again", domain="test", expression=f"{factor}*r**3") for factor in (3, 5, 7)
    ]
    known = tiny_evaluations([CUBE, *twins])
    first, *others = known.statistics.of_kind("effect")
    once, again = known.with_features((first,)), known.with_features((first, *others))
    np.testing.assert_allclose(again.gram, once.gram, atol=1e-8)
    np.testing.assert_allclose(again.product, once.product, atol=1e-8)


def test_f_carries_nearly_all_of_a_gap_that_is_a_smooth_function(smooth):
    share = smooth.share((), smooth.integrated(()))
    # A hundredth of the gap's RMS is noise, and the prior of f shrinks it a little.
    assert 0.98 < share <= 1.0


def test_f_carries_little_beside_the_effect_that_is_the_gap(known):
    effects = (known.statistics.of_kind("effect")[0],)
    assert known.share(effects, known.integrated(effects)) < 0.05


def share_by_hand(explained, sigma):
    """A share whose parts are written down: 60 rows of unit square, none of it in free columns."""
    known = tiny_evaluations()
    known.evaluator = SimpleNamespace(explained=lambda hypothesis, mode: explained)
    return known.share((), integrated(sigma=sigma))


def test_the_share_is_of_the_square_that_is_not_noise():
    assert share_by_hand(explained=9.0, sigma=0.5) == pytest.approx(9 / (60 * 0.75), rel=1e-6)


@pytest.mark.parametrize(("explained", "expected"), [(0.0, 0.0), (100.0, 1.0)])
def test_the_share_is_between_none_and_all(explained, expected):
    assert share_by_hand(explained, sigma=0.5) == expected


def test_where_noise_leaves_no_gap_whatever_f_takes_is_all_of_it():
    assert share_by_hand(explained=0.1, sigma=1.0) == 1.0


def test_what_free_terms_explain_is_no_gap():
    known = tiny_evaluations([], np.sin, noise=0.1, dictionary={"x": ["x"]})
    known.evaluator = SimpleNamespace(explained=lambda hypothesis, mode: 1.0)
    _, X, y = dense_columns(known, ())
    free = X[:, :1]
    rest = y - free @ np.linalg.lstsq(free, y, rcond=None)[0]
    assert known.share((), integrated(sigma=0.05)) == pytest.approx(1 / (rest @ rest - 60 * 0.05**2), rel=1e-4)


# What is remembered


class Counting:
    """An evaluator that says where it was asked to start."""

    def __init__(self, bridged=None):
        self.starts, self.chains, self._bridged = [], 0, bridged

    def integrate(self, hypothesis, start, draws):
        self.starts.append(start)
        return integrated(len(self.starts), se=0.5)

    def bridged(self, hypothesis, seed):
        self.chains += 1
        return self._bridged


def counted(**given):
    known = tiny_evaluations([CUBE, SQUARE])
    known.evaluator = Counting(**given)
    return known, known.statistics.of_kind("effect")


def test_f_is_integrated_once_beside_the_same_effects():
    known, (cube, square) = counted()
    found = [known.integrated(effects).log_evidence for effects in ((cube,), (square,), (cube,))]
    assert found == [1.0, 2.0, 1.0]


def test_the_search_for_a_mode_begins_at_the_first_one():
    known, (cube, square) = counted()
    first = known.integrated((cube,))
    known.integrated((square,))
    assert known.evaluator.starts[0] is None and known.evaluator.starts[1] is first.mode


def test_evidence_that_is_sure_enough_needs_no_chains():
    known, (cube, _) = counted()
    known.seed = 0
    known.settled((cube,), sure=0.6)
    assert known.evaluator.chains == 0


@pytest.mark.parametrize(("se", "expected"), [(0.4, 7.0), (0.6, 1.0)])
def test_of_two_estimates_the_surer_one_is_kept(se, expected):
    known, (cube, _) = counted(bridged=SimpleNamespace(log_evidence=7.0, se=se))
    known.seed = 0
    known.settled((cube,), sure=0.1)
    assert known.evaluator.chains == 1
    assert known.integrated((cube,)).log_evidence == expected


# Names


def test_a_column_has_the_name_of_its_effect_and_a_binding_says_on_what():
    known = tiny_evaluations([CUBE])
    (cube,) = known.statistics.of_kind("effect")
    assert known.name(cube) == "cube" and known.binding(cube) == "cube(r=x)"


def test_the_group_of_a_column_are_all_values_of_its_inner_parameter():
    known = tiny_evaluations([DEAD_ZONE, CUBE])
    *zones, cube = known.statistics.of_kind("effect")
    assert known.group(zones[3]) == tuple(zones) and known.group(cube) == (cube,)


def test_the_best_column_of_an_effect_is_at_the_value_in_the_data():
    known = tiny_evaluations([DEAD_ZONE], lambda x: -np.sign(x) * np.maximum(np.abs(x) - 0.43, 0))
    best = known.statistics.columns[known.best_of("dead-zone")].inner["gap"]
    offered = [known.statistics.columns[i].inner["gap"] for i in known.statistics.of_kind("effect")]
    assert best == min(offered, key=lambda value: abs(np.log(value / 0.43)))


def test_odds_of_a_correction_are_those_that_were_given():
    rare, usual = (tiny_evaluations(odds=Odds(correction=p)).patterns()[1] for p in (0.01, 0.4))
    assert np.exp(rare[1]) == pytest.approx(0.01) and np.exp(usual[1]) == pytest.approx(0.4)


def test_what_a_set_gains_on_rows_near_itself_no_other_set_gains():
    """What stands beside could have taken up what the gain is for: an effect, or a memory, which has no formula."""
    known = tiny_evaluations([CUBE, SQUARE], lambda x: -(x**3))
    statistics = known.statistics
    cube, square = statistics.of_kind("effect")
    statistics.remember([(Memory(HYSTERESIS, "x"), np.sin(3 * statistics.rows.columns["x"])[:, None])])
    (memory,) = statistics.of_kind("memory")
    columns = statistics.columns
    columns[cube] = replace(columns[cube], nearer=Nearer(2.5))
    assert known.inner_weight((cube,)) == 2.5 and known.inner_weight((cube,), gains=False) == 0.0
    assert (
        known.inner_weight((cube, square)) == known.inner_weight((cube, memory)) == known.inner_weight((square,)) == 0
    )
    columns[cube] = replace(columns[cube], nearer=Nearer(2.5, frozenset({columns[square].called})))
    assert known.inner_weight((cube, square)) == 2.5 and known.inner_weight((cube,)) == 0.0
