"""Sensors whose reading is no straight line of what they measure."""

import numpy as np
import pytest

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.suspects.bends import CUBIC, POWERS, QUADRATIC, bent, straightened
from bayes_greybox.discovery.suspects.channels import GAIN, OFFSET, ChannelSuspect, as_shown, calibrated
from bayes_greybox.discovery.suspects.sensors import bent_by, sensor_columns

X = np.linspace(-1.3, 2.1, 137)


@pytest.mark.parametrize("unit", [1.0, 1e9, 1e-9], ids=["1", "1e9", "1e-9"])
@pytest.mark.parametrize("errors", [{3: -0.02}, {3: 0.2}, {2: 0.1}, {2: -0.1, 3: 0.05}, {2: 0.0, 3: 0.0}, {}])
def test_what_is_bent_is_straightened_again_in_any_unit(errors, unit):
    x, own = unit * X, {p: size / unit ** (p - 1) for p, size in errors.items()}
    np.testing.assert_allclose(straightened(1.1 * x + bent(x, own), own, 1.1), x, rtol=1e-12, atol=1e-12 * unit)


def test_beyond_its_turning_point_a_reading_is_still_a_number_of_its_own():
    readings = np.linspace(-3, 3, 101)
    found = straightened(readings, {3: -1.0})
    assert np.all(np.diff(found) > 0)


def test_a_sample_that_is_not_there_stays_away():
    found = straightened(np.array([0.5, np.nan, np.inf]), {3: 0.1})
    assert np.isfinite(found[0]) and np.isnan(found[1]) and np.isinf(found[2])


def test_a_sensor_is_put_right_with_all_its_errors_and_shows_them_again():
    data = Trajectories.from_arrays(np.arange(len(X)), states={"x": X, "z": X})
    sizes = {
        ChannelSuspect(GAIN, "x", 1.0): 0.03, ChannelSuspect(OFFSET, "x", 1.0): 0.2,
        ChannelSuspect(QUADRATIC, "x", 1.0): 0.05, ChannelSuspect(CUBIC, "x", 1.0): -0.03,
    }  # fmt: skip
    (shown,) = as_shown(X[None], "x", data, sizes, data)
    np.testing.assert_allclose(shown, 1.03 * X + 0.05 * X**2 - 0.03 * X**3 + 0.2)
    read = Trajectories.from_arrays(np.arange(len(X)), states={"x": shown, "z": X})
    right = calibrated(read, "v", sizes, data)
    np.testing.assert_allclose(right.states["x"], X, atol=1e-12)
    assert np.array_equal(right.states["z"], X)


def test_columns_are_of_their_own_sensor_and_what_they_did_is_done_again():
    data = Trajectories.from_arrays(np.arange(len(X)), states={"x": X, "z": -2 * X})
    columns = {suspect.key: column for suspect, column in sensor_columns(data, data)}
    for kind, power in POWERS.items():
        np.testing.assert_allclose(columns[f"{kind} of z"], [*np.zeros(len(X)), *(-2 * X) ** power])
    sizes = {ChannelSuspect(CUBIC, "z", 1.0): 0.1}
    np.testing.assert_allclose(bent_by(data, sizes), 0.1 * columns["cubic error of z"])
