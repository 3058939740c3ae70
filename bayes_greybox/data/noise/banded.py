"""Banded row noise: of finite filters, the same along each run, and of rows that share samples with neighbours."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import block_diag, cholesky_banded, get_lapack_funcs, toeplitz

from .protocol import WHITE_SHARE, RowNoise, band_by_columns, check_white_share


def fir_noise(
    taps: Float[np.ndarray, " n_tap"], order: int, run_lengths: Sequence[int], steps: Sequence[float],
    white_share: float = WHITE_SHARE,
) -> "BandedNoise":  # fmt: skip
    """Return the noise of rows computed by a finite impulse response filter, edges dropped.

    With G the filter's rows, G Gᵀ is banded Toeplitz with entries Σ_i c_i c_{i+k}. The `taps` are for unit sample
    spacing: a run with step h uses taps / h^order. Lengths count filtered rows.
    """
    autocovariance = np.correlate(taps, taps, mode="full")[len(taps) - 1 :]
    lengths = np.asarray(run_lengths, dtype=float)
    variances = autocovariance[0] / np.asarray(steps, dtype=float) ** (2 * order)
    mean = float(np.sum(lengths * variances) / np.sum(lengths))
    counts = tuple(int(n) for n in run_lengths)
    return BandedNoise(autocovariance / autocovariance[0], counts, variances / mean, math.sqrt(mean), white_share)


class _CholeskyNoise(RowNoise):
    """R of each run is its variance times L Lᵀ, with L in lower banded form; every operation costs O(n bandwidth²)."""

    run_variances: Float[np.ndarray, " n_run"]
    bands: tuple[Float[np.ndarray, "_ _"], ...]

    @cached_property
    def _factors(self) -> tuple[np.ndarray, ...]:
        return tuple(cholesky_banded(band, lower=True) for band in self.bands)

    @cached_property
    def log_det(self) -> float:  # pyright: ignore[reportIncompatibleMethodOverride]
        """log|R| = Σ 2 log diag L."""
        total = 0.0
        for factor, variance in zip(self._factors, self.run_variances, strict=True):
            total += 2.0 * float(np.sum(np.log(factor[0]))) + factor.shape[1] * math.log(variance)
        return total

    def whiten(self, rows: Float[np.ndarray, "n_obs k"]) -> Float[np.ndarray, "n_white k"]:
        """Return L⁻¹ rows."""
        return self._solve(rows, "N")

    def whiten_transpose(self, rows: Float[np.ndarray, "n_white k"]) -> Float[np.ndarray, "n_obs k"]:
        """Return L⁻ᵀ rows."""
        return self._solve(rows, "T")

    def _solve(self, rows: np.ndarray, trans: str) -> np.ndarray:
        parts = np.split(rows, np.cumsum(self.run_lengths)[:-1])
        each = zip(self._factors, parts, self.run_variances, strict=True)
        return np.concatenate([triangular_solve(factor, part, trans) / math.sqrt(v) for factor, part, v in each])


@dataclass(frozen=True, eq=False)
class BandedNoise(_CholeskyNoise):
    """Rows of a finite impulse response filter: R is banded Toeplitz in each run."""

    kind: ClassVar[str] = "banded"
    # Correlation of rows 0, 1, 2, … apart, before the white share; zero beyond.
    autocorrelation: Float[np.ndarray, " n_lag"]
    run_lengths: tuple[int, ...]
    # Diagonal of R in each run (differs only if the sample spacing does); row mean 1.
    run_variances: Float[np.ndarray, " n_run"]
    scale: float
    white_share: float = WHITE_SHARE  # δ

    def __post_init__(self) -> None:
        check_white_share(self.white_share)

    def precision_band(self, width: int) -> Float[np.ndarray, "n_obs width"]:
        """Return diagonals of R⁻¹ by the displacement structure of an inverse Toeplitz matrix.

        With x the first column of T⁻¹: (T⁻¹)_{i+1,j+1} = (T⁻¹)_{i,j} + (x_{i+1} x_{j+1} − x_{n−1−i} x_{n−1−j}) / x_0
        (Gohberg & Semencul 1972).
        """
        band, start = np.zeros((self.n_obs, width)), 0
        for factor, variance in zip(self._factors, self.run_variances, strict=True):
            n = factor.shape[1]
            x = triangular_solve(factor, triangular_solve(factor, np.eye(n, 1), "N"), "T")[:, 0]
            for k in range(min(width, n)):
                steps = (x[1 : n - k] * x[1 + k :] - x[:k:-1] * x[::-1][k : n - 1]) / x[0]
                band[start : start + n - k, k] = np.cumsum(np.concatenate([x[k : k + 1], steps])) / variance
            start += n
        return band

    def covariance(self) -> Float[np.ndarray, "n_obs n_obs"]:
        """Return R as a dense matrix."""
        blocks = [
            variance * toeplitz(np.pad(self._column, (0, n))[:n])
            for n, variance in zip(self.run_lengths, self.run_variances, strict=True)
        ]
        return np.asarray(block_diag(*blocks))

    def restrict(self, bounds: Sequence[tuple[int, int]]) -> "BandedNoise":
        """Return the noise of contiguous rows of each run; see `RowNoise.restrict`."""
        lengths = np.array([stop - start for start, stop in bounds])
        stay = lengths > 0
        variances = self.run_variances[stay]
        mean = float(np.sum(lengths[stay] * variances) / np.sum(lengths[stay]))
        kept = tuple(int(n) for n in lengths[stay])
        return replace(self, run_lengths=kept, run_variances=variances / mean, scale=self.scale * math.sqrt(mean))

    def thin(self, every: int) -> "BandedNoise":
        """Return the noise of every so many rows of each run, from its first on."""
        lengths = tuple(-(-n // every) for n in self.run_lengths)
        return replace(self, autocorrelation=self.autocorrelation[::every], run_lengths=lengths)

    @property
    def _column(self) -> Float[np.ndarray, " n_lag"]:
        column = (1.0 - self.white_share) * self.autocorrelation
        column[0] += self.white_share
        return column

    @cached_property
    def _factors(self) -> tuple[np.ndarray, ...]:
        bands = {n: self._column[:n] for n in set(self.run_lengths)}
        each = {n: cholesky_banded(np.repeat(band[:, None], n, axis=1), lower=True) for n, band in bands.items()}
        return tuple(each[n] for n in self.run_lengths)


def triangular_solve(factor: np.ndarray, rows: np.ndarray, trans: str) -> np.ndarray:
    """Return L⁻¹ rows or, for trans "T", L⁻ᵀ rows, with L in lower banded form."""
    (tbtrs,) = get_lapack_funcs(("tbtrs",), (factor,))
    solution, info = tbtrs(factor, rows, uplo="L", trans=trans, diag="N")
    if info != 0:
        raise np.linalg.LinAlgError(f"banded triangular solve failed (LAPACK info {info})")
    return solution


LEAST_PIVOT_SHARE = 1e-10  # share of its variance below which a row's pivot is zero: earlier rows determine it


@dataclass(frozen=True, eq=False)
class OverlappingNoise(_CholeskyNoise):
    """Rows that are sums over overlapping stretches of noisy samples; entries of R⁻¹ cost O(n² bandwidth)."""

    kind: ClassVar[str] = "overlapping"
    derived: ClassVar[bool] = True
    # R of each run in lower banded form: row k holds the k-th subdiagonal; mean diagonal 1 over all runs.
    bands: tuple[Float[np.ndarray, "_ _"], ...]
    scale: float = 1.0

    @property
    def run_lengths(self) -> tuple[int, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Rows of each run."""
        return tuple(band.shape[1] for band in self.bands)

    @property
    def run_variances(self) -> Float[np.ndarray, " n_run"]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Ones: variances are those of the bands."""
        return np.ones(len(self.bands))

    def precision_band(self, width: int) -> Float[np.ndarray, "n_obs width"]:
        """Return diagonals of R⁻¹, from its columns."""

        def band(factor: np.ndarray) -> np.ndarray:
            back = partial(triangular_solve, factor, trans="T")
            return band_by_columns(lambda x: back(triangular_solve(factor, x, "N")), factor.shape[1], width)

        return np.concatenate([np.zeros((0, width)), *map(band, self._factors)])

    def covariance(self) -> Float[np.ndarray, "n_obs n_obs"]:
        """Return R as a dense matrix."""
        lower = [sum(np.diag(row[: len(row) - k], -k) for k, row in enumerate(band)) for band in self.bands]
        return np.asarray(block_diag(*(each + np.tril(each, -1).T for each in lower)))

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


def overlapping(
    bands: Sequence[Float[np.ndarray, "_ _"]], scale: float = 1.0, mean: float | None = None
) -> OverlappingNoise:
    """Return noise of rows of these covariances over scale², in lower banded form; its `mean` diagonal becomes one."""
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
