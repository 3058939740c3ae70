"""Description of an FMU, in the words of this package, and its units against those of the data."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayes_greybox.data.reading.units import registry
from bayes_greybox.physics.units import parse_unit
from bayes_greybox.running.errors import InputError

SAME_FACTOR = 1e-5
"""Relative difference of factors that are the same: descriptions write the factor of rpm as 0.104720."""

BASE_UNITS = {
    "kg": "kilogram", "m": "meter", "s": "second", "A": "ampere", "K": "kelvin", "mol": "mole", "cd": "candela",
    "rad": "radian",
}  # fmt: skip
"""Names of FMI's base units by its attributes."""


@dataclass(frozen=True)
class Unit:
    """A unit of a variable.

    It is a multiple of a product of base units, such as "meter**1 * second**-2", "" if that is not stated, and has its
    zero at an offset in these, such as 273.15 of degrees Celsius.
    """

    name: str
    base: str = ""
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Variable:
    """A variable of an FMU.

    Attributes:
        name: Its name, such as "mass.s".
        ref: Value reference; aliases share theirs.
        kind: Type, such as "Real" or "Boolean".
        causality: "parameter", "input", "output", "local" or another word of FMI.
        unit: Its unit, if it has one.
        scalar: True if it is one number.
        nominal: Its usual size; 1 where it is not stated.
        initial: "exact" or "approx" where its start may be set, else "calculated" or "".
    """

    name: str
    ref: int
    kind: str = "Real"
    causality: str = "local"
    unit: Unit | None = None
    scalar: bool = True
    nominal: float = 1.0
    initial: str = ""

    @property
    def column(self) -> str:
        """Name of a column of data for it: "mass_s" for "mass.s"."""
        return re.sub(r"\W+", "_", self.name).strip("_")


@dataclass(frozen=True, eq=False)
class Description:
    """Content of the modelDescription.xml of an FMU.

    Attributes:
        file: The FMU.
        name: Name of the model.
        guid: Its identity: the GUID, or the instantiation token of FMI 3.0.
        version: Version of FMI, "2.0" or "3.0".
        exchanged: True if it is run by Model Exchange, as where it has that; else by Co-Simulation.
        identifier: Name of the library by which it is run.
        directional: True if it declares directional derivatives; FMPy does not read that of FMI 3.0.
        variables: Variables by name.
        states: Continuous states, each with the variable that is its rate.
        rates: Variable that is declared as the rate of another, by the name of the latter.
        eventful: True if it has event indicators.
        start: Time at which it starts.
        step: Length of a step; 0 if it is not stated.
        content: Digest of the file.
        folder: Folder of an unpacked copy, which lives as long as this object: the file may change meanwhile.
    """

    file: Path
    name: str
    guid: str
    version: str
    exchanged: bool
    identifier: str
    directional: bool
    variables: Mapping[str, Variable]
    states: tuple[tuple[Variable, Variable], ...]
    rates: Mapping[str, Variable]
    eventful: bool
    start: float
    step: float
    content: str
    folder: Path


def description_of(file: Path, content: str, folder: Path, parsed: Any) -> Description:
    """Convert FMPy's `ModelDescription` of a file with this digest, unpacked in a folder."""
    units = {unit.name: _unit(unit) for unit in parsed.unitDefinitions}
    variables = {each.name: _variable(each, units) for each in parsed.modelVariables}
    interface = parsed.modelExchange or parsed.coSimulation
    derivatives = [each.variable for each in parsed.derivatives]
    lost = [d.name for d in derivatives if d.derivative is None]
    if lost:
        raise ValueError(f"{lost[0]!r} is listed as a rate and does not say of which state")
    return Description(
        file=file,
        name=str(parsed.modelName),
        guid=str(parsed.guid),
        version=str(parsed.fmiVersion),
        exchanged=parsed.modelExchange is not None,
        identifier=str(interface.modelIdentifier),
        directional=bool(interface.providesDirectionalDerivative),
        variables=variables,
        states=tuple((variables[d.derivative.name], variables[d.name]) for d in derivatives),
        rates={each.derivative.name: variables[each.name] for each in parsed.modelVariables if each.derivative},
        eventful=bool(parsed.numberOfEventIndicators or getattr(parsed, "eventIndicators", None)),
        start=float(getattr(parsed.defaultExperiment, "startTime", None) or 0.0),
        step=float(getattr(parsed.defaultExperiment, "stepSize", None) or 0.0),
        content=content,
        folder=folder,
    )


def _variable(given: Any, units: Mapping[str, Unit]) -> Variable:
    declared = given.declaredType
    unit = given.unit or (declared.unit if declared is not None else None)
    return Variable(
        name=given.name,
        ref=int(given.valueReference),
        # FMI 3.0 has another name for FMI 2.0's only kind of real numbers.
        kind="Real" if given.type == "Float64" else str(given.type),
        causality=str(given.causality or "local"),
        unit=units.get(unit, Unit(unit)) if unit else None,
        scalar=not given.dimensions,
        nominal=abs(float((given.nominal or (declared.nominal if declared is not None else None)) or 1.0)) or 1.0,
        initial=str(given.initial or ""),
    )


def _unit(given: Any) -> Unit:
    base = given.baseUnit
    if base is None:
        return Unit(given.name)
    powers = [f"{name}**{int(getattr(base, key))}" for key, name in BASE_UNITS.items() if getattr(base, key)]
    return Unit(given.name, " * ".join(powers) or "dimensionless", float(base.factor), float(base.offset))


def require_units(model: str, variables: Mapping[str, Variable], units: Mapping[str, str]) -> None:
    """Refuse columns in other units than the FMU's variables; where one of them is not stated, nothing is compared."""
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
