"""Sources one by one, and their readers: files by their extension, tables in memory by their interface."""

import glob
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.running.errors import InputError

from .cells import is_measured
from .formats.labview import read_lvm
from .formats.matlab import read_mat
from .formats.text import read_text
from .table import Layout, Table, capital, first_line, first_row_measured, require_distinct, tidy


def listed(source: Any) -> list[tuple[str | None, Any]]:
    """Return the sources, each with the name of its run: that of its file, or None if there is only one source."""
    if not isinstance(source, list | tuple):
        if not _is_pattern(source):
            return [(None, source)]
        source = [source]
    if any(map(_is_pattern, source)):
        source = _opened(source)
    if not source:
        raise InputError("There is nothing to read: the list of sources is empty.")
    stems = [Path(each).stem if isinstance(each, str | Path) else str(i) for i, each in enumerate(source)]
    if len(set(stems)) < len(stems):
        stems = [str(each) if isinstance(each, str | Path) else str(i) for i, each in enumerate(source)]
    return list(zip(stems, source, strict=True))


def _is_pattern(source: Any) -> bool:
    """Return True if a source is a path that stands for all files that it matches."""
    if not isinstance(source, str | Path):
        return False
    require_path(source)
    return glob.has_magic(str(source)) and not Path(source).exists()


def _opened(sources: Sequence[Any]) -> list[Any]:
    """Replace patterns by their files; a file that two of them match, or that is named besides, is read once."""
    named = {Path(each) for each in sources if isinstance(each, str | Path) and not _is_pattern(each)}
    opened: list[Any] = []
    for each in sources:
        if not _is_pattern(each):
            opened.append(each)
            continue
        files = sorted(glob.glob(str(each), recursive=True), key=_in_order)
        if not files:
            raise InputError(f'No file matches "{each}"; check the folder and the pattern.')
        opened += [path for path in files if Path(path) not in named]
        named |= {Path(path) for path in files}
    return opened


