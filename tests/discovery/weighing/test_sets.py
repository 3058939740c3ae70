"""Sets of effects and suspects, against sums over all of them with dense covariances."""

import os
from dataclasses import replace
from itertools import chain, combinations, product
from types import SimpleNamespace

import numpy as np
import pytest
from tiny_equation import CUBE, DEAD_ZONE, SQUARE, on, tiny_data, tiny_evaluations, tiny_model

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.evidence.columns import Nearer, at_values, limits
from bayes_greybox.discovery.evidence.columns import log_weights as widths
from bayes_greybox.discovery.evidence.evaluations import Evaluations
from bayes_greybox.discovery.evidence.inner_parameters import SPANS, ZOOM_NODES, ZOOMS, refine
from bayes_greybox.discovery.evidence.odds import Odds
from bayes_greybox.discovery.evidence.of_equation import sufficient_statistics
from bayes_greybox.discovery.evidence.ranges import WRONG_SIGN
from bayes_greybox.discovery.evidence.with_discrepancy import Evaluator
from bayes_greybox.discovery.suspects.channels import DELAY, GAIN, OFFSET, ChannelSuspect
from bayes_greybox.discovery.suspects.memory import HYSTERESIS, LAW, RELAXATION, Memory, memory_columns
from bayes_greybox.discovery.weighing.laws import Laws
from bayes_greybox.discovery.weighing.search import SUSPECTS_AT_MOST
from bayes_greybox.discovery.weighing.set_prior import SetPrior
from bayes_greybox.discovery.weighing.sets import LAWFUL, MEMORY, OTHER_LAWS, PLAIN, RECALIBRATED, REST, Sets
from bayes_greybox.physics.catalogue.effects import Effect
from bayes_greybox.physics.catalogue.inner_parameter import InnerParameter

COSINE = Effect(slug="cosine", name="Cosine", domain="test", expression="cos(5*r)")
TWO_TERMS = {"simulation": {"x": "-x + 0.3*cos(x)"}}
ODDS = Odds()


def cubic(x):
    return -(x**3)


def two_places(hidden=lambda x, u: 0 * x, effects=(SQUARE,), noise=0.05, n=60):
    """ẋ = −x + hidden(x, u), effects bound to x and to u."""
    rng = np.random.default_rng(3)
    x, u = (rng.permutation(np.linspace(-1, 1, n)) for _ in range(2))
    rate = -x + hidden(x, u) + noise * rng.standard_normal(n)
    data = Trajectories.from_arrays(np.arange(n) * 0.1, states={"x": x}, inputs={"u": u}, derivatives={"x": rate})
    bound = [on(effect, place) for effect in effects for place in ("x", "u")]
    statistics = sufficient_statistics(tiny_model(), data, "x", bound)
    return Evaluations(
        statistics, ODDS, Evaluator(statistics.prior, statistics.kernel, np.asarray(statistics.basis.frequency))
    )


def suspicious(known, *suspects):
    """The same with suspects whose columns are waves of no meaning."""
    x = known.statistics.rows.columns["x"]
    known.statistics.suspect(
        [(ChannelSuspect(kind, channel, 0.1), np.sin((7 + k) * x)) for k, (kind, channel) in enumerate(suspects)]
    )
    return known


def bindings(known, e):
    return tuple(sorted(known.binding(i) for i in e.effects))


def dense(known, columns, together=()):
    """Log evidence of a linear model of these columns by its covariance, summed over a grid of σ.

    Corrections that come together are off by one factor.
    """
    statistics = known.statistics
    X = statistics.at_rows(list(columns))
    y = statistics.rows.target / statistics.target_scale
    sd = np.array([statistics.columns[i].sd for i in columns])
    C = X * sd**2 @ X.T
    if together:
        off = [statistics.columns[i] for i in together]
        shift = statistics.at_rows(list(together)) @ [column.sd * np.sign(column.nominal) for column in off]
        C = C + np.outer(shift, shift)
    values, vectors = np.linalg.eigh(C)
    t = np.linspace(-7, 2, 1501)
    noise = statistics.noise
    sigma = noise.sigma(t)
    var = np.maximum(values, 0) + sigma[:, None] ** 2
    loglik = -0.5 * np.sum(np.log(2 * np.pi * var) + (vectors.T @ y) ** 2 / var, axis=1)
    total = loglik + noise.log_density(t) + np.log(t[1] - t[0])
    return float(np.logaddexp.reduce(total))


