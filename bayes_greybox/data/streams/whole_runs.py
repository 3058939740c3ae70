"""Whole runs, however their rows lie in pieces of files: a path is that of a run, and knows of all its rows."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
import pandas as pd
from jaxtyping import Int

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.running.errors import InputError

from .asked import Asked

ROWS_HELD_TOGETHER = 2048
"""Rows of short runs that are held together; a longer run is held alone."""

REMEMBERED_RUNS = 100_000
"""Runs of a file, the latest, whose names are known when another one comes that may be one of them."""


class Piece(NamedTuple):
    """Rows of a file.

    Attributes:
        first: Number of the first one in it.
        frame: The rows, by columns as the file has them.
        attributes: Of each column, where the file states any.
    """

    first: int
    frame: pd.DataFrame
    attributes: Mapping[str, Mapping[str, Any]]

    @property
    def table(self) -> Any:
        """What `read` takes."""
        if not self.attributes:
            return self.frame
        import xarray as xr

        columns = {str(name): self.frame[name].to_numpy() for name in self.frame}
        return xr.Dataset({name: ("row", values, self.attributes.get(name, {})) for name, values in columns.items()})


@runtime_checkable
class Tables(Protocol):
    """Files that are read in pieces."""

    @property
    def where(self) -> str:
        """The files, in a sentence."""
        ...

    @property
    def asked(self) -> Asked:
        """What is read of them."""
        ...

    @property
    def paths(self) -> list[str]:
        """The file of each part."""
        ...

    def tables(self, part: int) -> Iterator[Piece]:
        """Rows of a part as they lie in the file, some at a time.

        Args:
            part: Number of the part.
        """
        ...


@dataclass(frozen=True)
class WholeRuns:
    """Files whose chunks hold whole runs; a part is a file.

    A run begins where the column that tells runs apart changes or, without one, where the time goes back if that begins
    another run; else a file is one run. Memory is that of the longest run, and of a few chunks.

    Attributes:
        rows: The files in pieces.
    """

    rows: Tables

    def __post_init__(self) -> None:
        if self.rows.asked.time is None:
            raise InputError(
                f"Rows of paths are samples in time, and those of {self.where} have no stamps: name their column, "
                "time=..., or give measured rates, derivatives={...}."
            )

    @property
    def where(self) -> str:
        """The files."""
        return self.rows.where

    @property
    def n_part(self) -> int:
        """Files."""
        return len(self._files)

    def whole_runs(self) -> "WholeRuns":
        """The same."""
        return self

    def chunks(self, part: int) -> Iterator[Trajectories]:
        """Whole runs of a file in order, one or more at a time."""
        path, label = self._files[part]
        n_run = 0
        for piece, dropped in self._runs(path):
            for data in self.rows.asked.formed(piece.table, f'"{path}"', piece.first, dropped, whole=True):
                yield replace(data, run_names=tuple(self._named(name, label, n_run) for name in data.run_names))
                n_run += len({name.partition(",")[0] for name in data.run_names})

    @cached_property
    def _files(self) -> list[tuple[str, str]]:
        """Each file, with what its runs are called after; nothing where it is the only one."""
        paths = list(dict.fromkeys(self.rows.paths))
        stems = [Path(path).stem for path in paths]
        labels = [""] if len(paths) == 1 else stems if len(set(stems)) == len(stems) else paths
        return list(zip(paths, labels, strict=True))

    def _runs(self, path: str) -> Iterator[tuple[Piece, int]]:
        """Rows of whole runs of a file, and how many beside them were left out with runs that have no others.

        Rows with missing values are among them: `read` cuts runs before it leaves out any, and their stamps may tell
        where one ends.
        """
        asked, dropped = self.rows.asked, 0
        for piece, number in self._whole(path):
            said = np.isin(number, number[asked.usable(piece.frame)])
            # On either side of a run that is left out rows are read by themselves, as nothing else may part them.
            for rows in np.split(np.arange(len(said)), np.flatnonzero(np.diff(said)) + 1):
                if said[rows[0]]:
                    own = piece.frame.iloc[rows].reset_index(drop=True)
                    yield Piece(piece.first + int(rows[0]), own, piece.attributes), dropped
                    dropped = 0
                else:
                    dropped += len(rows)

    def _whole(self, path: str) -> Iterator[tuple[Piece, Int[np.ndarray, " n_row"]]]:
        """All rows of whole runs of a file, and the number of each row's run."""
        asked, held = self.rows.asked, list[tuple[pd.DataFrame, np.ndarray]]()
        first = n_held = n_run = 0
        before: pd.DataFrame | None = None
        attributes: Mapping[str, Mapping[str, Any]] = {}
        seen: dict[Any, None] = {}

        def together() -> tuple[Piece, np.ndarray]:
            frames, numbers = zip(*held, strict=True)
            return Piece(first, pd.concat(frames, ignore_index=True), attributes), np.concatenate(numbers)

        for piece in self._pieces(path):
            frame, start = piece.frame, 0
            if not len(frame):
                continue
            attributes, first = piece.attributes, first if held else piece.first
            begins = asked.begins(frame, before)
            self._require_together(piece, begins, path, seen)
            begun, number = np.flatnonzero(begins), n_run + np.cumsum(begins)
            before, n_run = asked.latest(frame, before), int(number[-1])
            # Few runs are cut one from another: what is asked for is a place between two.
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

    def _pieces(self, path: str) -> Iterator[Piece]:
        for part, own in enumerate(self.rows.paths):
            if own == path:
                yield from self.rows.tables(part)

    def _require_together(self, piece: Piece, begins: np.ndarray, path: str, seen: dict[Any, None]) -> None:
        """Refuse rows that name no run, as `read` does, and a run whose rows lie apart."""
        column = self.rows.asked.labels
        if column is None:
            return
        # A missing label is none of those beside it, so that it seems to begin a run.
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
        """A run's name as `read` would have it of all files at once."""
        if self.rows.asked.labels is not None:
            return f"{label}/{name}" if label else name
        number, comma, part = name.partition(",")
        if self.rows.asked.restarts:
            number = str(int(number) + n_run)
            return (f"{label}/{number}" if label else number) + comma + part
        return (label or number) + comma + part


