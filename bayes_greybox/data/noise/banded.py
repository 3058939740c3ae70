"""Row noise of finite filters: banded, the same along each run."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag, cholesky_banded, get_lapack_funcs, toeplitz

from .protocol import WHITE_SHARE, RowNoise, check_white_share


def fir_noise(
    taps: Float[np.ndarray, " n_tap"],
    order: int,
    run_lengths: Sequence[int],
    steps: Sequence[float],
    white_share: float = WHITE_SHARE,
) -> "BandedNoise":
    """Return the noise of rows computed by a finite impulse response filter, edges dropped.

    With G the filter's rows, G Gᵀ is banded Toeplitz with entries Σ_i c_i c_{i+k}.

    Args:
        taps: taps for unit sample spacing; a run with step h uses taps / h^order.
        order: order of the derivative.
        run_lengths: filtered rows of each run.
        steps: sample spacing of each run.
        white_share: δ.
    """
    autocovariance = np.correlate(taps, taps, mode="full")[len(taps) - 1 :]
    lengths = np.asarray(run_lengths, dtype=float)
    variances = autocovariance[0] / np.asarray(steps, dtype=float) ** (2 * order)
    mean = float(np.sum(lengths * variances) / np.sum(lengths))
    return BandedNoise(
        autocorrelation=autocovariance / autocovariance[0],
        run_lengths=tuple(int(n) for n in run_lengths),
        run_variances=variances / mean,
        scale=math.sqrt(mean),
        white_share=white_share,
    )


@dataclass(frozen=True, eq=False)
class BandedNoise(RowNoise):
    """Rows of a finite impulse response filter: R is banded Toeplitz in each run, W = L⁻¹ with R = L Lᵀ.

    Every operation costs O(n · bandwidth²) at most.

    Attributes:
        autocorrelation: correlation of rows 0, 1, 2, … apart, before the white share; zero beyond.
        run_lengths: rows of each run.
        run_variances: diagonal of R in each run (differs only if the sample spacing does); row mean 1.
        scale: see `RowNoise`.
        white_share: δ.
    """

    kind: ClassVar[str] = "banded"
    autocorrelation: Float[np.ndarray, " n_lag"]
    run_lengths: tuple[int, ...]
    run_variances: Float[np.ndarray, " n_run"]
    scale: float
    white_share: float = WHITE_SHARE

    def __post_init__(self) -> None:
        check_white_share(self.white_share)

    @cached_property
    def log_det(self) -> float:  # pyright: ignore[reportIncompatibleMethodOverride]
        """log|R| = Σ 2 log diag L."""
        total = 0.0
        for n, variance in zip(self.run_lengths, self.run_variances, strict=True):
            total += 2.0 * float(np.sum(np.log(self._factors[n][0]))) + n * math.log(variance)
        return total

    def whiten(self, rows: Float[np.ndarray, "n_obs k"]) -> Float[np.ndarray, "n_white k"]:
        """Return L⁻¹ rows."""
        return self._solve(rows, trans="N")

    def whiten_transpose(self, rows: Float[np.ndarray, "n_white k"]) -> Float[np.ndarray, "n_obs k"]:
        """Return L⁻ᵀ rows."""
        return self._solve(rows, trans="T")

    def precision_band(self, width: int) -> Float[np.ndarray, "n_obs width"]:
        """Return diagonals of R⁻¹ by the displacement structure of an inverse Toeplitz matrix.

        With x the first column of T⁻¹: (T⁻¹)_{i+1,j+1} = (T⁻¹)_{i,j} + (x_{i+1} x_{j+1} − x_{n−1−i} x_{n−1−j}) / x_0
        (Gohberg & Semencul 1972).
        """
        band, start = np.zeros((self.n_obs, width)), 0
        for n, variance in zip(self.run_lengths, self.run_variances, strict=True):
            half = triangular_solve(self._factors[n], np.eye(n, 1), "N")
            x = triangular_solve(self._factors[n], half, "T")[:, 0]
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
    def _factors(self) -> dict[int, np.ndarray]:
        """Lower banded Cholesky factor of the unit-variance block, for each length of run."""
        return {n: _toeplitz_cholesky(self._column, n) for n in set(self.run_lengths)}

    def _solve(self, rows: np.ndarray, trans: str) -> np.ndarray:
        out, start = [], 0
        for n, variance in zip(self.run_lengths, self.run_variances, strict=True):
            block = rows[start : start + n]
            out.append(triangular_solve(self._factors[n], block, trans) / math.sqrt(variance))
            start += n
        return np.concatenate(out)


def _toeplitz_cholesky(column: np.ndarray, n: int) -> np.ndarray:
    """Return the banded Cholesky factor, lower form: row k holds the k-th subdiagonal."""
    band = column[: min(len(column), n)]
    return cholesky_banded(np.repeat(band[:, None], n, axis=1), lower=True)


def triangular_solve(factor: np.ndarray, rows: np.ndarray, trans: str) -> np.ndarray:
    """Return L⁻¹ rows or, for trans "T", L⁻ᵀ rows, with L in lower banded form."""
    (tbtrs,) = get_lapack_funcs(("tbtrs",), (factor,))
    solution, info = tbtrs(factor, rows, uplo="L", trans=trans, diag="N")
    if info != 0:
        raise np.linalg.LinAlgError(f"banded triangular solve failed (LAPACK info {info})")
    return solution
