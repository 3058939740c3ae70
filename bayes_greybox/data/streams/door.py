"""Reader of more rows than memory holds."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from bayes_greybox.data.reading.door import Columns, named
from bayes_greybox.data.reading.listed import listed
from bayes_greybox.running.errors import InputError

from .asked import Asked
from .labelled import labelled_rows
from .parquet import parquet_rows
from .row_stream import SAMPLE_ROWS, RowStream

STREAM_READERS = {".parquet": parquet_rows, ".nc": labelled_rows, ".zarr": labelled_rows}
"""Readers in pieces by extension."""


def stream(
    source: Any,
    *,
    states: Columns = (),
    inputs: Columns = (),
    derivatives: Mapping[str, str] | None = None,
    outputs: Columns = (),
    time: str | None = None,
    run: str | None = None,
    restart: Literal["error", "run"] = "error",
    units: Mapping[str, str] | None = None,
    missing: Literal["error", "drop"] = "error",
    sample: int = SAMPLE_ROWS,
    workers: int | None = None,
    scheduler: str | None = None,
) -> RowStream:
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
    asked = Asked(
        columns=(*wanted, *(name for name in (time, run) if name is not None)),
        time=time,
        missing=missing,
        settings={**chosen, "run": run, "restart": restart, "units": dict(units or {})},
    )
    files = _paths(source)
    rows = STREAM_READERS[files[0].suffix.lower()](files, asked)
    return RowStream(rows, sample, workers, scheduler)


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
