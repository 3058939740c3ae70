"""White noise, as is assumed of measured rates, and rows of unequal noise: R = D^½ R₀ D^½, with D known row by row."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.running.errors import InputError

from .protocol import RowNoise, Sequences, rows_within


@dataclass(frozen=True)
class WhiteNoise(RowNoise):
    """R = I: every row is its own whitened row."""

    kind: ClassVar[str] = "white"
    unsaved: ClassVar[tuple[str, ...]] = ("scale",)
    local: ClassVar[bool] = True
    run_lengths: tuple[int, ...]
    scale: float = 1.0

    @property
    def log_det(self) -> float:
        """log|I| = 0."""
        return 0.0

    def whiten(self, rows: Float[np.ndarray, "n_obs k"]) -> Float[np.ndarray, "n_white k"]:
        """Return the rows themselves."""
        return rows

    def whiten_transpose(self, rows: Float[np.ndarray, "n_white k"]) -> Float[np.ndarray, "n_obs k"]:
        """Return the rows themselves."""
        return rows

    def precision_band(self, width: int) -> Float[np.ndarray, "n_obs width"]:
        """Return ones on the diagonal."""
        return np.eye(1, width).repeat(self.n_obs, axis=0)

    def precision_at(self, index: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n n"]:
        """Return the identity."""
        return np.eye(len(index))

    def covariance(self) -> Float[np.ndarray, "n_obs n_obs"]:
        """Return the identity."""
        return np.eye(self.n_obs)

    def correlated(self, white: Float[np.ndarray, "n_draw n_obs"]) -> Float[np.ndarray, "n_draw n_obs"]:
        """Return the draws themselves."""
        return white

    def restrict(self, bounds: Sequence[tuple[int, int]]) -> "WhiteNoise":
        """Return the noise of contiguous rows of each run."""
        return WhiteNoise(tuple(stop - start for start, stop in bounds if stop > start))


@dataclass(frozen=True, eq=False)
class WeightedNoise(RowNoise):
    """Noise whose standard deviation differs from row to row."""

    kind: ClassVar[str] = "weighted"
    inner: RowNoise  # R₀, the noise of rows of equal variance
    sd: Float[np.ndarray, " n_obs"]  # roots of the diagonal of D, over the σ of the model [n_obs]
    scale: float = 1.0

    def __post_init__(self) -> None:
        if self.sd.shape != (self.inner.n_obs,) or not np.all((self.sd > 0) & np.isfinite(self.sd)):
            raise InputError("Weighted noise needs one finite standard deviation above 0 for each row.")

    @property
    def run_lengths(self) -> tuple[int, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Rows of each run."""
        return self.inner.run_lengths

    @property
    def independent(self) -> bool:
        """True if R₀ is diagonal."""
        return self.inner.independent

    @property
    def white_lengths(self) -> tuple[int, ...]:
        """Number of whitened rows of each run of R₀."""
        return self.inner.white_lengths

    @cached_property
    def log_det(self) -> float:  # pyright: ignore[reportIncompatibleMethodOverride]
        """log|R₀| + 2 Σ log sd."""
        return self.inner.log_det + 2 * float(np.sum(np.log(self.sd)))

    def whiten(self, rows: Float[np.ndarray, "n_obs k"]) -> Float[np.ndarray, "n_white k"]:
        """Return W₀ D^-½ rows."""
        return self.inner.whiten(rows / self.sd[:, None])

    def whiten_transpose(self, rows: Float[np.ndarray, "n_white k"]) -> Float[np.ndarray, "n_obs k"]:
        """Return D^-½ W₀ᵀ rows."""
        return self.inner.whiten_transpose(rows) / self.sd[:, None]

    def precision_band(self, width: int) -> Float[np.ndarray, "n_obs width"]:
        """Return entries of R₀⁻¹ over the roots of D."""
        band, n = self.inner.precision_band(width), len(self.sd)
        for lag in range(min(width, n)):
            band[: n - lag, lag] /= self.sd[: n - lag] * self.sd[lag:]
        return band

    def covariance(self) -> Float[np.ndarray, "n_obs n_obs"]:
        """Return R as a dense matrix."""
        return self.sd[:, None] * self.inner.covariance() * self.sd

    def correlated(self, white: Float[np.ndarray, "n_draw n_obs"]) -> Float[np.ndarray, "n_draw n_obs"]:
        """Return draws from N(0, R₀) times the roots of D."""
        return self.inner.correlated(white) * self.sd

    def sequences(self, white: Float[np.ndarray, "n_draw n_white"]) -> Sequences:
        """Return those of R₀."""
        return self.inner.sequences(white)

    def restrict(self, bounds: Sequence[tuple[int, int]]) -> "WeightedNoise":
        """Return the noise of contiguous rows of each run; their standard deviations over the same σ stay."""
        inner = self.inner.restrict(bounds)
        sd = self.sd[rows_within(self.run_lengths, bounds)]
        return WeightedNoise(inner, sd, self.scale * inner.scale / self.inner.scale)


def correlation_and_sd(noise: RowNoise) -> tuple[RowNoise, Float[np.ndarray, " n_obs"]]:
    """Split the noise of the rows alone into noise of rows of equal variance and the standard deviation of each row."""
    error = noise.error
    return (error.inner, error.sd) if isinstance(error, WeightedNoise) else (error, np.ones(error.n_obs))


def with_sd(correlation: RowNoise, sd: Float[np.ndarray, " n_obs"]) -> RowNoise:
    """Join what `correlation_and_sd` splits."""
    return correlation if np.all(sd == 1.0) else WeightedNoise(correlation, sd)
