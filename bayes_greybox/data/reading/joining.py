"""Two tables of one experiment joined on the clock of one of them: what was commanded, and what was measured."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from bayes_greybox.data.rates.filters import GAP_STEPS
from bayes_greybox.data.runs.resampling import interpolated
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.limits import is_finite

from .cells import numbers, stamps
from .door import layout_of
from .sources import read_source
from .table import Layout, Table, capital

HOW = ("linear", "hold")  # ways in which an input goes on between two of its samples


def join(
    inputs: Any, measurements: Any, *, time: str | Sequence[str], how: str = "linear", offset: float = 0.0,
    run: str | None = None, **layout: Any,
) -> pd.DataFrame:  # fmt: skip
    """Return the rows of the measurements with the inputs at their times beside them, for `read`.

    Where the inputs are not known at a row, before their first sample, after their last or, with lines, in a gap of
    over four usual steps, they are NaN: `read(..., missing="drop")` leaves such rows out, and counts them.

    Args:
        inputs: table of inputs, anything that `read` takes but several files.
        measurements: table of measurements, likewise.
        time: column of time stamps in both, or its names in the first and in the second; dates and clock times are
            compared as such.
        how: "linear" draws lines between samples of an input; "hold" holds each up to the next, and the last one on:
            commands and set points, which may be logged where they change.
        offset: what the clock of the inputs shows when that of the measurements shows 0, in units of time; seconds for
            dates. An input that a study finds late may be such an offset.
        run: column in both tables whose value tells runs apart; each is joined by itself.
        **layout: layout of both tables: sep, decimal, thousands, skiprows, encoding, sheet, dayfirst; see `read`.

    Returns:
        A table with the columns of the measurements as they are and those of the inputs as numbers, each with its unit
        behind its name where the table states one, such as "F [N]".

    Raises:
        InputError: a table or column cannot be used; a column is in both; no row lies within the record of the inputs.
    """
    if how not in HOW:
        raise InputError(f'how must be "linear" or "hold", not {how!r}.')
    if not is_finite(offset):
        raise InputError(f"offset must be a number, not {offset!r}.")
    pair = (time, time) if isinstance(time, str) else tuple(time)
    if len(pair) != 2:
        raise InputError(f"time must be the name of a column, or one for each of the two tables, not {time!r}.")
    way = layout_of(**layout)
    first, second = (read_source(source, way).packed() for source in (inputs, measurements))
    clocks = [first.own_name(pair[0]), second.own_name(pair[1])]
    runs = [] if run is None else [first.own_name(run), second.own_name(run)]
    added = [name for name in first.frame.columns if name not in (clocks[0], *runs[:1])]
    if both := [name for name in added if name in second.frame.columns]:
        raise InputError(
            f'Both tables have a column "{both[0]}": rename it in one of them, or leave it out, so that it is clear '
            "which is meant."
        )
    known, at = _times(first, second, clocks, way)
    values = {name: numbers(first, name, way) for name in added}
    columns = {name: np.full(len(at), np.nan) for name in added}
    for own, rows in _by_run(first, second, runs):
        stamped = own[np.isfinite(known[own])]
        back = np.flatnonzero(np.diff(known[stamped]) <= 0)
        if len(back):
            raise InputError(
                f'The time "{clocks[0]}" of {first.where} does not go forward after {known[stamped][back[0]]:g}: sort '
                "its rows, leave out those that are there twice, or say by run= which column tells runs apart."
            )
        for name in added:
            there = stamped[np.isfinite(values[name][stamped])]
            columns[name][rows] = _at(known[there] - offset, values[name][there], at[rows], how)
    if added and not any(np.isfinite(column).any() for column in columns.values()):
        raise InputError(
            f"No row of {second.where} lies within the record of {first.where}: their times go from "
            f"{np.nanmin(known) - offset:g} to {np.nanmax(known) - offset:g} and from {np.nanmin(at):g} to "
            f"{np.nanmax(at):g}. If their clocks differ, give offset=, what the first shows when the second shows 0."
        )
    units = {**{name: first.units.get(name) for name in added}, **second.units}
    return second.frame.assign(**columns).rename(
        columns={name: f"{name} [{unit}]" for name, unit in units.items() if unit}
    )


def _times(first: Table, second: Table, clocks: Sequence[str], layout: Layout) -> tuple[np.ndarray, np.ndarray]:
    """Return the stamps of both tables, counted from one time."""
    where, both = f"{first.where} and {second.where}", list(zip((first, second), clocks, strict=True))
    units = [table.units.get(name) for table, name in both]
    if None not in units and units[0] != units[1]:
        raise InputError(f"The times of {where} are in {units[0]} and in {units[1]}: convert one.")
    one, two = (table.frame[name] for table, name in both)
    dated = [stamps(table, name, layout).dated for table, name in both]
    if dated[0] != dated[1]:
        raise InputError(f"The stamps of {where} differ, dates in only one of them: convert one.")
    together = pd.DataFrame({"t": pd.concat([one, two], ignore_index=True)})
    time = stamps(Table(together, where), "t", layout).time
    return time[: len(one)], time[len(one) :]


def _by_run(first: Table, second: Table, runs: Sequence[str]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the rows of each run in both tables."""
    if not runs:
        return [(np.arange(len(first.frame)), np.arange(len(second.frame)))]
    one, two = (table.frame[name].astype(str).to_numpy() for table, name in zip((first, second), runs, strict=True))
    lacking = [label for label in dict.fromkeys(two.tolist()) if label not in set(one.tolist())]
    if lacking:
        raise InputError(f'{capital(first.where)} has no inputs of run "{lacking[0]}", which {second.where} has.')
    return [(np.flatnonzero(one == label), np.flatnonzero(two == label)) for label in dict.fromkeys(two.tolist())]


def _at(time: np.ndarray, values: np.ndarray, at: Float[np.ndarray, " m"], how: str) -> Float[np.ndarray, " m"]:
    """Return one input at other times, NaN where it is not known."""
    out = np.full(len(at), np.nan)
    if len(time) < 2:
        return np.where(at >= time[0], values[0], np.nan) if len(time) and how == "hold" else out
    inside = at >= time[0]
    if how == "linear":
        after = np.clip(np.searchsorted(time, at), 1, len(time) - 1)
        wide = time[after] - time[after - 1] > GAP_STEPS * np.median(np.diff(time))
        exact = (at == time[after]) | (at == time[after - 1])
        inside &= (at <= time[-1]) & (~wide | exact)
    out[inside] = interpolated(time, values, at[inside], how)
    return out
