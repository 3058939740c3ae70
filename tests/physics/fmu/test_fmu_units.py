"""Units of an FMU against those of the data."""

import pytest

from bayes_greybox.physics.simulation.fmu.description import Unit, Variable, require_units
from bayes_greybox.running.errors import InputError


def compared(own, name, base, factor=1.0, offset=0.0):
    unit = Unit(name, base, factor, offset)
    require_units("plant", {"c": Variable("x", 0, unit=unit)}, {"c": own})


@pytest.mark.parametrize(
    ("own", "name", "base", "factor", "offset"),
    [
        ("deg", "deg", "radian", 0.0174533, 0.0), ("rpm", "rpm", "radian / second", 0.104720, 0.0),
        ("degF", "degF", "kelvin", 0.555556, 255.372), ("degC", "degC", "kelvin", 1.0, 273.15),
        ("Hz", "Hz", "1 / second", 1.0, 0.0),
    ],
)  # fmt: skip
def test_units_are_the_same_to_the_digits_that_descriptions_have(own, name, base, factor, offset):
    compared(own, name, base, factor, offset)


@pytest.mark.parametrize(
    ("own", "name", "base", "factor"),
    [
        ("m", "mm", "meter", 1e-3),
        ("Hz", "rad/s", "radian / second", 1.0),
        ("kHz", "rad/s", "radian / second", 1e3),
        ("rad/s", "Hz", "1 / second", 1.0),
    ],
)
def test_other_units_are_refused(own, name, base, factor):
    with pytest.raises(InputError, match="convert the column"):
        compared(own, name, base, factor)
