"""Values of nonlinear parameters are found though the first ones miss them."""

from dataclasses import replace

import numpy as np
import pytest
from tiny_equation import CUBE, DEAD_ZONE, WIDTH, on, tiny_data, tiny_model, tiny_study_of

from bayes_greybox.discovery.grid.log_evidence import gram, log_evidences
from bayes_greybox.discovery.grid.points import NO_DISCREPANCY, NoisePoint
from bayes_greybox.discovery.linearise.near import Point
from bayes_greybox.discovery.linearise.rates import RateRows
from bayes_greybox.discovery.linearise.refine import Ground, _Search, carrying, refined
from bayes_greybox.discovery.linearise.visits import table_of
from bayes_greybox.discovery.regressors.columns import Values

SHAPE = replace(WIDTH, name="bend", meaning="bend", low=0.2, high=5.0, unit_of="")
BENT_ZONE = replace(
    DEAD_ZONE, slug="bent-zone", expression="sign(r)*max(abs(r) - gap, 0)*exp(-(bend*r)**2)", inner=(WIDTH, SHAPE)
)


def zone(gap):
    return lambda x: -np.sign(x) * np.maximum(np.abs(x) - gap, 0)


def bent(gap, bend):
    return lambda x: 3 * zone(gap)(x) * np.exp(-((bend * x) ** 2))


def found(effects, hidden, noise=0.005, n=400):
    """Rows, and the values that they are refined to before anything is weighed."""
    source = RateRows(tiny_model(), tiny_data(hidden, noise, n), "x", [on(effect) for effect in effects])
    rows = source.near(Point())
    ground = Ground(table_of(rows), (rows.force,), (NoisePoint(NO_DISCREPANCY),), rows.floor)
    return source, rows, refined(rows.regressors, ground)[0]


@pytest.mark.parametrize("gap", [0.137, 0.32, 0.611])
def test_the_width_of_a_dead_zone_is_found_to_a_percent(gap):
    _, rows, values = found([DEAD_ZONE, CUBE], zone(gap))
    first = [column.inner["gap"] for column in rows.regressors.columns if column.inner]
    assert np.min(np.abs(np.log(np.array(first) / gap))) > 0.01
    (label,) = values
    points, weights = values[label].points[:, 0], values[label].log_weights
    assert np.min(np.abs(points / gap - 1)) < 0.01
    # Finer values that carry nothing are left out; the others weigh as much of the prior as they stand for.
    assert len(points) < len(first) + 5 * 9 and 0 < np.sum(np.exp(weights)) <= 1 + 1e-9


@pytest.mark.parametrize(("spread", "kept"), [(0.05, 8), (4.0, 21)])
def test_kept_values_carry_99_per_cent_of_the_posterior(spread, kept):
    # Normal of a standard deviation in steps of the values: 99 % lie within 2.58 of them, 21 values for 4 steps.
    x = np.arange(-50, 51)
    logs = -0.5 * (x / spread) ** 2
    stay = carrying(np.maximum(logs, -11.0) if spread < 1 else logs)
    assert stay.sum() == kept and stay[50]


def test_the_likeliest_value_of_a_study_is_the_true_one():
    study = tiny_study_of([DEAD_ZONE, CUBE], tiny_data(zone(0.32), 0.02, 300))
    row = study.effects(tiny_data()).iloc[0]
    assert row["slug"] == "dead-zone" and row["inner"]["gap"] == pytest.approx(0.32, rel=0.05)
    # At least a few values: intervals of the coefficient are smooth.
    assert len({int(i) for i in study.coefficients.inner[:, 0]}) >= 3


def test_two_parameters_are_found_together():
    _, _, values = found([BENT_ZONE], bent(0.23, 0.9))
    (label,) = values
    away = np.abs(np.log(values[label].points / [0.23, 0.9]))
    assert np.min(np.max(away, axis=1)) < 0.1


def test_finer_values_are_columns_of_the_next_rows():
    source, rows, values = found([DEAD_ZONE], zone(0.32))
    again = source.near(Point(values=values))
    inner = [column.inner["gap"] for column in again.regressors.columns if column.inner]
    (points,) = [each.points[:, 0] for each in values.values()]
    np.testing.assert_allclose(np.sort(inner), np.sort(points))
    assert len(rows.regressors.group(next(iter(values)))) == 8


