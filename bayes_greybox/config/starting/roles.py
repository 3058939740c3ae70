"""Probable roles of the columns of a table, from their names and their behaviour."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayes_greybox.data.rates.filters import step_slack
from bayes_greybox.data.reading.cells import is_packed_dates, numbers, stamps
from bayes_greybox.data.reading.pieces import clock_set_back
from bayes_greybox.data.reading.table import Layout, Table
from bayes_greybox.data.reading.units import registry
from bayes_greybox.running.errors import InputError

from .clock import COUNTERS, ROWS_OUT_OF_ORDER, counts_rows, counts_runs, run_codes, run_sizes, tells_runs, time_column

INPUTS = re.compile(
    r"(?i)^(u|f|q|i|in|input|force|load|torque|voltage|current|command|cmd|valve|pump|kraft)(_?\d+|[ _].*)?$"
)
AMBIENT = re.compile(
    r"(?i)(^|[ _.])(amb|ambient|room|outdoor|outside|setpoint|umgebung|raum|aussen|außen|soll)(_?\d+|[ _.].*)?$"
)
"""Word for the surroundings, anywhere in the name: T_amb."""

LIQUID_LEVELS = re.compile(
    r"(?i)^(level|height|depth|head|h|pegel|füllstand|fuellstand|höhe|hoehe|tiefe)([ _]?\d+)?([ _].*)?$"
)
"""A length that is no position of a body: its own rate is what is known."""

POSITIONS = re.compile(r"(?i)^(x|y|z|s|q|pos|position|disp|displacement|angle|theta|phi|weg|winkel)(_?\d+|[ _].*)?$")
SPEEDS = re.compile(r"(?i)^(v|vel|velocity|speed|omega|rpm|geschwindigkeit|drehzahl)(_?\d+|[ _].*)?$")

EXPLAINED_SHARE, RATE_FACTOR = 0.95, 1.25
"""Share of a column that the integral of its rate explains, beside a line, and the factor by which that may be off."""

HELD_SHARE, SAME_CORRELATION = 0.3, 0.99999
"""Share of repeated samples beyond which a column is set, not measured; correlation beyond which columns are one."""


@dataclass(frozen=True)
class Guess:
    """Probable roles of columns, by their names in the table.

    Attributes:
        restart: True if the time goes back without a column of runs.
        even: True if the stamps of every run are evenly spaced.
        missing: Number of rows with missing cells.
        set_back: True if the time goes back by an hour, as clocks do when summer time ends.
        rate_of: Column of the rate by the state whose rate it is.
        left_out: Reason why a column has no role.
        dated: True if the stamps are dates or clock times, which become seconds.
        shuffled: True if the time goes back every few rows, as that of rows which are out of order does.
        lengths: Number of rows by run, without those with missing cells.
    """

    time: str | None
    run: str | None
    restart: bool
    even: bool
    missing: int
    set_back: bool
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    rate_of: dict[str, str]
    left_out: dict[str, str]
    dated: bool
    shuffled: bool
    lengths: dict[str, int]


def guessed(table: Table, layout: Layout) -> Guess:
    """Guess the roles of the columns of a table with this layout."""
    names = [str(name) for name in table.frame.columns]
    time = time_column(table, names, layout)
    table = table.packed() if time is not None else table
    run = next((name for name in names if name != time and tells_runs(table, name, layout)), None)
    clock, dated = np.arange(len(table.frame), dtype=float), False
    if time is not None:
        clock, dated, *_ = stamps(table, time, layout)
        others = [name for name in names if name != time and run is None]
        run = next((name for name in others if counts_runs(table, name, layout, clock)), run)
    left_out: dict[str, str] = {}
    columns: dict[str, np.ndarray] = {}
    for name in names:
        if name in (time, run):
            continue
        reason = _unusable(table, name, layout, columns, run_codes(table, run))
        if reason is None:
            columns[name] = numbers(table, name, layout)
        else:
            left_out[name] = reason
    if not columns:
        nothing = f"No column of {table.where} holds numbers that change; there is nothing to model."
        raise InputError(f"{nothing}{table.hint}")
    complete = np.all([np.isfinite(values) for values in (clock, *columns.values())], axis=0)
    # A new run wherever the label changes or the time goes back.
    label = run_codes(table, run)
    starts = np.flatnonzero((np.diff(label) != 0) | (np.diff(clock) < 0)) + 1
    back = bool(np.any((np.diff(clock) < 0) & (np.diff(label) == 0)))
    parts = [part[complete[part]] for part in np.split(np.arange(len(clock)), starts)]
    set_back = dated and any(clock_set_back(clock, int(i) + 1) for i in np.flatnonzero(np.diff(clock) < 0))
    shuffled = back and float(np.median([len(part) for part in parts])) <= ROWS_OUT_OF_ORDER
    states, inputs, rate_of = _roles(clock, columns, [part for part in parts if len(part) > 3], table.units)
    return Guess(
        time, run, back and time is not None, _even(clock, parts), int(np.sum(~complete)), set_back, states, inputs,
        rate_of, left_out, dated, shuffled, run_sizes(table, run, parts),
    )  # fmt: skip


def _unusable(table: Table, name: str, layout: Layout, before: dict[str, np.ndarray], codes: np.ndarray) -> str | None:
    """Return the reason why a column can be neither state nor input; None if it can."""
    try:
        values = numbers(table, name, layout)
    except InputError:
        return "holds words or dates"
    if counts_rows(values, codes, COUNTERS.match(name) is not None):
        return "counts the rows"
    finite = values[np.isfinite(values)]
    if is_packed_dates(values):
        return "holds words or dates"
    if len(finite) < len(values) / 2:
        return "is mostly empty"
    if np.all(finite == finite[0]):
        return "never changes"
    for other, column in before.items():
        both = np.isfinite(values) & np.isfinite(column)
        if abs(np.corrcoef(values[both], column[both])[0, 1]) > SAME_CORRELATION:
            return f"is {other} again, but for a factor and an offset"
    return None


def _even(clock: np.ndarray, parts: Sequence[np.ndarray]) -> bool:
    for time in (clock[part] for part in parts if len(part) > 1):
        steps, mean = np.diff(time), float(np.mean(np.diff(time)))
        if np.any(np.abs(steps - mean) > step_slack(time, mean)):
            return False
    return True


def _roles(
    clock: np.ndarray, columns: dict[str, np.ndarray], parts: list[np.ndarray], units: Mapping[str, str]
) -> tuple[tuple[str, ...], tuple[str, ...], dict[str, str]]:
    """Find states, inputs, and rates by state."""
    rate_of: dict[str, str] = {}
    for state in columns:
        fits = {name: _explained(clock, columns[state], columns[name], parts) for name in columns if name != state}
        best = max(fits, key=lambda name: fits[name], default=state)
        if fits.get(best, 0.0) > EXPLAINED_SHARE:
            rate_of[state] = best
    still = [name for name in columns if name not in {*rate_of, *rate_of.values()}]
    held = {name for name in still if np.mean(np.diff(columns[name]) == 0) > HELD_SHARE}
    inputs = [name for name in still if name in held or INPUTS.match(name) or AMBIENT.search(name)]
    # The last rate of a chain of three is measured, and no state: y, v and a.
    # So is that of a speed without a position.
    last = {
        rate
        for state, rate in rate_of.items()
        if rate not in rate_of and (state in rate_of.values() or _is_speed(state, units.get(state, "")))
    }
    states = [name for name in columns if name not in inputs and name not in last]
    if not states:
        states, inputs = inputs[:1], inputs[1:]
    return tuple(states), tuple(inputs), rate_of


def _is_speed(column: str, unit: str) -> bool:
    """Return True if a column is a speed or a speed of rotation: by its unit if it has one, else by its name."""
    if not unit:
        return bool(SPEEDS.match(column))
    return any(registry().parse_units(unit).is_compatible_with(each) for each in ("m/s", "rad/s"))


def _explained(clock: np.ndarray, state: np.ndarray, rate: np.ndarray, parts: Sequence[np.ndarray]) -> float:
    """Return the share of a column, less a line in each run, that the integral of another one explains."""
    moved, summed = [], []
    for part in parts:
        t, r = clock[part], rate[part]
        integral = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(t) * (r[1:] + r[:-1]))])
        line = np.column_stack([np.ones(len(t)), t - t.mean()])
        both = np.column_stack([state[part], integral])
        rest = both - line @ np.linalg.lstsq(line, both, rcond=None)[0]
        moved.append(rest[:, 0])
        summed.append(rest[:, 1])
    y, x = np.concatenate(moved or [np.zeros(0)]), np.concatenate(summed or [np.zeros(0)])
    if not (np.any(x) and np.any(y)):
        return 0.0
    factor = float(x @ y) / float(x @ x)
    if not 1 / RATE_FACTOR < factor < RATE_FACTOR:
        return 0.0
    return 1.0 - float(np.sum((y - factor * x) ** 2)) / float(y @ y)
