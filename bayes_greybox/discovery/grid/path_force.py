"""A latent force along the path of samples: the Kalman filter of (δ, w), with the sensors' noise.

A small change δ of the path goes on by δ̇ = A δ + E w, w an Ornstein–Uhlenbeck process; a row is one state of δ and
noise. δ and w are discretised together: within a step w has its conditional moments at the middle and the end, and acts
through the weights that the classical method of Runge and Kutta gives to these (Särkkä & Solin 2019, section 6.2).
"""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from .kalman import Process, innovations, smoothed
from .latent_force import LatentForce, Ratios, Smoothed, Table, Whitened


class PathSteps(NamedTuple):
    """Steps of the linear equation along a path: transitions M, and responses b to the force at start, middle and end.

    `end` has the segment, and the end of the step, of each sample.
    """

    M: Float[np.ndarray, "n_segment n_step d d"]
    b: Float[np.ndarray, "n_segment n_step d 3"]
    h: Float[np.ndarray, "n_segment n_step"]
    end: Int[np.ndarray, "n_sample 2"]


@dataclass(frozen=True, eq=False)
class ForcedPath(LatentForce):
    """Rows of samples along a path, ordered by sensor, then by sample.

    `outputs` are the states that have a sensor, `start_sd` the prior standard deviations at starts over the noise's.
    """

    steps: PathSteps
    outputs: tuple[int, ...]
    start_sd: Float[np.ndarray, " d"]
    spread: Float[np.ndarray, " n_row"]
    period: float
    step: float
    noise: float
    gap: float = 1.0
    _moved: dict[tuple[float, bool], tuple[np.ndarray, np.ndarray]] = field(default_factory=dict, repr=False)

    @property
    def effect_size(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Return the size of the gap: samples are far larger than the forces that moved them."""
        return self.gap

    @property
    def fresh(self) -> Bool[np.ndarray, " n_sample"]:
        """Return true for each sample that is the first one of its segment."""
        return np.diff(self.steps.end[:, 0], prepend=-1) != 0

    def rescaled(self, white: Float[np.ndarray, " n_white"]) -> tuple[float, ...]:
        """See `LatentForce.rescaled`."""
        sensors = len(self.outputs)
        if sensors == 1:
            return ()
        relative = self.spread.reshape(sensors, -1)[:, 0] * np.sqrt(np.mean(white.reshape(sensors, -1) ** 2, axis=1))
        return tuple((relative / np.sqrt(np.mean(relative**2))).tolist())

    def weighted(self, spread: Float[np.ndarray, " n_row"]) -> "ForcedPath":
        """See `LatentForce.weighted`."""
        return replace(self, spread=self.spread * spread)

    def whiten(self, table: Table, scale: float, ratios: Ratios, sensor: bool = False) -> Whitened:
        """See `LatentForce.whiten`."""
        white, logs = innovations(self._process(scale, sensor), ratios, self._by_sample(table))
        white = white.swapaxes(0, 1).reshape(len(table), *white.shape[2:])
        return white, logs.swapaxes(0, 1).reshape(len(table), -1)

    def smooth(self, residual: Table, scale: float, ratio: float) -> Smoothed:
        """See `LatentForce.smooth`: w at the samples."""
        return smoothed(self._process(scale, False), ratio, self._by_sample(residual), len(self.start_sd))

    def _by_sample(self, table: np.ndarray) -> np.ndarray:
        return table.reshape(len(self.outputs), -1, table.shape[-1]).swapaxes(0, 1)

    def _process(self, scale: float, sensor: bool) -> Process:
        d, p = len(self.start_sd) + 1, len(self.outputs)
        H = np.zeros((p, d))
        H[range(p), list(self.outputs)], H[:, -1] = 1.0, float(sensor)
        start, started = np.zeros((d, d)), np.zeros((d, d))
        start[range(d - 1), range(d - 1)], started[-1, -1] = self.start_sd**2, 1.0
        # A start is as uncertain as beside white noise, though r² of a sensor's noise is correlated now.
        started[range(d - 1), range(d - 1)] = float(sensor) * self.start_sd**2
        F, Q = self._transitions(scale, sensor)
        return Process(F, Q, H, self.spread.reshape(p, -1).T ** 2, self.fresh, start, started)

    def _transitions(self, scale: float, sensor: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return the transition of (δ, w) to each sample from the one before, and the covariance that unit w adds."""
        key = (scale, sensor)
        moved = self._moved.get(key)
        if moved is None:
            steps = self.steps._replace(b=np.zeros_like(self.steps.b)) if sensor else self.steps
            moved = _discretised(steps, self.fresh, scale)
            # Other threads take from it meanwhile.
            # Transitions of more time scales than these are not kept.
            if len(self._moved) > 12:
                self._moved.clear()
            self._moved[key] = moved
        return moved


def _discretised(steps: PathSteps, fresh: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray]:
    d, end = steps.M.shape[-1], steps.end
    n = len(end)
    F, Q = np.tile(np.eye(d + 1), (n, 1, 1)), np.zeros((n, d + 1, d + 1))
    before = np.where(fresh, 0, np.concatenate([[0], end[:-1, 1]]))
    count = end[:, 1] - before
    # All samples at once, a step of each at a time.
    for k in range(int(count.max(initial=0))):
        on = np.flatnonzero(count > k)
        at = end[on, 0], before[on] + k
        half = np.exp(-0.5 * steps.h[at] / scale)
        whole = half**2
        step, b = np.zeros((len(on), d + 1, d + 1)), steps.b[at]
        step[:, :d, :d] = steps.M[at]
        step[:, :d, d] = b[..., 0] + b[..., 1] * half[:, None] + b[..., 2] * whole[:, None]
        step[:, d, d] = whole
        # Given w at the start: Cov(w_m, w_m) = 1 − φ_h², Cov(w_m, w_e) = φ_h (1 − φ_h²), Cov(w_e, w_e) = 1 − φ²
        act = np.zeros((len(on), d + 1, 2))
        act[:, :d, 0], act[:, :d, 1], act[:, d, 1] = b[..., 1], b[..., 2], 1.0
        cov = np.empty((len(on), 2, 2))
        cov[:, 0, 0], cov[:, 1, 1] = 1 - whole, 1 - whole**2
        cov[:, 0, 1] = cov[:, 1, 0] = half * (1 - whole)
        noise = act @ cov @ act.swapaxes(1, 2)
        F[on] = step @ F[on]
        Q[on] = step @ Q[on] @ step.swapaxes(1, 2) + noise
    return F, Q