def test_values_refined_again_on_other_rows_stand_for_no_more_of_the_prior():
    # Kept values stand for the posterior on the rows before: on others they say where to look, and weigh nothing.
    _, _, before = found([BENT_ZONE], bent(0.26, 0.8), noise=0.01)
    source, _, values = found([BENT_ZONE], bent(0.26, 0.8), noise=0.01, n=380)

    def log_evidence(rows):
        columns = rows.regressors.columns
        table, sets = table_of(rows), [(i,) for i, column in enumerate(columns) if column.inner]
        products = gram(table, (NoisePoint(NO_DISCREPANCY),), (rows.force,))
        precision = np.array([each.sd**-2.0 for each in table.regressors])
        logs = log_evidences(products, precision, sets, rows.floor)[:, 0]
        return np.logaddexp.reduce(logs + [column.log_weight for column in columns if column.inner])

    moved = source.near(Point(values=before))
    ground = Ground(table_of(moved), (moved.force,), (NoisePoint(NO_DISCREPANCY),), moved.floor)
    again = refined(moved.regressors, ground)[0]
    direct = log_evidence(source.near(Point(values=values)))
    assert log_evidence(source.near(Point(values=again))) == pytest.approx(direct, abs=0.2)


class Known(_Search):
    """A search among values whose evidence is known: shares of the ranges of two parameters."""

    def __init__(self, tabled, evidence, rival=-np.inf):
        self._rival, self._least, self._most, self.tabled = (
            rival,
            np.ones(2),
            np.full(2, 100.0),
            100.0 ** np.asarray(tabled),
        )
        middles = (np.arange(8) + 0.5) / 8
        grid = np.array([(a, b) for a in middles for b in middles])
        self.first = Values(100.0**grid, np.full(64, -np.log(64)))
        self._log_evidence = lambda context, values: evidence(np.log(values) / np.log(100.0), context)


def normal(centre, sd, floor=-25.0):
    def evidence(shares, context=None):
        return np.logaddexp(-0.5 * np.sum(((shares - centre) / sd) ** 2, axis=1), floor)

    return evidence


def test_a_mode_that_was_found_before_is_kept_though_the_first_values_say_nothing():
    centre, sd = np.array([0.31, 0.62]), np.array([2e-3, 4e-3])
    tabled = centre + sd * np.random.default_rng(0).standard_normal((20, 2))
    values = Known(tabled, normal(centre, sd)).values([None])
    logs = normal(centre, sd)(np.log(values.points) / np.log(100.0)) + values.log_weights
    assert np.logaddexp.reduce(logs) == pytest.approx(np.log(2 * np.pi * np.prod(sd)), abs=0.3)


def test_values_are_searched_for_while_the_effect_can_still_catch_up_with_another():
    centre, calls = np.array([0.31, 0.62]), []

    def evidence(shares, context):
        calls.append(len(shares))
        return normal(centre, 1e-4, floor=-1e9)(shares)

    def best(rival):
        calls.clear()
        first = Known([centre + 0.1], evidence).first.points
        values = Known(np.log(first) / np.log(100.0), evidence, rival).values([None])
        return np.max(evidence(np.log(values.points) / np.log(100.0), None)), len(calls)

    # The first values are 10⁵ nats behind a peak that is as high as the other effect's, or 10⁷ lower.
    (near, searched), (behind, given_up) = best(0.0), best(1e7)
    assert near > -3.0 and behind < -100.0 and given_up < searched / 2


def test_what_carries_one_context_is_kept_beside_another_that_is_narrower():
    centre, widths = np.array([0.31, 0.62]), {"wide": 0.05, "narrow": 0.01}

    def evidence(shares, context):
        return normal(centre, widths[context])(shares)

    values = Known([centre], evidence).values(list(widths))
    shares = np.log(values.points) / np.log(100.0)
    for context, sd in widths.items():
        found = np.logaddexp.reduce(evidence(shares, context) + values.log_weights)
        assert found == pytest.approx(np.log(2 * np.pi * sd**2), abs=0.3)


def test_values_without_a_column_are_no_values():
    assert Known([[0.3, 0.6]], lambda shares, context: np.full(len(shares), -np.inf)).values([None]) is None
