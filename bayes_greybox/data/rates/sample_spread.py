"""What a smoothed sample stands for: the states that its step passes through, and those that its noise allows.

Where a term jumps, as dry friction does, its value at one point per sample is not its mean around it: the crossing
falls somewhere between two samples, and near it the sign of a noisy state is a guess. By values at one point a rounded
jump fits better than the jump that is there. So near a jump values are means,

    φ̄_n = E φ(x_n + τ Δ_n + e),   τ ~ U(−½, ½),   e ~ N(0, diag s²),

with Δ_n what the columns change by to the next sample (τ > 0) or from the one before, and s what the filter leaves of
the samples' noise; e as of a classical error with a density of the states that is flat over s (Carroll et al. 2006,
Measurement Error in Nonlinear Models, section 4.1). Elsewhere, and where a term is smooth, the value at the sample is
right: over a step the filter's weights integrate it, to cubics.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import norm, qmc

Columns = Mapping[str, Float[np.ndarray, " n"]]
"""States and inputs at some samples, by name."""

Evaluate = Callable[[Columns], Float[np.ndarray, "n k"]]
"""From columns to values."""

MEAN_POINTS = 64
"""Points of a mean: a jump is crossed in steps of so many parts of it."""

NOISE_REACH = 2.5
"""Standard deviations of the noise at which a jump is looked for."""

JUMP = 0.5
"""Second difference over the reach from which on it is one of a jump, of the largest value there."""

BEND_PARTS = 16
"""Parts of the reach in which what bends is told from what is smooth."""

MOST_AVERAGED_AT_ONCE = 1_000_000
"""Values that are averaged at once, at most: memory."""

NEXT, LAST = " to the next sample", " from the last sample"
"""End the keys of what a column changes by; no name has a space."""


@dataclass(frozen=True, eq=False)
class SampleSpread:
    """The spread of samples.

    Attributes:
        noise: s by state, user's units; states without noise are left out.
        ahead: What each column changes by to the next sample; zero at the end of a run.
        behind: From the one before; zero at its start.
    """

    noise: Mapping[str, float]
    ahead: Columns
    behind: Columns

    @classmethod
    def of(cls, columns: Columns, run_lengths: Sequence[int], noise: Mapping[str, float]) -> "SampleSpread":
        """That of columns at all samples.

        Args:
            columns: Smoothed states and inputs.
            run_lengths: Samples of each run.
            noise: Standard deviation of what is left of a state's noise; zero or not finite where it is not known.
        """
        ends = np.cumsum(run_lengths)[:-1]
        steps = {
            name: [np.diff(part) for part in np.split(np.asarray(column, float), ends)]
            for name, column in columns.items()
        }
        known = {name: s for name, s in noise.items() if name in columns and 0 < s < np.inf}
        ahead = {name: np.concatenate([np.append(part, 0.0) for part in parts]) for name, parts in steps.items()}
        behind = {name: np.concatenate([[0.0, *part] for part in parts]) for name, parts in steps.items()}
        return cls(known, ahead, behind)

    def beside(self, columns: Columns) -> dict[str, np.ndarray]:
        """Columns at all samples with what they change by, to be taken in stretches."""
        return {
            **columns,
            **{name + NEXT: self.ahead[name] for name in columns},
            **{name + LAST: self.behind[name] for name in columns},
        }

    def mean(self, evaluate: Evaluate, columns: Columns, jumping: Evaluate | None = None) -> Float[np.ndarray, "n k"]:
        """Means φ̄ at some samples of terms that jump.

        Args:
            evaluate: From columns to values [n, k], each sample by itself.
            columns: Some samples of `beside`.
            jumping: What of these jumps, where they are sums with what does not; all of them by default.
        """
        x = {name: column for name, column in columns.items() if not name.endswith((NEXT, LAST))}
        value = np.array(evaluate(x), float)
        with np.errstate(all="ignore"):
            own = value if jumping is None else np.asarray(jumping(x), float)
            near = np.flatnonzero(np.any(self._near(jumping or evaluate, x, columns, own), axis=1))
            for some in np.array_split(
                near, -(-len(near) * MEAN_POINTS * value.shape[1] // MOST_AVERAGED_AT_ONCE) or 1
            ):
                if len(some):
                    around = np.reshape(evaluate(self._moved(x, columns, some)), (MEAN_POINTS, len(some), -1)).mean(
                        axis=0
                    )
                    # A term that ends nearby has no mean.
                    value[some] = np.where(np.isfinite(around), around, value[some])
        return value

    def bends(self, evaluate: Evaluate, columns: Columns) -> Float[np.ndarray, " n"]:
        """Largest second difference of one function within reach of each sample, 0 where it is that of a smooth one.

        In parts of 1/n of the reach that of a kink is 1/n, and that of a jump all of it; of what is smooth it is 1/n².

        Args:
            evaluate: From columns to its values [n, 1].
            columns: At all samples.
        """
        found = np.zeros(len(next(iter(columns.values()))))
        for first, other in self._ends(columns, self.beside(columns)):
            at = np.linspace(0.0, 1.0, 2 * BEND_PARTS + 1)
            values = [
                evaluate({name: (1 - a) * first[name] + a * other[name] for name in first})[:, 0] for a in at.tolist()
            ]
            whole = np.abs(values[0] + values[-1] - 2 * values[BEND_PARTS])
            # Of a kink off the middle of both parts that have it, a quarter is seen.
            part = np.max(
                [np.abs(a + c - 2 * b) for a, b, c in zip(values, values[1:], values[2:], strict=False)], axis=0
            )
            found = np.fmax(found, np.where(3 * BEND_PARTS * part > whole, whole, 0.0))
        return found

    def _near(self, evaluate: Evaluate, x: Columns, columns: Columns, value: np.ndarray) -> Bool[np.ndarray, "n k"]:
        """Whether a jump is within reach of a sample."""
        near = np.zeros(value.shape, bool)
        for first, other in self._ends(x, columns):
            a, b = np.asarray(evaluate(first)), np.asarray(evaluate(other))
            size = np.maximum(np.maximum(np.abs(a), np.abs(b)), np.abs(value))
            # What is not finite is not known to jump.
            near |= np.abs(a + b - 2 * value) > JUMP * size
        return near

    def _ends(self, x: Columns, columns: Columns) -> Iterator[tuple[dict[str, np.ndarray], dict[str, np.ndarray]]]:
        """Where samples may be, on either side of the step and of the noise of one state."""
        # One state's noise after the other: noise in all at once has no effect on what depends on a difference.
        for state in self.noise or [""]:
            for side in (1.0, -1.0) if self.noise else (0.0,):
                s = side * NOISE_REACH * self.noise.get(state, 0.0)
                first = {name: x[name] + columns[name + NEXT] / 2 + (s if name == state else 0.0) for name in x}
                other = {name: x[name] - columns[name + LAST] / 2 - (s if name == state else 0.0) for name in x}
                yield first, other

    def _moved(self, x: Columns, columns: Columns, at: np.ndarray) -> dict[str, np.ndarray]:
        """Columns at the points around some samples."""
        tau, e = self._points
        return {
            name: np.ravel(
                x[name][at]
                + np.where(tau > 0, tau, 0.0)[:, None] * columns[name + NEXT][at]
                + np.where(tau < 0, tau, 0.0)[:, None] * columns[name + LAST][at]
                + e.get(name, np.zeros(MEAN_POINTS))[:, None]
            )
            for name in x
        }

    @cached_property
    def _points(self) -> tuple[Float[np.ndarray, " n_point"], dict[str, Float[np.ndarray, " n_point"]]]:
        """τ, and e by state, each in the middles of equal parts of its probability; the same for all samples."""
        u = qmc.Sobol(1 + len(self.noise), scramble=False).random(MEAN_POINTS) + 0.5 / MEAN_POINTS
        return u[:, 0] - 0.5, {name: s * norm.ppf(u[:, 1 + k]) for k, (name, s) in enumerate(self.noise.items())}
