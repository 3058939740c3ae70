"""Whole runs, however their rows lie in pieces of files: a path depends on all rows of its run."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Int

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.running.errors import InputError

from .asked import Asked

ROWS_HELD_TOGETHER = 2048  # rows of short runs that are read together; a longer run is read alone
REMEMBERED_RUNS = 100_000  # latest runs of a file whose names are remembered, to refuse rows of the same run elsewhere


class Piece(NamedTuple):
    """Rows of a file: number of the first one, rows as they lie there, and attributes of columns, if it states any."""

    first: int
    frame: pd.DataFrame
    attributes: Mapping[str, Mapping[str, Any]]

    @property
    def table(self) -> Any:
        """Table that `read` takes."""
        if not self.attributes:
            return self.frame
        import xarray as xr

        columns = {str(name): self.frame[name].to_numpy() for name in self.frame}
        return xr.Dataset({name: ("row", values, self.attributes.get(name, {})) for name, values in columns.items()})


@dataclass(frozen=True)
class FileRows(ABC):
    """Rows of files that are read in pieces; a part lies in one file, whose name comes first in its piece."""

    pieces: tuple[tuple[Any, ...], ...]
    asked: Asked

    @property
    def where(self) -> str:
        """Description of the files, within a sentence."""
        files = list(dict.fromkeys(self.paths))
        return f'"{files[0]}"' + (f" and {len(files) - 1} more" if len(files) > 1 else "")

    @property
    def n_part(self) -> int:
        """Number of parts."""
        return len(self.pieces)

    @property
    def paths(self) -> list[str]:
        """File of each part."""
        return [piece[0] for piece in self.pieces]

    def whole_runs(self) -> "WholeRuns":
        """Return the files with whole runs in each chunk."""
        return WholeRuns(self)

    def chunks(self, part: int) -> Iterator[Trajectories]:
        """Yield the rows of a part, some at a time."""
        for piece in self.tables(part):
            kept = self.asked.usable(piece.frame)
            if kept.any():
                table, dropped = piece._replace(frame=piece.frame[kept]).table, int((~kept).sum())
                yield self.asked.formed(table, f'"{self.paths[part]}"', piece.first, dropped)

    @abstractmethod
    def tables(self, part: int) -> Iterator[Piece]:
        """Yield rows of a part as they lie in the file, some at a time."""


@dataclass(frozen=True)
class WholeRuns:
    """Files whose chunks hold whole runs; a part is a file. Memory is that of the longest run, and of a few chunks.

    A run begins where the column that tells runs apart changes or, without one, where the time goes back if that begins
    another run; else a file is one run.
    """

    rows: FileRows

    def __post_init__(self) -> None:
        if self.rows.asked.time is None:
            raise InputError(
                f"Rows of paths are samples in time, and those of {self.where} have no stamps: name their column, "
                "time=..., or give measured rates, derivatives={...}."
            )

    @property
    def where(self) -> str:
        """Description of the files, within a sentence."""
        return self.rows.where

    @property
    def n_part(self) -> int:
        """Number of files."""
        return len(self._files)

    def whole_runs(self) -> "WholeRuns":
        """Return itself."""
        return self

    def chunks(self, part: int) -> Iterator[Trajectories]:
        """Yield whole runs of a file in order, one or more at a time."""
        path, label = self._files[part]
        n_run = 0
        for piece, dropped in self._runs(path):
            data = self.rows.asked.formed(piece.table, f'"{path}"', piece.first, dropped, whole=True)
            yield replace(data, run_names=tuple(self._named(name, label, n_run) for name in data.run_names))
            n_run += len({name.partition(",")[0] for name in data.run_names})

    @cached_property
    def _files(self) -> list[tuple[str, str]]:
        """Each file, with the name that its runs take from it; empty if it is the only one."""
        paths = list(dict.fromkeys(self.rows.paths))
        stems = [Path(path).stem for path in paths]
        labels = [""] if len(paths) == 1 else stems if len(set(stems)) == len(stems) else paths
        return list(zip(paths, labels, strict=True))

    def _runs(self, path: str) -> Iterator[tuple[Piece, int]]:
        """Yield rows of whole runs of a file, and the number of rows before them in runs without a usable row.

        Rows with missing values are among them: `read` cuts runs before it leaves out any, and their stamps may show
        where a run ends.
        """
        asked, dropped = self.rows.asked, 0
        for piece, number in self._whole(path):
            stays = np.isin(number, number[asked.usable(piece.frame)])
            # On either side of a run that is left out rows are read by themselves, as nothing else may part them.
            for rows in np.split(np.arange(len(stays)), np.flatnonzero(np.diff(stays)) + 1):
                if stays[rows[0]]:
                    frame = piece.frame.iloc[rows].reset_index(drop=True)
                    yield Piece(piece.first + int(rows[0]), frame, piece.attributes), dropped
                    dropped = 0
                else:
                    dropped += len(rows)

    def _whole(self, path: str) -> Iterator[tuple[Piece, Int[np.ndarray, " n_row"]]]:
        """Yield all rows of whole runs of a file, and the number of each row's run."""
        asked, held = self.rows.asked, list[tuple[pd.DataFrame, np.ndarray]]()
        first = n_held = n_run = 0
        before: pd.DataFrame | None = None
        attributes: Mapping[str, Mapping[str, Any]] = {}
        seen: dict[Any, None] = {}

        def together() -> tuple[Piece, np.ndarray]:
            frames, numbers = zip(*held, strict=True)
            return Piece(first, pd.concat(frames, ignore_index=True), attributes), np.concatenate(numbers)

        parts = [part for part, its in enumerate(self.rows.paths) if its == path]
        for piece in chain.from_iterable(map(self.rows.tables, parts)):
            frame, start = piece.frame, 0
            if not len(frame):
                continue
            attributes, first = piece.attributes, first if held else piece.first
            begins = asked.begins(frame, before)
            self._require_together(piece, begins, path, seen)
            begun, number = np.flatnonzero(begins), n_run + np.cumsum(begins)
            before, n_run = asked.latest(frame, before), int(number[-1])
            # Short runs stay together: the cut is at the first begin of a run behind enough rows.
            while len(enough := begun[begun - start + n_held >= ROWS_HELD_TOGETHER]):
                stop = int(enough[0])
                held += [(frame.iloc[start:stop], number[start:stop])] if stop > start else []
                yield together()
                held, n_held = [], 0
                first, start, begun = piece.first + stop, stop, begun[begun > stop]
            held.append((frame.iloc[start:], number[start:]))
            n_held += len(frame) - start
        if held:
            yield together()

    def _require_together(self, piece: Piece, begins: np.ndarray, path: str, seen: dict[Any, None]) -> None:
        """Refuse rows that name no run, as `read` does, and a run whose rows lie apart."""
        column = self.rows.asked.labels
        if column is None:
            return
        # A missing label differs from its neighbours, so that it seems to begin a run.
        for row, label in zip(np.flatnonzero(begins), piece.frame[column][begins], strict=True):
            if pd.isna(label):
                raise InputError(
                    f'Column "{column}" of "{path}" names no run in row {piece.first + row}; fill it in, or leave out '
                    "that row."
                )
            if label in seen:
                raise InputError(
                    f'Rows of run {label!r} of "{path}" lie apart, and a stream holds one run at a time: sort the rows '
                    f'of the file by "{column}".'
                )
            seen[label] = None
            if len(seen) > REMEMBERED_RUNS:
                del seen[next(iter(seen))]

    def _named(self, name: str, label: str, n_run: int) -> str:
        """Return a run's name as `read` would form it from all files at once."""
        if self.rows.asked.labels is not None:
            return f"{label}/{name}" if label else name
        number, comma, part = name.partition(",")
        if self.rows.asked.restarts:
            number = str(int(number) + n_run)
            return (f"{label}/{number}" if label else number) + comma + part
        return (label or number) + comma + part


