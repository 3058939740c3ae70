"""Checks and conventions for the columns of measured data: names, units, lengths, times, missing values."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.running.errors import InputError

from .plain_arrays import first_lost, plain_array, since_first

# Names that no column can have, and their meaning.
RESERVED = {"t": "time", "run": "run number", "obs_id": "number of the row in results"}
Columns = Mapping[str, Any]  # columns by name, as users give them


def derivative_label(state: str, time_name: str = "t") -> str:
    """Return the column label of the derivative of a state, such as d(y)/dt."""
    return f"d({state})/d{time_name}"


def rate_unit(unit: str | None, time_unit: str | None) -> str | None:
    """Return the unit of a rate, such as m/s, or None if either unit is unknown."""
    if unit is None or time_unit is None:
        return None
    return f"{unit}/{time_unit}" if time_unit.isidentifier() else f"({unit})/({time_unit})"


def several(value: Any) -> list[Any]:
    """Return one entry for each run: a list or tuple of arrays is several runs, anything else is one."""
    if isinstance(value, list | tuple) and len(value) > 0 and np.ndim(value[0]) > 0:
        return list(value)
    # Objects with a mask or a unit stay as they are, as a plain array would lose both.
    return [value if np.ndim(value) > 0 and hasattr(value, "dtype") else np.atleast_1d(np.asarray(value))]


def require_mappings(**arguments: Any) -> None:
    """Refuse arguments that do not map names to columns, with an example of a mapping."""
    for name, columns in arguments.items():
        if columns is not None and not isinstance(columns, Mapping):
            raise InputError(
                f'{name} must map names to arrays, such as {name}={{"y": y}}, not be a {type(columns).__name__}.'
            )


def counted_from_first(runs: Sequence[Any], names: Sequence[str]) -> tuple[list[Any], tuple[str, ...]]:
    """Subtract the first stamp from runs of whole numbers of more digits than a float holds; with remarks on them."""
    counted, remarks = [], []
    for run, name in zip(runs, names, strict=True):
        what = f'time of run "{name}"'
        stamps = plain_array(run, what)
        if first_lost(stamps) is not None:
            first = f"counts from its first stamp, {stamps.min()}"
            remarks.append(f"the {what}, of more digits than a float holds, {first}")
            stamps = since_first(stamps)
        counted.append(stamps)
    return counted, tuple(remarks)


def name_runs(run_names: Sequence[str] | None, n_run: int) -> tuple[str, ...]:
    """Return distinct names of the runs; "0", "1", … by default."""
    if run_names is None:
        return tuple(str(i) for i in range(n_run))
    names = tuple(str(name) for name in run_names)
    if len(names) != n_run:
        raise InputError(f"There are {n_run} runs but {len(names)} run names; give one name for each run.")
    if len(set(names)) != n_run:
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f'Run name "{twice}" occurs twice; give every run its own name.')
    return names


def labelled_runs(labels: Any, what: str) -> tuple[np.ndarray, Any, list[str]]:
    """Return the number of each row's run, and labels and names of the runs in order; refuse a row without a label."""
    if labels.isna().any():
        row = int(np.argmax(labels.isna().to_numpy()))
        raise InputError(f"{what} names no run in row {row}; fill it in, or leave out that row.")
    codes, values = pd.factorize(labels)
    # A whole number stays one, where an empty cell elsewhere made the column one of decimals.
    names = [str(int(v)) if isinstance(v, float) and v.is_integer() else str(v) for v in values]
    return codes, values, names


