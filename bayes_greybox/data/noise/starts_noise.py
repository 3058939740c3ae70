"""Rows of samples whose path starts anywhere, and may be moved by an unknown force.

The freedom that a wide prior on the starts allows, beside the sensor's noise R₀, is R = R₀ + B Bᵀ, with B the rows'
responses to the starts of their segments, scaled by the starts' prior. With singular vectors U and values s of W₀ B,

    W = (I + U ((1 + s²)^-½ − 1) Uᵀ) W₀,    log|R| = log|R₀| + Σ log(1 + s²).

A force, white in time, acts on a state's rate, and the system answers it. Between samples a small change δ of the path
goes on by δ₊ = M δ + w, w ~ N(0, λσ² G), from anywhere at the start of a segment; a row is one state of it with the
sensor's noise of variance σ² r. The innovations of the Kalman filter are the whitened rows, the same gains for every
column (de Jong 1989, Biometrika 76:663, for R⁻¹).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from bayes_greybox.running.errors import InputError

from .protocol import RowNoise, band_by_columns, rows_within


class Motion(NamedTuple):
    """Propagation of changes of a path from sample to sample, samples in order of time within their segment."""

    # Transition from the sample before; for the first sample of a segment, from the segment's start.
    M: Float[np.ndarray, "n d d"]
    G: Float[np.ndarray, "n d d"]  # covariance that a force of unit intensity adds on the way, over that of the rows
    fresh: Bool[np.ndarray, " n"]  # true for the first sample of each segment
    outputs: tuple[int, ...]  # indices of the states that have a sensor; rows are ordered by sensor, then by sample
    # Prior standard deviation of each state at the start of a segment, in the rows' unit.
    start_sd: Float[np.ndarray, " d"]
    # λ that are worth trying, from hardly anything to a force as large as the path's own.
    intensities: Float[np.ndarray, " n_intensity"]


@dataclass(frozen=True, eq=False)
class ForcedNoise(RowNoise):
    """Noise of sensors, of the starts of segments, and of an unknown force along the path."""

    kind: ClassVar[str] = "forced"
    sensor: RowNoise  # noise of the sensors alone, of independent rows
    motion: Motion
    starts: Float[np.ndarray, "n_obs n_start"]  # change of the rows by one prior standard deviation of each start
    intensity: float  # λ
    scale: float = 1.0

    @property
    def run_lengths(self) -> tuple[int, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Rows of each run."""
        return self.sensor.run_lengths

    @cached_property
    def log_det(self) -> float:  # pyright: ignore[reportIncompatibleMethodOverride]
        """log|R| = Σ log S, S the variances of the innovations."""
        return float(np.sum(np.log(self._gains[1])))

    def whiten(self, rows: Float[np.ndarray, "n_obs k"]) -> Float[np.ndarray, "n_white k"]:
        """Return the innovations over their standard deviations."""
        K, S = self._gains
        return self._by_row(self._filter.innovations(self.motion, K, self._by_sample(rows)) / np.sqrt(S)[..., None])

    def whiten_transpose(self, rows: Float[np.ndarray, "n_white k"]) -> Float[np.ndarray, "n_obs k"]:
        """Run the adjoint of the filter backwards."""
        K, S = self._gains
        return self._by_row(self._filter.adjoint(self.motion, K, self._by_sample(rows) / np.sqrt(S)[..., None]))

    def precision_diagonal(self) -> Float[np.ndarray, " n_obs"]:
        """Return 1/S + Kᵀ N K, N the covariance of the adjoint."""
        return self._filter.precision_diagonal(self.motion, *self._gains).T.ravel()

    def precision_band(self, width: int) -> Float[np.ndarray, "n_obs width"]:
        """Return entries of R⁻¹, a few of its columns at a time."""
        band = band_by_columns(lambda unit: self.whiten_transpose(self.whiten(unit)), self.n_obs, width)
        run = np.repeat(np.arange(len(self.run_lengths)), self.run_lengths)
        for lag in range(1, min(width, self.n_obs)):
            band[: self.n_obs - lag, lag] *= run[: self.n_obs - lag] == run[lag:]
        return band

    def covariance(self) -> Float[np.ndarray, "n_obs n_obs"]:
        """Return R as a dense matrix."""
        inverse = np.linalg.inv(self.whiten(np.eye(self.n_obs)))
        return inverse @ inverse.T

    def correlated(self, white: Float[np.ndarray, "n_draw n_obs"]) -> Float[np.ndarray, "n_draw n_obs"]:
        """Return draws of the sensors' noise alone: where the path goes is part of the prediction."""
        return self.sensor.correlated(white)

    def without_starts(self, rows: Float[np.ndarray, "n_obs k"]) -> Float[np.ndarray, "n_obs k"]:
        """Return residuals less B Bᵀ R⁻¹ of them, the posterior mean of the effect of the starts."""
        return rows - self.starts @ (self.starts.T @ self.whiten_transpose(self.whiten(rows)))

    @property
    def sensors(self) -> RowNoise:
        """Noise of the sensors alone."""
        return self.sensor

    def restrict(self, bounds: Sequence[tuple[int, int]]) -> "ForcedNoise":
        """Refuse: the effect that a force had before a part of a run is not known within that part."""
        raise InputError("Rows of a path that an unknown force moves cannot be parted: leave out whole runs.")

    @property
    def _filter(self) -> Any:
        from . import innovations  # imported here: it brings JAX, which data do without

        return innovations

    @cached_property
    def _gains(self) -> tuple[Float[np.ndarray, "n n_output d"], Float[np.ndarray, "n n_output"]]:
        """Gains and variances of the innovations, sensor by sensor."""
        variances = self._by_sample(1 / self.sensor.precision_diagonal()[:, None])[..., 0]
        return self._filter.gains(self.motion, variances, self.intensity)

    def _by_sample(self, rows: np.ndarray) -> np.ndarray:
        """Reshape rows to [sample, sensor, column]."""
        return rows.reshape(len(self.motion.outputs), -1, rows.shape[1]).swapaxes(0, 1)

    def _by_row(self, by_sample: np.ndarray) -> np.ndarray:
        return by_sample.swapaxes(0, 1).reshape(-1, by_sample.shape[-1])


@dataclass(frozen=True, eq=False)
class StartsNoise(RowNoise):
    """Noise of rows with unknown starts."""

    kind: ClassVar[str] = "starts"
    unsaved: ClassVar[tuple[str, ...]] = ("motion",)
    # All rows of a run share its start.
    triangular: ClassVar[bool] = False
    inner: RowNoise  # R₀
    starts: Float[np.ndarray, "n_obs n_start"]  # B
    # Function that returns the propagation of changes of the path, where it is known; called on first need.
    motion: Callable[[], Motion] | None = None
    scale: float = 1.0

    @property
    def run_lengths(self) -> tuple[int, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Rows of each run."""
        return self.inner.run_lengths

    @property
    def white_lengths(self) -> tuple[int, ...]:
        """Number of whitened rows of each run of R₀."""
        return self.inner.white_lengths

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
        starts = self.starts[rows_within(self.run_lengths, bounds)]
        return StartsNoise(self.inner.restrict(bounds), starts, scale=self.scale)

    @cached_property
    def _svd(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return np.linalg.svd(self.inner.whiten(self.starts), full_matrices=False)

    def _shrunk(self, rows: np.ndarray) -> np.ndarray:
        U, s, _ = self._svd
        return rows + U @ ((1 / np.sqrt(1 + s**2) - 1)[:, None] * (U.T @ rows))