def some_runs(source: Any, size: int, places: int) -> list[tuple[int, Trajectories]]:
    """Return whole runs of about `size` rows with their part, at places spread over the parts; all if they are few."""
    n_part, chosen, more = source.n_part, dict[int, list[Trajectories]](), list[tuple[int, int]]()
    rows = 0
    # Places in the middle of equal shares of the parts, then all other parts.
    first = ((np.arange(places) + 0.5) / places * n_part).astype(int)
    for part in dict.fromkeys([*first[_evenly(places)].tolist(), *_evenly(n_part).tolist()]):
        if rows >= size:
            break
        n_place = int(np.sum(first == part))
        wanted = size * n_place // places if n_place else size - rows
        chosen[part], total = _runs_of_part(source, part, max(wanted, 1), max(n_place, 1))
        taken = sum(each.n_obs for each in chosen[part])
        rows += taken
        more += [(part, taken)] if taken < total else []
    # Parts that have more rows make up for those that have too few.
    for part, taken in more:
        if rows >= size:
            break
        chosen[part], _ = _runs_of_part(source, part, taken + size - rows, max(int(np.sum(first == part)), 1))
        rows += sum(each.n_obs for each in chosen[part]) - taken
    return [(part, runs) for part in sorted(chosen) for runs in chosen[part]]


