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

SAMPLE_ROWS = 2000  # rows of the sample by default
STRETCHES = 10  # stretches of the sample; their rows follow each other, as some checks compare neighbours


@runtime_checkable
class Source(Protocol):
    """Rows in parts, which can be sent to another process and read there."""

    @property
    def where(self) -> str:
        """Description of the source, within a sentence."""
        ...

    @property
    def n_part(self) -> int:
        """Number of parts."""
        ...

    def chunks(self, part: int) -> Iterator[Trajectories]:
        """Yield the rows of a part in order, as many at a time as memory holds; no chunk is empty."""
        ...

    def whole_runs(self) -> "Source":
        """Return the same rows in parts whose chunks hold whole runs, as paths need them."""
        ...


@dataclass(frozen=True, eq=False, repr=False)
class RowStream:
    """Measured rates or outputs of any number of rows, or samples of paths: `GreyBox.fit` reads them a chunk at a time.

    All rows decide the posterior. Whatever looks at single rows (predictions of the training data, checks,
    leave-one-out densities, figures) looks at those of `sample`.

    Attributes:
        source: Source of the rows; see `stream`.
        sample_size: Rows of the sample, about.
        workers: Processes of this machine that read parts; one if left out.
        scheduler: Address of a Dask scheduler, whose workers read parts and see the same files.
        by_run: If true, chunks and the sample hold whole runs.
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
        """Advice where rows are needed all at once."""
        return (
            "GreyBox.fit alone reads a bg.stream in chunks; everything else needs its rows at once: give it "
            "stream.sample, some of them, or as many as memory holds, read by bg.read."
        )

    @classmethod
    def from_chunks(
        cls, chunk: Callable[[int], Trajectories], n_chunk: int, *, sample: int = SAMPLE_ROWS,
        workers: int | None = None, scheduler: str | None = None,
    ) -> "RowStream":  # fmt: skip
        """Stream rows that a function returns, from a source that `stream` does not read.

        Args:
            chunk: Function from 0, 1, … to rows, the same ones at each call; where a state or an input may be constant
                over a chunk, made with `constant="keep"`. For workers it must be a function of a module. Runs of a
                chunk end with it: where rows are samples of paths give whole runs, as each part of a divided run has a
                start of its own.
            n_chunk: Number of chunks.
            sample: Rows that are looked at one by one.
            workers: Processes of this machine that ask for chunks; one if left out.
            scheduler: Address of a Dask scheduler.
        """
        if not callable(chunk) or n_chunk < 1:
            raise InputError("RowStream.from_chunks takes a function of a chunk's number, and how many there are.")
        return cls(_FunctionRows(chunk, n_chunk), sample, workers, scheduler)

    def whole_runs(self) -> "RowStream":
        """Return the same rows in chunks of whole runs, of which a sample is made too."""
        return replace(self, source=self.source.whole_runs(), by_run=True)

    @cached_property
    def sample(self) -> Trajectories:
        """Stretches of rows that follow each other, or whole runs, evenly spaced over the parts."""
        if self.by_run:
            pieces = some_runs(self.source, self.sample_size, STRETCHES)
        else:
            # Stretches are in the middle of equal shares of the parts.
            place = (np.arange(STRETCHES) + 0.5) / STRETCHES * self.source.n_part
            size = max(self.sample_size // STRETCHES, 1)
            places = {part: place[place.astype(int) == part] - part for part in np.unique(place.astype(int)).tolist()}
            pieces = [(part, each) for part in places for each in _stretches(self.source, part, places[part], size)]
        if not pieces:
            raise InputError(f"There are no rows in {self.source.where}.")
        _require_alike([piece for _, piece in pieces])
        return stacked_runs(pieces)

    def __repr__(self) -> str:
        parts = "1 part" if self.source.n_part == 1 else f"{self.source.n_part} parts"
        return f"RowStream({self.source.where}, {parts}; a sample of about {self.sample_size} rows is looked at)"


@dataclass(frozen=True)
class _FunctionRows:
    """Chunks that a function of the user returns."""

    chunk: Callable[[int], Trajectories]
    n_part: int

    @property
    def where(self) -> str:
        return "chunks of a function"

    def whole_runs(self) -> "_FunctionRows":
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
    """Return rows of one part that follow each other, at places given as shares of the part."""
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
    stretches = []
    for number, chunk in enumerate(source.chunks(part) if wanted else ()):
        start = int(ends[number]) - chunk.n_obs
        for first, stop in wanted.get(number, ()):
            cut, name = chunk.keep(slice(first - start, stop - start)), f"part {part} from row {first}"
            names = (name,) if cut.n_run == 1 else tuple(f"{name}, {run}" for run in cut.run_names)
            stretches.append(replace(cut, run_names=names))
    return stretches


def _require_alike(pieces: list[Trajectories]) -> None:
    """Refuse pieces of other columns or units than the first one's."""
    first = pieces[0]
    for piece in pieces:
        if set(piece.columns) != set(first.columns) or set(piece.derivatives) != set(first.derivatives):
            raise InputError("Chunks of a stream must have the same states, inputs, derivatives and outputs.")
        if piece.units != first.units:
            raise InputError("Chunks of a stream must have the same units.")
