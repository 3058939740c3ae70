"""Latent force and sensor noise on the rows, and the Kalman filters that whiten them.

w(t) is a Gaussian process of time scale τ, whose standard deviation is r times that of the noise (Álvarez, Luengo &
Lawrence 2009; Hartikainen & Särkkä 2010). The innovations of the filter are the whitened rows, with the same gains for
every column of a table.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Real

from bayes_greybox.data.noise.protocol import RowNoise
from bayes_greybox.data.noise.state_space import transition

from .kalman import Process, innovations, smoothed
from .points import LATENT_FORCE, SENSOR_NOISE, SENSOR_SCALES, TIME_SCALES, NoisePoint

MEDIAN_ABSOLUTE_NORMAL = 0.6745
"""Median of |z| of a standard normal number."""

Ratios = Float[np.ndarray, " n_ratio"]
"""Standard deviations of the force over that of the noise."""

Table = Float[np.ndarray, "n_row n_column"]
"""Values at the rows."""

Whitened = tuple[Float[np.ndarray, "n_white n_ratio n_column"], Float[np.ndarray, "n_white n_ratio"]]
"""Innovations in units of their standard deviations, and the logarithms of their variances."""

Smoothed = tuple[Float[np.ndarray, "n_sample n_column"], Float[np.ndarray, " n_sample"]]
"""Posterior mean of the force at the samples, and its variance over that of the noise."""


class LatentForce(ABC):
    """Rows under a latent force and white noise.

    Attributes:
        period: Period of the motion, which time scales are shares of.
        step: Usual time between two rows of a sensor.
        noise: First guess of the noise's standard deviation, over the target's size.
        gap: RMS of the gap as a force, over that of the target: the scale of what remains.
        effect_size: Prior standard deviation of an effect's RMS, over that of the target.
        forced: True if a latent force is weighed on these rows.
    """

    period: float
    step: float
    noise: float
    gap: float = 1.0
    effect_size: float = 1.0
    forced: bool = True
    sensor_scales: tuple[float, ...] = SENSOR_SCALES

    @abstractmethod
    def whiten(self, table: Table, scale: float, ratios: Ratios, sensor: bool = False) -> Whitened:
        """Return innovations over their standard deviations, and log variances; if `sensor`, w is sensor noise."""

    @abstractmethod
    def smooth(self, residual: Table, scale: float, ratio: float) -> Smoothed:
        """Return the posterior mean of the force at the samples, and its variance over that of the noise."""

    @abstractmethod
    def weighted(self, spread: Float[np.ndarray, " n_row"]) -> Any:
        """Return the same rows with noise whose standard deviations are multiplied by factors."""

    def rescaled(self, white: Float[np.ndarray, " n_white"]) -> tuple[float, ...]:
        """Return relative standard deviations of several sensors' noise by their whitened rows; none of one sensor."""
        return ()

    def whiten_plain(self, table: Float[np.ndarray, "n_row k"]) -> Float[np.ndarray, "n_white k"]:
        """Return rows whitened without any force."""
        return self.whiten(table, 1.0, np.zeros(1))[0][:, 0]

    def whiten_at(
        self, point: NoisePoint, table: Float[np.ndarray, "n_row k"]
    ) -> tuple[Float[np.ndarray, "n_white k"], Float[np.ndarray, "n_white 1"]]:
        """Return rows whitened at a noise point, but for a law or a memory there, and their log variances."""
        forced = point.kind in (LATENT_FORCE, SENSOR_NOISE)
        scale, ratio = (point.scale, point.ratio) if forced else (1.0, 0.0)
        white, logs = self.whiten(table, scale, np.array([ratio]), point.kind == SENSOR_NOISE)
        return white[:, 0], logs


