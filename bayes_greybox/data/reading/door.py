"""The door for measurements: any table that an engineer has, read into Trajectories."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from itertools import count
from typing import Any, Literal

import numpy as np

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.limits import is_finite

from .formats.text import BLANKS
from .listed import listed
from .pieces import Asked, cut, stated_units
from .sources import read_source
from .table import Layout, Table

Columns = Sequence[str] | Mapping[str, str] | Mapping[str, int] | None


def read(
    source: Any,
    *,
    states: Columns = (),
    inputs: Columns = (),
    derivatives: Mapping[str, str] | None = None,
    outputs: Columns = (),
    time: str | int | None = None,
    dt: float | None = None,
    run: str | int | None = None,
    units: Mapping[str, str] | None = None,
    rates: Mapping[str, str] | None = None,
    missing: Literal["error", "drop"] = "error",
    constant: Literal["error", "keep"] = "error",
    restart: Literal["error", "run"] = "error",
    sep: str | None = None,
    decimal: str = ".",
    thousands: str | None = None,
    skiprows: int | Sequence[int] | None = 0,
    encoding: str = "utf-8",
    sheet: str | int | None = None,
    columns: Sequence[str] | None = None,
    dayfirst: bool | None = None,
) -> Trajectories:
    """Read measurements from a table: a file, several files, a DataFrame or a Dataset.

    What was done that the table does not say itself stands in `remarks` of the data, which their repr shows.

    Args:
        source: pandas DataFrame, xarray Dataset, mapping of name to column, or path of a file: .csv, .tsv, .txt and
            .dat (lines marked # or % above the rows are remarks, but for names above rows of numbers), .xlsx, .parquet,
            .nc, .mat (columns of a matrix X are X_1, X_2, …; fields of a structure S are S.name) or .lvm. A list of
            these, or a path with * or ?, also in a list, is one run or more for each.
        states: names of state columns, or a mapping of state name to column.
        inputs: names of input columns, or a mapping of input name to column.
        derivatives: mapping of state name to the column of its measured derivative.
        outputs: names of output columns, or a mapping of output name to column (see `Trajectories.from_arrays`).
        time: column of time stamps; dates and clock times become seconds since the first of each run. None needs `dt`.
        dt: sample spacing, in units of time, where there is no column of time.
        run: column whose value tells the runs apart, or dimension of a Dataset; rows of a run keep their order.
        units: unit by state, input, output or time column ("t" also names the time); in place of those that the table
            states behind names ("pos [mm]"), in a row below them or as attributes; "" for none.
        rates: {"y": "ydot"} says that the rate of state y is a state ydot that was not measured: it is computed by
            `Trajectories.differentiate(rates=...)`, with its defaults.
        missing: as in `Trajectories.from_arrays`.
        constant: as in `Trajectories.from_arrays`.
        restart: "run" begins a new run wherever the time goes back, named 0, 1, …, or a/0, a/1, … where what is cut
            has the name a; "error" refuses that.
        sep: what separates the values of text; found from the text by default.
        decimal: decimal mark.
        thousands: mark between groups of digits.
        skiprows: lines, or rows of a sheet, before the names; or the numbers of those to leave out, from 0.
        encoding: encoding of text.
        sheet: name or number of a sheet; the first by default.
        columns: names of all columns, where the table has none or others.
        dayfirst: whether 03.04.2024 is in April; needed where it cannot be told.

    Returns:
        The data.

    Raises:
        InputError: if the source or a column cannot be used; the message names it and says what to do.
    """
    if time is not None and dt is not None:
        raise InputError("Give either time, the column of time stamps, or dt, the sample spacing, not both.")
    if dt is not None and not (is_finite(dt) and dt > 0.0):
        raise InputError(f"dt must be positive and a number, not {dt!r}.")
    for what, given in (("derivatives", derivatives), ("units", units), ("rates", rates)):
        if given is not None and not isinstance(given, Mapping):
            example = {"derivatives": '{"y": "ydot"}', "units": '{"y": "m"}', "rates": '{"y": "ydot"}'}[what]
            raise InputError(f"{what} must be a mapping, such as {what}={example}, not {given!r}.")
    if restart not in ("error", "run"):
        raise InputError(f'restart must be "error" or "run", not {restart!r}.')
    layout = layout_of(
        sep=sep,
        decimal=decimal,
        thousands=thousands,
        skiprows=skiprows,
        encoding=encoding,
        sheet=sheet,
        columns=columns,
        dayfirst=dayfirst,
    )
    kinds = {
        "state": named(states, "states"),
        "input": named(inputs, "inputs"),
        "derivative": dict(derivatives or {}),
        "output": named(outputs, "outputs"),
    }
    # Columns of a frame may be numbers.
    time, run = (None if name is None else str(name) for name in (time, run))
    found = listed(source)
    asked = [*(column for chosen in kinds.values() for column in chosen.values()), time, run]
    wanted = [name for name in asked if name is not None]
    tables = [read_source(each, layout).holding(wanted) for _, each in found]
    if time is None and dt is None:
        first = tables[0]
        raise InputError(
            f"Give either time, the column of time stamps, or dt, the sample spacing; the columns of {first.where} are "
            f"{', '.join(first.frame.columns)}."
        )
    # A matrix stands for its columns.
    kinds = {kind: _spread(chosen, tables[0]) for kind, chosen in kinds.items()}
    parts = [
        cut(table, Asked(kinds, time, dt, run, restart), layout, label)
        for table, (label, _) in zip(tables, found, strict=True)
    ]
    names = _distinct([name for part in parts for name in part.names])
    remarks = [remark for part in parts for remark in part.remarks]
    if len(found) > 1:
        remarks.append(f"{len(found)} sources were read as {len(names)} runs: {', '.join(names)}")

    def runs(key: tuple[str, str]) -> list[np.ndarray]:
        return [values for part in parts for values in part.columns[key]]

    given = {kind: {name: runs((kind, name)) for name in chosen} for kind, chosen in kinds.items()}
    data = Trajectories.from_arrays(
        runs(("time", "t")),
        states=given["state"],
        inputs=given["input"],
        derivatives=given["derivative"],
        outputs=given["output"],
        units=stated_units(parts, units or {}, time),
        run_names=names,
        missing=missing,
        constant=constant,
    )
    if data.dropped:
        rows = (
            "1 row with a missing value was" if data.dropped == 1 else f"{data.dropped} rows with missing values were"
        )
        remarks.append(f"{rows} left out")
    data = replace(data, remarks=(*dict.fromkeys(remarks), *data.remarks))
    _require_computed(rates or {}, tables)
    return data.differentiate(rates=rates) if rates else data


def require_computed(source: Any, rates: Mapping[str, str], settings: Mapping[str, Any]) -> None:
    """Refuse to compute rates that a source has, where they are computed later than it is read.

    Args:
        source: As in `read`.
        rates: As in `read`.
        settings: Further arguments of `read`.

    Raises:
        InputError: A column of that name, or a source that cannot be read.
    """
    layout = layout_of(**{field.name: settings[field.name] for field in fields(Layout) if field.name in settings})
    _require_computed(rates, [read_source(each, layout) for _, each in listed(source)])


def layout_of(
    *, skiprows: Any = 0, encoding: str = "utf-8", columns: Sequence[str] | None = None, **given: Any
) -> Layout:
    """How tables are laid out, as `read` is told."""
    if skiprows is None:
        skiprows = 0
    try:
        lines = np.asarray(skiprows).astype(np.int64, casting="safe").tolist() if np.size(skiprows) else []
    except (TypeError, ValueError):
        raise InputError(f"skiprows counts lines, or numbers them from 0; it cannot be {skiprows!r}.") from None
    if np.any(np.asarray(lines) < 0):
        raise InputError(f"skiprows counts lines, or numbers them from 0; it cannot be {skiprows}.")
    if isinstance(columns, str):
        raise InputError(f'columns must be a list of names, such as columns=["{columns}"], not a single string.')
    sep = given.get("sep")
    if sep and len(sep) > 1 and sep != BLANKS:
        raise InputError(
            f'sep must be one character, or r"{BLANKS}" for any number of blanks, not {sep!r}; replace it in the '
            "text by one that is not in its cells."
        )
    layout = Layout(
        skiprows=lines if isinstance(lines, int) else tuple(lines),
        # With the mark of byte order that some programs write.
        encoding="utf-8-sig" if encoding == "utf-8" else encoding,
        columns=None if columns is None else tuple(columns),
        **given,
    )
    if layout.thousands == layout.decimal:
        raise InputError(
            f'decimal and thousands are both "{layout.decimal}"; give the decimal mark too, such as decimal=",".'
        )
    return layout


def named(columns: Columns, what: str) -> dict[str, str]:
    """Columns by name, as `read` is told of them.

    Args:
        columns: Names, or a mapping of name to column.
        what: Which argument they are.

    Raises:
        InputError: A single string, or a name that cannot stand in expressions.
    """
    if columns is None:
        return {}
    if isinstance(columns, str):
        raise InputError(f'{what} must be a list of names, such as ["{columns}"], not a single string.')
    if isinstance(columns, Mapping):
        return {name: str(column) for name, column in columns.items()}
    for name in columns:
        if not str(name).isidentifier():
            renamed = {_plain(str(each)): str(each) for each in columns}
            raise InputError(
                f"{name!r} cannot be used as a name in expressions; give the column one there: {what}={renamed}."
            )
    return {name: name for name in columns}


def _plain(name: str) -> str:
    """A name that can stand in expressions; the name itself if it can."""
    plain = name if name.isidentifier() else re.sub(r"\W+", "_", name).strip("_")
    return plain if plain.isidentifier() else f"x{plain}"


def _spread(chosen: Mapping[str, str], table: Table) -> dict[str, str]:
    """Columns by name, a group of them under its name and their numbers."""
    spread: dict[str, str] = {}
    for name, column in chosen.items():
        if column in table.groups and column not in table.frame.columns:
            spread |= {f"{name}_{i + 1}": part for i, part in enumerate(table.groups[column])}
        else:
            spread[name] = column
    return spread


def _require_computed(rates: Mapping[str, str], tables: Sequence[Table]) -> None:
    """Refuse to compute a rate that the table has."""
    for state, rate in rates.items():
        where = next((table.where for table in tables if rate in table.frame.columns), None)
        if where is not None:
            raise InputError(
                f'rates says that "{rate}" was not measured, but {where} has that column: if it is the measured rate '
                f'of "{state}", pass derivatives={{"{state}": "{rate}"}}; if not, choose another name.'
            )


def _distinct(names: Sequence[str]) -> list[str]:
    """Names of runs, later ones of the same name numbered."""
    found: list[str] = []
    for name in names:
        numbered = (f"{name}_{i}" for i in count(2))
        found.append(name if name not in found else next(each for each in numbered if each not in (*names, *found)))
    return found