def some_runs(source: Any, size: int, places: int) -> list[tuple[int, Trajectories]]:
    """Whole runs of about so many rows together, spread over parts and within them; all where there are no more rows.

    Args:
        source: Whole runs in parts.
        size: Rows, about.
        places: How many places they are taken at, more where parts hold too few.

    Returns:
        Runs with the number of their part, in order.
    """
    n_part, found, more = source.n_part, dict[int, list[Trajectories]](), list[tuple[int, int]]()
    rows = 0
    # Places in the middle of equal shares of the parts, then all other parts.
    first = ((np.arange(places) + 0.5) / places * n_part).astype(int)
    for part in dict.fromkeys([*first[_evenly(places)].tolist(), *_evenly(n_part).tolist()]):
        if rows >= size:
            break
        own = int(np.sum(first == part))
        wanted = size * own // places if own else size - rows
        found[part], total = _of_part(source, part, max(wanted, 1), max(own, 1))
        taken = sum(each.n_obs for each in found[part])
        rows += taken
        more += [(part, taken)] if taken < total else []
    # What some parts have too few rows for is taken from those that have more.
    for part, taken in more:
        if rows >= size:
            break
        found[part], _ = _of_part(source, part, taken + size - rows, max(int(np.sum(first == part)), 1))
        rows += sum(each.n_obs for each in found[part]) - taken
    return [(part, runs) for part in sorted(found) for runs in found[part]]


def stacked_runs(pieces: list[tuple[int, Trajectories]]) -> Trajectories:
    """Whole runs as one set of data.

    Args:
        pieces: Runs with the number of their part, alike in columns and units.
    """
    _, first = pieces[0]
    names = [(part, name) for part, piece in pieces for name in piece.run_names]
    alone = len({name for _, name in names}) == len(names)
    starts = np.cumsum([0, *(piece.n_run for _, piece in pieces)])

    def of(pick: Any) -> Any:
        return np.concatenate([pick(piece) for _, piece in pieces])

    def unseen(piece: Trajectories) -> np.ndarray:
        return np.zeros(piece.n_obs, bool) if piece.unseen is None else piece.unseen

    return replace(
        first,
        time=of(lambda piece: piece.time),
        run=np.concatenate([piece.run + start for (_, piece), start in zip(pieces, starts[:-1], strict=True)]),
        states={name: of(lambda piece: piece.states[name]) for name in first.states},  # noqa: B023
        inputs={name: of(lambda piece: piece.inputs[name]) for name in first.inputs},  # noqa: B023
        derivatives={name: of(lambda piece: piece.derivatives[name]) for name in first.derivatives},  # noqa: B023
        run_names=tuple(name if alone else f"{name} of part {part}" for part, name in names),
        dropped=0,
        remarks=(),
        unseen=of(unseen) if any(piece.unseen is not None for _, piece in pieces) else None,
    )


def _of_part(source: Any, part: int, wanted: int, places: int) -> tuple[list[Trajectories], int]:
    """Whole runs of one part, at places evenly spaced over its rows, and how many rows it has."""
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
    found, start = [], 0
    for chunk in source.chunks(part):
        own = [run - start for run in sorted(chosen) if start <= run < start + chunk.n_run]
        start += chunk.n_run
        if own:
            found.append(chunk if len(own) == chunk.n_run else chunk.keep(np.isin(chunk.run, own)))
    return found, int(ends[-1])


def _evenly(n: int) -> np.ndarray:
    """0 … n − 1 in an order whose beginnings are spread evenly."""
    return np.argsort(np.arange(n) * 0.6180339887498949 % 1.0)
