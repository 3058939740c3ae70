"""Errors of sensors whose samples are rows, and of the inputs that drive their path."""

import numpy as np
import pytest

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.suspects.channels import DELAY, GAIN, OFFSET, ChannelSuspect
from bayes_greybox.discovery.suspects.sensors import input_columns, input_force
from bayes_greybox.physics.terms import Term

RATE = [(Term("F"), 1.0), (Term("y"), -2.0), (Term("u**2*y"), 0.3), (Term("u*sin(F)"), 0.7)]


def path():
    t = np.linspace(0, 10, 201)
    columns = {"y": np.sin(t), "F": np.cos(2 * t), "u": 1 + 0.5 * np.sin(3 * t)}
    return Trajectories.from_arrays(t, states={"y": columns["y"]}, inputs={n: columns[n] for n in ("F", "u")})


def whole(data):
    return sum(value * np.asarray(term.evaluate(data.columns)) for term, value in RATE)


@pytest.mark.parametrize("kind", [GAIN, OFFSET])
@pytest.mark.parametrize("name", ["F", "u"])
def test_the_force_of_an_inputs_error_is_its_column_along_the_path(kind, name):
    data = path()
    columns = {suspect.key: column for suspect, column in input_columns(data, whole, 0.05)}
    force = input_force(ChannelSuspect(kind, name, 1.0), RATE)
    assert force is not None
    np.testing.assert_allclose(force.evaluate(data.columns), columns[f"{kind} of {name}"], atol=1e-6)


@pytest.mark.parametrize(
    ("suspect", "rate"),
    [
        (ChannelSuspect(DELAY, "F", 1.0), RATE),
        (ChannelSuspect(OFFSET, "F", 1.0), []),
        (ChannelSuspect(OFFSET, "F", 1.0), [(Term("y"), 1.0)]),
        (ChannelSuspect(OFFSET, "F", 1.0), [(Term("sign(F)"), 1.0)]),
    ],
    ids=["delay", "unreadable", "unused", "jump"],
)
def test_what_no_term_says_is_none(suspect, rate):
    assert input_force(suspect, rate) is None
