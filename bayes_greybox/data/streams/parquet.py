"""Parquet files a few row groups at a time."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayes_greybox.data.reading.sources import INSTALL_TABLES
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.running.errors import InputError

from .asked import CHUNK_ROWS, PART_ROWS, Asked
from .whole_runs import Piece, WholeRuns


@dataclass(frozen=True)
class ParquetRows:
    """Rows of one or several Parquet files; a part is some row groups of one file.

    Attributes:
        pieces: File, number of its first row, and row groups of each part.
        asked: What is read of them.
    """

    pieces: tuple[tuple[str, int, tuple[int, ...]], ...]
    asked: Asked

    @property
    def where(self) -> str:
        """The files."""
        files = list(dict.fromkeys(file for file, _, _ in self.pieces))
        return f'"{files[0]}"' + (f" and {len(files) - 1} more" if len(files) > 1 else "")

    @property
    def n_part(self) -> int:
        """Parts."""
        return len(self.pieces)

    @property
    def paths(self) -> list[str]:
        """The file of each part."""
        return [path for path, _, _ in self.pieces]

    def whole_runs(self) -> WholeRuns:
        """The files with whole runs in each chunk."""
        return WholeRuns(self)

    def chunks(self, part: int) -> Iterator[Trajectories]:
        """The rows of a part, some at a time."""
        for first, frame, _ in self.tables(part):
            kept = self.asked.usable(frame)
            if kept.any():
                yield from self.asked.formed(frame[kept], f'"{self.paths[part]}"', first, int(np.sum(~kept)))

    def tables(self, part: int) -> Iterator[Piece]:
        """The rows of a part as they lie in the file, some at a time."""
        import pyarrow as pa

        path, first, groups = self.pieces[part]
        with _opened(path) as file:
            batches = file.iter_batches(
                batch_size=CHUNK_ROWS, row_groups=list(groups), columns=list(self.asked.columns)
            )
            for batch in batches:
                frame = pa.Table.from_batches([batch]).to_pandas(ignore_metadata=True)
                yield Piece(first, frame, {})
                first += len(frame)


def parquet_rows(files: Sequence[Path], asked: Asked) -> ParquetRows:
    """The parts of some files.

    Args:
        files: Their paths.
        asked: What is to be read, still by the names that were given.

    Raises:
        InputError: pyarrow is not there; a file that cannot be read or has no such column.
    """
    pieces: list[tuple[str, int, tuple[int, ...]]] = []
    own: Asked | None = None
    for path in files:
        with _opened(path) as file:
            if file.metadata.num_rows:
                here = asked.among(_kinds(file), f'"{path}"')
                own = here if own is None else own
                _require_same(own, here, pieces[0][0] if pieces else "", str(path))
            sizes = [file.metadata.row_group(i).num_rows for i in range(file.metadata.num_row_groups)]
        row = start = 0
        groups: list[int] = []
        for i, size in enumerate(sizes):
            groups.append(i)
            row += size
            if row - start >= PART_ROWS or (i == len(sizes) - 1 and row > start):
                pieces.append((str(path), start, tuple(groups)))
                groups, start = [], row
    if own is None:
        raise InputError(f'"{files[0]}" has no rows.')
    return ParquetRows(tuple(pieces), own)


def _require_same(first: Asked, other: Asked, one: str, another: str) -> None:
    """Refuse a file whose headers differ, such as in a unit."""
    for own, theirs in zip(first.columns, other.columns, strict=True):
        if own != theirs:
            raise InputError(
                f'The column "{own}" of "{one}" is "{theirs}" in "{another}": write one of them anew, with the same '
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
    """Kind of NumPy's data type by column."""
    empty = file.schema_arrow.empty_table().to_pandas(ignore_metadata=True)
    return {str(name): empty[name].dtype.kind for name in empty.columns}
