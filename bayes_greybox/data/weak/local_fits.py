"""Cubics through a few neighbours of each sample: what they say of a path under noise, and how many neighbours do.

The more neighbours, the less noise and the more of the path is missed. With noise of a known standard deviation s the
mean square error of the fits H x can be seen from the data alone (Stein 1981, Ann. Statist. 9:1135),

    mean (x − H x)² + 2 s² tr H / n − s².
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.data.runs.gaps import after_gaps

HALF_WIDTHS = (2, 3, 4, 5, 6, 8, 10, 13, 16, 20, 25, 32, 40, 50, 64, 80, 100, 125, 160, 200)
"""Neighbours on either side that are tried."""

FEWEST_FITS = 8
"""A stretch holds at least so many windows of the widest that is tried."""

MOST_FITS = 2000
"""Samples, evenly thinned, at which widths are compared."""

WEIGHTS_AT_ONCE = 200_000
"""Weights worked out at once."""


@dataclass(frozen=True)
class Stretch:
    """Samples of one run without a gap.

    Attributes:
        run: Number of the run.
        rows: First sample, and the one after the last.
    """

    run: int
    rows: tuple[int, int]


def stretches(time: Float[np.ndarray, " n"], run_lengths: Sequence[int]) -> list[Stretch]:
    """Runs, parted at gaps.

    Args:
        time: Times of the samples.
        run_lengths: Samples of each run.
    """
    found, start = [], 0
    for run, n in enumerate(run_lengths):
        edges = [0, *after_gaps(time[start : start + n], usual=0.5), n]
        found += [Stretch(run, (start + a, start + b)) for a, b in zip(edges[:-1], edges[1:], strict=True)]
        start += n
    return found


@dataclass(frozen=True, eq=False)
class LocalFits:
    """Cubics of one width, at every sample.

    Attributes:
        neighbours: Samples of each fit.
        value: Weights of the neighbours in the fit's value at the sample.
        slope: The same in its slope.
        leverage: Weight of the sample itself.
    """

    neighbours: Int[np.ndarray, "n m"]
    value: Float[np.ndarray, "n m"]
    slope: Float[np.ndarray, "n m"]
    leverage: Float[np.ndarray, " n"]

    @classmethod
    def of(
        cls,
        time: Float[np.ndarray, " n"],
        parts: Sequence[Stretch],
        half_width: int,
        at: Int[np.ndarray, " m"] | None = None,
    ) -> "LocalFits":
        """Fits over so many neighbours on either side; as many on one side where a stretch ends.

        Args:
            time: Times of the samples.
            parts: Stretches, which no fit reaches beyond.
            half_width: Neighbours on either side.
            at: Samples at which fits are wanted; all by default.
        """
        width = 2 * half_width + 1
        at = np.arange(len(time)) if at is None else at
        neighbours, own = np.zeros((len(at), width), int), np.ones((len(at), width), bool)
        for part in parts:
            start, stop = part.rows
            inside = slice(*np.searchsorted(at, (start, stop)))
            k = min(width, stop - start)
            first = np.clip(at[inside] - k // 2, start, stop - k)
            neighbours[inside] = np.minimum(first[:, None] + np.arange(width), stop - 1)
            own[inside, k:] = False
        value, slope = np.zeros(neighbours.shape), np.zeros(neighbours.shape)
        for rows in np.array_split(np.arange(len(at)), max(1, neighbours.size // WEIGHTS_AT_ONCE)):
            value[rows], slope[rows] = _weights(time[neighbours[rows]] - time[at[rows], None], own[rows])
        itself = (neighbours == at[:, None]) & own
        return cls(neighbours, value, slope, np.sum(np.where(itself, value, 0.0), axis=1))

    def smooth(self, column: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n_fit"]:
        """H x."""
        return np.sum(self.value * column[self.neighbours], axis=1)

    def rate(self, column: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n_fit"]:
        """Slopes of the fits."""
        return np.sum(self.slope * column[self.neighbours], axis=1)


def chosen_half_widths(
    time: Float[np.ndarray, " n"], columns: Float[np.ndarray, "n k"], noise: Float[np.ndarray, " k"],
    parts: Sequence[Stretch],
) -> tuple[int, ...]:  # fmt: skip
    """Neighbours on either side with the least mean square error that the data show, column by column.

    Args:
        time: Times of the samples.
        columns: Samples.
        noise: s of each column.
        parts: Stretches.
    """
    longest = max(part.rows[1] - part.rows[0] for part in parts)
    at = np.unique(np.linspace(0, len(time) - 1, MOST_FITS).astype(int))
    tried = [m for m in HALF_WIDTHS if m == HALF_WIDTHS[0] or longest >= FEWEST_FITS * (2 * m + 1)]
    errors = []
    for half_width in tried:
        fits = LocalFits.of(time, parts, half_width, at)
        left = np.array([np.mean((x[at] - fits.smooth(x)) ** 2) for x in columns.T])
        errors.append(left + 2 * noise**2 * np.mean(fits.leverage))
    return tuple(tried[k] for k in np.argmin(errors, axis=0))


def _weights(offset: np.ndarray, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights of the value and of the slope of least-squares cubics at offset zero; of fewer samples lower degrees."""
    size = np.max(np.abs(np.where(own, offset, 0.0)), axis=1)
    size = np.where(size > 0, size, 1.0)
    u = np.where(own, offset / size[:, None], 0.0)
    count = own.sum(axis=1)
    A = np.stack([np.where(own & (count > degree)[:, None], u**degree, 0.0) for degree in range(4)], axis=-1)
    # The pseudo-inverse of a polynomial in −1 … 1 of degree three is harmless by its Gram matrix.
    gram = np.einsum("nmi,nmj->nij", A, A)
    gram = gram + np.einsum("ni,ij->nij", (count[:, None] <= np.arange(4)).astype(float), np.eye(4))
    solved = np.einsum("nij,nmj->nmi", np.linalg.inv(gram), A)
    return solved[..., 0], solved[..., 1] / size[:, None]
