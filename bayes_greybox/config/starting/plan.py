"""Names in formulas, rates of states, open equations and examples of them, of a first configuration."""

import re
from collections.abc import Iterable, Mapping
from functools import cached_property

from bayes_greybox.data.columns import RESERVED
from bayes_greybox.data.reading.table import Table
from bayes_greybox.data.reading.units import registry
from bayes_greybox.physics.formula.grammar import check_name
from bayes_greybox.running.errors import InputError

from .clock import time_unit
from .held_out import split_of
from .roles import LIQUID_LEVELS, POSITIONS, Guess


class Plan:
    """Names in formulas, and the data from which each equation is learned.

    Attributes:
        names: Name in formulas by column.
        measured: Column of the measured rate by state.
        chained: State that is the rate, by state.
        learned: States whose rate is open.
        second: Name of the rate that is a state of its own, by position of which nothing but the position was measured.
        followed: True if a position is all that was measured, beside inputs.
        computed: True if rates are computed by a filter; where they are not measured either, rows are samples.
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
    def positions(self) -> dict[str, str]:
        """Positions by the name of their rate, which is a state."""
        positions = {rate: state for state, rate in self.second.items()}
        return positions | {self.names[rate]: state for state, rate in self.chained.items()}

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
        units = [registry().parse_units(self.unit(state)) for state in self.guess.states if self.unit(state)]
        if any(unit.is_compatible_with(each) for unit in units for each in ("V", "A", "C", "Wb")):
            return "electrical"
        return "thermal" if any(unit.dimensionality == {"[temperature]": 1} for unit in units) else "mechanical"

    def _is_position(self, state: str) -> bool:
        """Return True if a state is a position of a body: by its unit if it has one, else by its name."""
        unit = self.unit(state)
        if LIQUID_LEVELS.match(state):
            return False
        if not unit:
            return bool(POSITIONS.match(state))
        return registry().parse_units(unit).is_compatible_with("m") or is_angle(unit)

    def free(self, name: str) -> str:
        """Return a name that no column has in formulas."""
        return name if name not in self.names.values() else self.free(f"{name}_")


def _names(columns: Iterable[str]) -> Mapping[str, str]:
    """Return a name for formulas by column."""
    names: dict[str, str] = {}
    for column in dict.fromkeys(columns):
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

TIME_CONSTANT = 10.0
"""Number of the example of first order, in units of the time."""

TEXT_OF_PARAMETERS = """# [parameters]
# Numbers of the formulas above by name, in units of the table. With sd one is learned by fit; without, it is
# believed, and discover says if it is off, and what it should be."""


def equation_of_motion(plan: Plan, rate: str) -> str:
    """Write m a = F - k x - c v: '"F/2000 - 1.5e-05*x - 0.0004*v" (2 kg, 30 N/m, 0.8 N s/m in mm, ms)'."""
    state = plan.positions[rate]
    position, length, time = plan.names[state], plan.unit(state) or "m", plan.unit(plan.guess.time) or "s"
    turns = is_angle(length)
    per_time = registry().Quantity(1.0, "1/s").to(f"1/({time})").magnitude
    parts = [f"- {SPRING / MASS * per_time**2:.4g}*{position}", f"- {DAMPER / MASS * per_time:.4g}*{rate}"]
    usual = ("kg m²", "N m/rad", "N m s/rad") if turns else ("kg", "N/m", "N s/m")
    notes = [f"{value:g} {unit}" for value, unit in zip((MASS, SPRING, DAMPER), usual, strict=True)]
    used = [length, time]
    for column in plan.guess.inputs[:1]:
        name, unit = plan.names[column], plan.unit(column)
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
    text = text if plan.guess.inputs else f"-{text}"
    return f'"{text}" ({", ".join(notes)} in {", ".join(used)})'


def is_angle(unit: str) -> bool:
    """Return True if a unit is that of an angle."""
    parsed = registry().parse_units(unit)
    return str(registry().get_base_units(parsed)[1]) == "radian" and parsed.dimensionless


