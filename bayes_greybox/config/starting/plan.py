"""Names in formulas, rates of states, open equations and an example of one, of a first configuration."""

import re
from collections.abc import Iterable, Mapping
from functools import cached_property

from bayes_greybox.config.starting.roles import LIQUID_LEVELS, POSITIONS, Guess
from bayes_greybox.data.columns import RESERVED
from bayes_greybox.data.reading.table import Table
from bayes_greybox.data.reading.units import registry
from bayes_greybox.physics.formula.grammar import check_name
from bayes_greybox.running.errors import InputError

from .held_out import split_of


class Plan:
    """Names in formulas, and the data from which each equation is learned.

    Attributes:
        names: Name in formulas by column.
        measured: Column of the measured rate by state.
        chained: State that is the rate, by state.
        learned: States whose rate is open.
        computed: True if rates are computed by a filter; where they are not measured either, rows are samples.
        followed: True if a position is all that was measured, beside inputs.
        split: Rows that are held out.
        second: Name of the rate that is a state of its own, by position of which nothing but the position was measured.
    """

    def __init__(self, table: Table, guess: Guess) -> None:
        self.table, self.guess = table, guess
        self.names = _names((*guess.states, *guess.inputs, *guess.rate_of.values()))
        columns = [each for each in (guess.time, *self.names) if each is not None]
        stated = {column: table.units.get(table.own_name(column)) for column in columns}
        self.units: dict[str, str] = {column: unit for column, unit in stated.items() if unit}
        if guess.dated and guess.time is not None:
            self.units[guess.time] = "s"
        states = set(guess.states)
        rate_of = {state: rate for state, rate in guess.rate_of.items() if state in states}
        self.measured = {state: rate for state, rate in rate_of.items() if rate not in states}
        self.chained = {state: rate for state, rate in rate_of.items() if rate in states}
        learned = [state for state in guess.states if state not in self.chained]
        # Rates of some and not of others: those that are measured are learned.
        self.learned = [state for state in learned if state in self.measured] or learned
        taken = {*self.chained, *self.chained.values()}
        alone = [state for state in guess.states if state not in taken and self._is_position(state)]
        alone = [] if self.measured else alone
        self.second = {state: self.free("v" if len(alone) == 1 else f"v_{self.names[state]}") for state in alone}
        # One position is followed along its samples, which tell more than rates of a filter, and of memory too.
        self.followed = alone == [*guess.states] and len(alone) == 1
        self.computed = not self.measured and guess.even and not self.followed
        self.split = split_of(guess.lengths, None, self.computed)
        if self.computed and self.split.share is None:
            # Too few rows for a filter.
            self.computed = False
        if self.sampled:
            self.split = split_of(guess.lengths, len(guess.states) + len(self.second), False)

    def name(self, columns: Iterable[str]) -> list[str]:
        """Return the names of columns in formulas."""
        return [self.names[column] for column in columns]

    def unit(self, column: str | None) -> str:
        """Return the unit of a column; "" if it is unknown."""
        return "" if column is None else self.units.get(column, "")

    @property
    def sampled(self) -> bool:
        """True if rows are samples: rates are neither measured nor computed."""
        return not (self.measured or self.computed)

    @cached_property
    def variables(self) -> list[str]:
        """Names that a term may use."""
        return [*self.name(self.guess.states), *self.second.values(), *self.name(self.guess.inputs)]

    @cached_property
    def equations(self) -> list[str]:
        """Learned equations: a measured or computed rate of each."""
        return [self.second.get(state, self.names[state]) for state in self.learned]

    @cached_property
    def known(self) -> dict[str, str]:
        """Rates that are other states."""
        chained = {self.names[state]: self.names[rate] for state, rate in self.chained.items()}
        return chained | {self.names[state]: rate for state, rate in self.second.items()}

    @property
    def catalogue(self) -> str:
        """The field of the states, by their names and units."""
        if any(LIQUID_LEVELS.match(state) for state in self.guess.states):
            return "fluid"
        units = [self.unit(state) for state in self.guess.states]
        if any(map(is_electrical, units)):
            return "electrical"
        return "thermal" if any(map(is_temperature, units)) else "mechanical"

    def _is_position(self, state: str) -> bool:
        """Return True if a state is a position of a body: by its unit if it has one, else by its name."""
        unit = self.unit(state)
        if LIQUID_LEVELS.match(state):
            return False
        return is_length_or_angle(unit) if unit else bool(POSITIONS.match(state))

    def free(self, name: str) -> str:
        """Return a name that no column has in formulas."""
        return name if name not in self.names.values() else self.free(f"{name}_")


