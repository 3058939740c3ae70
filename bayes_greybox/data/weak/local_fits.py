"""Cubics through a few neighbours of each sample: estimates of a path under noise, and the best number of neighbours.

More neighbours average more noise away and lose more of the path. With noise of a known standard deviation s the
mean square error of the fits H x can be estimated from the data alone (Stein 1981, Ann. Statist. 9:1135),

    mean (x − H x)² + 2 s² tr H / n − s².
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.data.runs.gaps import after_gaps

HALF_WIDTHS = (2, 3, 4, 5, 6, 8, 10, 13, 16, 20, 25, 32, 40, 50, 64, 80, 100, 125, 160, 200)
"""Numbers of neighbours on either side that are tried."""

FEWEST_FITS = 8
"""Windows that a stretch holds at least for a width to be tried."""

MOST_FITS = 2000
"""Samples, evenly thinned, at which widths are compared."""

WEIGHTS_AT_ONCE = 200_000
"""Weights that are computed at once."""


@dataclass(frozen=True)
class Stretch:
    """Samples of one run without a gap: its number, the first row, and the row behind the last."""

    run: int
    rows: tuple[int, int]


def stretches(time: Float[np.ndarray, " n"], run_lengths: Sequence[int]) -> list[Stretch]:
    """Return the runs, parted at gaps."""
    parts, start = [], 0
    for run, n in enumerate(run_lengths):
        edges = [0, *after_gaps(time[start : start + n], usual=0.5), n]
        parts += [Stretch(run, (start + a, start + b)) for a, b in zip(edges[:-1], edges[1:], strict=True)]
        start += n
    return parts


@dataclass(frozen=True, eq=False)
class LocalFits:
    """Cubics of one width, at every sample.

    Attributes:
        neighbours: Samples of each fit.
        value: Weights of the neighbours in the fit's value at the sample.
        slope: Weights of the neighbours in the fit's slope at the sample.
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
        """Fit over so many neighbours on either side; at the end of a stretch the window lies on one side.

        No fit reaches beyond its stretch. `at` are the samples at which fits are wanted, all by default.
        """
        width = 2 * half_width + 1
        at = np.arange(len(time)) if at is None else at
        neighbours, used = np.zeros((len(at), width), int), np.ones((len(at), width), bool)
        for part in parts:
            start, stop = part.rows
            inside = slice(*np.searchsorted(at, (start, stop)))
            k = min(width, stop - start)
            first = np.clip(at[inside] - k // 2, start, stop - k)
            neighbours[inside] = np.minimum(first[:, None] + np.arange(width), stop - 1)
            used[inside, k:] = False
        value, slope = np.zeros(neighbours.shape), np.zeros(neighbours.shape)
        for rows in np.array_split(np.arange(len(at)), max(1, neighbours.size // WEIGHTS_AT_ONCE)):
            value[rows], slope[rows] = _weights(time[neighbours[rows]] - time[at[rows], None], used[rows])
        itself = (neighbours == at[:, None]) & used
        return cls(neighbours, value, slope, np.sum(np.where(itself, value, 0.0), axis=1))

    def smooth(self, column: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n_fit"]:
        """Return H x."""
        return np.sum(self.value * column[self.neighbours], axis=1)

    def rate(self, column: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n_fit"]:
        """Return the slopes of the fits."""
        return np.sum(self.slope * column[self.neighbours], axis=1)


def chosen_half_widths(
    time: Float[np.ndarray, " n"], columns: Float[np.ndarray, "n k"], noise: Float[np.ndarray, " k"],
    parts: Sequence[Stretch],
) -> tuple[int, ...]:  # fmt: skip
    """Choose the number of neighbours on either side with the least estimated mean square error, column by column.

    The noise is s of each column.
    """
    longest = max(part.rows[1] - part.rows[0] for part in parts)
    at = np.unique(np.linspace(0, len(time) - 1, MOST_FITS).astype(int))
    tried = [m for m in HALF_WIDTHS if m == HALF_WIDTHS[0] or longest >= FEWEST_FITS * (2 * m + 1)]
    errors = []
    for half_width in tried:
        fits = LocalFits.of(time, parts, half_width, at)
        square = np.array([np.mean((x[at] - fits.smooth(x)) ** 2) for x in columns.T])
        errors.append(square + 2 * noise**2 * np.mean(fits.leverage))
    return tuple(tried[k] for k in np.argmin(errors, axis=0))


def _weights(offset: np.ndarray, used: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return weights of value and slope of least-squares cubics at offset zero; of fewer samples lower degrees."""
    size = np.max(np.abs(np.where(used, offset, 0.0)), axis=1)
    size = np.where(size > 0, size, 1.0)
    u = np.where(used, offset / size[:, None], 0.0)
    count = used.sum(axis=1)
    A = np.stack([np.where(used & (count > degree)[:, None], u**degree, 0.0) for degree in range(4)], axis=-1)
    # Normal equations are harmless for a polynomial of degree three in −1 … 1.
    gram = np.einsum("nmi,nmj->nij", A, A)
    gram = gram + np.einsum("ni,ij->nij", (count[:, None] <= np.arange(4)).astype(float), np.eye(4))
    solved = np.einsum("nij,nmj->nmi", np.linalg.inv(gram), A)
    return solved[..., 0], solved[..., 1] / size[:, None]
