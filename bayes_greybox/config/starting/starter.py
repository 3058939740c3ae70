"""The first configuration for a table: commented, complete, and running as it is."""

import json
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from bayes_greybox.data.columns import derivative_label
from bayes_greybox.data.errors import InputError
from bayes_greybox.data.reading.cells import COMMA
from bayes_greybox.data.reading.sources import read_source
from bayes_greybox.data.reading.table import Layout, Table
from bayes_greybox.physics.formula.grammar import check_name

from .roles import POSITION, Guess, guessed

PLACE = "..."

OPTIONS = ("sep", "decimal", "thousands", "skiprows", "encoding", "sheet", "dayfirst")
"""What of the layout is written where it is not the usual."""

_SET_BACK = [
    "# It goes back by an hour, as clocks do when summer time ends: if no new run begins there, take the next line out",
    "# and write the stamps in UTC or with their offset, such as 2024-10-27T02:00:00+01:00.",
]
"""What stands above `restart` where it may be a mistake."""

GROUPS = r"[+-]?(\d+|[1-9]\d{0,2}(\.\d{3})+)(,\d+)?"
"""A number with a comma for its decimal mark, whose digits may be grouped by points."""


def starter(data: Path, config: Path, layout: Layout) -> str:
    """The text of a configuration for a table.

    Args:
        data: The table.
        config: Where the configuration will stand; paths in it start from its folder.
        layout: How the table is laid out, where it does not tell itself.

    Raises:
        InputError: A table that cannot be read, or has nothing to model.
    """
    table = read_source(data, layout)
    if layout.decimal == "." and _has_decimal_commas(table):
        layout = replace(layout, decimal=",")
        table = read_source(data, layout)
    if layout.decimal == "," and layout.thousands is None and _has_groups(table):
        layout = replace(layout, thousands=".")
        table = read_source(data, layout)
    guess = guessed(table, layout)
    names = _names((*guess.states, *guess.inputs, *guess.rate_of.values()))
    path = os.path.relpath(data, config.parent).replace(os.sep, "/")
    plan = _Plan(guess, names)
    parts = [
        f"# A first configuration for {data.name}. What columns are was guessed from names and behaviour: check it,\n"
        f"# then bayes-greybox fit {config.name} learns the terms of [dictionary],\n"
        f"# and  bayes-greybox discover {config.name} finds what [simulation] is missing.",
        _data(path, table, layout, plan),
        _units(table, plan),
        plan.differentiate(),
        _simulation(plan),
        _dictionary(plan),
        "[discrepancy]\n"
        "# Take these lines out for a Gaussian process beside the terms: it shows what they miss (one equation only).\n"
        "enabled = false",
        "[sampling]\ndraws = 500\ntune = 500\nchains = 2\nseed = 0",
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


class _Plan:
    """Names in formulas, and which equations are learned from what."""

    def __init__(self, guess: Guess, names: Mapping[str, str]) -> None:
        self.guess, self.names = guess, names
        states = set(guess.states)
        rate_of = {state: rate for state, rate in guess.rate_of.items() if state in states}
        self.measured = {state: rate for state, rate in rate_of.items() if rate not in states}
        self.chained = {state: rate for state, rate in rate_of.items() if rate in states}
        learned = [state for state in guess.states if state not in self.chained]
        # Rates of some and not of others: those that are measured are learned.
        self.learned = [state for state in learned if state in self.measured] or learned
        self.computed = not self.measured and guess.even
        lonely = [s for s in guess.states if self.computed and s not in self.chained and s not in self.chained.values()]
        self.second = {state: self._free(f"{names[state]}_rate") for state in lonely if POSITION.match(state)}

    def _free(self, name: str) -> str:
        return name if name not in self.names.values() else self._free(f"{name}_")

    def name(self, columns: Iterable[str]) -> list[str]:
        return [self.names[column] for column in columns]

    @property
    def variables(self) -> list[str]:
        """What a term may be of."""
        return [*self.name(self.guess.states), *self.second.values(), *self.name(self.guess.inputs)]

    @property
    def equations(self) -> list[str]:
        """What is learned: a measured or computed rate of each."""
        return [self.second.get(state, self.names[state]) for state in self.learned]

    @property
    def known(self) -> dict[str, str]:
        """Rates that are other states."""
        return {self.names[s]: self.names[r] for s, r in self.chained.items()} | {
            self.names[state]: rate for state, rate in self.second.items()
        }

    def differentiate(self) -> str:
        if not self.computed:
            return ""
        rates = ", ".join(f"{_key(self.names[state])} = {_quoted(rate)}" for state, rate in self.second.items())
        lines = [
            "[data.differentiate]",
            "# Rates that were not measured are computed by a filter whose noise is known.",
        ]
        lines.append('method = "savgol"')
        if rates:
            lines += ["# The rate of a position is a state of its own: the equation of that rate is learned."]
            lines += [f"rates = {{ {rates} }}"]
        return "\n".join(lines)


def _data(path: str, table: Table, layout: Layout, plan: _Plan) -> str:
    guess = plan.guess
    lines = ["[data]", f"path = {_quoted(path)}"]
    if guess.time is not None:
        lines.append(f"time = {_quoted(guess.time)}")
    else:
        lines += ["# The table has no column of time: set the distance of its rows.", "dt = 1.0"]
    lines += [f"{option} = {_quoted(value)}" for option, value in _options(layout)]
    if guess.run is not None:
        lines.append(f"run = {_quoted(guess.run)}  # tells the runs apart")
    if guess.restart:
        lines += _SET_BACK if guess.set_back else []
        lines.append('restart = "run"  # the time goes back: a new run begins there')
    lines.append(f"states = {_columns(plan, guess.states)}  # what has an equation of motion")
    if guess.inputs:
        lines.append(f"inputs = {_columns(plan, guess.inputs)}  # what is applied from outside")
    if plan.measured:
        rates = ", ".join(f"{_key(plan.names[s])} = {_quoted(rate)}" for s, rate in plan.measured.items())
        lines.append(f"derivatives = {{ {rates} }}  # measured rates: this column is the rate of that state")
    if guess.missing:
        lines.append(f'missing = "drop"  # rows with empty cells are left out, {guess.missing} here')
    lines.append("test_fraction = 0.2  # the end of each run, held out")
    lines += [f"# {column} has no role: it {why}." for column, why in guess.left_out.items()]
    return "\n".join(lines)


def _units(table: Table, plan: _Plan) -> str:
    """Units to be filled in; those of the table stand there already."""
    columns = {"t": plan.guess.time} | {plan.names[c]: c for c in (*plan.guess.states, *plan.guess.inputs)}
    columns |= {derivative_label(plan.names[s]): rate for s, rate in plan.measured.items()}
    lines = [
        "[data.units]",
        "# With all of them, terms are checked and coefficients get units: fill in and take the # away.",
    ]
    for name, column in columns.items():
        unit = table.units.get(table.known(column)) if column is not None else None
        example = "the time, such as s" if name == "t" else f"{name}, such as m/s^2"
        asked = f'# {_key(name)} = "{PLACE}"  # unit of {example}'
        lines.append(f"{_key(name)} = {_quoted(unit)}" if unit else asked)
    return "\n".join(lines)


def _simulation(plan: _Plan) -> str:
    lines = ["[simulation]", "# What is known: the rate of a state as a formula of states and inputs."]
    lines += [f"{_key(state)} = {_quoted(rate)}" for state, rate in plan.known.items()]
    example = " + ".join(plan.variables[-1:]) or "0"
    lines += [f'# {_key(name)} = "{PLACE}"  # such as "{example} - 2*{name}"' for name in plan.equations]
    return "\n".join(lines)


def _dictionary(plan: _Plan) -> str:
    terms, example = ", ".join(map(_quoted, ["1", *plan.variables])), _quoted(plan.variables[0])
    lines = [
        "[dictionary]",
        "# What may be in the rate beside it: candidate terms, each with a coefficient to be learned.",
        "# What is known of a coefficient stands in the place of its term:",
        f'# {{ expression = {example}, sign = "-" }}, or prior = [mean, sd], bounds = [least, largest], fixed = value',
    ]
    return "\n".join([*lines, *(f"{_key(name)} = [{terms}]" for name in plan.equations)])


def _options(layout: Layout) -> list[tuple[str, object]]:
    """Options of the table that are not the usual ones."""
    usual = Layout()
    return [(name, value) for name in OPTIONS if (value := getattr(layout, name)) != getattr(usual, name)]


def _columns(plan: _Plan, columns: Iterable[str]) -> str:
    """A list of columns, or a table where a column's name cannot stand in formulas."""
    chosen = list(columns)
    if plan.name(chosen) == chosen:
        return f"[{', '.join(map(_quoted, chosen))}]"
    return "{ " + ", ".join(f"{_key(plan.names[c])} = {_quoted(c)}" for c in chosen) + " }"


def _names(columns: Iterable[str]) -> dict[str, str]:
    """A name for formulas by column."""
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
    return name not in ("t", "run")


def _has_decimal_commas(table: Table) -> bool:
    cells = [column for column in _words(table) if column.str.fullmatch(f"{COMMA}|{GROUPS}").all()]
    return any(column.str.contains(",").any() for column in cells)


def _has_groups(table: Table) -> bool:
    """Whether a column of numbers has cells whose digits are grouped by points."""
    cells = [column for column in _words(table) if column.str.fullmatch(f"{COMMA}|{GROUPS}").all()]
    return any(column.str.contains(".", regex=False).any() for column in cells)


def _words(table: Table) -> list[Any]:
    words = table.frame.select_dtypes(exclude="number")
    return [column for name in words if len(column := words[name].dropna().astype(str).str.strip())]


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _quoted(name)


def _quoted(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)
