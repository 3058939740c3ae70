"""Rows whose path starts anywhere: noise of the sensor, and the freedom that a wide prior on the starts allows.

    R = R₀ + B Bᵀ

with R₀ the sensor's noise and B the rows' responses to the starts of their segments, scaled by
the starts' prior. With the singular vectors U and values s of W₀ B,

    W = (I + U ((1 + s²)^-½ − 1) Uᵀ) W₀,    log|R| = log|R₀| + Σ log(1 + s²).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from .forced_noise import ForcedNoise, Motion
from .protocol import RowNoise


@dataclass(frozen=True, eq=False)
class StartsNoise(RowNoise):
    """Noise of rows with unknown starts.

    Attributes:
        inner: R₀.
        starts: B [n_obs, n_start].
        motion: Function that returns the propagation of changes of the path, where it is known; called on first need.
        scale: See `RowNoise`.
    """

    kind: ClassVar[str] = "starts"
    unsaved: ClassVar[tuple[str, ...]] = ("motion",)
    # All rows of a run share its start.
    triangular: ClassVar[bool] = False
    inner: RowNoise
    starts: Float[np.ndarray, "n_obs n_start"]
    motion: Callable[[], Motion] | None = None
    scale: float = 1.0

    @property
    def run_lengths(self) -> tuple[int, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Rows of each run."""
        return self.inner.run_lengths

    @property
    def n_white(self) -> int:
        """Number of whitened rows of R₀."""
        return self.inner.n_white

    @cached_property
    def log_det(self) -> float:  # pyright: ignore[reportIncompatibleMethodOverride]
        """log|R₀| + Σ log(1 + s²)."""
        return self.inner.log_det + float(np.sum(np.log1p(self._svd[1] ** 2)))

    def whiten(self, rows: Float[np.ndarray, "n_obs k"]) -> Float[np.ndarray, "n_white k"]:
        """Return W rows."""
        return self._shrunk(self.inner.whiten(rows))

    def whiten_transpose(self, rows: Float[np.ndarray, "n_white k"]) -> Float[np.ndarray, "n_obs k"]:
        """Return Wᵀ rows."""
        return self.inner.whiten_transpose(self._shrunk(rows))

    def precision_band(self, width: int) -> Float[np.ndarray, "n_obs width"]:
        """Return entries (i, i + k), k < width, of R⁻¹ = W₀ᵀ (I − U s²/(1 + s²) Uᵀ) W₀."""
        U, s, _ = self._svd
        V = self.inner.whiten_transpose(U)
        band = self.inner.precision_band(width)
        run = np.repeat(np.arange(len(self.run_lengths)), self.run_lengths)
        for k in range(min(width, len(V))):
            n = len(V) - k
            band[:n, k] -= np.where(run[:n] == run[k:], (V[:n] * (s**2 / (1 + s**2)) * V[k:]).sum(axis=1), 0.0)
        return band

    def covariance(self) -> Float[np.ndarray, "n_obs n_obs"]:
        """Return R as a dense matrix."""
        return self.inner.covariance() + self.starts @ self.starts.T

    def correlated(self, white: Float[np.ndarray, "n_draw n_obs"]) -> Float[np.ndarray, "n_draw n_obs"]:
        """Return draws of the sensor's noise alone: starts are part of the prediction."""
        return self.inner.correlated(white)

    def without_starts(self, rows: Float[np.ndarray, "n_obs k"]) -> Float[np.ndarray, "n_obs k"]:
        """Return residuals less B b, b the posterior mean of the starts."""
        U, s, Vt = self._svd
        return rows - self.starts @ (Vt.T @ ((s / (1 + s**2))[:, None] * (U.T @ self.inner.whiten(rows))))

    @property
    def n_start(self) -> int:
        """Number of columns of B."""
        return self.starts.shape[1]

    def starts_given(
        self, rows: Float[np.ndarray, "n_obs k"], white: Float[np.ndarray, "n_start k"]
    ) -> tuple[Float[np.ndarray, "n_start k"], Float[np.ndarray, "n_obs k"]]:
        """Draw b ~ N(V s/(1 + s²) Uᵀ W₀ r, V (1 + s²)⁻¹ Vᵀ), and return r − B b with it."""
        U, s, Vt = self._svd
        mean = (s / (1 + s**2))[:, None] * (U.T @ self.inner.whiten(rows))
        # Where there are fewer rows than starts, the prior decides the other directions.
        white_in_rows = Vt @ white
        b = Vt.T @ (mean + white_in_rows / np.sqrt(1 + s**2)[:, None]) + white - Vt.T @ white_in_rows
        return b, rows - self.starts @ b

    @property
    def error(self) -> RowNoise:
        """R₀."""
        return self.inner

    def with_error(self, error: RowNoise) -> "StartsNoise":
        """Return the noise with another R₀."""
        return replace(self, inner=error)

    @property
    def intensities(self) -> Float[np.ndarray, " n"]:
        """Intensities of the motion; none where rows of the sensor are not independent."""
        return self.motion().intensities if self.motion is not None and self.inner.independent else np.zeros(0)

    def forced(self, intensity: float) -> RowNoise:
        """Return the same noise with an unknown force along the path."""
        assert self.motion is not None
        return ForcedNoise(self.inner, self.motion(), self.starts, intensity, self.scale)

    def restrict(self, bounds: Sequence[tuple[int, int]]) -> "StartsNoise":
        """Return the noise of contiguous rows of each run."""
        first = np.cumsum([0, *self.run_lengths])
        rows = np.concatenate([np.arange(first[i] + a, first[i] + b) for i, (a, b) in enumerate(bounds)])
        return StartsNoise(self.inner.restrict(bounds), self.starts[rows], scale=self.scale)

    @cached_property
    def _svd(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return np.linalg.svd(self.inner.whiten(self.starts), full_matrices=False)

    def _shrunk(self, rows: np.ndarray) -> np.ndarray:
        U, s, _ = self._svd
        return rows + U @ ((1 / np.sqrt(1 + s**2) - 1)[:, None] * (U.T @ rows))
