"""Units of an FMU against those of the data."""

from collections.abc import Mapping
from typing import Any

from bayes_greybox.data.reading.unit_registry import registry
from bayes_greybox.physics.simulation.fmu.description import Variable
from bayes_greybox.physics.units import parse_unit
from bayes_greybox.running.errors import InputError


def require_units(model: str, variables: Mapping[str, Variable], units: Mapping[str, str]) -> None:
    """Refuse columns in other units than the FMU's variables; where one of them is not stated, nothing is compared.

    Args:
        model: The FMU's name.
        variables: Variables by column.
        units: Units by column, the time's under "t".

    Raises:
        InputError: Another unit, or a time that is not in seconds.
    """
    if units.get("t") and not _same(units["t"], "the time", "s", "second", 1.0, 0.0):
        raise InputError(f"The time is in {units['t']}, and an FMU's is in s: convert it.")
    for column, variable in variables.items():
        unit, own = variable.unit, units.get(column)
        if unit is None or not unit.base or not own:
            continue
        if not _same(own, f"column {column!r}", unit.name, unit.base, unit.factor, unit.offset):
            raise InputError(
                f"{variable.name!r} of the FMU {model} is in {unit.name}, and the column {column!r} in {own}: convert "
                "the column."
            )


CLOSE = 1e-5
"""Relative difference that is one of the sixth digit: descriptions write the factor of rpm as 0.104720."""


def _same(text: str, what: str, name: str, base: str, factor: float, offset: float) -> bool:
    given, known = parse_unit(text, what), registry()
    other = known.parse_units(base)
    if given.dimensionality != other.dimensionality:
        return False
    # Pint's hertz has no angle, so that it would pass for a radian a second.
    if (_has(given, "hertz") and _has(other, "radian")) or ("Hz" in name and _has(given, "radian")):
        return False
    zero = float(known.Quantity(0.0, given).to_root_units().magnitude)
    size = float(known.get_root_units(given)[0]), factor * float(known.get_root_units(other)[0])
    return abs(size[0] - size[1]) <= CLOSE * abs(size[0]) and abs(zero - offset) <= CLOSE * max(1.0, abs(offset))


def _has(unit: Any, name: str) -> bool:
    return any(name in each for each, _ in registry().Quantity(1.0, unit).unit_items())
