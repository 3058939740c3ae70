"""Description of an FMU, in the words of this package."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

MODEL_EXCHANGE = "model exchange"
CO_SIMULATION = "co-simulation"

BASE_UNITS = {
    "kg": "kilogram", "m": "meter", "s": "second", "A": "ampere", "K": "kelvin", "mol": "mole", "cd": "candela",
    "rad": "radian",
}  # fmt: skip
"""Names of FMI's base units by its attributes."""


@dataclass(frozen=True)
class Unit:
    """A unit of a variable.

    Attributes:
        name: Name in the FMU, such as "m/s2".
        base: Product of base units that it is a multiple of, such as "meter**1 * second**-2"; "" if it is not stated.
        factor: The multiple.
        offset: Its zero in base units, such as 273.15 of degrees Celsius.
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
        variability: "continuous", "discrete", "tunable", "fixed" or "constant".
        start: Value that it starts from, as text; "" if there is none.
        unit: Its unit, if it has one.
        scalar: True if it is one number.
        nominal: Its usual size; 1 where it is not stated.
        initial: "exact" or "approx" where its start may be set, else "calculated" or "".
    """

    name: str
    ref: int
    kind: str
    causality: str
    variability: str
    start: str
    unit: Unit | None
    scalar: bool
    nominal: float = 1.0
    initial: str = ""

    @property
    def column(self) -> str:
        """Name of a column of data for it: "mass_s" for "mass.s"."""
        return re.sub(r"\W+", "_", self.name).strip("_")


@dataclass(frozen=True)
class Interface:
    """One of the two ways in which an FMU may be run.

    Attributes:
        identifier: Name of its library.
        directional: True if it declares directional derivatives; FMPy does not read that of FMI 3.0.
    """

    identifier: str
    directional: bool


@dataclass(frozen=True, eq=False)
class Description:
    """Content of the modelDescription.xml of an FMU.

    Attributes:
        file: The FMU.
        name: Name of the model.
        guid: Its identity: the GUID, or the instantiation token of FMI 3.0.
        version: Version of FMI, "2.0" or "3.0".
        interfaces: Interfaces by `MODEL_EXCHANGE` and `CO_SIMULATION`.
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
    interfaces: Mapping[str, Interface]
    variables: Mapping[str, Variable]
    states: tuple[tuple[Variable, Variable], ...]
    rates: Mapping[str, Variable]
    eventful: bool
    start: float
    step: float
    content: str
    folder: Path

    @property
    def interface(self) -> Interface:
        """The interface by which it is run: Model Exchange where it has that."""
        return self.interfaces[MODEL_EXCHANGE if self.exchanged else CO_SIMULATION]

    @property
    def exchanged(self) -> bool:
        """True if it is run by Model Exchange."""
        return MODEL_EXCHANGE in self.interfaces


def description_of(file: Path, content: str, folder: Path, parsed: Any) -> Description:
    """Convert FMPy's `ModelDescription` of a file with this digest, unpacked in a folder."""
    units = {unit.name: _unit(unit) for unit in parsed.unitDefinitions}
    variables = {each.name: _variable(each, units) for each in parsed.modelVariables}
    interfaces = {}
    for name, each in ((MODEL_EXCHANGE, parsed.modelExchange), (CO_SIMULATION, parsed.coSimulation)):
        if each is not None:
            interfaces[name] = Interface(str(each.modelIdentifier), bool(each.providesDirectionalDerivative))
    derivatives = [each.variable for each in parsed.derivatives]
    lost = [d.name for d in derivatives if d.derivative is None]
    if lost:
        raise ValueError(f"{lost[0]!r} is listed as a rate and does not say of which state")
    return Description(
        file=file,
        name=str(parsed.modelName),
        guid=str(parsed.guid),
        version=str(parsed.fmiVersion),
        interfaces=interfaces,
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
        variability=str(given.variability or "continuous"),
        start="" if given.start is None else str(given.start),
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
