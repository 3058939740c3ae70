"""Read measured tables: delimited text, Parquet, MATLAB and netCDF files."""

import difflib
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from .errors import InputError
from .trajectories import Trajectories


def read_table(
    path: str | Path,
    *,
    time: str | None = None,
    states: Sequence[str] | Mapping[str, str] = (),
    inputs: Sequence[str] | Mapping[str, str] = (),
    derivatives: Mapping[str, str] | None = None,
    outputs: Sequence[str] | Mapping[str, str] = (),
    trajectory: str | None = None,
    dt: float | None = None,
    units: Mapping[str, str] | None = None,
    missing: Literal["error", "drop"] = "error",
    constant: Literal["error", "keep"] = "error",
) -> Trajectories:
    """Read one file of measurements.

    Args:
        path: .csv, .tsv, .txt (delimiter found from the text; lines marked # before the rows are remarks, but for
            names above rows of numbers), .parquet, .mat or .nc.
        time: column of time stamps; None needs `dt`.
        states: names of state columns, or a mapping of state name to column.
        inputs: names of input columns, or a mapping of input name to column.
        derivatives: mapping of state name to the column of its measured derivative.
        outputs: names of output columns, or a mapping of output name to column (see `Trajectories.from_arrays`).
        trajectory: column whose value tells the runs apart; rows of a run keep their order.
        dt: sample spacing, in units of time, where the file has no time column.
        units: unit by state, input, output or time column ("t" also names the time).
        missing: as in `Trajectories.from_arrays`.
        constant: as in `Trajectories.from_arrays`.

    Returns:
        The data.

    Raises:
        InputError: if the file or a column cannot be used; the message names it.
    """
    path = Path(path)
    if (time is None) == (dt is None):
        raise InputError("Give either time, the column of time stamps, or dt, the sample spacing.")
    if dt is not None and not dt > 0.0:
        raise InputError(f"dt must be positive, not {dt}.")
    table = _read(path)
    if len(table) == 0:
        raise InputError(f'"{path}" has no rows.')
    state_columns, input_columns = _mapping(states, "states"), _mapping(inputs, "inputs")
    output_columns = _mapping(outputs, "outputs")
    groups = [np.arange(len(table))]
    run_names = None
    if trajectory is not None:
        # Order of first appearance, so that runs stay as they lie in the file.
        labels = _column(table, trajectory, path)
        if labels.isna().any():
            row = int(np.argmax(labels.isna().to_numpy()))
            raise InputError(f'Column "{trajectory}" of "{path}" names no run in row {row}; fill it in.')
        codes, values = pd.factorize(labels)
        groups = [np.flatnonzero(codes == i) for i in range(len(values))]
        run_names = [str(value) for value in values]

    def runs(name: str) -> list[np.ndarray]:
        values = _numbers(table, name, path)
        return [values[rows] for rows in groups]

    stamps = runs(time) if time is not None else [np.arange(len(rows)) * float(dt or 0.0) for rows in groups]
    return Trajectories.from_arrays(
        stamps,
        states={name: runs(column) for name, column in state_columns.items()},
        inputs={name: runs(column) for name, column in input_columns.items()},
        derivatives={name: runs(column) for name, column in (derivatives or {}).items()},
        outputs={name: runs(column) for name, column in output_columns.items()},
        units={"t" if name == time else name: unit for name, unit in (units or {}).items()},
        run_names=run_names,
        missing=missing,
        constant=constant,
    )


def _read(path: Path) -> pd.DataFrame:
    readers: dict[str, Callable[[Path], pd.DataFrame]] = {
        ".csv": _read_text,
        ".tsv": _read_text,
        ".txt": _read_text,
        ".parquet": _read_parquet,
        ".mat": _read_mat,
        ".nc": _read_netcdf,
    }
    suffix = path.suffix.lower()
    if suffix not in readers:
        raise InputError(f'"{path}" has an unknown extension; readable are {", ".join(readers)}.')
    if not path.is_file():
        raise InputError(f'There is no file "{path}".')
    if path.stat().st_size == 0:
        raise InputError(f'"{path}" is empty.')
    try:
        table = readers[suffix](path)
    except InputError:
        raise
    except Exception as error:
        # Each library has its own exceptions for a damaged file; all mean the same to the user.
        kind = suffix.removeprefix(".")
        raise InputError(f'"{path}" cannot be read as {kind} ({_first_line(error)}); check the file.') from error
    table.columns = [str(name).strip() for name in table.columns]
    return table


def _read_text(path: Path) -> pd.DataFrame:
    marked: list[str] = []
    skipped, first = 0, ""
    with path.open(encoding="utf-8-sig") as file:
        for first in file:
            if first.strip() and not first.startswith("#"):
                break
            marked += [first.lstrip("#").strip()] if first.strip() else []
            skipped += 1
    delimiter = _delimiter(first, path.suffix.lower())
    # Names behind a # above rows of numbers, as numpy.savetxt writes them; other such lines are remarks.
    names = _cells(marked[-1], delimiter) if marked and all(map(_is_number, _cells(first, delimiter))) else None
    if names is not None and len(names) != len(_cells(first, delimiter)):
        raise InputError(
            f'"{path}" names {len(names)} columns, but its first row has {len(_cells(first, delimiter))} values; '
            "correct the line of names."
        )
    with warnings.catch_warnings():
        # Rows with more values than names would lose the last ones.
        warnings.simplefilter("error", pd.errors.ParserWarning)
        return pd.read_csv(
            path,
            sep=delimiter,
            skipinitialspace=True,
            skiprows=skipped,
            header=None if names else "infer",
            names=names,
            # A delimiter at the end of each row would make the first column an index.
            index_col=False,
        )