def number_runs(labels: Any, run_names: Sequence[str] | None) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return the number of the run of each row, and the names of the runs: the labels by default."""
    codes, values, names = labelled_runs(labels, 'The column "run"')
    if np.any(np.diff(codes) < 0):
        row = int(np.argmax(np.diff(codes) < 0)) + 1
        raise InputError(
            f"Rows of run {values[codes[row]]!r} do not lie together: row {row} comes after those of another run; sort "
            'the table, frame.sort_values("run", kind="stable"), or read it with bg.read(frame, run="run", ...).'
        )
    if run_names is None:
        return codes.astype(np.int64), name_runs(names, len(names))
    listed = name_runs(run_names, len(run_names))
    numbers = [listed.index(name) if name in listed else -1 for name in names]
    if pd.api.types.is_numeric_dtype(labels) and all(value in range(len(listed)) for value in values):
        # As `to_frame` writes them.
        numbers = [int(value) for value in values]
    if -1 in numbers:
        raise InputError(
            f'The column "run" has the run {names[numbers.index(-1)]!r}, which run_names does not name: it has '
            f"{', '.join(listed)}; name every run, or leave run_names out."
        )
    if numbers != list(range(len(listed))):
        raise InputError(
            f'The column "run" has the runs {", ".join(names)}, but run_names names {", ".join(listed)} in this order; '
            "name the runs that there are, in the order of their rows, or leave run_names out."
        )
    return codes.astype(np.int64), listed


def check_names(states: Columns, inputs: Columns, derivatives: Columns, outputs: Columns) -> None:
    """Refuse names that expressions cannot use, that clash, or that belong to no state."""
    if not states and not outputs:
        raise InputError("There is no state; give at least one column in states={...}.")
    if not states and not inputs:
        raise InputError(
            "There is nothing that an output could depend on; give at least one column in states={...} or inputs={...}."
        )
    for name in (*states, *inputs, *outputs):
        if not (isinstance(name, str) and name.isidentifier()):
            raise InputError(
                f"{name!r} cannot be used as a name in expressions; use letters, digits and underscores, "
                "not starting with a digit."
            )
        if name in RESERVED:
            raise InputError(f'The name "{name}" is taken by the {RESERVED[name]}; rename that column.')
    for name in inputs:
        if name in states:
            raise InputError(f'"{name}" is both a state and an input; rename one or leave one out.')
    for name in outputs:
        if name in states or name in inputs:
            what = "a state" if name in states else "an input"
            raise InputError(f'"{name}" is both an output and {what}; rename one or leave one out.')
    for name in derivatives:
        if name not in states:
            raise InputError(
                f'A derivative is given for "{name}", which is no state; the states are {", ".join(states)}.'
            )


def check_units(units: Mapping[str, str], states: Columns, inputs: Columns, outputs: Columns) -> None:
    """Refuse units of columns that do not exist."""
    columns = ["t", *states, *inputs, *outputs, *(derivative_label(name) for name in states)]
    for name in units:
        if name not in columns:
            raise InputError(f'A unit is given for "{name}", which is no column; the columns are {", ".join(columns)}.')


def stack(label: str, value: Any, names: tuple[str, ...], lengths: list[int]) -> np.ndarray:
    """Join the runs of one column to one float vector."""
    runs = several(value)
    if len(runs) != len(lengths):
        raise InputError(f"The {label} has {len(runs)} runs but the time has {len(lengths)}; give one array each.")
    out = []
    for name, length, values in zip(names, lengths, runs, strict=True):
        what = f'{label} of run "{name}"'
        try:
            raw = plain_array(values, what)
            # NumPy would turn dates into ticks without a word.
            if raw.dtype.kind in "mM":
                raise InputError(f"The {what} holds dates; convert it to a number, such as seconds since the start.")
            array = np.asarray(raw, dtype=float)
        except InputError:
            raise
        except (TypeError, ValueError) as error:
            raise InputError(f"The {what} is not numeric; convert it to numbers.") from error
        lost = first_lost(raw)
        if lost is not None:
            raise InputError(
                f"The {what} holds whole numbers of more digits than a float does, such as {raw[lost]} in row "
                f"{lost}; subtract a number from all of them first."
            )
        if array.ndim != 1:
            raise InputError(
                f"The {what} has shape {array.shape}; give one-dimensional arrays, one for each column and run."
            )
        if len(array) != length:
            raise InputError(
                f"The {what} has {len(array)} rows but the time has {length}; every column needs one value for each "
                "time stamp."
            )
        if length == 0:
            raise InputError(f'Run "{name}" has no rows; leave it out.')
        out.append(array)
    return np.concatenate(out)


def usable_rows(columns: Mapping[str, np.ndarray], run: np.ndarray, names: tuple[str, ...], missing: str) -> np.ndarray:
    """Mark the rows without missing values, or raise an error that names the first of them."""
    if missing not in ("error", "drop"):
        raise InputError(f'missing must be "error" or "drop", not {missing!r}.')
    keep = np.ones(len(run), dtype=bool)
    for label, values in columns.items():
        bad = ~np.isfinite(values)
        if missing == "error" and np.any(bad):
            first = int(np.argmax(bad))
            row = first - int(np.argmax(run == run[first]))
            raise InputError(
                f"The {label} has {int(np.sum(bad))} missing or infinite values (NaN or inf), the first in "
                f'row {row} of run "{names[run[first]]}"; repair them or pass missing="drop" to leave out their rows.'
            )
        keep &= ~bad
    lost = np.flatnonzero(np.bincount(run[keep], minlength=len(names)) == 0)
    if len(lost):
        raise InputError(f'Run "{names[lost[0]]}" has no row without missing values; leave it out.')
    return keep


def check_times(time: np.ndarray, run: np.ndarray, names: tuple[str, ...]) -> None:
    """Refuse stamps that repeat or go back within a run."""
    step = np.diff(time)
    bad = (np.diff(run) == 0) & (step <= 0)
    if not np.any(bad):
        return
    # Stamps that occur twice are reported first.
    at = int(np.argmax(bad & (step == 0)) or np.argmax(bad))
    row = at + 1 - int(np.argmax(run == run[at]))
    back = f"row {row} goes back from {time[at]:.12g} to {time[at + 1]:.12g}"
    twice = f"has the stamp {time[at]:.12g} twice (row {row}); remove one of the rows"
    fault = twice if step[at] == 0 else f"is not increasing: {back}; sort the rows by time"
    raise InputError(f'The time of run "{names[run[at]]}" {fault}, or give separate recordings as separate runs.')


def check_varying(columns: Mapping[str, np.ndarray]) -> None:
    """Refuse columns that never change."""
    for label, values in columns.items():
        if len(values) == 1:
            raise InputError(
                f'There is one row, in which the {label} cannot change: give more (constant="keep" allows it in '
                "held-out data)."
            )
        if np.all(values == values[0]):
            raise InputError(
                f"The {label} is constant ({values[0]:g} in every row); leave it out, since the dictionary "
                "term '1' covers a constant (constant=\"keep\" allows it in held-out data)."
            )


def split_cuts(lengths: Sequence[int], names: Sequence[str], fraction: float, by: str) -> list[int]:
    """Return the number of rows of each run that belong to the first part of a split."""
    if not 0.0 < fraction < 1.0:
        raise InputError(f"fraction must lie between 0 and 1, not {fraction}.")
    if by not in ("time", "trajectory"):
        raise InputError(f'by must be "time" or "trajectory", not {by!r}.')
    if by == "trajectory":
        if len(lengths) < 2:
            raise InputError("Splitting by trajectory needs two runs or more; use by='time' for one run.")
        n_first = min(max(round(fraction * len(lengths)), 1), len(lengths) - 1)
        return [n if i < n_first else 0 for i, n in enumerate(lengths)]
    if 1 in lengths:
        name = names[list(lengths).index(1)]
        raise InputError(f'Run "{name}" has one row and cannot be split; use by="trajectory".')
    return [min(max(round(fraction * n), 1), n - 1) for n in lengths]