def _in_order(name: str) -> list[tuple[int, str]]:
    """Return a key by which run 2 stands before run 10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]


INSTALL_TABLES = 'install it with pip install ".[tables]" in the checkout'

# Advice on files that are not read.
SAVE_AS = {
    **dict.fromkeys((".xls", ".xlsb", ".ods"), "save it as .xlsx"),
    ".tdms": "export it as text (.lvm or .csv)",
    **dict.fromkeys((".mdf", ".mf4"), "export it as .csv or .parquet"),
    **dict.fromkeys((".h5", ".hdf5"), "read it with pandas.read_hdf or h5py and pass the DataFrame"),
    **dict.fromkeys((".npy", ".npz"), "load it with numpy.load and pass bg.read({name: column, ...})"),
    ".json": "read it with pandas.read_json and pass the DataFrame",
}


def read_source(source: Any, layout: Layout) -> Table:
    """Read one source, a path or a table in memory, and tidy it."""
    if isinstance(source, str | Path):
        require_path(source)
        return tidy(_file(Path(source), layout), layout)
    if hasattr(source, "data_vars"):
        return tidy(dataset_table(source, "the data set"), layout)
    if hasattr(source, "to_dataset") and hasattr(source, "dims"):
        return tidy(dataset_table(source.to_dataset(name=source.name or "value"), "the data array"), layout)
    if isinstance(source, pd.Series):
        source = source.to_frame(source.name or "value")
    if hasattr(source, "to_pandas"):
        source = source.to_pandas()
    if isinstance(source, Mapping):
        try:
            source = pd.DataFrame(dict(source))
        except ValueError as error:
            raise InputError(f"The columns do not make a table: {error}; give columns of one length.") from None
    if not isinstance(source, pd.DataFrame):
        raise InputError(
            f"bg.read cannot read a {type(source).__name__}; give the path of a file, a pandas DataFrame, an xarray "
            "Dataset, or a mapping of name to column (arrays: bg.Trajectories.from_arrays)."
        )
    return tidy(_frame_table(source, "the table"), layout)


def require_path(source: str | Path) -> None:
    """Refuse text that cannot be the path of a file: several lines, or a name that is too long."""
    text = str(source)
    try:
        Path(source).exists()
        lines = text.splitlines()
    except (OSError, ValueError):
        lines = []
    if len(lines) != 1:
        raise InputError(
            f"{text[:40]!r}... cannot be the path of a file; if it is the text of a table, pass "
            "pandas.read_csv(io.StringIO(text))."
        )


def _frame_table(frame: pd.DataFrame, where: str) -> Table:
    """Return a DataFrame as a table; an index that is more than a count is a column, under its name or "index"."""
    if isinstance(frame.columns, pd.MultiIndex):
        raise InputError(
            f"{capital(where)} has columns with several names each, such as {frame.columns[0]}; give each "
            'one name: frame.columns = ["_".join(map(str, names)) for names in frame.columns].'
        )
    for name in {name for name in frame.index.names if name is not None and name in frame.columns}:
        # set_index(name, drop=False) leaves the column beside the index.
        if not np.array_equal(frame.index.get_level_values(name), frame[name].to_numpy()):
            raise InputError(f'{capital(where)} has both an index and a column "{name}", which differ; rename one.')
        # A single index with a whole number for its name is no level to pandas.
        frame = frame.reset_index(level=name if frame.index.nlevels > 1 else None, drop=True)
    counts = isinstance(frame.index, pd.RangeIndex) or (frame.index.nlevels == 1 and frame.index.name is None)
    # Decimal numbers are no count: they are times.
    if not counts or frame.index.dtype.kind in "mMf":
        frame = frame.reset_index()
    return Table(frame.reset_index(drop=True), where)


def _file(path: Path, layout: Layout) -> Table:
    suffix = path.suffix.lower()
    if path.is_dir():
        raise InputError(f'"{path}" is a folder; name a file in it, or several by a pattern such as "{path}/*.csv".')
    if suffix not in TABLE_READERS:
        remedy = f"; {SAVE_AS[suffix]}" if suffix in SAVE_AS else ""
        raise InputError(f'"{path}" has an unknown extension; readable are {", ".join(TABLE_READERS)}{remedy}.')
    if not path.is_file():
        raise InputError(f'There is no file "{path}".')
    if path.stat().st_size == 0:
        raise InputError(f'"{path}" is empty.')
    try:
        return TABLE_READERS[suffix](path, layout)
    except InputError:
        raise
    except Exception as error:
        # Each library has exceptions of its own for a damaged file.
        kind = suffix.removeprefix(".")
        raise InputError(f'"{path}" cannot be read as {kind} ({first_line(error)}); check the file.') from error


def _read_parquet(path: Path, layout: Layout) -> Table:
    try:
        import pyarrow.parquet
    except ImportError as error:
        raise InputError(f'Reading "{path}" needs pyarrow; {INSTALL_TABLES}.') from error
    return _frame_table(pyarrow.parquet.read_table(path).to_pandas(), f'"{path}"')


def _read_excel(path: Path, layout: Layout) -> Table:
    """Read one sheet; rows and columns that are empty throughout are no part of the table."""
    try:
        import openpyxl  # noqa: F401 - pandas would name it in words of its own
    except ImportError as error:
        raise InputError(f'Reading "{path}" needs openpyxl; {INSTALL_TABLES}.') from error
    skipped = layout.skiprows if isinstance(layout.skiprows, int) else list(layout.skiprows)
    with pd.ExcelFile(path, engine="openpyxl") as book:
        sheets = book.sheet_names
        sheet = sheets[0] if layout.sheet is None else layout.sheet
        exists = 0 <= sheet < len(sheets) if isinstance(sheet, int) else sheet in sheets
        if not exists:
            raise InputError(f'"{path}" has no sheet {sheet!r}; its sheets are {", ".join(map(str, sheets))}.')
        # pandas numbers the second of two names.
        first = pd.read_excel(book, sheet_name=sheet, skiprows=skipped, header=None, nrows=1)
        names = ["" if pd.isna(cell) else str(cell).strip() for cell in first.to_numpy(dtype=object).ravel()]
        measured = layout.columns is not None and any(is_measured(name, layout) for name in names)
        if layout.columns is None:
            require_distinct(names, f'"{path}"')
        frame = pd.read_excel(book, sheet_name=sheet, skiprows=skipped, header=None if measured else 0)
        if len(frame.columns) == 1:
            # pandas leaves out the empty cells of a column that is alone.
            frame = _only_column(book, sheet, frame, () if isinstance(skipped, int) else skipped)
    if measured and len(frame.columns) != len(layout.columns or ()):
        frame = frame.dropna(axis=1, how="all")
    unnamed = [name for name in frame.columns if str(name).startswith("Unnamed:") and np.all(frame[name].isna())]
    frame = frame.drop(columns=unnamed)
    several = layout.sheet is None and len(sheets) > 1
    remarks = (f'read from the sheet "{sheet}" of "{path}", which has {len(sheets)}',) if several else ()
    remarks += (first_row_measured(f'"{path}"'),) if measured else ()
    hint = "" if layout.skiprows else " If the names stand further down the sheet, pass skiprows= the rows above them."
    return Table(frame, f'"{path}"', remarks=remarks, hint=hint, spaced=True)


def _only_column(book: pd.ExcelFile, sheet: Any, frame: pd.DataFrame, skipped: Sequence[int]) -> pd.DataFrame:
    """Restore the empty cells of a sheet's only column, which pandas read from some row on."""
    rows = (book.book.worksheets[sheet] if isinstance(sheet, int) else book.book[sheet]).iter_rows(values_only=True)
    kept = (row for i, row in enumerate(rows) if i not in skipped)
    filled = [next((cell for cell in row if cell is not None), None) for row in kept]
    places = [i for i, cell in enumerate(filled) if cell is not None and str(cell).strip()]
    # pandas keeps empty cells below skipped rows.
    if len(frame) == 0 or frame.iloc[:, 0].isna().any() or len(places) < len(frame):
        return frame
    places = places[len(places) - len(frame) :]
    inside = np.array(places) - places[0]
    return frame.set_axis(inside, axis=0).reindex(range(inside[-1] + 1))