def every_set(known, most):
    """Log weight of every explanation under a process in time, by columns: prior times dense evidence."""
    statistics, odds = known.statistics, known.odds
    effects, corrections = statistics.of_kind("effect"), statistics.of_kind("correction")
    free = statistics.of_kind("free")
    found = {}
    sizes = odds.effects * odds.another ** np.arange(most) / np.sum(odds.another ** np.arange(most))
    for core in chain.from_iterable(combinations(effects, k) for k in range(most + 1)):
        logs = []
        for pattern in product((0, 1), repeat=len(corrections)):
            inside = [i for i, one in zip(corrections, pattern, strict=True) if one]
            prior = np.prod([odds.correction if one else 1 - odds.correction for one in pattern])
            logs.append(np.log(prior) + dense(known, (*free, *inside, *core)))
        if len(corrections) > 1:
            one = odds.correction * (1 - odds.correction) ** (len(corrections) - 1)
            logs.append(np.log(one) + dense(known, (*free, *core), corrections))
            logs = np.array(logs) - np.log1p(one)
        n = len(list(combinations(effects, len(core))))
        prior = odds.unknown / 2 if not core else sizes[len(core) - 1] / n * odds.remainder / 2
        found[core] = np.log(prior) + np.logaddexp.reduce(logs)
    return found


# Against all sets


@pytest.fixture(scope="module")
def known():
    """A free term, two corrections and three effects, of which the cube is hidden, faintly."""
    return tiny_evaluations(
        [CUBE, SQUARE, COSINE], lambda x: -0.15 * x**3, noise=0.1, dictionary={"x": ["sin(3*x)"]}, **TWO_TERMS
    )


def test_every_set_weighs_its_prior_times_its_evidence_over_all_patterns(known):
    found = {e.effects: e.log_weight for e in Sets(known, 2, in_time=True).weigh() if e.kind != LAWFUL}
    expected = every_set(known, 2)
    assert set(found) == set(expected)
    for core, value in expected.items():
        assert found[core] == pytest.approx(value, abs=1e-3)


def test_the_probability_of_an_effect_is_the_sum_over_all_sets_that_hold_it(known):
    def share(logs, index):
        weight = np.exp(np.array(list(logs.values())) - max(logs.values()))
        return weight[[index in core for core in logs]].sum() / weight.sum()

    found = {e.effects: e.log_weight for e in Sets(known, 3, in_time=True).weigh() if e.kind != LAWFUL}
    for index in known.statistics.of_kind("effect"):
        assert share(found, index) == pytest.approx(share(every_set(known, 3), index), abs=2e-3)


def test_laws_weigh_the_same_in_batches_of_any_size(known, monkeypatch):
    def laws():
        return {(e.columns, e.memory): e.log_weight for e in Sets(known, 2).weigh() if e.kind == LAWFUL}

    together = laws()
    monkeypatch.setattr("bayes_greybox.discovery.weighing.sets.TOGETHER", 1)
    assert len(together) > 2 and laws() == pytest.approx(together, rel=1e-9)


def test_no_gap_and_recalibration_are_told_apart(known):
    bare = {e.kind: e for e in Sets(known, 2).weigh() if not e.effects and e.kind != LAWFUL}
    fitted = known.parametric([()])[0]
    assert set(bare) == {PLAIN, RECALIBRATED, REST}
    assert bare[PLAIN].log_weight == pytest.approx(fitted.none + np.log(ODDS.no_gap), abs=1e-4)
    assert bare[RECALIBRATED].log_weight == pytest.approx(fitted.some + np.log(ODDS.recalibrate), abs=1e-4)


def test_effects_that_show_only_together_are_found_as_a_pair():
    near = Effect(slug="near", name="Near", domain="test", expression="r**3 + 0.1*cos(9*r)")
    known = tiny_evaluations([near, CUBE, SQUARE], lambda x: 0.2 * np.cos(9 * x), noise=0.02)
    sets = Sets(known, 3)
    found = sets.weigh()
    assert bindings(known, found[0]) == ("cube(r=x)", "near(r=x)")
    bare = next(e for e in found if e.columns == () and e.kind == PLAIN)
    for index in known.statistics.of_kind("effect")[:2]:
        assert sets.parametric((index,)).all + sets.log_prior((index,)) < bare.log_weight


@pytest.mark.parametrize("most", [1, 2, 3])
def test_a_set_has_at_most_so_many_effects(most):
    known = tiny_evaluations([CUBE, SQUARE, COSINE], lambda x: x**2 - x**3 + np.cos(5 * x))
    found = Sets(known, most).weigh()
    assert max(len(e.effects) for e in found) == most
    assert len(found[0].effects) == most


def test_where_no_effect_is_allowed_there_is_none():
    found = Sets(tiny_evaluations([CUBE], cubic), 0).weigh()
    assert {e.kind for e in found} == {PLAIN, RECALIBRATED, REST} and not any(e.effects for e in found)


def test_more_effects_are_allowed_than_there_are():
    known = tiny_evaluations([CUBE], cubic)
    assert bindings(known, Sets(known, 3).weigh()[0]) == ("cube(r=x)",)


# The prior


