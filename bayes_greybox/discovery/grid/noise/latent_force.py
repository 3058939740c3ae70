"""Latent force and noise of the sensors on rows, and the Kalman filters that whiten them.

w(t) is a Gaussian process of time scale τ, whose standard deviation is r times that of the noise (Álvarez, Luengo &
Lawrence 2009; Hartikainen & Särkkä 2010). The innovations of the filter are the whitened rows, with the same gains for
every column of a table.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Real

from bayes_greybox.data.noise.state_space import transition

from .kalman import Process, innovations, smoothed

Ratios = Float[np.ndarray, " n_ratio"]
"""Standard deviations of the force over that of the noise."""


@runtime_checkable
class LatentForce(Protocol):
    """Rows under a latent force and white noise."""

    @property
    def period(self) -> float:
        """Period of the motion, which time scales are shares of."""
        ...

    @property
    def step(self) -> float:
        """Usual time between two rows of a sensor."""
        ...

    @property
    def forced(self) -> bool:
        """Return whether a latent force is weighed on these rows."""
        ...

    @property
    def noise(self) -> float:
        """Return a first guess of the noise's standard deviation, over the target's size."""
        ...

    @property
    def gap(self) -> float:
        """Return the RMS of the gap as a force, over that of the target: the scale of effects and of what remains."""
        ...

    def whiten(
        self, table: Float[np.ndarray, "n_row n_column"], scale: float, ratios: Ratios, sensor: bool = False
    ) -> tuple[Float[np.ndarray, "n_row n_ratio n_column"], Float[np.ndarray, "n_row n_ratio"]]:
        """Return innovations in units of their standard deviations, and the logarithms of their variances.

        Args:
            table: Values at the rows.
            scale: τ.
            ratios: r, several at once; 0 is no force.
            sensor: Whether w is noise of the sensors that hangs together, and moves nothing.
        """
        ...

    def smooth(
        self, residual: Float[np.ndarray, "n_row n_column"], scale: float, ratio: float
    ) -> tuple[Float[np.ndarray, "n_sample n_column"], Float[np.ndarray, " n_sample"]]:
        """Return the posterior mean of the force at the samples, and its variance over that of the noise.

        Args:
            residual: Rows less everything else; columns are different residuals.
            scale: τ.
            ratio: r.
        """
        ...

    def rescaled(self, white: Float[np.ndarray, " n_white"]) -> tuple[float, ...]:
        """Return relative standard deviations of the noise of several sensors by their whitened rows; none of one.

        Args:
            white: Whitened residual, of unit variance where these are right.
        """
        ...

    def weighted(self, spread: Float[np.ndarray, " n_row"]) -> "LatentForce":
        """Return the same rows with noise of other standard deviations.

        Args:
            spread: Factors of the noise's standard deviation.
        """
        ...


@dataclass(frozen=True, eq=False)
class ForcedRates:
    """Rows of a rate, or of an output: the force itself, and noise; z_k = w_k + s_k e_k.

    Attributes:
        time: Of each row, in order within its run.
        run: Run of each row.
        period: Period of the motion.
        spread: s, relative standard deviations of the noise.
        noise: First guess of the noise's standard deviation, over the target's size.
    """

    time: Float[np.ndarray, " n_row"]
    run: Real[np.ndarray, " n_row"]
    period: float
    spread: Float[np.ndarray, " n_row"]
    noise: float

    @cached_property
    def fresh(self) -> Bool[np.ndarray, " n_row"]:
        """Return whether a row begins a run."""
        return np.diff(self.run, prepend=self.run[0] - 1) != 0

    @cached_property
    def steps(self) -> Float[np.ndarray, " n_row"]:
        """Return the time since the row before, infinite where a run begins."""
        return np.where(self.fresh, np.inf, np.diff(self.time, prepend=self.time[0]))

    @property
    def step(self) -> float:
        """Return the usual time between two rows."""
        inside = self.steps[np.isfinite(self.steps)]
        return float(np.median(inside)) if len(inside) else 1.0

    @property
    def forced(self) -> bool:
        """See `LatentForce.forced`."""
        return True

    @property
    def gap(self) -> float:
        """See `LatentForce.gap`: the target is the force."""
        return 1.0

    def rescaled(self, white: Float[np.ndarray, " n_white"]) -> tuple[float, ...]:
        """See `LatentForce.rescaled`: rates have one sensor."""
        return ()

    def weighted(self, spread: Float[np.ndarray, " n_row"]) -> "ForcedRates":
        """See `LatentForce.weighted`."""
        return replace(self, spread=self.spread * spread)

    def whiten(
        self, table: Float[np.ndarray, "n_row n_column"], scale: float, ratios: Ratios, sensor: bool = False
    ) -> tuple[Float[np.ndarray, "n_row n_ratio n_column"], Float[np.ndarray, "n_row n_ratio"]]:
        """See `LatentForce.whiten`."""
        if not np.any(ratios):
            white = np.repeat((table / self.spread[:, None])[:, None], len(ratios), axis=1)
            return white, np.repeat(2 * np.log(self.spread)[:, None], len(ratios), axis=1)
        white, logs = innovations(self._process(scale, sensor), ratios, table[:, None])
        return white[:, 0], logs[:, 0]

    def smooth(
        self, residual: Float[np.ndarray, "n_row n_column"], scale: float, ratio: float
    ) -> tuple[Float[np.ndarray, "n_sample n_column"], Float[np.ndarray, " n_sample"]]:
        """See `LatentForce.smooth`."""
        return smoothed(self._process(scale, False), ratio, residual[:, None], 0)

    def _process(self, scale: float, sensor: bool) -> Process:
        # Noise of a sensor is rough; a force of the machine is as smooth as its motion.
        kind = "exponential" if sensor else "matern32"
        F, Q, stationary = transition(kind, np.where(self.fresh, 0.0, self.steps) / scale)
        d = len(stationary)
        noise = (self.spread**2)[:, None]
        return Process(F, Q, np.eye(d)[:1], noise, self.fresh, np.zeros((d, d)), stationary)


def rough_noise(target: Float[np.ndarray, " n"]) -> float:
    """Return a first guess of the noise over the size of a target: its differences of second order over √6.

    They have the variance of white noise, and next to nothing of anything smooth.

    Args:
        target: Values in order of time.
    """
    spread = float(np.sqrt(np.mean(target**2)))
    rough = np.abs(np.diff(target, 2)) / np.sqrt(6.0)
    return min(float(np.median(rough)) / 0.6745 / spread, 1.0) if len(rough) and spread > 0 else 1.0
