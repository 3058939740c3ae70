"""Reader of measurements: any table that an engineer has becomes Trajectories."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from itertools import count
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.limits import is_finite

from .formats.text import BLANKS
from .pieces import Asked, Pieces, cut, stated_units
from .sources import listed, read_source
from .table import Layout, Table

Columns = Sequence[str] | Mapping[str, str] | Mapping[str, int] | None


def read(
    source: Any, *, states: Columns = (), inputs: Columns = (), derivatives: Mapping[str, str] | None = None,
    outputs: Columns = (), time: str | int | None = None, dt: float | None = None, run: str | int | None = None,
    units: Mapping[str, str] | None = None, rates: Mapping[str, str] | None = None,
    missing: Literal["error", "drop"] = "error", constant: Literal["error", "keep"] = "error",
    restart: Literal["error", "run"] = "error", sep: str | None = None, decimal: str = ".",
    thousands: str | None = None, skiprows: int | Sequence[int] | None = 0, encoding: str = "utf-8",
    sheet: str | int | None = None, columns: Sequence[str] | None = None, dayfirst: bool | None = None,
) -> Trajectories:  # fmt: skip
    """Read measurements from a table: a file, several files, a DataFrame or a Dataset.

    Any change that the table does not state itself stands in `remarks` of the data, which their repr shows.

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
        restart: "run" begins a new run wherever the time goes back, named 0, 1, …, or a/0, a/1, … where the run that
            is cut has the name a; "error" refuses that.
        sep: separator of the values of text; found from the text by default.
        decimal: decimal mark.
        thousands: mark between groups of digits.
        skiprows: lines, or rows of a sheet, before the names; or the numbers of those to leave out, from 0.
        encoding: encoding of text.
        sheet: name or number of a sheet; the first by default.
        columns: names of all columns, where the table has none or others.
        dayfirst: true if 03.04.2024 is in April; needed where the dates do not show it.

    Raises:
        InputError: if the source or a column cannot be used; the message names it and says what to do.
    """
    _check_arguments(time, dt, restart, {"derivatives": derivatives, "units": units, "rates": rates})
    layout = layout_of(
        sep=sep, decimal=decimal, thousands=thousands, skiprows=skiprows, encoding=encoding, sheet=sheet,
        columns=columns, dayfirst=dayfirst,
    )  # fmt: skip
    by_kind = {"state": states, "input": inputs, "derivative": dict(derivatives or {}), "output": outputs}
    kinds = {kind: named(chosen, f"{kind}s") for kind, chosen in by_kind.items()}
    # Columns of a frame may be numbers.
    asked = Asked(kinds, None if time is None else str(time), dt, None if run is None else str(run), restart)
    labels, tables = _tables(source, asked, layout)
    # A matrix stands for its columns.
    asked = replace(asked, kinds={kind: _spread(chosen, tables[0]) for kind, chosen in kinds.items()})
    parts = [cut(table, asked, layout, label) for table, label in zip(tables, labels, strict=True)]
    data = _joined(parts, asked, units or {}, missing, constant)
    _require_computed(rates or {}, tables)
    return data.differentiate(rates=rates) if rates else data


def _check_arguments(time: Any, dt: Any, restart: str, mappings: Mapping[str, Any]) -> None:
    if time is not None and dt is not None:
        raise InputError("Give either time, the column of time stamps, or dt, the sample spacing, not both.")
    if dt is not None and not (is_finite(dt) and dt > 0.0):
        raise InputError(f"dt must be positive and a number, not {dt!r}.")
    for argument, value in mappings.items():
        if value is not None and not isinstance(value, Mapping):
            example = '{"y": "m"}' if argument == "units" else '{"y": "ydot"}'
            raise InputError(f"{argument} must be a mapping, such as {argument}={example}, not {value!r}.")
    if restart not in ("error", "run"):
        raise InputError(f'restart must be "error" or "run", not {restart!r}.')


def _tables(source: Any, asked: Asked, layout: Layout) -> tuple[list[str | None], list[Table]]:
    """Read the tables that hold the columns, with the name of each source."""
    sources = listed(source)
    columns = [column for chosen in asked.kinds.values() for column in chosen.values()]
    wanted = [name for name in (*columns, asked.time, asked.run) if name is not None]
    tables = [read_source(each, layout).holding(wanted) for _, each in sources]
    if asked.time is None and asked.dt is None:
        raise InputError(
            f"Give either time, the column of time stamps, or dt, the sample spacing; the columns of "
            f"{tables[0].where} are {', '.join(tables[0].frame.columns)}."
        )
    return [label for label, _ in sources], tables


def _joined(parts: list[Pieces], asked: Asked, units: Mapping[str, str], missing: Any, constant: Any) -> Trajectories:
    """Join the runs of all sources."""
    names = _distinct([name for part in parts for name in part.names])
    remarks = [remark for part in parts for remark in part.remarks]
    if len(parts) > 1:
        remarks.append(f"{len(parts)} sources were read as {len(names)} runs: {', '.join(names)}")

    def runs(kind: str, name: str) -> list[np.ndarray]:
        return [values for part in parts for values in part.columns[kind, name]]

    arrays = {f"{kind}s": {name: runs(kind, name) for name in chosen} for kind, chosen in asked.kinds.items()}
    stated = stated_units(parts, units, asked.time)
    data = Trajectories.from_arrays(
        runs("time", "t"), **arrays, units=stated, run_names=names, missing=missing, constant=constant
    )
    if data.dropped:
        one = data.dropped == 1
        rows = "1 row with a missing value was" if one else f"{data.dropped} rows with missing values were"
        remarks.append(f"{rows} left out")
    return replace(data, remarks=(*dict.fromkeys(remarks), *data.remarks))


def require_computed(source: Any, rates: Mapping[str, str], settings: Mapping[str, Any]) -> None:
    """Refuse to compute rates that a source has, where they are computed later than it is read with these settings."""
    layout = layout_of(**{field.name: settings[field.name] for field in fields(Layout) if field.name in settings})
    _require_computed(rates, [read_source(each, layout) for _, each in listed(source)])


def layout_of(*, skiprows: Any = 0, encoding: str = "utf-8", columns: Any = None, **options: Any) -> Layout:
    """Check the arguments of `read` that describe the layout of tables, and collect them."""
    skiprows = 0 if skiprows is None else skiprows
    try:
        lines = np.asarray(skiprows).astype(np.int64, casting="safe").tolist() if np.size(skiprows) else []
        if np.any(np.asarray(lines) < 0):
            raise ValueError
    except (TypeError, ValueError):
        raise InputError(f"skiprows counts lines, or numbers them from 0; it cannot be {skiprows!r}.") from None
    if isinstance(columns, str):
        raise InputError(f'columns must be a list of names, such as columns=["{columns}"], not a single string.')
    sep = options.get("sep")
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
        **options,
    )
    if layout.thousands == layout.decimal:
        raise InputError(
            f'decimal and thousands are both "{layout.decimal}"; give the decimal mark too, such as decimal=",".'
        )
    return layout


def named(columns: Columns, what: str) -> dict[str, str]:
    """Return columns by name, from names alone or a mapping of name to column; `what` is the argument's name."""
    if columns is None:
        return {}
    if isinstance(columns, str):
        raise InputError(f'{what} must be a list of names, such as ["{columns}"], not a single string.')
    if isinstance(columns, Mapping):
        return {name: str(column) for name, column in columns.items()}
    odd = next((name for name in columns if not str(name).isidentifier()), None)
    if odd is not None:
        renamed = {_plain(str(each)): str(each) for each in columns}
        raise InputError(
            f"{odd!r} cannot be used as a name in expressions; give the column one there: {what}={renamed}."
        )
    return {name: name for name in columns}


