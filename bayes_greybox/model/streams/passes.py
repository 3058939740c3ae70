"""Two passes over the chunks of a stream: ranges and sizes first, then the triangular factors of the rows.

Parts are read in any order, here or on workers, and what they give is put together in the order of the parts: the
result is the same to the last bit wherever they were read, on processors of one kind.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.streams.row_stream import RowStream, Source
from bayes_greybox.data.tasks import run_tasks
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.running.stages import stage

from ..algebra.stacking import BLOCK, empty_factor, joined, stacked
from ..assemble import with_steps
from ..blocks import by_block
from ..frame import Frame
from ..program import Program
from ..rows.equation_rows import EquationRows, nothing_left
from ..scaling import scaled_frame
from .extent import Extent, Sizes, together
from .statistics import RowStatistics

RANGES, STATISTICS = "Reading ranges of the rows", "Reading the rows"
"""What bars say of the two passes."""

SAME = 1e-6
"""Relative difference up to which the sizes of columns in both passes are those of the same rows: far above rounding
errors, and far below what other random rows make of a hundred million."""


@dataclass(frozen=True)
class Rows:
    """How chunks become rows of equations, wherever they are read.

    Attributes:
        source: The chunks.
        model: Model.
        sample: Some of the rows, whose names and units are those of all.
    """

    source: Source
    model: Program
    sample: Trajectories

    def of_part(self, part: int) -> Iterator[tuple[Trajectories, dict[str, EquationRows]]]:
        """Chunks of a part, and rows by block."""
        simulation, names = self.model.simulator(self.sample), set(self.sample.columns)
        for chunk in self.source.chunks(part):
            if set(chunk.columns) != names:
                raise InputError(f"Part {part} of {self.source.where} has other columns than its first one.")
            self._require_units(part, chunk)
            blocks = self.model.blocks.items()
            yield chunk, {name: self.model.rows.shared_rows(chunk, of, simulation) for name, of in blocks}

    def _require_units(self, part: int, chunk: Trajectories) -> None:
        for name in (*self.sample.units, *chunk.units):
            first, second = self.sample.units.get(name), chunk.units.get(name)
            if first != second:
                raise InputError(
                    f"The unit of {name} is {first or 'not stated'} in the sample of {self.source.where} but "
                    f'{second or "not stated"} in part {part}: convert one of them, or pass units={{"{name}": ...}} '
                    "if both are the same."
                )


@dataclass(frozen=True)
class Whole:
    """All rows of a stream, of which ranges and sizes are known.

    Attributes:
        stream: The stream.
        sample: Rows that are looked at.
        extent: What the first pass found.
    """

    stream: RowStream
    sample: Trajectories
    extent: Extent

    def statistics(self, model: Program) -> dict[str, RowStatistics]:
        """What all rows say under a model, by block: one pass over them.

        Args:
            model: One with the terms and the simulation of the first pass; its features may be others.

        Raises:
            InputError: Fewer rows than terms; a term that is not finite, or zero; a target that is zero; chunks that
                cannot be read, or that are others than in the first pass.
        """
        n, sizes = self.extent.n_row, self.extent.sizes
        rows = {block: model.equation_rows(self.sample, block) for block in sizes}
        frames = {block: self._frame(model, rows[block], dictionary) for block, dictionary in _terms(model, self)}
        parts = _over_parts(self.stream, _factors_of_part, STATISTICS, model, self.sample, frames)
        factors = {block: empty_factor(_width(frame)) for block, frame in frames.items()}
        for part in parts:
            factors = {block: joined([factor, part[block]]) for block, factor in factors.items()}
        found = {}
        for block, frame in frames.items():
            self._require_same(factors[block], len(frame.dictionary))
            levels, floor = sizes[block].levels, model.noise_floor
            if levels is not None:
                floor = with_steps(levels / frame.target_scale, n, floor)
            ends = self.extent.ends
            found[block] = RowStatistics(n, ends, frame.term_scale, frame.target_scale, floor, factors[block])
        return found

    def _require_same(self, factor: np.ndarray, n_term: int) -> None:
        # Terms and target were divided by their RMS over the rows of the first pass.
        squares = np.sum(factor[:, [*range(n_term), -1]] ** 2, axis=0) / self.extent.n_row
        if not np.all(np.abs(squares - 1.0) <= SAME):
            raise InputError(
                f"The rows of {self.stream.source.where} were others when they were read again: let nothing write to "
                "the files during a fit; a function must give the same rows each time, from a seed of the chunk's "
                "number where they are random."
            )

    def _frame(self, model: Program, rows: EquationRows, dictionary: Any) -> Frame:
        n, sizes = self.extent.n_row, self.extent.sizes[rows.equation]
        if n < len(dictionary):
            raise InputError(
                f"Equation {rows.equation!r} has {len(dictionary)} terms but only {n} rows of data: give at least as "
                "many rows as terms."
            )
        if nothing_left(np.sqrt(sizes.target), np.sqrt(sizes.measured)):
            raise rows.nothing_to_learn()
        term_scale, target_scale = np.sqrt(sizes.terms / n), float(np.sqrt(sizes.target / n))
        return scaled_frame(rows.equation, dictionary, model.discrepancy, self.extent.ends, term_scale, target_scale)


def whole_of(stream: RowStream, model: Program, sample: Trajectories) -> Whole:
    """The first pass.

    Args:
        stream: All rows.
        model: Model, which chose its kind of rows.
        sample: Some of the rows.

    Raises:
        InputError: Chunks that cannot be read; a column that is the same everywhere.
    """
    return Whole(stream, sample, together(_over_parts(stream, _extent_of_part, RANGES, model, sample)))


def _terms(model: Program, whole: Whole) -> Any:
    return by_block(model.blocks, model.dictionaries(whole.sample)).items()


def _extent_of_part(source: Source, part: int, model: Program, sample: Trajectories) -> Extent | None:
    dictionaries = by_block(model.blocks, model.dictionaries(sample))
    found: Extent | None = None
    for chunk, rows in Rows(source, model, sample).of_part(part):
        own = Extent(
            chunk.n_obs,
            chunk.dropped,
            {name: float(column.min()) for name, column in chunk.columns.items()},
            {name: float(column.max()) for name, column in chunk.columns.items()},
            {block: Sizes.of(each, dictionaries[block]) for block, each in rows.items()},
        )
        found = own if found is None else found + own
    return found


def _factors_of_part(
    source: Source, part: int, model: Program, sample: Trajectories, frames: Mapping[str, Frame]
) -> dict[str, Float[np.ndarray, "n_column n_column"]]:
    factors = {block: empty_factor(_width(frame)) for block, frame in frames.items()}
    # The last digits of a factor may depend on how many threads made it.
    with threadpool_limits(1):
        for _, rows in Rows(source, model, sample).of_part(part):
            for block, each in rows.items():
                factors[block] = _with_rows(factors[block], frames[block], each)
    return factors


def _with_rows(R: np.ndarray, frame: Frame, rows: EquationRows) -> np.ndarray:
    n_term = len(frame.dictionary)
    y = rows.target / frame.target_scale
    for start in range(0, rows.n_row, BLOCK):
        columns = rows.at(slice(start, start + BLOCK))
        table = np.empty((len(y[start : start + BLOCK]), len(R)), order="F")
        # [Φ ψ y] by NumPy: XLA takes twice the processor's time for these few rows, and compiles before.
        table[:, :n_term] = frame.dictionary_rows(columns)
        table[:, n_term:-1] = frame.plain_features(columns)
        table[:, -1] = y[start : start + BLOCK]
        R = stacked(R, table)
    return R


def _width(frame: Frame) -> int:
    return len(frame.dictionary) + 1 + (0 if frame.basis is None else frame.basis.size)


def _over_parts(stream: RowStream, function: Callable[..., Any], what: str, *arguments: Any) -> Iterator[Any]:
    """What a function gives of each part that has rows, in the order of the parts."""
    n_part = stream.source.n_part
    tasks = {str(part): (stream.source, part, *arguments) for part in range(n_part)}
    # Without a wish parts are read here: workers have to be paid for, and a part may hold all rows.
    workers = stream.workers if stream.scheduler is not None else stream.workers or 1
    waiting: dict[int, Any] = {}
    turn = 0
    with (
        stage(what, n_part) as line,
        closing(run_tasks(function, tasks, workers=workers, scheduler=stream.scheduler)) as done_tasks,
    ):
        for done in done_tasks:
            if done.failed:
                raise InputError(done.failed)
            line.advance(1)
            waiting[int(done.name)] = done.result
            while turn in waiting:
                result = waiting.pop(turn)
                turn += 1
                if result is not None:
                    yield result
