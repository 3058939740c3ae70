"""Parquet files a few row groups at a time."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayes_greybox.data.reading.sources import INSTALL_TABLES
from bayes_greybox.running.errors import InputError

from .asked import CHUNK_ROWS, PART_ROWS, Asked
from .whole_runs import FileRows, Piece


@dataclass(frozen=True)
class ParquetRows(FileRows):
    """Rows of one or several Parquet files; a part is a file, the number of its first row, and some row groups."""

    pieces: tuple[tuple[str, int, tuple[int, ...]], ...]
    asked: Asked

    def tables(self, part: int) -> Iterator[Piece]:
        """Yield the rows of a part as they lie in the file, some at a time."""
        import pyarrow as pa

        path, first, groups = self.pieces[part]
        with _opened(path) as file:
            columns = list(self.asked.columns)
            for batch in file.iter_batches(batch_size=CHUNK_ROWS, row_groups=list(groups), columns=columns):
                frame = pa.Table.from_batches([batch]).to_pandas(ignore_metadata=True)
                yield Piece(first, frame, {})
                first += len(frame)


def parquet_rows(files: Sequence[Path], asked: Asked) -> ParquetRows:
    """Divide files into parts; `asked` still has the names that the user gave.

    Raises:
        InputError: pyarrow is not there; a file that cannot be read or has no such column.
    """
    pieces: list[tuple[str, int, tuple[int, ...]]] = []
    common: Asked | None = None
    for path in files:
        with _opened(path) as file:
            if file.metadata.num_rows:
                here = asked.among(_kinds(file), f'"{path}"')
                common = here if common is None else common
                _require_same(common, here, pieces[0][0] if pieces else "", str(path))
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


def _require_same(first: Asked, other: Asked, one: str, another: str) -> None:
    """Refuse a file whose headers differ, such as in a unit."""
    for column, its in zip(first.columns, other.columns, strict=True):
        if column != its:
            raise InputError(
                f'The column "{column}" of "{one}" is "{its}" in "{another}": write one of them anew, with the same '
                "header and in the same unit."
            )


def _opened(path: str | Path) -> Any:
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


def _kinds(file: Any) -> dict[str, str]:
    """Return the kind of NumPy's data type of each column."""
    empty = file.schema_arrow.empty_table().to_pandas(ignore_metadata=True)
    return {str(name): empty[name].dtype.kind for name in empty.columns}