def total_prior(known, most):
    """Prior summed over all sets of effects, values of an inner parameter by their weights."""
    sets, effects = Sets(known, most), known.statistics.of_kind("effect")
    total = 0.0
    for k in range(1, most + 1):
        for core in combinations(effects, k):
            if len({known.binding(i) for i in core}) == k:
                total += np.exp(sets.log_prior(core) + known.inner_weight(core))
    return total


@pytest.mark.parametrize("most", [1, 2, 3, 5])
def test_the_prior_of_all_sets_adds_up_to_that_of_effects(known, most):
    assert total_prior(known, most) == pytest.approx(ODDS.effects)


@pytest.mark.parametrize("most", [1, 2, 3])
def test_so_it_does_with_inner_parameters_and_with_an_effect_at_two_places(most):
    assert total_prior(tiny_evaluations([CUBE, DEAD_ZONE]), most) == pytest.approx(ODDS.effects)
    assert total_prior(two_places(effects=(SQUARE,)), most) == pytest.approx(ODDS.effects)
    assert total_prior(two_places(effects=(SQUARE, COSINE)), most) == pytest.approx(ODDS.effects)


def test_names_share_a_size_equally_and_bindings_their_name():
    known = two_places(effects=(SQUARE,))
    known.statistics.add("effect", [(on(COSINE).term(), {"effect": on(COSINE)})])
    sets = Sets(known, 1)
    prior = {known.binding(i): np.exp(sets.log_prior((i,))) for i in known.statistics.of_kind("effect")}
    half = ODDS.effects / 2
    assert prior == pytest.approx({"square(r=x)": half / 2, "square(r=u)": half / 2, "cosine(r=x)": half})


def test_a_larger_set_is_rarer_by_its_odds():
    known = tiny_evaluations([CUBE, SQUARE, COSINE])
    sets, (a, b, c) = Sets(known, 3), known.statistics.of_kind("effect")
    by_size = [3 * np.exp(sets.log_prior((a,))), 3 * np.exp(sets.log_prior((a, b))), np.exp(sets.log_prior((a, b, c)))]
    assert np.divide(by_size[1:], by_size[:-1]) == pytest.approx([ODDS.another] * 2)


@pytest.mark.skipif(os.environ.get("BAYES_GREYBOX_TYPECHECK", "0") == "1", reason="of the columns only their names are")
@pytest.mark.parametrize("places", [26, 40])
def test_hundreds_of_bindings_have_a_prior(places):
    columns = [SimpleNamespace(slug=f"e{k}", label=f"e{k}(r={c})") for k in range(10) for c in range(places)]
    statistics = SimpleNamespace(columns=columns, of_kind=lambda kind: range(len(columns)) if kind == "effect" else ())
    known = SimpleNamespace(statistics=statistics, odds=ODDS)
    known.name, known.binding = (lambda i: columns[i].slug), (lambda i: columns[i].label)
    prior = SetPrior.of(known, 2, ())  # type: ignore[arg-type]
    pairs = [prior.log((0, i)) for i in range(1, 10 * places)]
    # All that hold this one, of ten names: it is in one of five pairs at one of its places, in a pair of its own too.
    own, others = pairs[: places - 1], pairs[places - 1 :]
    assert np.exp(prior.log((0,))) * 10 * places == pytest.approx(ODDS.effects / (1 + ODDS.another))
    size = ODDS.effects * ODDS.another / (1 + ODDS.another)
    half = 10 * places * (np.exp(own).sum() + np.exp(others).sum()) / 2
    assert half == pytest.approx(size)


def test_each_suspect_is_in_or_out_by_its_odds():
    known = suspicious(tiny_evaluations([CUBE]), (GAIN, "x"), (OFFSET, "x"))
    first, _ = known.statistics.of_kind("suspect")
    sets, p = Sets(known, 1), ODDS.suspect
    assert sets.log_prior(()) == pytest.approx(2 * np.log1p(-p))
    assert sets.log_prior((first,)) == pytest.approx(np.log(p) + np.log1p(-p))


# Signs


