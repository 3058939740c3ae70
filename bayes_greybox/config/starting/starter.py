"""The first configuration for a table: commented, complete, and running as soon as its equation is written."""

import json
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from bayes_greybox.data.columns import derivative_label
from bayes_greybox.data.reading.table import Layout

from .clock import time_unit
from .held_out import FEWEST_TRAINED
from .layout import read_as_found
from .plan import Plan, equation_of_motion, parameters_text, starts_text
from .roles import guessed
from .summary import summary_of

PLACE = "..."

SUFFIXES = frozenset(
    "s ms us m mm cm um km N kN mN V mV kV A mA W kW Pa kPa MPa bar mbar K °C degC deg rad mrad Hz kHz rpm kg g N*m Nm "
    "m/s mm/s cm/s m/s^2 rad/s deg/s l/min l/s m^3/h m^3/s kg/s".split()
)
"""Units that a name may end with; not those that are words or indices as well, such as in, min and h."""


@dataclass(frozen=True)
class Start:
    """A first configuration: the text of the file, and lines about the roles of columns and the next steps."""

    text: str
    summary: tuple[str, ...]


def starter(data: Path, config: Path, layout: Layout) -> Start:
    """Write the first configuration for a table; paths in it start from its folder."""
    table, layout = read_as_found(data, layout)
    plan = Plan(table, guessed(table, layout))
    path = os.path.relpath(data, config.parent).replace(os.sep, "/")
    parts = [
        f"# A first configuration for {data.name}. What columns are was guessed from names and behaviour: check it\n"
        f"# and write [simulation]. Then  bayes-greybox discover {config.name}  finds what it is missing, once the\n"
        f"# section [dictionary] is out, and  bayes-greybox fit {config.name}  learns its terms.",
        _data(path, layout, plan),
        _units(plan),
        _differentiate(plan),
        _simulation(plan),
        parameters_text(plan),
        starts_text(plan),
        _dictionary(plan),
        "[study]\n"
        '# Effects that are weighed: "mechanical", "fluid", "electrical", "population", "thermal", "battery",\n'
        '# "compartment", "vehicle", "all", or your own file.\n'
        f"catalogue = {_quoted(plan.catalogue)}",
        "[discrepancy]\n"
        "# Take these lines out for a Gaussian process beside the terms: it shows what they miss (one equation only).\n"
        "enabled = false",
        # At the ends of intervals a third to two thirds of the draws count, where chains mix well, and 400 are asked
        # for: 1000 in all would pass or fail by chance, 4000 pass with room, at a few seconds more.
        "[sampling]\ndraws = 1000\ntune = 500\nchains = 4\nseed = 0",
    ]
    return Start("\n\n".join(part for part in parts if part) + "\n", summary_of(plan, layout, data, config))


def _data(path: str, layout: Layout, plan: Plan) -> str:
    guess, usual = plan.guess, Layout()
    lines = ["[data]", f"path = {_quoted(path)}"]
    if guess.time is not None:
        lines.append(f"time = {_quoted(guess.time)}")
    else:
        lines += ["# The table has no column of time: set the distance of its rows.", "dt = 1.0"]
    for name in ("sep", "decimal", "thousands", "skiprows", "encoding", "sheet", "dayfirst"):
        if getattr(layout, name) != getattr(usual, name):
            lines.append(f"{name} = {_quoted(getattr(layout, name))}")
    if layout.columns is not None:
        lines.append(f"columns = {_quoted(layout.columns)}  # the table has no names: give yours, here and below")
    if guess.run is not None:
        lines.append(f"run = {_quoted(guess.run)}  # tells the runs apart")
    if guess.shuffled:
        lines.append("# The time goes back every few rows: sort the rows of the table by time first.")
    elif guess.restart:
        if guess.set_back:
            lines += [
                "# It goes back by an hour, as clocks do when summer time ends: if no new run begins there, take the "
                "next line out",
                "# and write the stamps in UTC or with their offset, such as 2024-10-27T02:00:00+01:00.",
            ]
        lines.append('restart = "run"  # the time goes back: a new run begins there')
    lines.append(f"states = {_columns(plan, guess.states)}  # what has an equation of motion")
    if guess.inputs:
        lines.append(f"inputs = {_columns(plan, guess.inputs)}  # what is applied from outside")
    if plan.measured:
        rates = ", ".join(f"{_key(plan.names[s])} = {_quoted(rate)}" for s, rate in plan.measured.items())
        lines.append(f"derivatives = {{ {rates} }}  # measured rates: this column is the rate of that state")
    if guess.missing:
        lines.append(f'missing = "drop"  # rows with empty cells are left out, {guess.missing} here')
    lines += _split(plan)
    lines += [f"# {column} has no role: it {why}." for column, why in guess.left_out.items()]
    return "\n".join(lines)


def _split(plan: Plan) -> list[str]:
    """Write the rows that are held out, and runs that are left out."""
    split, guess = plan.split, plan.guess
    # Where the time goes back within a run, its parts have other names.
    named = not guess.shuffled and (guess.run is None or not guess.restart)
    lines = []
    if split.left_out and named:
        lines.append(f"leave_out = {_quoted(split.left_out)}  # runs of too few rows")
    if split.share is None:
        few = f"each part needs {split.needed} rows of each run, and training {FEWEST_TRAINED} in all"
        return [*lines, f"# test_fraction = 0.2 would hold out the end of each run, but rows are too few: {few}."]
    if split.whole_runs:
        return [*lines, f"test_fraction = {split.share}  # the last runs, held out", 'split_by = "trajectory"']
    return [*lines, f"test_fraction = {split.share}  # the end of each run, held out"]


