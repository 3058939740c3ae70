"""Rows of unequal noise: R = D^½ R₀ D^½, with D known row by row and R₀ the noise of rows of equal variance."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from bayes_greybox.running.errors import InputError

from .protocol import RowNoise


@dataclass(frozen=True, eq=False)
class WeightedNoise(RowNoise):
    """Noise whose standard deviation differs from row to row.

    Attributes:
        inner: R₀.
        sd: Roots of the diagonal of D, over the σ of the model [n_obs].
    """

    kind: ClassVar[str] = "weighted"
    inner: RowNoise
    sd: Float[np.ndarray, " n_obs"]
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
    def n_white(self) -> int:
        """Number of whitened rows of R₀."""
        return self.inner.n_white

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

    def sequences(
        self, white: Float[np.ndarray, "n_draw n_white"]
    ) -> tuple[Float[np.ndarray, "n_draw n_value"], tuple[int, ...], bool]:
        """Return those of R₀."""
        return self.inner.sequences(white)

    def restrict(self, bounds: Sequence[tuple[int, int]]) -> "WeightedNoise":
        """Return the noise of contiguous rows of each run; their standard deviations over the same σ stay."""
        starts = np.concatenate([[0], np.cumsum(self.run_lengths)])[:-1].astype(int)
        kept = [self.sd[s + a : s + b] for s, (a, b) in zip(starts, bounds, strict=True)]
        inner = self.inner.restrict(bounds)
        return WeightedNoise(inner, np.concatenate([np.zeros(0), *kept]), self.scale * inner.scale / self.inner.scale)


def correlation_and_sd(noise: RowNoise) -> tuple[RowNoise, Float[np.ndarray, " n_obs"]]:
    """Split the noise of the rows alone into noise of rows of equal variance and the standard deviation of each row."""
    error = noise.error
    return (error.inner, error.sd) if isinstance(error, WeightedNoise) else (error, np.ones(error.n_obs))


def with_sd(correlation: RowNoise, sd: Float[np.ndarray, " n_obs"]) -> RowNoise:
    """Join what `correlation_and_sd` splits."""
    return correlation if np.all(sd == 1.0) else WeightedNoise(correlation, sd)