@pytest.mark.parametrize(("sign", "hidden"), [(1, -0.2), (-1, -0.2), (1, 0.0)])
def test_the_prior_of_a_sign_is_that_of_the_coefficients_half_line(sign, hidden):
    signed = Effect(slug="cube", name="Cube", domain="test", expression="r**3", sign=sign, reverse="the other")
    known = tiny_evaluations([signed], lambda x: hidden * x**3, noise=0.1, simulation=lambda t, x, u: [-x[0]])
    (cube,) = known.statistics.of_kind("effect")
    (e,) = (e for e in Sets(known, 1, in_time=True).weigh() if e.effects)
    # Half-lines of the prior N(0, 1) by importance: draws of θ weighted by their likelihood, on a fine grid.
    statistics = known.statistics
    X, y = statistics.at_rows([cube])[:, 0], statistics.rows.target / statistics.target_scale
    theta, t = np.linspace(-5, 5, 2001), np.linspace(-3, 1, 200)
    s2 = statistics.noise.sigma(t)[:, None] ** 2
    square = y @ y - 2 * theta * (X @ y) + theta**2 * (X @ X)
    logs = -0.5 * (square / s2 + len(y) * np.log(2 * np.pi * s2)) + statistics.noise.log_density(t)[:, None]
    by_theta = np.logaddexp.reduce(logs, axis=0) - 0.5 * theta**2 - 0.5 * np.log(2 * np.pi)
    shares = np.where(sign * theta > 0, 1 - WRONG_SIGN, np.where(theta == 0, 0.5, WRONG_SIGN))
    expected = np.logaddexp.reduce(by_theta + np.log(2 * shares)) + np.log((theta[1] - theta[0]) * (t[1] - t[0]))
    # P(sign) is that of a normal distribution, and θ's is Student's t.
    assert e.log_evidence == pytest.approx(expected, abs=0.03)


def test_a_prior_without_sign_adds_nothing():
    known = tiny_evaluations([CUBE], cubic)
    (cube,) = known.statistics.of_kind("effect")
    (e,) = (e for e in Sets(known, 1, in_time=True).weigh() if e.effects)
    assert e.log_evidence == pytest.approx(known.parametric([(cube,)])[0].all)


# Places, suspects, and nothing


def test_the_same_effect_is_found_at_two_places():
    known = two_places(lambda x, u: 0.6 * x**2 - 0.5 * u**2)
    assert bindings(known, Sets(known, 2).weigh()[0]) == ("square(r=u)", "square(r=x)")


def test_an_empty_catalogue_leaves_no_gap_recalibration_and_a_rest():
    found = Sets(tiny_evaluations(), 3).weigh()
    assert {e.kind for e in found} == {PLAIN, RECALIBRATED, REST} and not any(e.columns for e in found)


def test_nothing_can_be_recalibrated_in_a_simulation_without_terms():
    known = tiny_evaluations([CUBE], cubic, simulation=lambda t, x, u: [-x[0]])
    found = Sets(known, 1).weigh()
    assert RECALIBRATED not in {e.kind for e in found} and bindings(known, found[0]) == ("cube(r=x)",)
    empty = Sets(tiny_evaluations(simulation=lambda t, x, u: [-x[0]]), 1).weigh()
    assert {e.kind for e in empty} == {PLAIN, REST}


def test_a_users_own_term_is_in_every_set():
    known = tiny_evaluations([CUBE, SQUARE], lambda x: np.sin(3 * x), dictionary={"x": ["sin(3*x)"]})
    best = Sets(known, 2).weigh()[0]
    assert best.kind == PLAIN and not best.effects


def test_what_no_effect_resembles_is_a_rest():
    known = tiny_evaluations([SQUARE], lambda x: np.cos(2.5 * x) * x, noise=0.02)
    best = Sets(known, 2).weigh()[0]
    assert best.kind == REST and best.share_left > 0.5


def test_an_effect_that_is_the_gap_leaves_no_rest():
    found = Sets(tiny_evaluations([CUBE, SQUARE], cubic), 2).weigh()
    assert found[0].kind == PLAIN
    assert all(0.0 <= e.share_left <= 1.0 for e in found)


def test_a_suspect_may_stand_beside_an_effect():
    known = suspicious(tiny_evaluations([CUBE], lambda x: -(x**3) + 0.3 * np.sin(8 * x)), (GAIN, "x"), (OFFSET, "x"))
    best = Sets(known, 1).weigh()[0]
    (offset,) = best.suspects
    assert known.statistics.columns[offset].suspect.key == "offset of x"
    assert bindings(known, best) == ("cube(r=x)",)


def test_of_suspects_there_are_at_most_three_and_one_delay():
    known = tiny_evaluations([CUBE], lambda x: -(x**3) + sum(np.sin((7 + k) * x) for k in range(5)))
    suspicious(known, (DELAY, "a"), (DELAY, "b"), (GAIN, "x"), (OFFSET, "x"), (OFFSET, "y"))
    suspects = known.statistics.of_kind("suspect")
    found = Sets(known, 1).weigh()
    assert max(len(e.suspects) for e in found) == SUSPECTS_AT_MOST
    assert not any(set(suspects[:2]) <= set(e.suspects) for e in found)


def test_what_is_always_in_is_in_every_set_and_costs_no_prior():
    known = suspicious(tiny_evaluations([CUBE], cubic), (DELAY, "x"), (GAIN, "x"))
    delay, gain = known.statistics.of_kind("suspect")
    sets = Sets(known, 1, always=(delay,))
    found = sets.weigh()
    assert all(delay in e.suspects for e in found)
    assert sets.log_prior((gain,)) == pytest.approx(np.log(ODDS.suspect))


