"""Values of nonlinear parameters are found though the first ones miss them."""

from dataclasses import replace

import numpy as np
import pytest
from tiny_equation import CUBE, DEAD_ZONE, WIDTH, on, tiny_data, tiny_model, tiny_study_of

from bayes_greybox.discovery.grid.points import NO_DISCREPANCY, NoisePoint
from bayes_greybox.discovery.linearise.near import Point
from bayes_greybox.discovery.linearise.rates import RateRows
from bayes_greybox.discovery.linearise.refine import Ground, carrying, refined
from bayes_greybox.discovery.linearise.settle import table_of

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
