"""More rows than memory holds, as they are fitted: parts that are read when they are needed, and a sample of rows."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.limits import Count, require_limits

from .whole_runs import some_runs, stacked_runs

SAMPLE_ROWS = 2000
"""Rows of the sample by default: as many as every group of a fit is kept for."""

STRETCHES = 10
"""Pieces that the sample is made of: rows that follow each other, for what is seen between neighbours only."""


@runtime_checkable
class Source(Protocol):
    """Rows in parts, which can be sent to another process and read there."""

    @property
    def where(self) -> str:
        """What is read, in a sentence."""
        ...

    @property
    def n_part(self) -> int:
        """Parts."""
        ...

    def chunks(self, part: int) -> Iterator[Trajectories]:
        """The rows of a part in order, as many at a time as memory holds; no chunk is empty.

        Args:
            part: Number of the part.
        """
        ...

    def whole_runs(self) -> "Source":
        """The same rows in parts whose chunks hold whole runs, as paths need them."""
        ...


@dataclass(frozen=True, eq=False, repr=False)
class RowStream:
    """Measured rates or outputs of any number of rows, or samples of paths: `GreyBox.fit` reads them a chunk at a time.

    All rows decide the posterior. What looks at single rows (predictions of the training data, checks, leave-one-out
    densities, figures) looks at those of `sample`.

    Attributes:
        source: Where they come from; see `stream`.
        sample_size: Rows of the sample, about.
        workers: Processes of this machine that read parts; one if left out.
        scheduler: Address of a Dask scheduler, whose workers read parts and see the same files.
        by_run: Whether chunks, and the sample, are of whole runs.
    """

    source: Source
    sample_size: Count = SAMPLE_ROWS
    workers: Count | None = None
    scheduler: str | None = field(default=None)
    by_run: bool = False

    def __post_init__(self) -> None:
        require_limits(self)
        if self.workers is not None and self.scheduler is not None:
            raise InputError("A scheduler has workers of its own: give scheduler or workers, not both.")

    @property
    def instead(self) -> str:
        """What to give where rows are needed all at once."""
        return (
            "GreyBox.fit alone reads a bg.stream in chunks; everything else needs its rows at once: give it "
            "stream.sample, some of them, or as many as memory holds, read by bg.read."
        )

    @classmethod
    def from_chunks(
        cls,
        chunk: Callable[[int], Trajectories],
        n_chunk: int,
        *,
        sample: int = SAMPLE_ROWS,
        workers: int | None = None,
        scheduler: str | None = None,
    ) -> "RowStream":
        """Rows that a function gives, from a source that `stream` does not read.

        Args:
            chunk: From 0, 1, … to rows, the same ones each time that it is asked; where a state or an input may stay
                the same all over a chunk, made with `constant="keep"`. For workers a function of a module. Runs of a
                chunk end with it: where rows are samples of paths give whole runs, as what is cut has a start of its
                own in each part.
            n_chunk: How many there are.
            sample: Rows that are looked at one by one.
            workers: Processes of this machine that ask for chunks; one if left out.
            scheduler: Address of a Dask scheduler.
        """
        if not callable(chunk) or n_chunk < 1:
            raise InputError("RowStream.from_chunks takes a function of a chunk's number, and how many there are.")
        return cls(_Given(chunk, n_chunk), sample, workers, scheduler)

    def whole_runs(self) -> "RowStream":
        """The same rows in chunks of whole runs, of which a sample is made too.

        Raises:
            InputError: Rows without stamps.
        """
        return replace(self, source=self.source.whole_runs(), by_run=True)

    @cached_property
    def sample(self) -> Trajectories:
        """Stretches of rows that follow each other, or whole runs, evenly spaced over the parts.

        Raises:
            InputError: No rows, or rows that cannot be used.
        """
        if self.by_run:
            return self._some_runs()
        size = max(self.sample_size // STRETCHES, 1)
        # Stretches are in the middle of equal shares of the parts.
        place = (np.arange(STRETCHES) + 0.5) / STRETCHES * self.source.n_part
        pieces: list[Trajectories] = []
        for part in np.unique(place.astype(int)):
            pieces += _stretches(self.source, int(part), place[place.astype(int) == part] - part, size)
        if not pieces:
            raise InputError(f"There are no rows in {self.source.where}.")
        return _together(pieces)

    def _some_runs(self) -> Trajectories:
        pieces = some_runs(self.source, self.sample_size, STRETCHES)
        if not pieces:
            raise InputError(f"There are no rows in {self.source.where}.")
        _require_alike([piece for _, piece in pieces])
        return stacked_runs(pieces)

    def __repr__(self) -> str:
        parts = "1 part" if self.source.n_part == 1 else f"{self.source.n_part} parts"
        return f"RowStream({self.source.where}, {parts}; a sample of about {self.sample_size} rows is looked at)"


@dataclass(frozen=True)
class _Given:
    """What a user's function gives."""

    chunk: Callable[[int], Trajectories]
    n_part: int

    @property
    def where(self) -> str:
        return "chunks of a function"

    def whole_runs(self) -> "_Given":
        return self

    def chunks(self, part: int) -> Iterator[Trajectories]:
        try:
            data = self.chunk(part)
        except StopIteration:
            raise InputError(
                "The function of RowStream.from_chunks ran out of rows: it is asked for each chunk more than once, and "
                "must give the same rows each time, and not the next ones of an iterator."
            ) from None
        if not isinstance(data, Trajectories):
            raise InputError(
                f"The function of RowStream.from_chunks must return bg.Trajectories, not a {type(data).__name__}: "
                "build them with bg.Trajectories.from_arrays."
            )
        if data.noise or data.filter is not None:
            raise InputError(
                "Rates that data.differentiate() computed know of their neighbours, and a stream has none beside a "
                "chunk: give chunks with measured rates or outputs."
            )
        if data.samples is not None:
            raise InputError(
                "A model has completed the data that the function of RowStream.from_chunks gives: give chunks as they "
                "were measured, data.samples."
            )
        yield data


