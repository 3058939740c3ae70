"""The rows of one equation: target, operator and noise.

Everything that needs a target, its projection or its whitening asks `EquationRows`; a kind of rows is a constructor
of it.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.data.columns import derivative_label
from bayes_greybox.data.noise.protocol import RowNoise
from bayes_greybox.data.rates.sample_spread import Columns, SampleSpread
from bayes_greybox.running.errors import InputError

Table = Callable[[Int[np.ndarray, " n_chunk"]], Float[np.ndarray, "n_chunk n_column"]]
"""Function from the indices of rows to these rows of a table that need never exist as a whole."""

Evaluate = Callable[[Columns], Any]
"""Function from states and inputs at some samples to k values [n, k], by NumPy or JAX."""


@runtime_checkable
class Operator(Protocol):
    """V: a linear map from values at the samples to values of the rows."""

    @property
    def sample(self) -> Int[np.ndarray, " n_row"]:
        """Sample of the data that each row is at."""
        ...

    @property
    def place(self) -> Int[np.ndarray, " n_row"]:
        """Place of each row among the columns that terms are evaluated on."""
        ...

    def __call__(self, table: Float[np.ndarray, "n_sample k"]) -> Float[np.ndarray, "n_row k"]:
        """Return V table."""
        ...

    def of(self, evaluate: Evaluate, columns: Columns) -> Float[np.ndarray, "n_row k"]:
        """Return V F, with F evaluated on columns [n] a stretch of samples at a time."""
        ...


def block_name(equations: Sequence[str]) -> str:
    """Return the name of rows that several equations share: "x_and_y", a name for variables; one has its own."""
    return "_and_".join(equations)


def nothing_left(target: float | np.floating, measured: float | np.floating) -> bool:
    """Return whether a target is rounding errors of what was measured, by the norms of both over the same rows."""
    return bool(target <= 1e-13 * measured)


class Removal(NamedTuple):
    """Whitened rows without the targets of some observations: those that are kept, and the change of log|R|.

    Orthonormal directions leave the whitened rows, or, where there are none, rows leave.
    """

    kept: Int[np.ndarray, " n_kept"]
    directions: Float[np.ndarray, "n_white n_out"] | None
    log_det: float


class Jumps(NamedTuple):
    """Values among others that may jump: their places, a function to them alone, and one to the parts that do jump."""

    places: Sequence[int]
    evaluate: Evaluate
    jumping: Evaluate | None = None


class Acting(NamedTuple):
    """V for forces on one of the learned states that share rows, and their size over that of the largest."""

    operator: Operator
    size: float


class Unfollowed(NamedTuple):
    """An unknown force along a path that its model does not follow.

    It gains `nats` of log likelihood at an intensity λ = q²/σ², σ the noise of a typical sensor. The `misfit` is the
    distance of the path from the samples, RMS over their spread; of several sensors the largest.
    """

    nats: float
    intensity: float
    misfit: float


@dataclass(frozen=True, eq=False)
class EquationRows:
    """The rows of one equation, y = V(Φθ + f) + ε, ε ~ N(0, σ² R), in user's units.

    Where several learned states k share the rows, y = Σ_k V_k Φ_k θ_k + ε.

    Attributes:
        equation: The learned state, or all together by `block_name`.
        simulated: V g, the measurements according to the simulation.
        noise: R, and W with W R Wᵀ = I.
        operator: V, from values at the samples to values of the rows; None where each sample is a row.
        gain: Divisor that took a sensor's unit to the unit of the rate; 1 where rows are rates.
        unfollowed: Force that the model lacks along the path that the rows are taken at.
        learned: V of each learned state; empty where rows are of one alone.
        exact: Rows as they would be if they were not linear near a model: a function from what draws add to the rates
            of the learned states, by columns and the draw's number, and from their starts, in units of the rows' σ
            times those of `RowNoise.starts_given`, to rows without noise; None where rows are linear.
        output: If true, the rows are of an output, else of a rate.
        n_all: Number of rows of a design of which these are some; None where it has these.
        segments: Number of segments, each with a start of its own, of each run of the path that rows are taken at.
        spread: Distribution of states that a sample stands for; None where columns are evaluated at the samples.
    """

    equation: str
    columns: Mapping[str, Float[np.ndarray, " n_sample"]]
    measured: Float[np.ndarray, " n_row"]
    simulated: Float[np.ndarray, " n_row"]
    noise: RowNoise
    time: Float[np.ndarray, " n_row"]
    run: Int[np.ndarray, " n_row"]
    operator: Operator | None = None
    gain: float = 1.0
    unfollowed: Unfollowed | None = None
    learned: Mapping[str, Acting] = field(default_factory=dict)
    exact: Callable[[Callable[[Columns, int], Any], np.ndarray], Float[np.ndarray, "n_draw n_row"]] | None = None
    output: bool = False
    n_all: int | None = None
    segments: int = 1
    spread: SampleSpread | None = None

    @property
    def label(self) -> str:
        """Left-hand side of the equation: d(y)/dt, or an output itself."""
        return self.equation if self.output else derivative_label(self.equation)

    @property
    def measurement(self) -> str:
        """Kind of what was measured: "derivative", "output", or "sample" of the states that learned equations move."""
        if self.output:
            return "output"
        return "sample" if self.learned else "derivative"

    @property
    def n_row(self) -> int:
        """Number of rows."""
        return len(self.measured)

    @property
    def n_white(self) -> int:
        """Number of white numbers that the rows carry: the observations that count."""
        return self.noise.n_white

    @cached_property
    def target(self) -> Float[np.ndarray, " n_row"]:
        """y: measured less simulated values."""
        return self.measured - self.simulated

    @property
    def shown(self) -> Float[np.ndarray, " n_row"]:
        """Measurements in the unit of the sensor that showed them: the same whatever model the rows are near."""
        return self.measured * self.gain

    @property
    def nothing_left(self) -> bool:
        """True if the simulation equals the measurement but for rounding errors."""
        return nothing_left(np.linalg.norm(self.target), np.linalg.norm(self.measured))

    @cached_property
    def scale(self) -> float:
        """RMS of the target, which the equation is scaled by; nothing but rounding errors is refused."""
        if self.nothing_left:
            raise self.nothing_to_learn()
        return float(np.sqrt(np.mean(self.target**2)))

    def nothing_to_learn(self) -> InputError:
        """Return the error for a simulation that equals the measurement."""
        measured = self.equation if self.output else f"derivative of {self.equation!r}"
        return InputError(f"The simulation equals the measured {measured} exactly: there is nothing to learn.")

    @property
    def n_sample(self) -> int:
        """Number of samples that terms are evaluated at."""
        return len(next(iter(self.columns.values())))

    @property
    def sample(self) -> Int[np.ndarray, " n_row"]:
        """Sample of the data that each row is at."""
        return np.arange(self.n_row) if self.operator is None else self.operator.sample

    def at(self, index: Int[np.ndarray, " n"] | slice) -> dict[str, Float[np.ndarray, " n"]]:
        """Return states and inputs at some samples."""
        return {name: column[index] for name, column in self.columns.items()}

    def at_rows(self) -> dict[str, Float[np.ndarray, " n_row"]]:
        """Return states and inputs where the rows are."""
        return self.at(slice(None) if self.operator is None else self.operator.place)

    def operate(self, table: Float[np.ndarray, "n_sample k"]) -> Float[np.ndarray, "n_row k"]:
        """Return V table: values of the rows from values at the samples."""
        return table if self.operator is None else self.operator(table)

    def at_samples(self, evaluate: Evaluate, jumps: "Jumps | None" = None) -> Float[np.ndarray, "n_sample k"]:
        """Return values at the samples, or means over what these stand for; `operate` makes rows of them."""
        values = np.array(evaluate(self.columns), float)
        if self.spread is not None and jumps is not None and jumps.places:
            values[:, jumps.places] = self.spread.mean(jumps.evaluate, self.spread.beside(self.columns), jumps.jumping)
        return values

    def table(self, evaluate: Evaluate, acts_on: Sequence[str] = (), jumps: "Jumps | None" = None) -> Table:
        """Return V F by index of the rows, F [n, k] evaluated on columns; where V mixes samples, it is evaluated here.

        Where learned states share the rows, each of the k `acts_on` one; jumps are averaged over what a sample stands
        for.
        """
        if self.operator is None:
            return lambda index: np.asarray(evaluate(self.at(index)))
        if not acts_on:
            whole = self.operator.of(lambda columns: np.asarray(evaluate(columns)), self.columns)
            if self.spread is not None and jumps is not None and jumps.places:
                means = partial(self.spread.mean, jumps.evaluate, jumping=jumps.jumping)
                whole[:, jumps.places] = self.operator.of(means, self.spread.beside(self.columns))
            return lambda index: whole[index]
        shared = np.empty((self.n_row, len(acts_on)))
        for name, acting in self.learned.items():
            on = np.array([each == name for each in acts_on])
            shared[:, on] = acting.operator.of(lambda at, on=on: np.asarray(evaluate(at))[:, on], self.columns)
        return lambda index: shared[index]

    def whiten(self, table: Float[np.ndarray, "n_row k"]) -> Float[np.ndarray, "n_white k"]:
        """Return W table."""
        return self.noise.whiten(table)

    def whitened(self, table: Table) -> Table:
        """Return W table by index of the whitened rows; the very table where every row is whitened by itself."""
        if self.noise.local:
            return table
        white = self.noise.whiten(table(np.arange(self.n_row)))
        return lambda index: white[index]

    def weighted(self, table: Table) -> tuple[Table, Table]:
        """Return R⁻¹ table and diag R⁻¹ [n, 1] by index of the observations; W table and ones where W is not square."""
        if self.noise.local:
            return table, lambda index: np.ones((len(index), 1))
        weighted = self.noise.whiten(table(np.arange(self.n_row)))
        precision = np.ones(len(weighted))
        if self.noise.square:
            weighted, precision = self.noise.whiten_transpose(weighted), self.noise.precision_diagonal()
        return (lambda index: weighted[index]), (lambda index: precision[index, None])

    def precision_blocks(
        self, folds: Sequence[Int[np.ndarray, " _"]]
    ) -> Callable[[Int[np.ndarray, "n_fold size"]], Float[np.ndarray, "n_fold size size"]]:
        """Return a function from these folds of observations, each in increasing order, to (R⁻¹)_FF."""
        if self.noise.local or not self.noise.square:
            return lambda index: np.broadcast_to(np.eye(index.shape[1]), (*index.shape, index.shape[1]))
        stretch = np.repeat(np.arange(len(self.noise.run_lengths)), self.noise.run_lengths)
        if any(stretch[fold[0]] != stretch[fold[-1]] for fold in folds):
            # Sensors of one run share its start, and a band knows of one stretch alone.
            return lambda index: np.stack([self.noise.precision_at(each) for each in index])
        band = self.noise.precision_band(max(int(fold[-1] - fold[0]) for fold in folds) + 1)

        def blocks(index: np.ndarray) -> np.ndarray:
            low, high = np.minimum(index[:, :, None], index[:, None]), np.maximum(index[:, :, None], index[:, None])
            return band[low, high - low]

        return blocks

    def without(self, out: Int[np.ndarray, " n_out"]) -> Removal:
        """Leave observations out, in increasing order: rows, or whitened coefficients where R is singular.

        The whitening of y₋ᵢ, with noise covariance σ² R₋ᵢ₋ᵢ, is that of all rows followed by the removal of directions
        a = W eᵢ, with log|R₋ᵢ₋ᵢ| = log|R| + log aᵀa. Where W is triangular and the start of each run stays, it is
        enough to leave rows of W out.
        """
        if self.n_all is not None:
            raise InputError(
                f"Leaving rows out needs all of them again, and the fit has read {self.n_all:,} rows in chunks: "
                "leave single rows of its sample out, scheme='loo' with max_refits=0; or fit streams with and without "
                "them, or as many rows as memory holds."
            )
        kept = np.delete(np.arange(self.n_white), out)
        if self.noise.local or not self.noise.square:
            return Removal(kept, None, 0.0)
        starts = self._starts(kept) if self.noise.triangular else None
        if starts is not None:
            return Removal(kept, None, self._log_det_of_starts(starts) - self.noise.log_det)
        unit = np.zeros((self.n_row, len(out)))
        unit[out, np.arange(len(out))] = 1.0
        directions, triangle = np.linalg.qr(self.whiten(unit))
        return Removal(kept, directions, 2 * float(np.sum(np.log(np.abs(np.diag(triangle))))))

    def log_det_of(self, kept: Int[np.ndarray, " n_kept"]) -> float:
        """Return log|R_AA| of the first rows A of each run."""
        starts = self._starts(np.sort(kept))
        assert starts is not None, "these rows are not the first ones of each run"
        return self._log_det_of_starts(starts)

    def _starts(self, kept: Int[np.ndarray, " n_kept"]) -> list[int] | None:
        """Return the number of rows of each run, if these are the first ones of each run; else None."""
        ends = np.cumsum(self.noise.run_lengths)
        of_runs = np.split(kept, np.searchsorted(kept, ends)[:-1])
        starts = ends - np.array(self.noise.run_lengths)
        first = all(np.array_equal(run, k + np.arange(len(run))) for k, run in zip(starts, of_runs, strict=True))
        return [len(run) for run in of_runs] if first else None

    def _log_det_of_starts(self, counts: Sequence[int]) -> float:
        if not sum(counts):
            return 0.0
        part = self.noise.restrict([(0, count) for count in counts])
        # Its R is rescaled to a mean diagonal of one.
        return part.log_det + 2 * sum(counts) * math.log(part.scale / self.noise.scale)
