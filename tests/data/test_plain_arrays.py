"""Arrays with a mask, a unit, imaginary parts: what a column of floats cannot hold is missing or refused."""

import os

import numpy as np
import pytest

from bayes_greybox.data.reading.units import registry
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.running.errors import InputError

UNTYPED = pytest.mark.skipif(
    os.environ.get("BAYES_GREYBOX_TYPECHECK", "0") == "1", reason="the checker of types answers first"
)
T = np.linspace(0.0, 1.0, 11)
HIDDEN = np.arange(11) == 4


def given(y, t=T, **changes):
    return Trajectories.from_arrays(t, states={"y": y}, **changes)


@pytest.mark.parametrize("kind", [float, int])
def test_masked_values_are_missing_and_no_measurements(kind):
    y = np.ma.masked_array(np.where(HIDDEN, 10**6, np.arange(11)).astype(kind), mask=HIDDEN)
    with pytest.raises(InputError, match='state "y" has 1 missing .* row 4'):
        given(y)
    data = given([y, y], [T, np.ma.masked_array(T, mask=False)], missing="drop")
    assert data.dropped == 2 and data.states["y"].max() == 10.0
    with pytest.raises(InputError, match="time has 1 missing"):
        given(T, np.ma.masked_array(T, mask=HIDDEN))


def test_imaginary_parts_are_not_dropped():
    with pytest.raises(InputError, match='state "y" of run "0" holds complex numbers.*give real and imaginary parts'):
        given(T + 1j * T)


def test_units_of_arrays_are_asked_for_as_units_and_plain_numbers_are_plain():
    unit = registry()
    for y, t in ((T * unit.mm, T), (T, T * unit.ms), ([T * unit.mm, T], [T, T])):
        with pytest.raises(InputError, match=r"has a unit of its own, milli.*units=\{"):
            given(y, t)
    np.testing.assert_array_equal(given(T * unit.dimensionless).states["y"], T)


@UNTYPED
@pytest.mark.parametrize("what", ["states", "inputs", "derivatives", "outputs"])
def test_names_without_arrays_are_answered_with_a_mapping(what):
    with pytest.raises(InputError, match=rf'{what} must map names to arrays, such as {what}={{"y": y}}, not be a list'):
        Trajectories.from_arrays(T, **{"states": {"y": T}, what: ["y"]})
