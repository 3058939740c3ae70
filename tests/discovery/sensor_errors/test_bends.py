"""Sensors whose reading is no straight line of what they measure."""

import numpy as np
import pytest

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.sensor_errors.bends import BEND_POWERS, CUBIC, QUADRATIC, Curve
from bayes_greybox.discovery.sensor_errors.channels import DELAY, GAIN, OFFSET, ChannelSuspect, as_shown, calibrated
from bayes_greybox.discovery.sensor_errors.sensors import bent_by, sensor_columns, unit_of_rows

X = np.linspace(-1.3, 2.1, 137)
CENTER = 0.4
SIZES = {
    ChannelSuspect(GAIN, "x", 1.0): 0.03, ChannelSuspect(OFFSET, "x", 1.0): 0.2,
    ChannelSuspect(QUADRATIC, "x", 1.0, center=CENTER): 0.05, ChannelSuspect(CUBIC, "x", 1.0, center=CENTER): -0.03,
}  # fmt: skip


def of(**states):
    return Trajectories.from_arrays(0.1 * np.arange(len(X)), states=states)


@pytest.mark.parametrize("unit", [1.0, 1e9, 1e-9], ids=["1", "1e9", "1e-9"])
@pytest.mark.parametrize("center", [0.0, CENTER, 300.0])
@pytest.mark.parametrize("errors", [{3: -0.02}, {3: 0.2}, {2: 0.1}, {2: -0.1, 3: 0.05}, {2: 0.0, 3: 0.0}, {}])
def test_what_is_bent_is_straightened_again_in_any_unit_and_about_any_middle(errors, center, unit):
    x = unit * (X + center)
    curve = Curve({p: size / unit ** (p - 1) for p, size in errors.items()}, unit * center, 1.1)
    np.testing.assert_allclose(curve.measured(curve.shown(x)), x, rtol=1e-12, atol=1e-12 * unit)


def test_beyond_its_turning_point_each_reading_is_still_that_of_one_value():
    curve, readings = Curve({3: -1.0}, CENTER), np.linspace(-3, 3, 101)
    found = curve.measured(readings)
    assert np.all(np.diff(found) > 0)
    np.testing.assert_allclose(curve.shown(found), readings, atol=1e-9)


def test_a_sample_that_is_not_there_stays_away():
    found = Curve({3: 0.1}).measured(np.array([0.5, np.nan, np.inf]))
    assert np.isfinite(found[0]) and np.isnan(found[1]) and np.isinf(found[2])
    assert np.all(np.isnan(Curve({3: 0.1}).measured(np.array([np.nan]))))


def test_a_sensor_is_put_right_with_all_its_errors_and_shows_them_again():
    data = of(x=X, z=X)
    (shown,) = as_shown(X[None], "x", data, SIZES, data)
    z = X - CENTER
    np.testing.assert_allclose(shown, 1.03 * X + 0.05 * z**2 - 0.03 * z**3 + 0.2)
    right = calibrated(of(x=shown, z=X), "v", SIZES, data)
    np.testing.assert_allclose(right.states["x"], X, atol=1e-12)
    assert np.array_equal(right.states["z"], X)


def test_columns_are_of_their_own_sensor_about_its_zero():
    data = of(x=X, z=-2 * X)
    columns = {suspect.key: column for suspect, column in sensor_columns(data, data)}
    for kind, power in BEND_POWERS.items():
        np.testing.assert_allclose(columns[f"{kind} of z"], [*np.zeros(len(X)), *(-2 * X) ** power])


def test_a_thermometer_bends_alike_in_every_scale_of_temperature():
    found = []
    for zero in (15.0, 288.15):
        data = of(T=zero + X)
        found.append(
            [(s.sd, s.center - zero, column) for s, column in sensor_columns(data, data) if s.kind in BEND_POWERS]
        )
    for (sd, center, column), (other_sd, other_center, other) in zip(*found, strict=True):
        assert sd == pytest.approx(other_sd) and center == pytest.approx(other_center)
        np.testing.assert_allclose(column, other, atol=1e-11)


@pytest.mark.parametrize("start", [-1e-9, 1e-9])
def test_a_tank_that_starts_empty_bends_about_zero(start):
    data = of(h=start + X - X[0])
    assert {s.center for s, _ in sensor_columns(data, data) if s.kind in BEND_POWERS} == {0.0}


def test_a_sensor_that_does_not_move_has_no_bend():
    still = Trajectories.from_arrays(0.1 * np.arange(len(X)), states={"x": np.full(len(X), 3.0)}, constant="keep")
    assert not any(suspect.kind in BEND_POWERS for suspect, _ in sensor_columns(still, still))


def test_what_a_late_sensor_bends_is_what_it_shows():
    path = of(x=np.sin(0.1 * np.arange(len(X))))
    columns = {suspect.key: column for suspect, column in sensor_columns(path, path, {"x": 0.35})}
    late = np.sin(0.1 * np.arange(len(X)) - 0.35)[10:]
    np.testing.assert_allclose(columns["gain of x"][10:], late, atol=1e-5)
    assert np.corrcoef(columns["cubic error of x"][10:], late**3)[0, 1] > 0.999999


def test_rows_are_in_the_unit_of_readings_that_are_bent_and_too_large():
    """A row is x + B(x) + κ x̄ where the reading is (1 + κ) x + B(x), by differences."""
    sizes = SIZES | {ChannelSuspect(DELAY, "x", 1.0): 0.0}

    def rows(readings):
        right = calibrated(of(x=readings), "v", sizes, of(x=X))
        return right.states["x"] + bent_by(right, sizes)

    (shown,), h = as_shown(X[None], "x", of(x=X), sizes, of(x=X)), 1e-6
    slope = (rows(shown + h) - rows(shown - h)) / (2 * h)
    assert unit_of_rows(of(x=X), sizes) == pytest.approx(-np.mean(np.log(slope)), rel=1e-6)
    # A bend alone is put back as it was, and a gain alone divides.
    bend = {suspect: size for suspect, size in SIZES.items() if suspect.kind in BEND_POWERS}
    assert unit_of_rows(of(x=X), bend) == pytest.approx(0.0, abs=1e-15)
    gain = {suspect: size for suspect, size in SIZES.items() if suspect.kind == GAIN}
    assert unit_of_rows(of(x=X), gain) == pytest.approx(np.log(1.03))
