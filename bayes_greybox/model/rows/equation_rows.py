"""The rows of one equation: what a row says, and what noise is on it.

Everything that needs a target, its projection or its whitening asks `EquationRows`; a kind of rows is a constructor of
it.
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
"""Rows of a table that need never exist as a whole, by index."""

Evaluate = Callable[[Columns], Any]
"""From states and inputs at some samples to k values [n, k], by NumPy or JAX."""


@runtime_checkable
class Operator(Protocol):
    """V: from values at the samples to values of the rows, linear."""

    @property
    def sample(self) -> Int[np.ndarray, " n_row"]:
        """The sample of the data that each row is at."""
        ...

    @property
    def place(self) -> Int[np.ndarray, " n_row"]:
        """Where each row is among the columns that terms are evaluated on."""
        ...

    def __call__(self, table: Float[np.ndarray, "n_sample k"]) -> Float[np.ndarray, "n_row k"]:
        """V table."""
        ...

    def of(
        self, evaluate: Callable[[Columns], Float[np.ndarray, "n k"]], columns: Columns
    ) -> Float[np.ndarray, "n_row k"]:
        """V F, F evaluated a stretch of samples at a time.

        Args:
            evaluate: From columns [n] to F [n, k].
            columns: At all samples.
        """
        ...


def block_name(equations: Sequence[str]) -> str:
    """What rows are called that several equations share: "x_and_y", a name for variables; one has its own."""
    return "_and_".join(equations)


def nothing_left(target: float | np.floating, measured: float | np.floating) -> bool:
    """Whether a target is rounding errors of what was measured; norms of both over the same rows."""
    return bool(target <= 1e-13 * measured)


class Removal(NamedTuple):
    """What is left of the whitened rows without the targets of some observations.

    Attributes:
        kept: Observations that stay.
        directions: Orthonormal directions that leave the whitened rows, or None where rows leave.
        log_det: What log|R| changes by.
    """

    kept: Int[np.ndarray, " n_kept"]
    directions: Float[np.ndarray, "n_white n_out"] | None
    log_det: float


class Jumps(NamedTuple):
    """Values among others that may jump.

    Attributes:
        places: Of these, in their order.
        evaluate: These alone, from columns [n] to [n, len(places)].
        jumping: What of these jumps, where they are sums with what does not.
    """

    places: Sequence[int]
    evaluate: Evaluate
    jumping: Evaluate | None = None


class Acting(NamedTuple):
    """V for forces on one of the learned states that share rows.

    Attributes:
        operator: V.
        size: Of such forces, over that of the learned state with the largest.
    """

    operator: Operator
    size: float


class Unfollowed(NamedTuple):
    """An unknown force along a path that its model does not follow.

    Attributes:
        nats: That it gains over no such force.
        intensity: λ = q²/σ², σ the noise of a typical sensor.
        misfit: How far the path is from the samples, RMS over their spread; of several sensors the largest.
    """

    nats: float
    intensity: float
    misfit: float


ExactRows = Callable[
    [Callable[[Columns, int], Float[np.ndarray, "n n_learned"]], Float[np.ndarray, "n_draw n_start"]],
    Float[np.ndarray, "n_draw n_row"],
]
"""From what draws add to the rates of the learned states, by columns and the draw's number, and their starts, in units
of the rows' σ times those of `RowNoise.starts_given`, to rows without noise; user's units."""


@dataclass(frozen=True, eq=False)
class EquationRows:
    """The rows of one equation, y = V(Φθ + f) + ε, ε ~ N(0, σ² R), in user's units.

    Where several learned states k share the rows, y = Σ_k V_k Φ_k θ_k + ε.

    Attributes:
        equation: The learned state, or all together by `block_name`.
        columns: States and inputs at the samples, which Φ and f are evaluated on.
        measured: What was measured [n_row].
        simulated: What the simulation says of it [n_row], V g.
        noise: R, and W with W R Wᵀ = I.
        time: Time stamps of the rows.
        run: Number of the run of each row.
        operator: V, from values at the samples to values of the rows; None where each sample is a row.
        gain: What a sensor's unit was divided by to have the rows in the unit of the rate; 1 where they are rates.
        unfollowed: What the model does not follow of the path that the rows are taken at.
        learned: V of each learned state; empty where rows are of one alone.
        exact: Rows as they would be if they were not linear near a model, `ExactRows`; None where rows are linear.
        output: Whether rows are of an output, and not of a rate.
        n_all: How many rows a design has of which these are some; None where it has these.
        segments: Of each run of the path that the rows are taken at, each with a start of its own.
        spread: What a sample stands for; None where columns are evaluated at the very samples.
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
    learned: Mapping[str, "Acting"] = field(default_factory=dict)
    exact: "ExactRows | None" = None
    output: bool = False
    n_all: int | None = None
    segments: int = 1
    spread: SampleSpread | None = None

    @property
    def label(self) -> str:
        """What the equation gives: d(y)/dt, or an output itself."""
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
        """White numbers that the rows carry: the observations that count."""
        return self.noise.n_white

    @cached_property
    def target(self) -> Float[np.ndarray, " n_row"]:
        """y: what was measured less what is simulated."""
        return self.measured - self.simulated

    @property
    def shown(self) -> Float[np.ndarray, " n_row"]:
        """What was measured, in the unit of the sensor that showed it: the same whatever model the rows are near."""
        return self.measured * self.gain

    @property
    def nothing_left(self) -> bool:
        """Whether the simulation equals the measurement but for rounding errors."""
        return nothing_left(np.linalg.norm(self.target), np.linalg.norm(self.measured))

    @cached_property
    def scale(self) -> float:
        """RMS of the target, which the equation is scaled by.

        Raises:
            InputError: Nothing but rounding errors.
        """
        if self.nothing_left:
            raise self.nothing_to_learn()
        return float(np.sqrt(np.mean(self.target**2)))

    def nothing_to_learn(self) -> InputError:
        """The error for a simulation that equals the measurement."""
        measured = self.equation if self.output else f"derivative of {self.equation!r}"
        return InputError(f"The simulation equals the measured {measured} exactly: there is nothing to learn.")

    @property
    def n_sample(self) -> int:
        """Samples that terms are evaluated at."""
        return len(next(iter(self.columns.values())))

    @property
    def sample(self) -> Int[np.ndarray, " n_row"]:
        """The sample of the data that each row is at."""
        return np.arange(self.n_row) if self.operator is None else self.operator.sample

    def at(self, index: Int[np.ndarray, " n"] | slice) -> dict[str, Float[np.ndarray, " n"]]:
        """States and inputs at some samples."""
        return {name: column[index] for name, column in self.columns.items()}

    def at_rows(self) -> dict[str, Float[np.ndarray, " n_row"]]:
        """States and inputs where the rows are."""
        return self.at(slice(None) if self.operator is None else self.operator.place)

    def operate(self, table: Float[np.ndarray, "n_sample k"]) -> Float[np.ndarray, "n_row k"]:
        """V table: values of the rows from values at the samples."""
        return table if self.operator is None else self.operator(table)

    def at_samples(self, evaluate: Evaluate, jumps: "Jumps | None" = None) -> Float[np.ndarray, "n_sample k"]:
        """Values at the samples, or what these stand for; `operate` makes rows of them.

        Args:
            evaluate: From columns [n] to values [n, k].
            jumps: Which of these may jump.
        """
        values = np.array(evaluate(self.columns), float)
        if self.spread is not None and jumps is not None and jumps.places:
            values[:, jumps.places] = self.spread.mean(jumps.evaluate, self.spread.beside(self.columns), jumps.jumping)
        return values

    def table(self, evaluate: Evaluate, acts_on: Sequence[str] = (), jumps: "Jumps | None" = None) -> Table:
        """V F by index of the rows, F evaluated on columns; where V mixes samples, evaluated here in stretches.

        Args:
            evaluate: From columns [n] to F [n, k].
            acts_on: The learned state that each of the k acts on, where several share the rows.
            jumps: Which of the k may jump: a sample has what it stands for.
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
            own = np.array([each == name for each in acts_on])
            shared[:, own] = acting.operator.of(lambda at, own=own: np.asarray(evaluate(at))[:, own], self.columns)
        return lambda index: shared[index]

    def whiten(self, table: Float[np.ndarray, "n_row k"]) -> Float[np.ndarray, "n_white k"]:
        """W table."""
        return self.noise.whiten(table)

    def whitened(self, table: Table) -> Table:
        """W table, by index of the whitened rows; the very table where every row is whitened by itself."""
        if self.noise.local:
            return table
        white = self.noise.whiten(table(np.arange(self.n_row)))
        return lambda index: white[index]

    def weighted(self, table: Table) -> tuple[Table, Table]:
        """R⁻¹ table and diag R⁻¹ [n, 1] by index of the observations; W table and ones where W is not square."""
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
        """(R⁻¹)_FF of folds of observations, by their numbers.

        Args:
            folds: All that will be asked for, each in increasing order.
        """
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
        """Leave observations out: rows, or whitened coefficients where R is singular.

        Where the noise is correlated, y₋ᵢ has noise covariance σ² R₋ᵢ₋ᵢ. Its whitening is that of all rows followed by
        the removal of the directions a = W eᵢ, with log|R₋ᵢ₋ᵢ| = log|R| + log aᵀa, so R₋ᵢ₋ᵢ is never formed. Where the
        start of each run stays (whole runs, or the past), W is triangular, so it is enough to leave rows of W out.

        Args:
            out: Observations, in increasing order.

        Raises:
            InputError: A design with more rows than these, of which none can be taken out again.
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
        """log|R_AA| of the first rows A of each run."""
        starts = self._starts(np.sort(kept))
        if starts is None:
            raise ValueError("these rows are not the first ones of each run")
        return self._log_det_of_starts(starts)

    def _starts(self, kept: Int[np.ndarray, " n_kept"]) -> list[int] | None:
        """How many rows of each run these are, if they are the first ones of each run; else None."""
        counts, start = [], 0
        for n in self.noise.run_lengths:
            own = kept[(kept >= start) & (kept < start + n)]
            if not np.array_equal(own, start + np.arange(len(own))):
                return None
            counts.append(len(own))
            start += n
        return counts

    def _log_det_of_starts(self, counts: Sequence[int]) -> float:
        if not sum(counts):
            return 0.0
        part = self.noise.restrict([(0, count) for count in counts])
        # Its R is rescaled to a mean diagonal of one.
        return part.log_det + 2 * sum(counts) * math.log(part.scale / self.noise.scale)