def stacked_runs(pieces: list[tuple[int, Trajectories]]) -> Trajectories:
    """Join pieces, with the number of their part and alike in columns and units, to one set of data."""
    _, first = pieces[0]
    names = [(part, name) for part, piece in pieces for name in piece.run_names]
    alone = len({name for _, name in names}) == len(names)
    starts = np.cumsum([0, *(piece.n_run for _, piece in pieces)])

    each = [piece for _, piece in pieces]
    columns = {
        kind: {name: np.concatenate([getattr(piece, kind)[name] for piece in each]) for name in getattr(first, kind)}
        for kind in ("states", "inputs", "derivatives")
    }
    unseen = [np.zeros(piece.n_obs, bool) if piece.unseen is None else piece.unseen for piece in each]
    return replace(
        first,
        time=np.concatenate([piece.time for piece in each]),
        run=np.concatenate([piece.run + start for piece, start in zip(each, starts[:-1], strict=True)]),
        **columns,
        run_names=tuple(name if alone else f"{name} of part {part}" for part, name in names),
        dropped=0,
        remarks=(),
        unseen=np.concatenate(unseen) if any(piece.unseen is not None for piece in each) else None,
    )


def _runs_of_part(source: Any, part: int, wanted: int, places: int) -> tuple[list[Trajectories], int]:
    """Return whole runs of one part, at places evenly spaced over its rows, and the number of its rows."""
    lengths = [n for chunk in source.chunks(part) for n in chunk.run_lengths]
    ends, chosen, each = np.cumsum(lengths), set[int](), max(wanted // places, 1)
    if not len(ends):
        return [], 0
    for place in (_evenly(places) + 0.5) / places:
        run, stop = int(np.searchsorted(ends, place * max(ends[-1] - each, 0), side="right")), 0
        while run < len(lengths) and stop < each and sum(lengths[i] for i in chosen) < wanted:
            stop += 0 if run in chosen else lengths[run]
            chosen.add(run)
            run += 1
    if ends[-1] <= wanted:
        chosen = set(range(len(lengths)))
    pieces, start = [], 0
    for chunk in source.chunks(part):
        runs = [run - start for run in sorted(chosen) if start <= run < start + chunk.n_run]
        start += chunk.n_run
        if runs:
            pieces.append(chunk if len(runs) == chunk.n_run else chunk.keep(np.isin(chunk.run, runs)))
    return pieces, int(ends[-1])


def _evenly(n: int) -> np.ndarray:
    """Return 0 … n − 1 in an order whose beginnings are spread evenly."""
    return np.argsort(np.arange(n) * 0.6180339887498949 % 1.0)
