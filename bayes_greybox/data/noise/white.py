"""Independent rows of equal variance: what is assumed of rates that were measured, not computed."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from .protocol import RowNoise


@dataclass(frozen=True)
class WhiteNoise(RowNoise):
    """R = I: every row is its own whitened row.

    Attributes:
        run_lengths: rows of each run.
    """

    run_lengths: tuple[int, ...]
    scale: float = 1.0

    @property
    def local(self) -> bool:
        """Rows are whitened one by one."""
        return True

    @property
    def n_white(self) -> int:
        """One for each row."""
        return self.n_obs

    @property
    def log_det(self) -> float:
        """log|I|."""
        return 0.0

    def whiten(self, rows: Float[np.ndarray, "n_obs k"]) -> Float[np.ndarray, "n_white k"]:
        """The rows themselves."""
        return rows

    def whiten_transpose(self, rows: Float[np.ndarray, "n_white k"]) -> Float[np.ndarray, "n_obs k"]:
        """The rows themselves."""
        return rows

    def precision_diagonal(self) -> Float[np.ndarray, " n_obs"]:
        """Ones."""
        return np.ones(self.n_obs)

    def precision_band(self, width: int) -> Float[np.ndarray, "n_obs width"]:
        """Ones on the diagonal."""
        band = np.zeros((self.n_obs, width))
        band[:, 0] = 1.0
        return band

    def precision_at(self, index: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n n"]:
        """The identity."""
        return np.eye(len(index))

    def covariance(self) -> Float[np.ndarray, "n_obs n_obs"]:
        """The identity."""
        return np.eye(self.n_obs)

    def correlated(self, white: Float[np.ndarray, "n_draw n_obs"]) -> Float[np.ndarray, "n_draw n_obs"]:
        """The draws themselves."""
        return white

    def restrict(self, bounds: Sequence[tuple[int, int]]) -> "WhiteNoise":
        """Noise of contiguous rows of each run."""
        return WhiteNoise(tuple(stop - start for start, stop in bounds if stop > start))

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {"kind": "white", "run_lengths": list(self.run_lengths)}