def test_the_probability_of_a_column_is_its_share_of_all_sets():
    known = tiny_evaluations([CUBE, SQUARE], cubic)
    sets = Sets(known, 2)
    sets.likeliest()
    cube, square = known.statistics.of_kind("effect")
    assert sets.probability([cube]) > 0.99 and sets.probability([square]) < 0.2
    assert sets.probability([cube, square]) >= sets.probability([cube])


def test_a_process_in_time_leaves_no_explanation_without_it():
    found = [e for e in Sets(tiny_evaluations([CUBE], cubic), 1, in_time=True).weigh() if e.kind != LAWFUL]
    assert {e.kind for e in found} == {PLAIN} and len(found) == 2


# The grid over an inner parameter, on rows of a dead zone


def dead(noise, gap=0.43):
    """Rows with a dead zone, sought among others in that shape only."""
    return tiny_evaluations([DEAD_ZONE], lambda x: -np.sign(x) * np.maximum(np.abs(x) - gap, 0), noise)


def values(known):
    return np.array([known.statistics.columns[i].inner["gap"] for i in known.statistics.of_kind("effect")])


def log_weights(known):
    return np.array([known.statistics.columns[i].log_weight for i in known.statistics.of_kind("effect")])


def posterior(known):
    effects = known.statistics.of_kind("effect")
    log_z = np.array([v.all for v in known.parametric([(i,) for i in effects])])
    return np.exp(log_z - np.logaddexp.reduce(log_z))


def refined(known):
    return refine(known, (), known.statistics.of_kind("effect"))


def test_an_effect_without_an_inner_parameter_has_no_grid_to_refine():
    known = tiny_evaluations([CUBE], cubic, 0.1)
    (cube,) = known.statistics.of_kind("effect")
    assert refine(known, (), [cube]) == (cube,)


def test_the_grid_is_refined_around_the_value_of_the_data_until_its_posterior_spans_several():
    known = dead(noise=0.003)
    assert np.max(posterior(known)) > 0.9
    old = values(known)
    found = refined(known)
    assert np.max(posterior(known)) < 0.5
    # The standard error of the gap is about 0.003/√30/1 = 6e-4; four of them and half a cell.
    assert posterior(known) @ values(known) == pytest.approx(0.43, abs=4e-3)
    gaps = np.diff(np.sort(values(known)))
    assert np.sort(values(known))[np.argmin(gaps)] == pytest.approx(0.43, abs=0.03)
    assert list(found) == known.statistics.of_kind("effect") and set(old) <= set(values(known))
    assert len(old) < len(found) <= len(old) + ZOOMS * ZOOM_NODES


@pytest.mark.parametrize("share", [0.104, 0.88])
def test_values_in_the_first_and_the_last_cell_are_reached_too(share):
    limit = share * float(np.max(np.abs(tiny_data().states["x"])))
    known = dead(noise=0.0005, gap=limit)
    assert not min(values(known)) < limit < max(values(known))
    refined(known)
    assert min(abs(np.array(values(known)) / limit - 1)) < 0.01
    assert posterior(known) @ values(known) == pytest.approx(limit, rel=0.01)


@pytest.mark.parametrize(("noise", "expected"), [(0.3, True), (1.0, True), (20.0, False)])
def test_a_grid_is_refined_if_one_value_has_more_than_its_share(noise, expected):
    known = dead(noise)
    effects = known.statistics.of_kind("effect")
    assert (np.max(posterior(known)) > SPANS) == expected
    assert (refined(known) != tuple(effects)) == expected


def test_a_prior_weight_is_the_width_of_its_cell_on_the_logarithm():
    known = dead(noise=0.003)
    assert np.sum(np.exp(log_weights(known))) == pytest.approx(1.0)
    refined(known)
    order = np.argsort(values(known))
    # Largest |x| is 1, so the prior is log-uniform from 0.1 to 0.9; cells meet half-way and end at its ends.
    u = np.log(values(known)[order])
    edges = np.concatenate([[np.log(0.1)], (u[1:] + u[:-1]) / 2, [np.log(0.9)]])
    np.testing.assert_allclose(np.exp(log_weights(known)[order]), np.diff(edges) / np.log(9), rtol=1e-9)


def test_refining_brings_the_evidence_to_its_integral_over_the_prior():
    def summed(indices):
        return np.logaddexp.reduce([v.all for v in known.parametric([(i,) for i in indices])])

    known = dead(noise=0.1)
    effects = known.statistics.of_kind("effect")
    coarse, fine = summed(effects), summed(refined(known))
    start = len(known.statistics.columns)
    values = np.geomspace(0.1, 0.9, 60)
    (least,), (most,) = limits(on(DEAD_ZONE), known.statistics.rows.columns)
    known.statistics.add("effect", at_values(on(DEAD_ZONE), values[:, None], widths(values, least, most)))
    integral = summed(range(start, len(known.statistics.columns)))
    assert fine == pytest.approx(integral, abs=0.05)
    assert abs(coarse - integral) > 0.3


