"""Runs of a table: the columns that are asked for, with stamps from zero where they were dates."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.data.columns import derivative_label, labelled_runs
from bayes_greybox.running.errors import InputError

from .cells import numbers, stamps
from .table import Layout, Table, capital

Rows = Int[np.ndarray, " _"]
Time = Float[np.ndarray, " n_row"]  # stamps of a table, NaN where one is missing
MOST_NIGHTS = 4  # most steps of a run that may be off by an hour because clocks were changed: those of some years


@dataclass(frozen=True)
class Asked:
    """Columns that are asked of a table, and what tells its runs apart; see `read` for each."""

    kinds: Mapping[str, Mapping[str, str]]  # column by name for each of "state", "input", "derivative" and "output"
    time: str | None
    dt: float | None
    run: str | None
    restart: str


@dataclass(frozen=True)
class Pieces:
    """Runs of one source."""

    names: list[str]
    # Values of each run by kind and name; the time's under ("time", "t").
    columns: dict[tuple[str, str], list[Float[np.ndarray, " _"]]]
    units: dict[str, str]  # units that the source states, by name as `Trajectories` has them
    dated: bool
    where: str
    remarks: tuple[str, ...]  # changes that the source does not state itself


def cut(table: Table, asked: Asked, layout: Layout, label: str | None) -> Pieces:
    """Cut a table into its runs; `label` is the name of the source, None if there is only one."""
    remarks = list(table.remarks)
    table = table.packed() if asked.time is not None else table
    run = asked.run if asked.run is not None else table.run
    groups, names = [np.arange(len(table.frame))], [label or "0"]
    if run is not None:
        # Blanks around a label are no part of it.
        labels = table.column(run).map(lambda value: value.strip() if isinstance(value, str) else value)
        codes, _, values = labelled_runs(labels, f'Column "{run}" of {table.where}')
        groups = [np.flatnonzero(codes == i) for i in range(len(values))]
        names = [f"{label}/{value}" if label else value for value in values]
    if asked.time is None and run is None and len(table.dimensions) > 1:
        raise InputError(
            f"{capital(table.where)} has the dimensions {' and '.join(table.dimensions)}, whose rows dt would put end "
            f'to end: pass run="{table.dimensions[0]}" if each of its values is a run.'
        )
    if asked.time is None:
        time, dated, long = np.empty(0), False, None
        stamped = [np.arange(len(rows)) * float(asked.dt or 0.0) for rows in groups]
    else:
        time, dated, long, zoned = stamps(table, asked.time, layout)
        _require_forward(table, asked.time, time, dated, groups, asked.restart == "run")
        if dated and not zoned:
            remarks += _hours_off(table, asked.time, time, groups)
        alone = label is None and run is None
        groups, names = _restarted(time, groups, names, alone, table.where, remarks)
        stamped = [time[rows] for rows in groups]
    if dated or long is not None:
        # Numbers far from zero have fewer digits behind the point.
        stamped = [values - np.nanmin(values) if np.isfinite(values).any() else values for values in stamped]
        first = table.column(str(asked.time)).dropna().iloc[0] if dated else long
        each = "the first of each run" if len(groups) > 1 else f"the first, {first}"
        how = " was converted to seconds since" if dated else ", of more digits than a float holds, counts from"
        remarks.append(f"time {asked.time} of {table.where}{how} {each}")
    columns: dict[tuple[str, str], Any] = {("time", "t"): stamped}
    units = {} if asked.time is None else {"t": table.units.get(table.own_name(asked.time))}
    for kind, chosen in asked.kinds.items():
        for name, column in chosen.items():
            values = numbers(table, column, layout)
            columns[kind, name] = [values[rows] for rows in groups]
            units[derivative_label(name) if kind == "derivative" else name] = table.units.get(table.own_name(column))
    if dated:
        units["t"] = "s"
    kept = {name: unit for name, unit in units.items() if unit}
    return Pieces(names, columns, kept, dated, table.where, tuple(remarks))


def stated_units(pieces: Sequence[Pieces], units: Mapping[str, str], time: str | None) -> dict[str, str]:
    """Return the units of all sources together: as given, "" for none, else as the sources state them."""
    chosen = {"t" if name == time else name: unit for name, unit in units.items()}
    if pieces[0].dated and chosen.get("t", "s") != "s":
        raise InputError(
            f"Dates are converted to seconds, so the unit of the time cannot be {chosen['t']!r}; leave it out of units."
        )
    for other in pieces[1:]:
        if other.dated != pieces[0].dated:
            raise InputError(
                f"The stamps of {pieces[0].where} and {other.where} differ, dates in only one of them: convert one."
            )
        for name in pieces[0].units.keys() | other.units.keys():
            first, second = pieces[0].units.get(name), other.units.get(name)
            if first != second and name not in chosen:
                raise InputError(
                    f"The unit of {name} is {first or 'not stated'} in {pieces[0].where} but {second or 'not stated'} "
                    f'in {other.where}; convert one of them, or pass units={{"{name}": ...}} if both are the same.'
                )
    return {name: unit for name, unit in {**pieces[0].units, **chosen}.items() if unit}


def clock_set_back(time: Time, row: int) -> bool:
    """Return True if stamps, in seconds, go back by an hour less the usual step, as when clocks are set back."""
    steps = np.diff(time[np.isfinite(time)])
    usual = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
    return bool(abs(time[row - 1] - time[row] + usual - 3600.0) <= min(usual, 900.0))


def _require_forward(table: Table, name: str, time: Time, dated: bool, groups: Sequence[Rows], restart: bool) -> None:
    """Refuse time that goes back within a run, unless a run begins there, and advise."""
    for rows in groups:
        stamped = rows[np.isfinite(time[rows])]
        steps = np.diff(time[stamped])
        # Where rows are an hour apart, a clock that is set back stands still.
        still = [int(i) + 1 for i in np.flatnonzero(steps == 0) if dated and clock_set_back(time[stamped], int(i) + 1)]
        back = [] if restart else (np.flatnonzero(steps < 0) + 1).tolist()
        at = next(iter(back or still), None)
        if at is None:
            continue
        row, stopped = int(stamped[at]), at in still
        to = table.column(name).iloc[row] if dated else f"{time[row]:.12g}"
        how = f"stands still in row {row}, at" if stopped else f"goes back in row {row}, to"
        fault = f"The time of {table.where} is not increasing, it {how} {to}"
        other = 'another run begins there, pass restart="run", or run= with the column that tells the runs apart'
        other = "the row is there twice, remove it" if stopped else other
        if dated and clock_set_back(time[stamped], at):
            raise InputError(
                f"{fault}, by an hour, as clocks do when summer time ends: write the stamps in UTC or with their "
                "offset, such as 2024-10-27T02:00:00+01:00, or give dt= in place of them if the rows are evenly "
                f"spaced; if {other}."
            )
        raise InputError(f"{fault}: if {other}; if the rows are out of order, sort them.")


def _hours_off(table: Table, name: str, time: Time, groups: Sequence[Rows]) -> list[str]:
    """Remark on a step of a run that is an hour longer or shorter than its others, as where summer time begins."""
    remarks = []
    for rows in groups:
        stamped = rows[np.isfinite(time[rows])]
        steps = np.diff(time[stamped])
        usual = float(np.median(steps)) if len(steps) else 0.0
        off = np.flatnonzero(np.abs(np.abs(steps - usual) - 3600.0) <= 0.01 * usual) if usual > 0 else []
        # Clocks change in two nights a year: many such steps have another reason.
        if 0 < len(off) <= MOST_NIGHTS and np.mean(np.abs(steps - usual) <= 0.01 * usual) > 0.5:
            before, after = (table.column(name).iloc[stamped[off[0] + i]] for i in (0, 1))
            remarks.append(
                f"a step of {table.where}, from {before} to {after}, is an hour off the others: if its clock changed "
                "to summer time or back there, write the stamps in UTC"
            )
    return remarks


def _restarted(
    time: Time, groups: list[Rows], names: list[str], alone: bool, where: str, remarks: list[str]
) -> tuple[list[Rows], list[str]]:
    """Cut runs wherever the time goes back; parts of a run that has a name have its name and a number."""
    parts: list[tuple[Rows, str]] = []
    for rows, name in zip(groups, names, strict=True):
        stamped = rows[np.isfinite(time[rows])]
        pieces = np.split(rows, np.searchsorted(rows, stamped[1:][np.diff(time[stamped]) < 0]))
        numbered = [str(i) if alone else f"{name}/{i}" for i in range(len(pieces))]
        parts += zip(pieces, numbered if len(pieces) > 1 else [name], strict=True)
    if len(parts) > len(groups):
        remarks.append(f"a new run begins wherever the time of {where} goes back: {len(parts)} runs")
    return [rows for rows, _ in parts], [name for _, name in parts]
