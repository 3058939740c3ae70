"""Passes over the chunks of a stream: ranges and sizes first, then the triangular factors of the rows.

Rows of paths have their factors in the first pass, which is done anew wherever they are taken near another model.
Parts are read in any order, here or on workers, and what they give is put together in the order of the parts: the
result is the same to the last bit wherever they were read, on processors of one kind.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from bayes_greybox.data.streams.row_stream import RowStream, Source
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.algebra.compression import CACHED_ROWS, stacked
from bayes_greybox.model.coefficient import by_block
from bayes_greybox.physics.terms import Dictionary
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.stages import stage
from bayes_greybox.running.tasks import run_tasks

from ..assemble import require_rows, scaled_table, with_steps
from ..frame import Frame, scaled_frame
from ..program import Program
from ..rows.equation_rows import EquationRows, nothing_left
from ..rows.row_kind import RowsOfRuns
from .statistics import Extent, Factors, RowStatistics, Sizes, ends_of, together


@contextmanager
def of_the_sample(sample: Trajectories, stream: RowStream) -> Iterator[None]:
    """Say of errors within that they are of a sample of whole runs, as they were measured, and not of all."""
    try:
        yield
    except InputError as error:
        runs = "1 run" if sample.n_run == 1 else f"{sample.n_run} runs"
        raise InputError(
            f"In the sample of {runs} of {stream.source.where}: {error} If it is otherwise in other runs, look at "
            "more of them: bg.stream(..., sample=...)."
        ) from error


@dataclass(frozen=True)
class Rows:
    """Rows of equations from chunks of a source, by functions to those of each block; the sample has some of them."""

    source: Source
    model: Program
    sample: Trajectories
    runs: Mapping[str, RowsOfRuns]

    def of_part(self, part: int) -> Iterator[tuple[Trajectories, dict[str, EquationRows]]]:
        """Return the chunks of a part, each with its rows by block."""
        simulation, names = self.model.simulator(self.sample), set(self.sample.columns)
        for chunk in self.source.chunks(part):
            if set(chunk.columns) != names:
                raise InputError(f"Part {part} of {self.source.where} has other columns than its first one.")
            self._require_units(part, chunk)
            blocks = self.model.blocks.items()
            for piece in _alone(chunk) if self.model.rows.follows_path else [chunk]:
                try:
                    rows = {name: self.runs[name](piece, of, simulation) for name, of in blocks}
                except InputError as error:
                    if self.model.rows.linear:
                        raise
                    first, last = piece.run_names[0], piece.run_names[-1]
                    runs = f'run "{first}"' if piece.n_run == 1 else f'one of the runs "{first}" to "{last}"'
                    raise InputError(f"In {runs} of {self.source.where}: {error}") from error
                yield piece, rows

    def _require_units(self, part: int, chunk: Trajectories) -> None:
        for name in (*self.sample.units, *chunk.units):
            first, second = self.sample.units.get(name), chunk.units.get(name)
            if first != second:
                raise InputError(
                    f"The unit of {name} is {first or 'not stated'} in the sample of {self.source.where} but "
                    f'{second or "not stated"} in part {part}: convert one of them, or pass units={{"{name}": ...}} '
                    "if both are the same."
                )


def _alone(chunk: Trajectories) -> Iterator[Trajectories]:
    """Return the runs one by one: a smoother is compiled for each number of runs that it is given at once."""
    for run in range(chunk.n_run):
        yield replace(chunk.take(run), dropped=0 if run else chunk.dropped)


@dataclass(frozen=True)
class Whole:
    """All rows of a stream, with a sample, and the extent, and frames of factors of paths, of the first pass."""

    stream: RowStream
    sample: Trajectories
    extent: Extent
    runs: Mapping[str, RowsOfRuns]
    first: Mapping[str, Frame]

    def statistics(self, model: Program) -> dict[str, RowStatistics]:
        """Return the statistics of all rows by block: one pass over them, none where those of the first are enough.

        The model has the terms and the simulation of the first pass; its features may be others.
        """
        sizes = self.extent.sizes
        rows = {block: model.equation_rows(self.sample, block) for block in sizes}
        frames = {block: self._frame(model, rows[block], terms) for block, terms in _terms(model, self.sample).items()}
        if self.first and model.discrepancy is None:
            factors = {}
            for block, frame in frames.items():
                first = self.first[block]
                by = np.append(first.term_scale / frame.term_scale, first.target_scale / frame.target_scale)
                factors[block] = self.extent.factors[block].scaled(by)
        else:
            factors = self._factors(model, frames)
        statistics = {}
        for block, frame in frames.items():
            size, floor = sizes[block], model.noise_floor
            if size.levels is not None:
                floor = with_steps(size.levels / frame.target_scale, size.n_white, floor)
            white, plain = factors[block]
            scales = frame.term_scale, frame.target_scale, floor
            statistics[block] = RowStatistics(
                self.extent.n_row, size.ends, *scales, white, size.n_white, size.log_det, plain if self.first else None
            )
        return statistics

    def _factors(self, model: Program, frames: Mapping[str, Frame]) -> dict[str, Factors]:
        rows = Rows(self.stream.source, model, self.sample.samples or self.sample, self.runs)
        parts = _over_parts(self.stream, _factors_of_part, "Reading the rows", rows, frames)
        factors = {block: Factors.empty(frame.n_column) for block, frame in frames.items()}
        for part in parts:
            factors = {block: factor.joined(part[block]) for block, factor in factors.items()}
        for block, frame in frames.items():
            self._require_same(factors[block], block, 0 if self.first else len(frame.dictionary))
        return factors

    def _require_same(self, factors: Factors, block: str, n_term: int) -> None:
        # Terms of rates, and targets, were divided by their RMS over the rows of the first pass. A millionth is far
        # above rounding errors, and far below what other random rows make of a hundred million.
        squares = np.sum(factors.plain[:, [*range(n_term), -1]] ** 2, axis=0) / self.extent.sizes[block].n_white
        if not np.all(np.abs(squares - 1.0) <= 1e-6):
            raise InputError(
                f"The rows of {self.stream.source.where} were others when they were read again: let nothing write to "
                "the files during a fit; a function must give the same rows each time, from a seed of the chunk's "
                "number where they are random."
            )

    def _frame(self, model: Program, rows: EquationRows, dictionary: Dictionary) -> Frame:
        sizes = self.extent.sizes[rows.equation]
        require_rows(rows.equation, sizes.n_white, len(dictionary))
        if nothing_left(np.sqrt(sizes.target), np.sqrt(sizes.measured)):
            raise rows.nothing_to_learn()
        scales = sizes.scales(rows, dictionary)
        frame = scaled_frame(rows.equation, dictionary, model.discrepancy, sizes.ends, *scales)
        # A path has points that stand for no sample: terms are as large as on those that are looked at.
        return replace(frame, term_scale=self.first[rows.equation].term_scale) if self.first else frame


def whole_of(stream: RowStream, model: Program, sample: Trajectories) -> Whole:
    """Make the first pass."""
    # Rows as they were measured, if they were completed.
    simulation, measured = model.simulator(sample), sample.samples or sample
    runs = {block: model.rows.of_runs(sample, of, simulation) for block, of in model.blocks.items()}
    frames = {}
    if not model.rows.linear:
        # Paths cost more than a factor of their terms: another pass may be saved.
        for block, dictionary in _terms(model, sample).items():
            some = model.equation_rows(sample, block)
            scales = Sizes.of(some, dictionary).scales(some, dictionary)
            with of_the_sample(measured, stream):
                frames[block] = scaled_frame(block, dictionary, None, some.columns, *scales)
    rows = Rows(stream.source, model, measured, runs)
    parts = _over_parts(stream, _extent_of_part, "Reading ranges of the rows", rows, frames)
    return Whole(stream, sample, together(parts), runs, frames)


def _terms(model: Program, sample: Trajectories) -> dict[str, Dictionary]:
    return by_block(model.blocks, model.dictionaries(sample))


def _extent_of_part(part: int, rows: Rows, frames: Mapping[str, Frame]) -> Extent | None:
    dictionaries = _terms(rows.model, rows.sample)
    total: Extent | None = None
    with threadpool_limits(1):
        for chunk, by_name in rows.of_part(part):
            factors = {
                block: _with_rows(Factors.empty(frame.n_column), frame, by_name[block])
                for block, frame in frames.items()
            }
            n_telling = max(len(np.unique(each.run)) for each in by_name.values()) if frames else chunk.n_run
            sizes = {block: Sizes.of(each, dictionaries[block]) for block, each in by_name.items()}
            ends = ends_of(chunk.columns)
            extent = Extent(chunk.n_obs, chunk.dropped, chunk.n_run, n_telling, ends, sizes, factors)
            total = extent if total is None else total + extent
    return total


def _factors_of_part(part: int, rows: Rows, frames: Mapping[str, Frame]) -> dict[str, Factors]:
    factors = {block: Factors.empty(frame.n_column) for block, frame in frames.items()}
    # The last digits of a factor may depend on how many threads made it.
    with threadpool_limits(1):
        for _, by_name in rows.of_part(part):
            for block, each in by_name.items():
                factors[block] = _with_rows(factors[block], frames[block], each)
    return factors


def _with_rows(factors: Factors, frame: Frame, rows: EquationRows) -> Factors:
    """Add rows to factors: to those of rates twice the same, as each is white by itself."""
    if rows.operator is not None:
        if not rows.n_row:
            return factors
        table = scaled_table(frame, rows)(np.arange(rows.n_row))
        return Factors(stacked(factors.white, rows.whiten(table)), stacked(factors.plain, table))
    R, n_term, y = factors.white, len(frame.dictionary), rows.target / frame.target_scale
    for start in range(0, rows.n_row, CACHED_ROWS):
        columns = rows.at(slice(start, start + CACHED_ROWS))
        table = np.empty((len(y[start : start + CACHED_ROWS]), len(R)), order="F")
        # [Φ ψ y] by NumPy: XLA takes twice the processor's time for these few rows, and compiles before.
        table[:, :n_term] = frame.dictionary_rows(columns)
        table[:, n_term:-1] = frame.plain_features(columns)
        table[:, -1] = y[start : start + CACHED_ROWS]
        R = stacked(R, table)
    return Factors(R, R)


def _over_parts(
    stream: RowStream, function: Callable[..., Any], label: str, rows: Rows, frames: Mapping[str, Frame]
) -> Iterator[Any]:
    """Return the results of a function for each part that has rows, in the order of the parts."""
    n_part = stream.source.n_part
    tasks = {str(part): (part, rows, frames) for part in range(n_part)}
    # Without a wish parts are read here: workers have to be paid for, and a part may hold all rows.
    workers = stream.workers if stream.scheduler is not None else stream.workers or 1
    waiting: dict[int, Any] = {}
    turn = 0
    with (
        stage(label, n_part) as line,
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
