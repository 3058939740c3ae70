"""What a smoothed sample stands for: the states that its step passes through, and those that its noise allows.

Where a term jumps, as dry friction does, its value at one point per sample is not its mean around it: the crossing
falls somewhere between two samples, and near it the sign of a noisy state is a guess. By values at one point a rounded
jump fits better than the jump that is there. So values are means,

    φ̄_n = E φ(x_n + τ Δ_n + e),   τ ~ U(−½, ½),   e ~ N(0, diag s²),

with Δ_n what the columns change by in one step and s what the filter leaves of the samples' noise; e as of a classical
error with a density of the states that is flat over s (Carroll et al. 2006, Measurement Error in Nonlinear Models,
section 4.1). A term that is smooth there has its value at the sample: over a step the filter's weights integrate it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.stats import norm, qmc

Columns = Mapping[str, Float[np.ndarray, " n"]]
"""States and inputs at some samples, by name."""

Evaluate = Callable[[Columns], Float[np.ndarray, "n k"]]
"""From columns to values."""

POINTS = 64
"""Points of a mean: a jump is crossed in steps of so many parts of it."""

REACH = 2.5
"""Standard deviations of the noise at which a jump is looked for."""

BENT = 0.05
"""Second difference over the reach, in RMS values of a term, from which on it is not smooth."""

STEP = " within a step"
"""Ends the key of what a column changes by; no name has a space."""


@dataclass(frozen=True, eq=False)
class SampleSpread:
    """The spread of samples.

    Attributes:
        noise: s by state, user's units; states without noise are left out.
        change: Δ by column, at all samples.
    """

    noise: Mapping[str, float]
    change: Columns

    @classmethod
    def of(cls, columns: Columns, run_lengths: Sequence[int], noise: Mapping[str, float]) -> "SampleSpread":
        """That of columns at all samples.

        Args:
            columns: Smoothed states and inputs.
            run_lengths: Samples of each run.
            noise: Standard deviation of what is left of a state's noise; zero or not finite where it is not known.
        """
        ends = np.cumsum(run_lengths)[:-1]
        change = {
            name: np.concatenate([_change(part) for part in np.split(np.asarray(column, float), ends)])
            for name, column in columns.items()
        }
        return cls({name: s for name, s in noise.items() if name in columns and 0 < s < np.inf}, change)

    def beside(self, columns: Columns) -> dict[str, np.ndarray]:
        """Columns at all samples with what they change by, to be taken in stretches."""
        return {**columns, **{name + STEP: change for name, change in self.change.items()}}

    def mean(self, evaluate: Evaluate, columns: Columns) -> Float[np.ndarray, "n k"]:
        """Means φ̄ at some samples.

        Args:
            evaluate: From columns to values [n, k], each sample by itself.
            columns: Some samples of `beside`.
        """
        x = {name: column for name, column in columns.items() if not name.endswith(STEP)}
        change = {name: columns[name + STEP] for name in x}
        value = np.array(evaluate(x), float)
        with np.errstate(all="ignore"):
            bent = self._bent(evaluate, x, change, value)
        if not np.any(bent):
            return value
        tau, e = self._points
        moved = {
            name: np.ravel(x[name][bent] + tau[:, None] * change[name][bent] + e.get(name, np.zeros(POINTS))[:, None])
            for name in x
        }
        with np.errstate(all="ignore"):
            around = np.mean(np.reshape(evaluate(moved), (POINTS, -1, value.shape[1])), axis=0)
        # A term that ends nearby has no mean.
        value[bent] = np.where(np.isfinite(around), around, value[bent])
        return value

    def _bent(
        self, evaluate: Evaluate, x: Columns, change: Columns, value: Float[np.ndarray, "n k"]
    ) -> Float[np.ndarray, " n"]:
        """Whether a sample has a term that is not smooth within its reach."""
        size = np.sqrt(np.mean(value**2, axis=0))
        bent = np.zeros(len(value), bool)
        # One state's noise after the other: noise in all at once has no effect on what depends on a difference.
        for state in self.noise or [""]:
            reach = {name: change[name] / 2 + (REACH * self.noise[name] if name == state else 0.0) for name in x}
            ahead, behind = (evaluate({name: x[name] + side * reach[name] for name in x}) for side in (1, -1))
            # What is not finite is not known to be bent.
            bent |= np.any(np.abs(ahead + behind - 2 * value) > BENT * size, axis=1)
        return bent

    @cached_property
    def _points(self) -> tuple[Float[np.ndarray, " n_point"], dict[str, Float[np.ndarray, " n_point"]]]:
        """τ, and e by state, each in the middles of equal parts of its probability; the same for all samples."""
        u = qmc.Sobol(1 + len(self.noise), scramble=False).random(POINTS) + 0.5 / POINTS
        return u[:, 0] - 0.5, {name: s * norm.ppf(u[:, 1 + k]) for k, (name, s) in enumerate(self.noise.items())}


def _change(column: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    return np.gradient(column) if len(column) > 1 else np.zeros_like(column)
