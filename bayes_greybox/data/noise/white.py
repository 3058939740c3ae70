"""Independent rows of equal variance: what is assumed of rates that were measured, not computed."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int

from .protocol import RowNoise


@dataclass(frozen=True)
class WhiteNoise(RowNoise):
    """R = I: every row is its own whitened row.

    Attributes:
        run_lengths: rows of each run.
    """

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
