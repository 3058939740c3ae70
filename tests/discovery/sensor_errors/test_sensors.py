"""Errors of sensors whose samples are rows, and of the inputs that drive their path."""

import numpy as np
import pytest

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.linearise.path_sensors import freed
from bayes_greybox.discovery.sensor_errors.channels import DELAY, GAIN, OFFSET, ChannelSuspect
from bayes_greybox.discovery.sensor_errors.sensors import _gradient, input_columns, sensor_columns
from bayes_greybox.physics.terms import Term

RATE = [(Term("F"), 1.0), (Term("y"), -2.0), (Term("u**2*y"), 0.3), (Term("u*sin(F)"), 0.7)]


def path():
    t = np.linspace(0, 10, 201)
    columns = {"y": np.sin(t), "F": np.cos(2 * t), "u": 1 + 0.5 * np.sin(3 * t)}
    return Trajectories.from_arrays(t, states={"y": columns["y"]}, inputs={n: columns[n] for n in ("F", "u")})


def whole(data):
    return sum(value * np.asarray(term.evaluate(data.columns)) for term, value in RATE)


@pytest.mark.parametrize("kind", [DELAY, GAIN, OFFSET])
@pytest.mark.parametrize("name", ["F", "u"])
def test_the_column_of_an_inputs_error_is_what_right_inputs_change_of_the_rate(kind, name):
    data, size = path(), 1e-5
    columns = {suspect.key: column for suspect, column in input_columns(data, data.input_names, whole, 0.05)}
    right = freed(data, "v", {ChannelSuspect(kind, name, 1.0): size}, data)
    assert not np.array_equal(right.inputs[name], data.inputs[name])
    change = (whole(right) - whole(data)) / size
    # The rate of change of an input is that of its samples, 0.05 apart: (ωh)²/6 of it is lost, and more at the ends.
    inside, tolerance = slice(1, -1), 0.01 if kind == DELAY else 1e-4
    scale = float(np.max(np.abs(change)))
    np.testing.assert_allclose(change[inside], columns[f"{kind} of {name}"][inside], atol=tolerance * scale)


def test_how_fast_a_held_input_changes_adds_up_to_its_leaps():
    """Of nodes as paths have them, a leap at 2.0 in no time: Simpson's sum over the steps is the whole leap."""
    ends = np.concatenate([np.linspace(0, 2, 21), np.linspace(2, 5, 31)])
    time = np.insert(ends, np.arange(1, len(ends)), (ends[1:] + ends[:-1]) / 2)
    u = np.where(np.arange(len(time)) <= 40, 0.0, 1.0)
    u[41] = 0.5
    fast, h = _gradient(time, u), np.diff(ends)
    assert np.sum(h / 6 * (fast[:-2:2] + 4 * fast[1::2] + fast[2::2])) == pytest.approx(1.0)


def test_a_late_sensor_keeps_its_samples_and_is_told_by_its_column_at_the_delay_so_far():
    data = path()
    suspect, late = ChannelSuspect(DELAY, "y", 1.0), 0.3
    assert freed(data, "v", {suspect: late}, data).states["y"] is data.states["y"]
    column = {suspect.key: column for suspect, column in sensor_columns(data, data, {"y": late})}["delay of y"]
    np.testing.assert_allclose(column[10:], -np.cos(data.time - late)[10:], atol=1e-3)