def _units(plan: Plan) -> str:
    """Write units to be filled in; those of the table stand there already."""
    columns = [("t", plan.guess.time, "s"), *((plan.names[state], state, "mm") for state in plan.guess.states)]
    columns += [(plan.names[name], name, "N") for name in plan.guess.inputs]
    columns += [(derivative_label(plan.names[state]), rate, "m/s^2") for state, rate in plan.measured.items()]
    lines = [
        "[data.units]",
        "# With all of them, terms are checked and coefficients get units: fill in and take the # away.",
    ]
    for name, column, example in columns:
        stem, _, last = (column or "").rpartition("_")
        supposed = time_unit(column or "") if name == "t" else last if stem and last in SUFFIXES else None
        asked = f'# {_key(name)} = "{supposed or PLACE}"  # unit of {"the time" if name == "t" else name}'
        asked += ", if its name says so" if supposed else f", such as {example}"
        lines.append(f"{_key(name)} = {_quoted(plan.unit(column))}" if plan.unit(column) else asked)
    return "\n".join(lines)


def _differentiate(plan: Plan) -> str:
    rates = ", ".join(f"{_key(plan.names[state])} = {_quoted(rate)}" for state, rate in plan.second.items())
    if plan.followed and plan.guess.even:
        return (
            "# Rows are samples. Rates of a filter in their place are quicker, tell less, and nothing of memory:\n"
            f"# [data.differentiate]\n# rates = {{ {rates} }}"
        )
    if not plan.computed:
        return ""
    lines = ["[data.differentiate]", "# Rates that were not measured are computed by a filter whose noise is known."]
    lines += ['method = "savgol"']
    if plan.second:
        lines += ["# The rate of a position is a state of its own: the equation of that rate is learned."]
        lines += [f"rates = {{ {rates} }}"]
    return "\n".join(lines)


def _simulation(plan: Plan) -> str:
    columns = (plan.guess.time, *plan.guess.states, *plan.guess.inputs)
    units = ", ".join(dict.fromkeys(unit for unit in map(plan.unit, columns) if unit))
    shown = f" ({units})" if units else ""
    lines = ["[simulation]", "# What your simulation says: the rate of a state as a formula of states and inputs,"]
    lines += [f"# its numbers in the units of the table{shown}. Take the # away and write yours."]
    for state, rate in plan.second.items():
        unit, time, also = plan.unit(state), plan.unit(plan.guess.time), " and rates above" if plan.computed else ""
        unit = f", in {unit}/{time}" if unit and time else ""
        lines += [f"# {rate} is the rate of {plan.names[state]}{unit}. Where the equation is of first order,"]
        lines += [f"# write {_quoted(PLACE)} for it below, and take out the line of {rate}{also}."]
    lines += [f"{_key(state)} = {_quoted(rate)}" for state, rate in plan.known.items()]
    for name in plan.equations:
        others = [f"{variable} - " for variable in plan.variables if variable != name] or ["-"]
        moved = name in plan.positions
        example = equation_of_motion(plan, name) if moved else f'"{others[-1]}2*{name}"'
        lines.append(f'# {_key(name)} = "{PLACE}"  # such as {example}')
    if len(plan.equations) > 1 and not plan.measured:
        lines += ["# What has no equation in your simulation acts from outside: move it from states to inputs above."]
    return "\n".join(lines)


def _dictionary(plan: Plan) -> str:
    """Write terms to be learned: active where rates were measured, else a comment, as studies learn them everywhere."""
    terms = ", ".join(map(_quoted, ["1", *plan.variables]))
    example = _quoted(plan.variables[0])
    equations = [f"{_key(name)} = [{terms}]" for name in plan.equations]
    lines = [
        "# What may be in the rate beside it: candidate terms, each with a coefficient to be learned.",
        "# What is known of a coefficient stands in the place of its term:",
        f'# {{ expression = {example}, sign = "-" }}, or prior = [mean, sd], bounds = [least, largest], fixed = value',
    ]
    if plan.measured:
        simple = "# For discover take this section out: what stands here is learned in every explanation."
        return "\n".join(["[dictionary]", *lines, simple, *equations])
    if plan.sampled and len(equations) > 1:
        head = [
            "[dictionary]",
            "# Rows are samples, and discover looks at one equation of these at a time: the one here.",
            f"{_key(plan.equations[0])} = []",
            "# For bayes-greybox fit, in the place of that line:",
        ]
    else:
        needs = "discover needs no such section, and learns its terms if it is there."
        head = ["# [dictionary]", f"# For bayes-greybox fit take the # away; {needs}"]
    return "\n".join([*head, *lines, *(f"# {line}" for line in equations)])


def _columns(plan: Plan, columns: Iterable[str]) -> str:
    """Write a list of columns, or a table where a column's name cannot stand in formulas."""
    chosen = list(columns)
    if plan.name(chosen) == chosen:
        return f"[{', '.join(map(_quoted, chosen))}]"
    return "{ " + ", ".join(f"{_key(plan.names[c])} = {_quoted(c)}" for c in chosen) + " }"


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _quoted(name)


def _quoted(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)
