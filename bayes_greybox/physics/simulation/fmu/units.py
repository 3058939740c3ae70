"""Units of an FMU against those of the data."""

from collections.abc import Mapping
from typing import Any

from bayes_greybox.data.reading.units import registry
from bayes_greybox.physics.units import parse_unit
from bayes_greybox.running.errors import InputError

from .description import Unit, Variable

SAME_FACTOR = 1e-5
"""Relative difference of factors that are the same: descriptions write the factor of rpm as 0.104720."""


def require_units(model: str, variables: Mapping[str, Variable], units: Mapping[str, str]) -> None:
    """Refuse columns in other units than the FMU's variables; where one of them is not stated, nothing is compared.

    Raises:
        InputError: A unit differs, or the time, "t", is not in seconds.
    """
    if units.get("t") and not _same(units["t"], "the time", Unit("s", "second")):
        raise InputError(f"The time is in {units['t']}, and an FMU's is in s: convert it.")
    for column, variable in variables.items():
        unit, of_column = variable.unit, units.get(column)
        if unit is not None and unit.base and of_column and not _same(of_column, f"column {column!r}", unit):
            raise InputError(
                f"{variable.name!r} of the FMU {model} is in {unit.name}, and the column {column!r} in {of_column}: "
                "convert the column."
            )


def _same(text: str, what: str, unit: Unit) -> bool:
    one, other = parse_unit(text, what), registry().parse_units(unit.base)
    if one.dimensionality != other.dimensionality:
        return False
    # Pint's hertz has no angle, so that it would pass for a radian a second.
    if (_has(one, "hertz") and _has(other, "radian")) or ("Hz" in unit.name and _has(one, "radian")):
        return False
    zero = float(registry().Quantity(0.0, one).to_root_units().magnitude)
    size, expected = (float(registry().get_root_units(each)[0]) for each in (one, other))
    same_size = abs(size - unit.factor * expected) <= SAME_FACTOR * abs(size)
    return same_size and abs(zero - unit.offset) <= SAME_FACTOR * max(1.0, abs(unit.offset))


def _has(unit: Any, name: str) -> bool:
    return any(name in each for each, _ in registry().Quantity(1.0, unit).unit_items())