def read_netcdf(path: Path, layout: Layout) -> Table:
    """Read a netCDF file, but for a saved fit; its stamps stay numbers."""
    import h5py
    import xarray as xr

    if h5py.is_hdf5(path):
        with h5py.File(path, "r") as file:
            if "posterior" in file:
                raise InputError(f'"{path}" is a saved fit, not a table; open it with bg.load.')
    with xr.open_dataset(path, engine="h5netcdf", decode_times=False) as dataset:
        return dataset_table(dataset, f'"{path}"')


def dataset_table(dataset: Any, where: str) -> Table:
    """Return the variables of an xarray Dataset that share most of its values.

    Variables over one dimension are columns. Where the longest have two, such as run and time, the dimensions are
    columns too, one row for each pair, so that one of them can tell the runs apart.
    """
    variables = {**dict(dataset.coords), **dict(dataset.data_vars)}
    usable = {name: array for name, array in variables.items() if 1 <= array.ndim <= 2}
    if not usable:
        raise InputError(f"{where} has no variable over one or two dimensions; select such with Dataset.sel.")
    data = {name: array for name, array in dataset.data_vars.items() if name in usable} or usable
    lengths = {frozenset(array.dims): array.size for array in data.values()}
    counts = {dims: sum(dims == frozenset(array.dims) for array in data.values()) for dims in lengths}
    shared = max(counts, key=lambda dims: (counts[dims], lengths[dims]))
    names = [name for name, array in usable.items() if set(array.dims) <= shared]
    # Rows of one run together, whatever the order in which a variable has its dimensions.
    order = sorted(shared, key=lambda dim: dataset.sizes[dim])
    frame = dataset[names].reset_coords().to_dataframe(dim_order=order).reset_index()
    dimensions = tuple(str(dim) for dim in order if dataset.sizes[dim] > 1) if len(shared) > 1 else ()
    # A single dimension without stamps is only a count.
    kept = [name for name in frame.columns if name in variables or (name in shared and len(shared) > 1)]
    units = {str(name): str(array.attrs["units"]) for name, array in variables.items() if "units" in array.attrs}
    others = [str(name) for name in dataset.data_vars if name not in names]
    remarks = (f"left out of {where}, being over other dimensions: {', '.join(others)}",) if others else ()
    return Table(frame[kept].rename(columns=str), where, units, remarks=remarks, dimensions=dimensions)


# Readers of files by extension.
TABLE_READERS: dict[str, Callable[[Path, Layout], Table]] = {
    **dict.fromkeys((".csv", ".tsv", ".txt", ".dat"), read_text),
    ".xlsx": _read_excel,
    ".xlsm": _read_excel,
    ".parquet": _read_parquet,
    ".mat": read_mat,
    ".nc": read_netcdf,
    ".lvm": read_lvm,
}
