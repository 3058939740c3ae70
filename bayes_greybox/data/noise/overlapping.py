"""Noise of rows that share samples with their neighbours: R is banded in each run, and differs along it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import block_diag, cholesky_banded

from .banded import triangular_solve
from .protocol import RowNoise, band_by_columns

LEAST_PIVOT_SHARE = 1e-10
"""Share of a row's variance below which its variance given the earlier rows counts as zero: they determine it."""


@dataclass(frozen=True, eq=False)
class OverlappingNoise(RowNoise):
    """Rows that are sums over overlapping stretches of noisy samples, W = L⁻¹ with R = L Lᵀ.

    Every operation costs O(n · bandwidth²) at most, but entries of R⁻¹, which cost O(n² · bandwidth).

    Attributes:
        bands: R of each run in lower banded form: row k holds the k-th subdiagonal; mean diagonal 1 over all runs.
        scale: See `RowNoise`.
    """

    kind: ClassVar[str] = "overlapping"
    derived: ClassVar[bool] = True
    bands: tuple[Float[np.ndarray, "_ _"], ...]
    scale: float = 1.0

    @property
    def run_lengths(self) -> tuple[int, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Rows of each run."""
        return tuple(band.shape[1] for band in self.bands)

    @cached_property
    def log_det(self) -> float:  # pyright: ignore[reportIncompatibleMethodOverride]
        """log|R| = Σ 2 log diag L."""
        return 2.0 * sum(float(np.sum(np.log(factor[0]))) for factor in self._factors)

    def whiten(self, rows: Float[np.ndarray, "n_obs k"]) -> Float[np.ndarray, "n_white k"]:
        """Return L⁻¹ rows."""
        return self._solve(rows, "N")

    def whiten_transpose(self, rows: Float[np.ndarray, "n_white k"]) -> Float[np.ndarray, "n_obs k"]:
        """Return L⁻ᵀ rows."""
        return self._solve(rows, "T")

    def precision_band(self, width: int) -> Float[np.ndarray, "n_obs width"]:
        """Return diagonals of R⁻¹, from its columns."""

        def band(factor: np.ndarray) -> np.ndarray:
            def inverse(unit: np.ndarray) -> np.ndarray:
                return triangular_solve(factor, triangular_solve(factor, unit, "N"), "T")

            return band_by_columns(inverse, factor.shape[1], width)

        return np.concatenate([np.zeros((0, width)), *map(band, self._factors)])

    def covariance(self) -> Float[np.ndarray, "n_obs n_obs"]:
        """Return R as a dense matrix."""
        blocks = []
        for band in self.bands:
            lower = np.zeros((band.shape[1], band.shape[1]))
            for k in range(len(band)):
                lower += np.diag(band[k, : band.shape[1] - k], -k)
            blocks.append(lower + lower.T - np.diag(band[0]))
        return np.asarray(block_diag(*blocks))

    def correlated(self, white: Float[np.ndarray, "n_draw n_obs"]) -> Float[np.ndarray, "n_draw n_obs"]:
        """Return L times the draws."""
        out, start = np.zeros_like(white), 0
        for factor in self._factors:
            n = factor.shape[1]
            for k in range(len(factor)):
                out[:, start + k : start + n] += white[:, start : start + n - k] * factor[k, : n - k]
            start += n
        return out

    def restrict(self, bounds: Sequence[tuple[int, int]]) -> "OverlappingNoise":
        """Return the noise of contiguous rows of each run; see `RowNoise.restrict`."""
        kept = []
        for band, (start, stop) in zip(self.bands, bounds, strict=True):
            if stop > start:
                part = band[: stop - start, start:stop].copy()
                # The last columns of a lower banded form have no entries of rows that are not there.
                for k in range(1, len(part)):
                    part[k, part.shape[1] - k :] = 0.0
                kept.append(part)
        return overlapping(kept, self.scale)

    @cached_property
    def _factors(self) -> tuple[Float[np.ndarray, "_ _"], ...]:
        return tuple(cholesky_banded(band, lower=True) for band in self.bands)

    def _solve(self, rows: np.ndarray, trans: str) -> np.ndarray:
        parts = np.split(rows, np.cumsum(self.run_lengths)[:-1])
        solved = [triangular_solve(f, part, trans) for f, part in zip(self._factors, parts, strict=True)]
        return np.concatenate(solved) if solved else rows


def overlapping(
    bands: Sequence[Float[np.ndarray, "_ _"]], scale: float = 1.0, mean: float | None = None
) -> OverlappingNoise:
    """Return noise that is rescaled to a mean diagonal of one.

    Args:
        bands: Covariance of the rows of each run over scale², in lower banded form.
        scale: See `RowNoise`.
        mean: Mean diagonal of a larger set of rows that is to be one; that of these rows by default.
    """
    mean = mean_diagonal(bands) if mean is None else mean
    return OverlappingNoise(tuple(band / mean for band in bands), scale * math.sqrt(mean))


def mean_diagonal(bands: Sequence[Float[np.ndarray, "_ _"]]) -> float:
    """Return the mean of the diagonals of lower bands; one if there are none."""
    n = sum(band.shape[1] for band in bands)
    return sum(float(np.sum(band[0])) for band in bands) / n if n else 1.0


def independent_rows(band: Float[np.ndarray, "_ n"]) -> Bool[np.ndarray, " n"]:
    """Mark the rows that earlier rows do not determine, from R in lower banded form; they are as many as its rank.

    Cholesky's factorisation, row by row, passes over a row with a pivot below `LEAST_PIVOT_SHARE` of its variance.
    """
    width, n = band.shape
    kept = np.zeros(n, bool)
    # Row i of L is in lower[i], its entry of column j at [j − i + width − 1].
    lower = np.zeros((n, width))
    for i in range(n):
        first = max(0, i - width + 1)
        for j in range(first, i):
            if not kept[j]:
                continue
            low = max(first, j - width + 1)
            left = lower[i, low - i + width - 1 : j - i + width - 1]
            right = lower[j, low - j + width - 1 : width - 1]
            lower[i, j - i + width - 1] = (band[i - j, j] - left @ right) / lower[j, width - 1]
        pivot = band[0, i] - float(np.sum(lower[i, : width - 1] ** 2))
        if pivot > LEAST_PIVOT_SHARE * band[0, i]:
            kept[i] = True
            lower[i, width - 1] = math.sqrt(pivot)
        else:
            lower[i] = 0.0
    return kept