def _delimiter(line: str, suffix: str) -> str:
    """What separates the values: tabs, semicolons, commas, or in a .txt blanks."""
    if suffix == ".tsv":
        return "\t"
    order = (",", ";", "\t") if suffix == ".csv" else ("\t", ";", ",")
    return next((mark for mark in order if mark in line), "," if suffix == ".csv" else r"\s+")


def _cells(line: str, delimiter: str) -> list[str]:
    cells = [cell.strip() for cell in re.split(delimiter, line.strip())]
    return cells[:-1] if cells[-1] == "" else cells


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _read_parquet(path: Path) -> pd.DataFrame:
    try:
        import pyarrow.parquet
    except ImportError as error:
        raise InputError(
            f'Reading "{path}" needs pyarrow; install it with pip install "bayes-greybox[tables]".'
        ) from error
    return pyarrow.parquet.read_table(path).to_pandas()


def _read_mat(path: Path) -> pd.DataFrame:
    import h5py
    import scipy.io

    content: dict[str, Any]
    if h5py.is_hdf5(path):
        # Version 7.3, which SciPy does not read.
        with h5py.File(path, "r") as file:
            items = {name: item for name, item in file.items() if isinstance(item, h5py.Dataset)}
            # Text is stored as a vector of letters, which may be longer than the record.
            numbers = {name: item for name, item in items.items() if item.attrs.get("MATLAB_class") != b"char"}
            content = {name: np.asarray(item) for name, item in numbers.items()}
    else:
        content = scipy.io.loadmat(path)
    vectors = {
        name: np.asarray(value).reshape(-1)
        for name, value in content.items()
        if not name.startswith("__") and np.size(value) > 1 and np.size(value) == max(np.shape(value))
    }
    if not vectors:
        raise InputError(f'"{path}" has no one-dimensional variable.')
    # The longest vectors are the table; shorter ones are settings and labels.
    n = max(len(values) for values in vectors.values())
    return pd.DataFrame({name: values for name, values in vectors.items() if len(values) == n})


def _read_netcdf(path: Path) -> pd.DataFrame:
    import h5py
    import xarray as xr

    if h5py.is_hdf5(path):
        with h5py.File(path, "r") as file:
            if "posterior" in file:
                raise InputError(f'"{path}" is a saved fit, not a table; open it with bg.load.')
    with xr.open_dataset(path, engine="h5netcdf", decode_times=False) as dataset:
        variables = {**dict(dataset.coords), **dict(dataset.data_vars)}
        lengths = {array.dims: array.size for array in variables.values() if array.ndim == 1}
        if not lengths:
            raise InputError(f'"{path}" has no one-dimensional variable.')
        counts = {dims: sum(array.dims == dims for array in variables.values()) for dims in lengths}
        shared = max(counts, key=lambda dims: (counts[dims], lengths[dims]))
        return pd.DataFrame({str(name): array.to_numpy() for name, array in variables.items() if array.dims == shared})


def _mapping(columns: Sequence[str] | Mapping[str, str], what: str) -> dict[str, str]:
    if isinstance(columns, str):
        raise InputError(f'{what} must be a list of names, such as ["{columns}"], not a single string.')
    if isinstance(columns, Mapping):
        return dict(columns)
    return {name: name for name in columns}


def _column(table: pd.DataFrame, name: str, path: Path) -> Any:
    if name not in table.columns:
        known = [str(column) for column in table.columns]
        lowered = {column.lower(): column for column in reversed(known)}
        near = [lowered[match] for match in difflib.get_close_matches(name.lower(), lowered, n=3, cutoff=0.5)]
        guess = f" Did you mean {' or '.join(near)}?" if near else ""
        raise InputError(f'"{path}" has no column "{name}".{guess} Its columns are {", ".join(known)}.')
    return table[name]


def _numbers(table: pd.DataFrame, name: str, path: Path) -> np.ndarray:
    column: Any = _column(table, name, path)
    if column.dtype.kind in "mM":
        raise InputError(
            f'Column "{name}" of "{path}" holds dates; convert it to a number, such as seconds since the start: '
            "(t - t.iloc[0]).dt.total_seconds()."
        )
    if pd.api.types.is_bool_dtype(column) or not pd.api.types.is_numeric_dtype(column):
        numbers: Any = pd.to_numeric(column, errors="coerce")
        bad = np.flatnonzero(numbers.isna().to_numpy() & column.notna().to_numpy())
        if len(bad) or not pd.api.types.is_numeric_dtype(numbers):
            row = int(bad[0]) if len(bad) else 0
            raise InputError(
                f'Column "{name}" of "{path}" is not numeric: row {row} holds {column.iloc[row]!r}; correct '
                "the cell or choose another column."
            )
        column = numbers
    return column.to_numpy(dtype=float, na_value=np.nan)


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0].rstrip(".")