def _stretches(source: Source, part: int, places: np.ndarray, size: int) -> list[Trajectories]:
    """Rows of one part that follow each other, at places given as shares of the part."""
    # Counted first, as a part may be too large to be held.
    ends = np.cumsum([chunk.n_obs for chunk in source.chunks(part)])
    total = int(ends[-1]) if len(ends) else 0
    wanted: dict[int, list[tuple[int, int]]] = {}
    begun = 0
    for place in places:
        # No row twice, and no stretch from one chunk to the next.
        first = max(int(place * (total - size)), begun)
        if first >= total:
            break
        at = int(np.searchsorted(ends, first, side="right"))
        begun = min(first + size, int(ends[at]))
        wanted.setdefault(at, []).append((first, begun))
    found = []
    for number, chunk in enumerate(source.chunks(part) if wanted else ()):
        start = int(ends[number]) - chunk.n_obs
        found += [_cut(chunk, a - start, b - start, f"part {part} from row {a}") for a, b in wanted.get(number, ())]
    return found


def _cut(chunk: Trajectories, start: int, stop: int, name: str) -> Trajectories:
    row = np.arange(chunk.n_obs)
    cut = chunk.keep((row >= start) & (row < stop))
    names = (name,) if cut.n_run == 1 else tuple(f"{name}, {own}" for own in cut.run_names)
    return replace(cut, run_names=names)


def _together(pieces: list[Trajectories]) -> Trajectories:
    """Pieces as runs of one set of data."""
    first = pieces[0]
    _require_alike(pieces)

    def runs(pick: Callable[[Trajectories], np.ndarray]) -> list[np.ndarray]:
        return [part for piece in pieces for part in np.split(pick(piece), np.cumsum(piece.run_lengths)[:-1])]

    return Trajectories.from_arrays(
        runs(lambda piece: piece.time),
        states={name: runs(lambda piece: piece.states[name]) for name in first.states},  # noqa: B023
        inputs={name: runs(lambda piece: piece.inputs[name]) for name in first.inputs},  # noqa: B023
        derivatives={n: runs(lambda piece: piece.derivatives[n]) for n in first.derivative_names},  # noqa: B023
        outputs={n: runs(lambda piece: piece.derivatives[n]) for n in first.output_names},  # noqa: B023
        units=first.units,
        run_names=[name for piece in pieces for name in piece.run_names],
        constant="keep",
    )


def _require_alike(pieces: list[Trajectories]) -> None:
    """Refuse pieces of other columns or units than the first one's."""
    first = pieces[0]
    for piece in pieces:
        if set(piece.columns) != set(first.columns) or set(piece.derivatives) != set(first.derivatives):
            raise InputError("Chunks of a stream must have the same states, inputs, derivatives and outputs.")
        if piece.units != first.units:
            raise InputError("Chunks of a stream must have the same units.")
