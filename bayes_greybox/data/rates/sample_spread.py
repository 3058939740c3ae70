"""Spread of a smoothed sample: the states that its step passes through, and those that its noise allows.

Where a term jumps, as dry friction does, its value at one point per sample is not its mean around it: the crossing
falls somewhere between two samples, and near it the sign of a noisy state is a guess. By values at one point a rounded
jump fits better than the jump that is there. So near a jump values are means,

    φ̄_n = E φ(x_n + τ Δ_n + e),   τ ~ U(−½, ½),   e ~ N(0, diag s²),

with Δ_n the change of the columns to the next sample (τ > 0) or from the one before, less the mean of τ Δ_n, so that
what is linear has its value at the sample, and s the noise of the samples that the filter leaves; e is a classical
error with a density of the states that is flat over s (Carroll et al. 2006, Measurement Error in Nonlinear Models,
section 4.1). Elsewhere, and where a term is smooth, the value at the sample is
right: over a step the filter's weights integrate it, to cubics.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.stats import norm, qmc

Columns = Mapping[str, Float[np.ndarray, " n"]]  # states and inputs at some samples, by name
Evaluate = Callable[[Columns], Float[np.ndarray, "n k"]]  # function from columns to values
MEAN_POINTS = 64  # points of a mean: it crosses a jump in so many steps
NOISE_REACH = 2.5  # standard deviations of the noise at which a jump is looked for
JUMP = 0.5  # second difference over a part of the reach, as a share of the largest value, from which a term jumps
BEND_PARTS = 16  # parts of the reach by which a kink is distinguished from a smooth curve
MOST_AVERAGED_AT_ONCE = 1_000_000  # largest number of values that are averaged at once, which bounds the memory
NEXT, LAST = " to the next sample", " from the last sample"  # endings of keys of changes; no name has a space


@dataclass(frozen=True, eq=False)
class SampleSpread:
    """Spread of samples."""

    noise: Mapping[str, float]  # s by state, user's units; states without noise are left out
    ahead: Columns  # change of each column to the next sample; zero at the end of a run
    behind: Columns  # change of each column from the sample before; zero at the start of a run

    @classmethod
    def of(cls, columns: Columns, run_lengths: Sequence[int], noise: Mapping[str, float]) -> "SampleSpread":
        """Return the spread of smoothed columns; noise that is zero or not finite is unknown and left out."""
        finite = {name: s for name, s in noise.items() if name in columns and 0 < s < np.inf}
        last = np.cumsum(run_lengths) - 1
        ahead = {name: np.diff(np.asarray(column, float), append=0.0) for name, column in columns.items()}
        for steps in ahead.values():
            steps[last] = 0.0
        return cls(finite, ahead, {name: np.roll(steps, 1) for name, steps in ahead.items()})

    def beside(self, columns: Columns) -> dict[str, np.ndarray]:
        """Return columns at all samples together with their changes, to be taken in stretches."""
        ahead = {name + NEXT: self.ahead[name] for name in columns}
        return {**columns, **ahead, **{name + LAST: self.behind[name] for name in columns}}

    def mean(self, evaluate: Evaluate, columns: Columns, jumping: Evaluate | None = None) -> Float[np.ndarray, "n k"]:
        """Return means φ̄ of jumping terms at some samples of `beside`.

        `jumping` has the parts [n, m] of them that jump, where they also have smooth ones: if one jumps, all are means.
        """
        x = {name: column for name, column in columns.items() if not name.endswith((NEXT, LAST))}
        value = np.array(evaluate(x), float)
        with np.errstate(all="ignore"):
            at_sample = value if jumping is None else np.asarray(jumping(x), float)
            jumps = self._near_jump(jumping or evaluate, x, columns, at_sample)
            if jumping is not None:
                jumps = np.any(jumps, axis=1, keepdims=True)
            near = np.flatnonzero(np.any(jumps, axis=1))
            n_value = len(near) * MEAN_POINTS * value.shape[1]
            for some in np.array_split(near, -(-n_value // MOST_AVERAGED_AT_ONCE) or 1):
                if len(some):
                    around = np.reshape(evaluate(self._moved(x, columns, some)), (MEAN_POINTS, len(some), -1))
                    mean = around.mean(axis=0)
                    # A term whose domain ends nearby has no mean.
                    value[some] = np.where(np.isfinite(mean) & jumps[some], mean, value[some])
        return value

    def bends(self, evaluate: Evaluate, columns: Columns) -> Float[np.ndarray, " n"]:
        """Return the largest second difference of a function [n, 1] within reach of each sample, 0 where it is smooth.

        Over 1/n of the reach, the second difference of a kink is 1/n of its size, that of a jump all of it, and that of
        a smooth function 1/n².
        """
        largest = np.zeros(len(next(iter(columns.values()))))
        for first, other in self._ends(columns, self.beside(columns)):
            middle = {name: (first[name] + other[name]) / 2 for name in first}
            values = [value[:, 0] for value in self._along(evaluate, first, middle, other)]
            whole = np.abs(values[0] + values[-1] - 2 * values[BEND_PARTS])
            # Of a kink off the middle of both parts that have it, a quarter is seen.
            part = _largest_bend(values)
            largest = np.fmax(largest, np.where(3 * BEND_PARTS * part > whole, whole, 0.0))
        return largest

    def _near_jump(self, evaluate: Evaluate, x: Columns, columns: Columns, value: np.ndarray) -> np.ndarray:
        """Return True where a jump is within reach of a sample."""
        near = np.zeros(value.shape, bool)
        for first, other in self._ends(x, columns):
            a, b = np.asarray(evaluate(first)), np.asarray(evaluate(other))
            size = np.maximum(np.maximum(np.abs(a), np.abs(b)), np.abs(value))
            # A comparison with a value that is not finite is false: no jump is assumed there.
            bent = np.abs(a + b - 2 * value) > JUMP * size
            rows = np.flatnonzero(np.any(bent, axis=1))
            if len(rows):
                # Any power bends by as much near its zero, over the reach; over a part of it only a jump does.
                ends = ({name: each[name][rows] for name in x} for each in (first, x, other))
                bent[rows] &= _largest_bend(self._along(evaluate, *ends)) > JUMP * size[rows]
            near |= bent
        return near

    def _ends(self, x: Columns, columns: Columns) -> Iterator[tuple[dict[str, np.ndarray], dict[str, np.ndarray]]]:
        """Yield pairs of points around each sample, on either side of its step and of the noise of one state."""
        # One state at a time: equal noise in all states would cancel in a term that depends on their difference.
        for state in self.noise or [""]:
            for side in (1.0, -1.0) if self.noise else (0.0,):
                s = side * NOISE_REACH * self.noise.get(state, 0.0)
                first = {name: x[name] + columns[name + NEXT] / 2 + (s if name == state else 0.0) for name in x}
                other = {name: x[name] - columns[name + LAST] / 2 - (s if name == state else 0.0) for name in x}
                yield first, other

    def _along(self, evaluate: Evaluate, first: Columns, middle: Columns, other: Columns) -> list[np.ndarray]:
        """Return values at the ends of equal parts of the way from one point to another by a third."""
        shares = np.linspace(0.0, 1.0, BEND_PARTS + 1).tolist()
        ways = [(first, middle, a) for a in shares] + [(middle, other, a) for a in shares[1:]]
        return [np.asarray(evaluate({name: (1 - a) * p[name] + a * q[name] for name in p})) for p, q, a in ways]

    def _moved(self, x: Columns, columns: Columns, at: np.ndarray) -> dict[str, np.ndarray]:
        """Return columns at the points around some samples, whose mean is the sample."""
        tau, e = self._points
        ahead, behind = (np.where(side * tau > 0, tau, 0.0) for side in (1, -1))
        ahead, behind = ahead - np.mean(ahead), behind - np.mean(behind)
        moved = {}
        for name in x:
            on = x[name][at] + ahead[:, None] * columns[name + NEXT][at] + behind[:, None] * columns[name + LAST][at]
            moved[name] = np.ravel(on + e.get(name, np.zeros(MEAN_POINTS))[:, None])
        return moved

    @cached_property
    def _points(self) -> tuple[Float[np.ndarray, " n_point"], dict[str, Float[np.ndarray, " n_point"]]]:
        """Return τ, and e by state, in the middles of equal parts of their probability; the same for all samples."""
        u = qmc.Sobol(1 + len(self.noise), scramble=False).random(MEAN_POINTS) + 0.5 / MEAN_POINTS
        return u[:, 0] - 0.5, {name: s * norm.ppf(u[:, 1 + k]) for k, (name, s) in enumerate(self.noise.items())}


def _largest_bend(values: Sequence[np.ndarray]) -> np.ndarray:
    """Return the largest second difference of successive values."""
    return np.max([np.abs(a + c - 2 * b) for a, b, c in zip(values, values[1:], values[2:], strict=False)], axis=0)