def test_a_column_that_has_one_value_of_its_inner_parameter_left_cannot_be_refined():
    known = dead(noise=0.003)
    first = known.statistics.of_kind("effect")[0]
    assert refine(known, (), [first]) == (first,)


def test_weighing_refines_the_inner_parameter_and_sums_over_its_values():
    known = dead(noise=0.003)
    before = len(known.statistics.columns)
    found = Sets(known, 1).weigh()
    assert len(known.statistics.columns) > before
    held = [e for e in found if e.effects and e.kind == PLAIN]
    assert len(held) > 1 and {bindings(known, e) for e in held} == {("dead-zone(r=x)",)}
    best = known.statistics.columns[held[0].effects[0]].inner["gap"]
    assert best == pytest.approx(0.43, abs=0.01)


# Laws that are in no catalogue


def lawful(hidden, *effects, noise=0.01, seed=1):
    data = tiny_data(hidden, noise=noise, n=200, seed=seed)
    statistics = sufficient_statistics(tiny_model(), data, "x", [on(e) for e in effects])
    return Evaluations(
        statistics, ODDS, Evaluator(statistics.prior, statistics.kernel, np.asarray(statistics.basis.frequency))
    )


def test_a_law_next_to_an_effect_is_not_that_effect():
    known = lawful(lambda x: -0.4 * x * np.abs(x), CUBE)
    found = Sets(known, 2).weigh()
    assert found[0].kind == LAWFUL and not found[0].effects and found[0].share_left > 0.9
    assert known.statistics.columns[found[0].memory[0]].memory == Memory(LAW, "x*abs(x)")


def test_an_effect_is_none_of_its_neighbours():
    found = Sets(lawful(lambda x: -0.4 * x**3, CUBE), 2).weigh()
    assert found[0].kind == PLAIN and found[0].effects
    laws = [e for e in found if e.kind == LAWFUL]
    assert len(laws) == 4 and all(e.log_weight < found[0].log_weight - 3 for e in laws)


def test_a_neighbouring_law_weighs_a_share_of_its_effects_prior_times_its_own_evidence():
    known = lawful(lambda x: -0.4 * x**3, CUBE, SQUARE)
    statistics, odds = known.statistics, known.odds
    found = Sets(known, 1).weigh()
    (correction,) = statistics.of_kind("correction")
    laws = [e for e in found if e.kind == LAWFUL]
    assert {statistics.columns[e.memory[0]].memory.channel for e in laws} >= {"x*abs(x)", "x**3*abs(x)"}
    for e in laws:
        evidence = np.logaddexp(
            np.log1p(-odds.correction) + dense(known, e.memory),
            np.log(odds.correction) + dense(known, (correction, *e.memory)),
        )
        prior = odds.effects / 2 * (1 - odds.remainder) * OTHER_LAWS / 4
        assert e.log_weight == pytest.approx(np.log(prior) + evidence, abs=1e-4)


def test_a_law_between_two_effects_is_not_the_two_together():
    """x|x| and x³ together follow the curve of x|x|^1.5 to within the noise, and one law is simpler than two."""
    signed = Effect(slug="signed-square", name="Signed square", domain="test", expression="r*abs(r)")
    found = Sets(lawful(lambda x: -0.4 * x * np.abs(x) ** 1.5, CUBE, signed), 2).weigh()
    assert found[0].kind == LAWFUL and not found[0].effects
    both = [e for e in found if e.kind == PLAIN and len(e.effects) == 2]
    assert both and found[0].log_weight > both[0].log_weight
    # Two that are there stay two: no law between fits.
    fifth = Effect(slug="fifth", name="Fifth power", domain="test", expression="r**5")
    found = Sets(lawful(lambda x: -0.4 * x * np.abs(x) - 0.5 * x**5, fifth, signed), 2).weigh()
    assert found[0].kind == PLAIN and len(found[0].effects) == 2


FADING = Effect(
    slug="fading", name="Fading friction", domain="test", expression="sign(r)*exp(-r**2/s**2)",
    inner=(InnerParameter("s", "where it fades", of="r", low=0.1, high=1.0),),
)  # fmt: skip


def test_an_effect_with_an_inner_parameter_is_none_of_its_neighbours():
    """A law that rises before it fades is no friction that begins with a jump, and the other way round."""
    known = lawful(lambda x: -0.6 * x * np.exp(-(x**2) / 0.25), FADING)
    found = Sets(known, 1).weigh()
    assert found[0].kind == LAWFUL and not found[0].effects
    found = Sets(lawful(lambda x: -0.4 * np.sign(x) * np.exp(-(x**2) / 0.25), FADING), 1).weigh()
    assert found[0].kind == PLAIN and found[0].effects


