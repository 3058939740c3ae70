"""Reader of more rows than memory holds: Parquet, netCDF and Zarr a piece at a time."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from bayes_greybox.data.reading.door import Columns, named
from bayes_greybox.data.reading.sources import INSTALL_TABLES, listed
from bayes_greybox.data.reading.table import first_line
from bayes_greybox.running.errors import InputError

from .asked import CHUNK_ROWS, PART_ROWS, Asked
from .row_stream import SAMPLE_ROWS, RowStream
from .whole_runs import FileRows, Piece

INSTALL_DISTRIBUTED = 'install it with pip install ".[distributed]" in the checkout'


@dataclass(frozen=True)
class LabelledRows(FileRows):
    """Variables over one dimension; a part is a store, the dimension, its first row and the row behind its last."""

    pieces: tuple[tuple[str, str, int, int], ...]

    def tables(self, part: int) -> Iterator[Piece]:
        """Yield the rows of a part as they lie in the store, some at a time."""
        path, dimension, start, stop = self.pieces[part]
        columns = list(self.asked.columns)
        with _open_labelled(Path(path)) as dataset:
            lacking = [name for name in columns if name not in dataset.variables]
            if lacking:
                raise InputError(f'"{path}" has no variable "{lacking[0]}", which other files of the stream have.')
            for first in range(start, stop, CHUNK_ROWS):
                some = dataset[columns].isel({dimension: slice(first, min(first + CHUNK_ROWS, stop))}).load()
                # Stamps may be the dimension's own coordinate.
                frame = some.reset_coords().to_dataframe().reset_index()[columns]
                yield Piece(first, frame, {str(name): dict(some[name].attrs) for name in frame})


def labelled_rows(stores: Sequence[Path], asked: Asked) -> LabelledRows:
    """Divide stores into parts; `asked` still has the names that the user gave."""
    pieces: list[tuple[str, str, int, int]] = []
    for path in stores:
        with _open_labelled(path) as dataset:
            variables = {str(name): array for name, array in dataset.variables.items() if array.ndim == 1}
            here = asked.among({name: array.dtype.kind for name, array in variables.items()}, f'"{path}"')
            dimensions = {str(variables[name].dims[0]) for name in here.columns}
            if len(dimensions) != 1:
                raise InputError(
                    f'The columns that are asked for lie along different dimensions of "{path}" '
                    f"({', '.join(sorted(dimensions))}): a stream has one row for each step of one dimension."
                )
            (dimension,) = dimensions
            n = int(dataset.sizes[dimension])
        asked = asked if pieces else here
        pieces += [(str(path), dimension, start, min(start + PART_ROWS, n)) for start in range(0, n, PART_ROWS)]
    if not pieces:
        raise InputError(f'"{stores[0]}" has no rows.')
    return LabelledRows(tuple(pieces), asked)


def _open_labelled(path: Path) -> Any:
    import xarray as xr

    if not path.exists():
        raise InputError(f'There is no file "{path}".')
    zarr = path.suffix.lower() == ".zarr"
    try:
        if zarr:
            # Without Dask, which would make a task of each of its chunks.
            return xr.open_zarr(path, chunks=None, consolidated=False, decode_times=False)
        return xr.open_dataset(path, engine="h5netcdf", decode_times=False, cache=False)
    except ImportError as error:
        raise InputError(f'Reading "{path}" needs zarr; {INSTALL_DISTRIBUTED}.') from error
    except Exception as error:
        kind = "zarr" if zarr else "nc"
        raise InputError(f'"{path}" cannot be read as {kind} ({first_line(error)}); check the file.') from error


@dataclass(frozen=True)
class ParquetRows(FileRows):
    """Rows of one or several Parquet files; a part is a file, the number of its first row, and some row groups."""

    pieces: tuple[tuple[str, int, tuple[int, ...]], ...]

    def tables(self, part: int) -> Iterator[Piece]:
        """Yield the rows of a part as they lie in the file, some at a time."""
        import pyarrow as pa

        path, first, groups = self.pieces[part]
        with _open_parquet(path) as file:
            columns = list(self.asked.columns)
            for batch in file.iter_batches(batch_size=CHUNK_ROWS, row_groups=list(groups), columns=columns):
                frame = pa.Table.from_batches([batch]).to_pandas(ignore_metadata=True)
                yield Piece(first, frame, {})
                first += len(frame)


def parquet_rows(files: Sequence[Path], asked: Asked) -> ParquetRows:
    """Divide files into parts; `asked` still has the names that the user gave."""
    pieces: list[tuple[str, int, tuple[int, ...]]] = []
    common: Asked | None = None
    for path in files:
        with _open_parquet(path) as file:
            if file.metadata.num_rows:
                empty = file.schema_arrow.empty_table().to_pandas(ignore_metadata=True)
                here = asked.among({str(name): empty[name].dtype.kind for name in empty.columns}, f'"{path}"')
                common = here if common is None else common
                for column, its in zip(common.columns, here.columns, strict=True):
                    if column != its:
                        raise InputError(
                            f'The column "{column}" of "{pieces[0][0]}" is "{its}" in "{path}": write one of them '
                            "anew, with the same header and in the same unit."
                        )
            sizes = [file.metadata.row_group(i).num_rows for i in range(file.metadata.num_row_groups)]
        row = start = 0
        groups: list[int] = []
        for i, size in enumerate(sizes):
            groups.append(i)
            row += size
            if row - start >= PART_ROWS or (i == len(sizes) - 1 and row > start):
                pieces.append((str(path), start, tuple(groups)))
                groups, start = [], row
    if common is None:
        raise InputError(f'"{files[0]}" has no rows.')
    return ParquetRows(tuple(pieces), common)


def _open_parquet(path: str | Path) -> Any:
    try:
        import pyarrow.parquet
    except ImportError as error:
        raise InputError(f'Reading "{path}" needs pyarrow; {INSTALL_TABLES}.') from error
    if not Path(path).is_file():
        raise InputError(f'There is no file "{path}".')
    try:
        # Read as it is decoded: a row group may be as large as the file.
        return pyarrow.parquet.ParquetFile(path, buffer_size=1 << 20, pre_buffer=False)
    except Exception as error:
        raise InputError(f'"{path}" cannot be read as parquet ({error}); check the file.') from error


STREAM_READERS = {".parquet": parquet_rows, ".nc": labelled_rows, ".zarr": labelled_rows}


def stream(
    source: Any, *, states: Columns = (), inputs: Columns = (), derivatives: Mapping[str, str] | None = None,
    outputs: Columns = (), time: str | None = None, run: str | None = None,
    restart: Literal["error", "run"] = "error", units: Mapping[str, str] | None = None,
    missing: Literal["error", "drop"] = "error", sample: int = SAMPLE_ROWS, workers: int | None = None,
    scheduler: str | None = None,
) -> RowStream:  # fmt: skip
    """Open measured rates or outputs, or samples of paths, that stay in their file: `GreyBox.fit` reads them in chunks.

    Memory is that of a few chunks, whatever the number of rows, and of the longest run where rows are of paths.
    The order of rows that are measured one by one matters only to the sample; those of a run of a path lie
    together in one file, in order of time.

    Args:
        source: Path of a Parquet or netCDF file or a Zarr store (.zarr), a list of such of one kind, or a path with *
            or ?. Of netCDF and Zarr the variables along one dimension are read.
        states: as in `read`.
        inputs: as in `read`.
        derivatives: as in `read`.
        outputs: as in `read`.
        time: column of time stamps, numbers; without it rows are numbered and cannot be samples of paths.
        run: as in `read`.
        restart: as in `read`.
        units: as in `read`.
        missing: "error" refuses missing values, "drop" leaves out their rows and counts them.
        sample: rows that stay in memory, about, for all that looks at single rows: ten stretches, evenly spaced, or
            whole runs, which also determine the properties that the paths of all runs share.
        workers: processes of this machine that read (extra "distributed"), files of runs each by one; one if left out.
        scheduler: address of a Dask scheduler, such as `tcp://host:8786`, whose workers read and see the same files.

    Returns:
        The stream; nothing but the names of its columns was read yet.

    Raises:
        InputError: A source that cannot be read in pieces, or lacks a column; the message says what to do.
    """
    kinds = {"states": states, "inputs": inputs, "outputs": outputs}
    chosen = {kind: named(columns, kind) for kind, columns in kinds.items()}
    chosen["derivatives"] = dict(derivatives or {})
    wanted = [column for columns in chosen.values() for column in columns.values()]
    settings = {**chosen, "run": run, "restart": restart, "units": dict(units or {})}
    asked = Asked((*wanted, *(name for name in (time, run) if name is not None)), time, missing, settings)
    files = _paths(source)
    return RowStream(STREAM_READERS[files[0].suffix.lower()](files, asked), sample, workers, scheduler)


def _paths(source: Any) -> Sequence[Path]:
    """Return the files, which must be of one kind that can be read in pieces."""
    sources = [each for _, each in listed(source)]
    for each in sources:
        if not isinstance(each, str | Path):
            raise InputError(
                f"bg.stream reads files and not a {type(each).__name__}: what is in memory is read by bg.read, and "
                "what a function makes is streamed by bg.RowStream.from_chunks."
            )
    paths = [Path(each) for each in sources]
    kinds = list(dict.fromkeys(path.suffix.lower() for path in paths))
    if len(kinds) > 1 or kinds[0] not in STREAM_READERS:
        raise InputError(
            f"A stream is of {', '.join(STREAM_READERS)} files, all of one kind, and not of "
            f"{', '.join(map(repr, kinds))}: read smaller ones by bg.read, and write large ones anew, such as with "
            "pandas.DataFrame.to_parquet."
        )
    return paths