def _names(columns: Iterable[str]) -> Mapping[str, str]:
    """Return a name for formulas by column."""
    names: dict[str, str] = {}
    for column in columns:
        if column in names:
            continue
        name = re.sub(r"\W+", "_", column, flags=re.ASCII).strip("_") or "x"
        name = f"x{name}" if name[0].isdigit() else name
        while not _usable(name) or name in names.values():
            name += "_"
        names[column] = name
    return names


def _usable(name: str) -> bool:
    try:
        check_name(name)
    except InputError:
        return False
    return name not in RESERVED


MASS, SPRING, DAMPER = 2.0, 30.0, 0.8
"""Numbers of the example, in kg, N/m and N s/m; of a rotation in kg m², N m/rad and N m s/rad."""


def is_length_or_angle(unit: str) -> bool:
    """Return True if a unit is that of a length, such as mm, or of an angle, such as deg."""
    parsed = registry().parse_units(unit)
    return parsed.is_compatible_with("m") or is_angle(unit)


def is_electrical(unit: str) -> bool:
    """Return True if a unit is that of a voltage, a current, a charge or a flux."""
    return bool(unit) and any(registry().parse_units(unit).is_compatible_with(each) for each in ("V", "A", "C", "Wb"))


def is_temperature(unit: str) -> bool:
    """Return True if a unit is that of a temperature."""
    return bool(unit) and registry().parse_units(unit).dimensionality == {"[temperature]": 1}


def equation_of_motion(position: str, rate: str, forces: tuple[str, str] | None, units: tuple[str, str]) -> str:
    """Write the rate of a rate, m a = F - k x - c v, and its parameters.

    It is a formula in quotation marks and words: '"F/2000 - 1.5e-05*x - 0.0004*v" (2 kg, 30 N/m, 0.8 N s/m in mm, ms)'.
    `forces` is the name of an input and its unit, None without inputs; `units` are those of position and time. They are
    "" if they are unknown.
    """
    length, time = units[0] or "m", units[1] or "s"
    turns = is_angle(length)
    per_time = registry().Quantity(1.0, "1/s").to(f"1/({time})").magnitude
    parts = [f"- {SPRING / MASS * per_time**2:.4g}*{position}", f"- {DAMPER / MASS * per_time:.4g}*{rate}"]
    notes = [f"{MASS:g} kg m²", f"{SPRING:g} N m/rad", f"{DAMPER:g} N m s/rad"] if turns else []
    notes = notes or [f"{MASS:g} kg", f"{SPRING:g} N/m", f"{DAMPER:g} N s/m"]
    used = [length, time]
    if forces is not None:
        name, unit = forces
        force = registry().Quantity(1.0 / MASS, f"({unit or ('N*m' if turns else 'N')})/(kg{'*m^2' if turns else ''})")
        wanted = registry().parse_units(f"({length})/({time})^2")
        if force.is_compatible_with(wanted):
            gain = force.to(wanted).magnitude
            parts.insert(0, f"{gain:.4g}*{name}" if gain > 1 else f"{name}/{1 / gain:.4g}")
            used.append(unit or ("N m" if turns else "N"))
        else:
            parts.insert(0, f"2*{name}")
            notes.append("a gain")
    text = " ".join(parts).removeprefix("- ")
    text = text if forces is not None else f"-{text}"
    return f'"{text}" ({", ".join(notes)} in {", ".join(used)})'


def is_angle(unit: str) -> bool:
    """Return True if a unit is that of an angle."""
    parsed = registry().parse_units(unit)
    return str(registry().get_base_units(parsed)[1]) == "radian" and parsed.dimensionless