def parameters_text(plan: Plan) -> str:
    """Write examples of named numbers, as a comment: a section of numbers that no formula has is refused."""
    equation = next((name for name in plan.equations if name in plan.positions), plan.equations[0])
    formula, numbers = (_of_motion if equation in plan.positions else _of_first_order)(plan, equation)
    # Parentheses stand around products only.
    (name, value, unit), *others = [
        (name, value, re.sub(r"\(([^*/^()]+)\)", r"\1", unit)) for name, value, unit in numbers
    ]
    lines = [f'# {name} = {{ value = {value:.4g}, sd = {value / 10:.4g}, lower = 0.0, unit = "{unit}" }}']
    lines += [f'# {name} = {{ value = {value:.4g}, unit = "{unit}" }}' for name, value, unit in others]
    return "\n".join([TEXT_OF_PARAMETERS, *lines, f'# With these the formula is {equation} = "{formula}".'])


def starts_text(plan: Plan) -> str:
    """Write an example of a hidden state, as a comment: a start of a state without a formula is refused."""
    if plan.sampled:
        return ""
    followed, hidden = plan.name(plan.guess.states)[0], plan.free("lagging")
    return f"""# [starts]
# A state that no sensor reads, with a formula of inputs, states and other hidden states in [simulation],
# follows from where it starts: a number, or the column that has the value where a run starts.
# {hidden} = "{followed}"  # beside {hidden} = "({followed} - {hidden})/{TIME_CONSTANT:g}" above"""


def _of_first_order(plan: Plan, equation: str) -> tuple[str, list[tuple[str, float, str]]]:
    others, tau = [name for name in plan.variables if name != equation], plan.free("tau")
    unit = plan.unit(plan.guess.time) or time_unit(plan.guess.time or "") or "s"
    toward = f"({others[-1]} - {equation})" if others else f"-{equation}"
    return f"{toward}/{tau}", [(tau, TIME_CONSTANT, unit)]


def _of_motion(plan: Plan, rate: str) -> tuple[str, list[tuple[str, float, str]]]:
    """Write m a = F - k x - c v with its parameters."""
    state = plan.positions[rate]
    position, length, time = plan.names[state], plan.unit(state) or "m", plan.unit(plan.guess.time) or "s"
    turns = is_angle(length)
    driver = plan.guess.inputs[0] if plan.guess.inputs else None
    force = plan.unit(driver) or ("N*m" if turns else "N")
    m, k, c, b = (plan.free(name) for name in "mkcb")
    usual = ("kg*m^2", "N*m/rad", "N*m*s/rad") if turns else ("kg", "N/m", "N*s/m")
    units = [f"({force})*({time})^2/({length})", f"({force})/({length})", f"({force})*({time})/({length})"]
    given = [registry().Quantity(value, unit) for value, unit in zip((MASS, SPRING, DAMPER), usual, strict=True)]
    if all(each.is_compatible_with(unit) for each, unit in zip(given, units, strict=True)):
        values = [float(each.to(unit).magnitude) for each, unit in zip(given, units, strict=True)]
        # The mass of a table in SI units is in kg.
        pairs = zip(usual, units, strict=True)
        shown = [own if registry().Quantity(1.0, own).to(unit).magnitude == 1.0 else unit for own, unit in pairs]
        sum_ = f"{plan.names[driver]} - {k}*{position} - {c}*{rate}" if driver else f"-{k}*{position} - {c}*{rate}"
        return f"({sum_})/{m}", list(zip((m, k, c), values, shown, strict=True))
    # What drives it is no force.
    per_time = float(registry().Quantity(1.0, "1/s").to(f"1/({time})").magnitude)
    spring, damper = SPRING / MASS * per_time**2, DAMPER / MASS * per_time
    driven = f"{b}*{plan.names[driver]} - " if driver else "-"
    numbers = [(b, 2.0, f"{length}/({time})^2/({force})"), (k, spring, f"1/({time})^2"), (c, damper, f"1/({time})")]
    return f"{driven}{k}*{position} - {c}*{rate}", numbers
