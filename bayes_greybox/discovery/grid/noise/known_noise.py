"""Rows whose noise hangs together in a way that is known, such as rates that a filter computed."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.noise.protocol import RowNoise

from .latent_force import Ratios


@dataclass(frozen=True, eq=False)
class KnownNoise:
    """Rows under noise R that is known up to its size; no latent force is weighed beside it.

    What a filter makes of white noise looks like a force, and a force like that.

    Attributes:
        rows: R.
        period: Period of the motion.
        step: Usual time between two rows.
        noise: First guess of the noise's standard deviation, over the target's size.
    """

    rows: RowNoise
    period: float
    step: float
    noise: float

    @property
    def forced(self) -> bool:
        """See `LatentForce.forced`."""
        return False

    @property
    def gap(self) -> float:
        """See `LatentForce.gap`."""
        return 1.0

    def whiten(
        self, table: Float[np.ndarray, "n_row n_column"], scale: float, ratios: Ratios, sensor: bool = False
    ) -> tuple[Float[np.ndarray, "n_white n_ratio n_column"], Float[np.ndarray, "n_white n_ratio"]]:
        """See `LatentForce.whiten`."""
        white = self.rows.whiten(table)
        logs = np.full((len(white), len(ratios)), self.rows.log_det / len(white))
        return np.repeat(white[:, None], len(ratios), axis=1), logs

    def smooth(
        self, residual: Float[np.ndarray, "n_row n_column"], scale: float, ratio: float
    ) -> tuple[Float[np.ndarray, "n_sample n_column"], Float[np.ndarray, " n_sample"]]:
        """See `LatentForce.smooth`: there is none."""
        return np.zeros_like(residual), np.zeros(len(residual))

    def weighted(self, spread: Float[np.ndarray, " n_row"]) -> "KnownNoise":
        """See `LatentForce.weighted`: its shape is known."""
        return self

    def rescaled(self, white: Float[np.ndarray, " n_white"]) -> tuple[float, ...]:
        """See `LatentForce.rescaled`."""
        return ()