FADED = lambda x: -0.6 * np.sign(x) * np.sqrt(np.abs(x)) * np.exp(-(x**2) / 0.2)  # noqa: E731
DEADENED = lambda x: -np.sign(x) * np.maximum(np.abs(x) - 0.4, 0) * np.sqrt(np.abs(x))  # noqa: E731


@pytest.mark.parametrize(
    ("effect", "hidden", "noise", "seed"),
    [(FADING, FADED, 0.02, 1), (FADING, FADED, 0.1, 2), (DEAD_ZONE, DEADENED, 0.02, 1)],
    ids=["fading", "fading, much noise", "dead zone"],
)
def test_a_law_next_to_a_bent_effect_is_summed_over_values_of_its_own(effect, hidden, noise, seed):
    """The effect fits best where the law does not: at its values the law is nothing like as likely as at its own."""
    known = lawful(hidden, effect, noise=noise, seed=seed)
    statistics, odds = known.statistics, known.odds
    found = Sets(known, 1).weigh()
    assert found[0].kind == LAWFUL and not found[0].effects
    laws = {statistics.columns[e.memory[0]].law.effect.expression: e for e in found if e.kind == LAWFUL}
    assert len(laws) == 2
    (law,) = (e for expression, e in laws.items() if expression.endswith("**0.5"))
    # Its evidence by a sum over a fine grid of its own, with the weights of a uniform prior on log s.
    shape = statistics.columns[law.memory[0]].law
    (least,), (most,) = limits(shape, statistics.rows.columns)
    values, start = np.geomspace(least * 1.001, most * 0.999, 120), len(statistics.columns)
    items = at_values(shape, values[:, None], widths(values, least, most), effect=None, law=shape)
    statistics.add("law", items)
    integral = np.logaddexp.reduce([v.all for v in known.parametric([(i,) for i in range(start, start + 120)])])
    prior = odds.effects * (1 - odds.remainder) * OTHER_LAWS / 2
    assert law.log_weight == pytest.approx(np.log(prior) + integral, abs=0.3)


def test_a_bent_law_that_is_an_effect_at_some_values_is_none_there():
    """Far below what the data see, tanh(x/s) |x| is x: the catalogue has that."""
    smooth = Effect(
        slug="smooth", name="Smooth friction", domain="test", expression="tanh(r/s)",
        inner=(InnerParameter("s", "width", of="r", low=0.001, high=1.0),),
    )  # fmt: skip
    line = Effect(slug="line", name="Line", domain="test", expression="r*abs(r)**0.0001")
    known = lawful(lambda x: -0.4 * x, smooth, line)
    (first, *_) = (i for i in known.statistics.of_kind("effect") if known.name(i) == "smooth")
    laws = Laws(known)
    every = {known.statistics.columns[law[0]].called: law for law in laws.next_to(first)}
    own = {known.statistics.columns[law[0]].called: law for law in laws.nameless(first)}
    (name,) = (each for each in every if each.endswith("abs(x)"))
    dropped = set(every[name]) - set(own[name])
    assert dropped and own[name]
    low = max(known.statistics.columns[i].inner["s"] for i in dropped)
    assert low < min(known.statistics.columns[i].inner["s"] for i in own[name])


# Forces that remember


def remembering(hidden, noise=0.02, n=400):
    """ẋ = −x + hidden(t, x) along a path in order of time, with what its elements remember."""
    t = np.linspace(0, 30, n)
    x = 0.7 * np.sin(t) + 0.3 * np.sin(2.3 * t + 1)
    rate = -x + hidden(t, x) + noise * np.random.default_rng(5).standard_normal(n)
    data = Trajectories.from_arrays(t, states={"x": x}, derivatives={"x": rate})
    statistics = sufficient_statistics(tiny_model(), data, "x", [on(CUBE), on(SQUARE)])
    statistics.remember(memory_columns(data))
    return Evaluations(
        statistics, ODDS, Evaluator(statistics.prior, statistics.kernel, np.asarray(statistics.basis.frequency))
    )


def sliding(t, x, limit=0.25):
    """Friction that gives way elastically, step by step."""
    z = np.zeros(len(x))
    for k in range(1, len(x)):
        z[k] = min(max(z[k - 1] + x[k] - x[k - 1], -limit), limit)
    return -z


def creeping(t, x):
    """A spring and a damper in series that forget within 1.5, by small steps."""
    fine = np.linspace(t[0], t[-1], 20 * (len(t) - 1) + 1)
    path, z = 0.7 * np.sin(fine) + 0.3 * np.sin(2.3 * fine + 1), np.zeros(len(fine))
    for k in range(1, len(fine)):
        z[k] = z[k - 1] + path[k] - path[k - 1] - z[k - 1] * (fine[1] - fine[0]) / 1.5
    return -z[::20]


