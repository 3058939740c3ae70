"""Errors of sensors whose samples are rows, and of the inputs that drive their path."""

import numpy as np
import pytest

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.suspects.channels import DELAY, GAIN, OFFSET, ChannelSuspect
from bayes_greybox.discovery.suspects.sensors import input_columns, sensor_columns
from bayes_greybox.discovery.weighing.sensors_along_path import freed
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
    columns = {suspect.key: column for suspect, column in input_columns(data, whole, 0.05)}
    right = freed(data, "v", {ChannelSuspect(kind, name, 1.0): size}, data)
    assert not np.array_equal(right.inputs[name], data.inputs[name])
    change = (whole(right) - whole(data)) / size
    # The rate of change of an input is that of its samples, 0.05 apart: (ωh)²/6 of it is lost, and more at the ends.
    inside, tolerance = slice(1, -1), 0.01 if kind == DELAY else 1e-4
    scale = float(np.max(np.abs(change)))
    np.testing.assert_allclose(change[inside], columns[f"{kind} of {name}"][inside], atol=tolerance * scale)


def test_a_late_sensor_keeps_its_samples_and_is_told_by_its_column_at_the_delay_so_far():
    data = path()
    suspect, late = ChannelSuspect(DELAY, "y", 1.0), 0.3
    assert freed(data, "v", {suspect: late}, data).states["y"] is data.states["y"]
    column = {suspect.key: column for suspect, column in sensor_columns(data, data, {"y": late})}["delay of y"]
    np.testing.assert_allclose(column[10:], -np.cos(data.time - late)[10:], atol=1e-3)