def _plain(name: str) -> str:
    """Return a name that can stand in expressions; the name itself if it can."""
    plain = name if name.isidentifier() else re.sub(r"\W+", "_", name).strip("_")
    return plain if plain.isidentifier() else f"x{plain}"


def _spread(chosen: Mapping[str, str], table: Table) -> dict[str, str]:
    """Replace each group of columns by its columns, under its name and their numbers."""
    spread: dict[str, str] = {}
    for name, column in chosen.items():
        if column in table.groups and column not in table.frame.columns:
            spread |= {f"{name}_{i + 1}": part for i, part in enumerate(table.groups[column])}
        else:
            spread[name] = column
    return spread


def _require_computed(rates: Mapping[str, str], tables: Sequence[Table]) -> None:
    for state, rate in rates.items():
        where = next((table.where for table in tables if rate in table.frame.columns), None)
        if where is not None:
            raise InputError(
                f'rates says that "{rate}" was not measured, but {where} has that column: if it is the measured rate '
                f'of "{state}", pass derivatives={{"{state}": "{rate}"}}; if not, choose another name.'
            )


def _distinct(names: Sequence[str]) -> list[str]:
    """Number later runs of the same name."""
    distinct: list[str] = []
    for name in names:
        free = (each for each in (f"{name}_{i}" for i in count(2)) if each not in (*names, *distinct))
        distinct.append(next(free) if name in distinct else name)
    return distinct


def read_table(
    path: str | Path, *, time: str | None = None, states: Columns = (), inputs: Columns = (),
    derivatives: Mapping[str, str] | None = None, outputs: Columns = (), trajectory: str | None = None,
    dt: float | None = None, units: Mapping[str, str] | None = None,
    missing: Literal["error", "drop"] = "error", constant: Literal["error", "keep"] = "error",
) -> Trajectories:  # fmt: skip
    """Read one file of measurements: `read(path, run=trajectory, ...)`, which has more options.

    `path` is the `source` of `read`, and `trajectory` its `run`: the column whose value tells the runs apart.
    """
    options = {"missing": missing, "constant": constant, "time": time, "dt": dt, "run": trajectory, "units": units}
    return read(path, states=states, inputs=inputs, derivatives=derivatives, outputs=outputs, **options)