@pytest.mark.parametrize(("hidden", "kind"), [(sliding, HYSTERESIS), (creeping, RELAXATION)])
def test_a_force_that_remembers_is_no_effect_and_no_function_of_the_states(hidden, kind):
    known = remembering(hidden)
    found = Sets(known, 2).weigh()
    assert found[0].kind == MEMORY and not found[0].effects and found[0].share_left > 0.8
    assert known.statistics.columns[found[0].memory[0]].memory == Memory(kind, "x")
    assert max(e.log_weight for e in found if e.kind != MEMORY) < found[0].log_weight - 5


def test_what_remembers_nothing_is_not_said_to():
    found = Sets(remembering(lambda t, x: -0.5 * x**3), 2).weigh()
    assert found[0].kind == PLAIN and found[0].effects
    assert max(e.log_weight for e in found if e.kind == MEMORY) < found[0].log_weight - 3


@pytest.mark.slow
@pytest.mark.parametrize("in_time", [False, True])
def test_a_memory_weighs_its_prior_times_its_evidence(in_time):
    known = remembering(lambda t, x: sliding(t, x) - 0.3 * x**3)
    found = Sets(known, 1, in_time=in_time).weigh()
    statistics, odds = known.statistics, known.odds
    (correction,) = statistics.of_kind("correction")
    n_effect, n_memory = 2, 2
    # Half of a rest stands with the states, half of that remembers; of a process in time a quarter.
    share, seen = 0.125 if in_time else 0.25, set()
    for e in found:
        if e.kind == MEMORY and len(e.effects) < 2:
            prior = odds.unknown if not e.effects else odds.effects / n_effect * odds.remainder
            columns = (*e.effects, *e.memory)
            out, inside = dense(known, columns), dense(known, (correction, *columns))
            evidence = np.logaddexp(np.log1p(-odds.correction) + out, np.log(odds.correction) + inside)
            assert e.log_weight == pytest.approx(np.log(prior * share / n_memory) + evidence, abs=1e-4)
            seen.add(e.columns)
    assert {(), (statistics.of_kind("effect")[0],)} <= seen


def test_what_a_column_gains_after_the_search_moves_the_likeliest_set():
    known = tiny_evaluations([CUBE, SQUARE], cubic)
    cube, square = known.statistics.of_kind("effect")
    sets = Sets(known, 1)
    assert sets.likeliest() == (cube,)
    columns, before = known.statistics.columns, sets.parametric((square,)).all
    columns[square] = replace(columns[square], nearer=Nearer(500.0))
    sets.reweigh()
    assert sets.likeliest() == (square,)
    assert sets.parametric((square,)).all == pytest.approx(before + 500.0)
    # Beside f, which has taken up what is gained near itself, nothing is.
    found = {(e.effects, e.kind): e.log_evidence for e in sets.weigh()}
    assert found[(square,), REST] < found[(square,), PLAIN] - 300.0


def test_values_that_were_told_later_are_of_the_same_set(monkeypatch):
    monkeypatch.setattr("bayes_greybox.discovery.weighing.sets.WITH_REST", 4)
    known = tiny_evaluations([DEAD_ZONE, CUBE], cubic, noise=0.2)
    zone, later = on(DEAD_ZONE), {"gap": 0.33}
    known.statistics.add("effect", [(zone.term(later), {"effect": zone, "inner": later})])
    *zones, cube, last = known.statistics.of_kind("effect")
    cores = [(), *((i, cube) for i in zones), (cube, last)]
    sets = Sets(known, 2)
    weight, _, others = sets._likely(cores, sets._plain(cores))
    weighed = [c for c in others if c]
    assert len(weighed) < len(cores) - 1
    whole = np.logaddexp.reduce([weight[c] for c in cores if c])
    assert np.logaddexp.reduce([weight[c] + others[c] for c in weighed]) == pytest.approx(whole)
    assert [others[c] for c in weighed] == pytest.approx([others[weighed[0]]] * len(weighed))


def test_values_that_are_not_weighed_beside_f_are_stood_for_by_those_that_are(monkeypatch):
    monkeypatch.setattr("bayes_greybox.discovery.weighing.sets.WITH_REST", 4)
    known = tiny_evaluations([DEAD_ZONE], lambda x: -np.sign(x) * np.maximum(np.abs(x) - 0.3, 0), noise=0.2)
    sets = Sets(known, 1)
    sets.likeliest()
    cores = sets.search.siblings(sets.search.near())
    plain = sets._plain(cores)
    weight, best, others = sets._likely(cores, plain)
    values = [c for c in cores if c]
    weighed = [c for c in best if c]
    assert len(weighed) < len(values)
    whole = np.logaddexp.reduce([weight[c] for c in values])
    assert np.logaddexp.reduce([weight[c] + others[c] for c in weighed]) == pytest.approx(whole)
    assert others[()] == 0.0
