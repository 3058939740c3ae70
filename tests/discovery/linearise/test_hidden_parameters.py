"""A parameter that only hidden states feel: rows near its value, and what is left of its change."""

import numpy as np
import pytest

import bayes_greybox as bg
from bayes_greybox.discovery.linearise.near import Point
from bayes_greybox.discovery.linearise.rates import RateRows

N, CAPACITY = 200, 2.1
CURRENT = np.repeat(np.random.default_rng(0).uniform(-1.0, 2.0, 20), 10)
VOLTS = 3.2 + 0.9 * (1.0 - np.append(0.0, np.cumsum(CURRENT[:-1])) * 10 / (3600 * CAPACITY)) - 0.05 * CURRENT


def rows(**values):
    """Rows of the voltage of a cell whose simulation believes in 2 A h."""
    data = bg.Trajectories.from_arrays(10.0 * np.arange(N), inputs={"i": CURRENT}, outputs={"V": VOLTS})
    model = bg.GreyBox(
        simulation={"soc": "-i/(3600*Q)", "V": "3.2 + 0.9*soc - R0*i"},
        parameters={"Q": 2.0, "R0": 0.05},
        starts={"soc": 1.0},
        rows=bg.DerivativeRows(interpolation="zoh"),
    )
    source = RateRows(model, model.started(data), "V", [])
    return source, source.near(Point(parameters=values))


@pytest.mark.parametrize("there", [2.0, 2.05, 2.0999])
def test_a_coefficient_is_the_whole_change_wherever_rows_are_taken(there):
    _, near = rows(Q=there) if there != 2.0 else rows()
    regressors = near.regressors
    (k,) = [k for k, column in enumerate(regressors.columns) if column.parameter == "Q"]
    change = (CAPACITY - 2.0) * regressors.columns[k].scale / regressors.target_scale
    left = regressors.target - change * regressors.values[:, k]
    # What the tangent leaves out goes with the square of the distance.
    assert np.max(np.abs(left)) < 1e-9 / regressors.target_scale + 1.5 * ((CAPACITY - there) / CAPACITY) ** 2 * np.max(
        np.abs(regressors.target)
    ) * CAPACITY / (CAPACITY - 2.0)


def test_data_put_right_have_hidden_states_that_follow_the_value_found():
    source, near = rows(Q=2.1)
    right = source.put_right(near.data, Point(parameters={"Q": 2.1}), {}, near.data)
    np.testing.assert_allclose(3.2 + 0.9 * right.states["soc"] - 0.05 * CURRENT, VOLTS, atol=1e-12)


def test_effects_are_tried_beside_a_change_that_rows_were_freed_of():
    assert set(rows(Q=2.1)[1].regressors.freed) == {"Q"} and not set(rows()[1].regressors.freed)


def test_no_sensor_reads_what_follows_from_its_start():
    """A state that a noisy current moves has noise of its own, which is none of a sensor."""
    noisy = CURRENT + 0.06 * np.random.default_rng(1).standard_normal(N)
    charge = 1.0 - np.append(0.0, np.cumsum(noisy[:-1])) * 10 / (3600 * 2.0)
    data = bg.Trajectories.from_arrays(10.0 * np.arange(N), inputs={"i": noisy}, outputs={"V": 3.2 + 0.9 * charge})
    model = bg.GreyBox(
        simulation={"soc": "-i/(3600*2.0)", "V": "3.1 + 0.9*soc"},
        starts={"soc": 1.0},
        rows=bg.DerivativeRows(interpolation="zoh"),
    )
    source = RateRows(model, model.started(data), "V", [])
    assert "soc" not in source.sample_noise and "soc" not in source.misread