@dataclass(frozen=True, eq=False)
class ForcedRates(LatentForce):
    """Rows of a rate, or of an output: the force itself, and noise of spread s; z_k = w_k + s_k e_k."""

    time: Float[np.ndarray, " n_row"]
    run: Real[np.ndarray, " n_row"]
    period: float
    spread: Float[np.ndarray, " n_row"]
    noise: float
    sensor_scales: tuple[float, ...] = SENSOR_SCALES
    gap: float = 1.0

    @cached_property
    def _fresh(self) -> Bool[np.ndarray, " n_row"]:
        return np.diff(self.run, prepend=self.run[0] - 1) != 0

    @property
    def step(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Return the usual time between two rows."""
        inside = np.diff(self.time, prepend=self.time[0])[~self._fresh]
        return float(np.median(inside)) if len(inside) else 1.0

    def weighted(self, spread: Float[np.ndarray, " n_row"]) -> "ForcedRates":
        """See `LatentForce.weighted`."""
        return replace(self, spread=self.spread * spread)

    def whiten(self, table: Table, scale: float, ratios: Ratios, sensor: bool = False) -> Whitened:
        """See `LatentForce.whiten`."""
        if not np.any(ratios):
            white = np.repeat((table / self.spread[:, None])[:, None], len(ratios), axis=1)
            return white, np.repeat(2 * np.log(self.spread)[:, None], len(ratios), axis=1)
        white, logs = innovations(self._process(scale, sensor), ratios, table[:, None])
        return white[:, 0], logs[:, 0]

    def smooth(self, residual: Table, scale: float, ratio: float) -> Smoothed:
        """See `LatentForce.smooth`."""
        return smoothed(self._process(scale, False), ratio, residual[:, None], 0)

    def _process(self, scale: float, sensor: bool) -> Process:
        # A sensor's noise is rough; a force of the machine is as smooth as its motion.
        kind = "exponential" if sensor else "matern32"
        steps = np.where(self._fresh, 0.0, np.diff(self.time, prepend=self.time[0]))
        F, Q, stationary = transition(kind, steps / scale)
        d = len(stationary)
        noise = (self.spread**2)[:, None]
        return Process(F, Q, np.eye(d)[:1], noise, self._fresh, np.zeros((d, d)), stationary)


@dataclass(frozen=True, eq=False)
class KnownNoise(LatentForce):
    """Rows under noise R that is known up to its size, such as rates that a filter computed.

    No latent force is weighed beside it: a filter makes white noise look like a force, and a force like that noise.
    """

    rows: RowNoise
    period: float
    step: float
    noise: float
    gap: float = 1.0
    forced = False

    def whiten(self, table: Table, scale: float, ratios: Ratios, sensor: bool = False) -> Whitened:
        """See `LatentForce.whiten`."""
        white = self.rows.whiten(table)
        logs = np.full((len(white), len(ratios)), self.rows.log_det / len(white))
        return np.repeat(white[:, None], len(ratios), axis=1), logs

    def smooth(self, residual: Table, scale: float, ratio: float) -> Smoothed:
        """See `LatentForce.smooth`: there is no force."""
        return np.zeros_like(residual), np.zeros(len(residual))

    def weighted(self, spread: Float[np.ndarray, " n_row"]) -> "KnownNoise":
        """See `LatentForce.weighted`: the shape of this noise is known."""
        return self


def rough_noise(target: Float[np.ndarray, " n"]) -> float:
    """Return a first guess of the noise over the size of a target, by its second differences over √6."""
    spread = float(np.sqrt(np.mean(target**2)))
    rough = np.abs(np.diff(target, 2)) / np.sqrt(6.0)
    return min(float(np.median(rough)) / MEDIAN_ABSOLUTE_NORMAL / spread, 1.0) if len(rough) and spread > 0 else 1.0


FORCE_SIZES = 10.0 ** np.arange(-6.0, 0.6, 0.5)
"""Standard deviations of the force, over that of the target, that are tried."""


def gap_size(force: LatentForce, target: Float[np.ndarray, " n_row"], free: Float[np.ndarray, "n_row n_free"]) -> float:
    """Return the RMS that the gap may have as a force, over that of the target; 1 where the residual is zero.

    √(mean(E[w]² + Var[w])) of a latent force w beside the user's model without effects, whose free coefficients are at
    their likeliest: the largest value over plausible time scales and sizes.
    """
    table, ratios, tried = np.column_stack([target, free]), FORCE_SIZES / force.noise, []
    # Those next to the motion's own, and sizes from a millionth of the target to all of it.
    for scale in (force.period * share for share in TIME_SCALES[1:3]):
        white, logs = force.whiten(table, scale, ratios)
        for k, ratio in enumerate(ratios.tolist()):
            y, X = white[:, k, 0], white[:, k, 1:]
            theta = np.linalg.lstsq(X, y, rcond=None)[0]
            v = float(np.mean((y - X @ theta) ** 2))
            if v > 0:
                log_evidence = -0.5 * (len(y) * np.log(v) + float(np.sum(logs[:, k])))
                tried.append((log_evidence, scale, ratio, theta, v))
    best, sizes = max((log_evidence for log_evidence, *_ in tried), default=0.0), []
    for log_evidence, scale, ratio, theta, v in tried:
        # Two nats are two standard deviations.
        if log_evidence >= best - 2.0:
            mean, variance = force.smooth((target - free @ theta)[:, None], scale, ratio)
            sizes.append(float(np.sqrt(np.mean(mean[:, 0] ** 2 + v * variance))))
    size = max(sizes, default=1.0)
    return size if np.isfinite(size) and size > 0 else 1.0
