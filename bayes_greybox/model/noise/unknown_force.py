"""An unknown force along the path that samples are taken of, weighed on residuals by a Kalman filter.

Sensor noise and such a force are told apart by the spectrum of the residual: what enters as a force rings as the system
does. It is something that the model lacks, or surroundings that shake it.
"""

import numpy as np
from jaxtyping import Float

from bayes_greybox.model.estimate.evidence import log_white_each
from bayes_greybox.model.gp.hyper import NoisePrior

from .noise_model import PROCESS, NoiseModel, Suspicion, weighed_on_grid

REFINED_INTERVALS = 8
"""Intervals that the neighbourhood of the best intensity is split into."""

FINE_NATS, MOST_REFINEMENTS = 1.0, 4
"""Nats between the best intensity and its neighbours up to which the grid is fine, and its most refinements."""


def force(residual: Float[np.ndarray, " n_obs"], current: NoiseModel, prior: NoisePrior) -> Suspicion:
    """Weigh an unknown force, white in time, its intensity λ on a grid.

        p(e | λ) = ∫ N(e | 0, σ² R(λ)) p(σ) dσ

    Unknown starts of the path are in the residual.
    """

    def logs(intensities: np.ndarray) -> np.ndarray:
        noises = [current.noise.forced(float(each)) for each in intensities]
        squares = np.array([np.sum(noise.whiten(residual[:, None]) ** 2) for noise in noises])
        return log_white_each(squares, len(residual), prior) - 0.5 * np.array([noise.log_det for noise in noises])

    grid = np.asarray(current.noise.intensities, float)
    found = logs(grid)
    # In long records an intensity between two nodes is many nats likelier than either.
    for _ in range(MOST_REFINEMENTS):
        best = int(np.argmax(found))
        beside = [k for k in (best - 1, best + 1) if 0 <= k < len(grid)]
        if all(found[best] - found[k] < FINE_NATS for k in beside):
            break
        low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
        nearby = np.setdiff1d(np.geomspace(low, high, REFINED_INTERVALS + 1)[1:-1], grid)
        order = np.argsort(np.concatenate([grid, nearby]))
        grid, found = (np.concatenate(pair)[order] for pair in ((grid, nearby), (found, logs(nearby))))
    intensity = float(grid[int(np.argmax(found))])
    noise = current.noise.forced(intensity)
    square = float(np.sum(current.noise.whiten(residual[:, None]) ** 2))
    before = float(log_white_each(np.array([square]), len(residual), prior)[0]) - 0.5 * current.noise.log_det
    about = {"intensity": intensity, "share": _share(residual, current, intensity)}
    # Uniform in log λ over the grid's range, by the trapezoidal rule.
    place = np.log(grid)
    width = (np.diff(place, prepend=place[0]) + np.diff(place, append=place[-1])) / 2
    return weighed_on_grid(PROCESS, found, np.log(width / (place[-1] - place[0])), before, noise, current, about)


def _share(residual: np.ndarray, current: NoiseModel, intensity: float) -> float:
    """Return the share of the residuals' variance that the force makes."""
    noise = current.noise.forced(intensity)
    sigma2 = float(np.mean(noise.whiten(residual[:, None]) ** 2))
    left = noise.without_starts(residual[:, None])[:, 0]
    sensor = sigma2 * float(np.mean(1 / current.noise.error.precision_diagonal()))
    return float(np.clip(1 - sensor / max(float(np.mean(left**2)), 1e-300), 0.0, 1.0))
