"""Whole runs, however their rows lie in pieces of files: a path is that of a run, and knows of all its rows."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import pandas as pd

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.trajectories import Trajectories

from .asked import Asked

ROWS = 2048
"""Rows of short runs that are held together; a longer run is held alone."""

REMEMBERED = 100_000
"""Runs of a file whose names are known when another one comes that may be one of them."""


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
        seen: set[Any] = set()
        n_run = 0
        for piece, dropped in self._runs(path):
            self._require_together(piece, path, seen)
            for data in self.rows.asked.formed(piece.table, f'"{path}"', piece.first, dropped):
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
        """Rows of whole runs of a file, and how many beside them were left out."""
        asked, held = self.rows.asked, list[pd.DataFrame]()
        first = n_held = dropped = 0
        before: pd.DataFrame | None = None
        attributes: Mapping[str, Mapping[str, Any]] = {}
        for piece in self._pieces(path):
            attributes = piece.attributes
            kept = asked.usable(piece.frame)
            dropped += int(np.sum(~kept))
            frame, row = pd.DataFrame(piece.frame[kept]), piece.first + np.flatnonzero(kept)
            if not len(frame):
                continue
            first = first if held else int(row[0])
            begun, start = np.flatnonzero(asked.begins(frame, before)), 0
            before = frame.iloc[-1:]
            # Few runs are cut one from another: what is asked for is a place between two.
            while len(enough := begun[begun - start + n_held >= ROWS]):
                stop = int(enough[0])
                held += [frame.iloc[start:stop]] if stop > start else []
                yield Piece(first, pd.concat(held, ignore_index=True), attributes), dropped
                held, n_held, dropped = [], 0, 0
                first, start, begun = int(row[stop]), stop, begun[begun > stop]
            held.append(frame.iloc[start:])
            n_held += len(frame) - start
        if held:
            yield Piece(first, pd.concat(held, ignore_index=True), attributes), dropped

    def _pieces(self, path: str) -> Iterator[Piece]:
        for part, own in enumerate(self.rows.paths):
            if own == path:
                yield from self.rows.tables(part)

    def _require_together(self, piece: Piece, path: str, seen: set[Any]) -> None:
        """Refuse a run whose rows lie apart."""
        if self.rows.asked.labels is None:
            return
        labels = piece.frame[self.rows.asked.labels].drop_duplicates().tolist()
        again = [label for label in labels if label in seen]
        if again:
            raise InputError(
                f'Rows of run {again[0]!r} of "{path}" lie apart, and a stream holds one run at a time: sort the rows '
                f'of the file by "{self.rows.asked.labels}".'
            )
        if len(seen) < REMEMBERED:
            seen.update(labels)

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
    n_part, found, rows = source.n_part, dict[int, list[Trajectories]](), 0
    # Places in the middle of equal shares of the parts, then all other parts.
    first = ((np.arange(places) + 0.5) / places * n_part).astype(int)
    for part in dict.fromkeys([*first[_evenly(places)].tolist(), *_evenly(n_part).tolist()]):
        if rows >= size:
            break
        own = int(np.sum(first == part))
        wanted = size * own // places if own else size - rows
        found[part] = _of_part(source, part, max(wanted, 1), max(own, 1))
        rows += sum(each.n_obs for each in found[part])
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
    )


def _of_part(source: Any, part: int, wanted: int, places: int) -> list[Trajectories]:
    """Whole runs of one part, at places evenly spaced over its rows."""
    lengths = [n for chunk in source.chunks(part) for n in chunk.run_lengths]
    ends, chosen, each = np.cumsum(lengths), set[int](), max(wanted // places, 1)
    if not len(ends):
        return []
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
    return found


def _evenly(n: int) -> np.ndarray:
    """0 … n − 1 in an order whose beginnings are spread evenly."""
    return np.argsort(np.arange(n) * 0.6180339887498949 % 1.0)
