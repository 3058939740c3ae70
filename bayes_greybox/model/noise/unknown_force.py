"""An unknown force along the path that samples are taken of, weighed on residuals by a Kalman filter.

Sensor noise and such a force are told apart by the spectrum of the residual: what enters as a force rings as the system
does. It is something that the model lacks, or a world that shakes it.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from bayes_greybox.model.evidence import log_white_each
from bayes_greybox.model.gp.hyper import NoisePrior

from .noise_model import PROCESS, NoiseModel, Suspicion, weighed_on_grid

FINER = 10.0 ** np.linspace(-0.75, 0.75, 7)
"""Intensities around the best one that are looked at once more."""


def force(residual: Float[np.ndarray, " n_obs"], known: NoiseModel, prior: NoisePrior) -> Suspicion:
    """Weigh an unknown force, white in time, its intensity λ on a grid.

        p(e | λ) = ∫ N(e | 0, σ² R(λ)) p(σ) dσ

    Args:
        residual: Samples less the explained path, scaled units, unknown starts in them.
        known: Noise as it is, of rows with a path.
        prior: Prior of σ.
    """

    def logs(intensities: np.ndarray) -> np.ndarray:
        noises = [known.noise.forced(float(each)) for each in intensities]
        squares = np.array([np.sum(noise.whiten(residual[:, None]) ** 2) for noise in noises])
        return log_white_each(squares, len(residual), prior) - 0.5 * np.array([noise.log_det for noise in noises])

    grid = known.noise.intensities
    coarse = logs(grid)
    nearby = float(grid[int(np.argmax(coarse))]) * FINER
    fine = logs(nearby)
    intensity = float(nearby[int(np.argmax(fine))])
    noise = known.noise.forced(intensity)
    square = float(np.sum(known.noise.whiten(residual[:, None]) ** 2))
    before = float(log_white_each(np.array([square]), len(residual), prior)[0]) - 0.5 * known.noise.log_det
    about = {"intensity": intensity, "share": _share(residual, known, intensity)}
    found = weighed_on_grid(PROCESS, coarse, np.full(len(grid), -np.log(len(grid))), before, noise, known, about)
    # The grid says how likely; what is held is the mode.
    constant = found.model.constant + float(np.max(coarse) - np.max(fine))
    return replace(found, model=replace(found.model, constant=constant))


def _share(residual: np.ndarray, known: NoiseModel, intensity: float) -> float:
    """Share of the residuals' variance that is the force's doing."""
    noise = known.noise.forced(intensity)
    sigma2 = float(np.mean(noise.whiten(residual[:, None]) ** 2))
    left = noise.without_starts(residual[:, None])[:, 0]
    sensor = sigma2 * float(np.mean(1 / known.noise.error.precision_diagonal()))
    return float(np.clip(1 - sensor / max(float(np.mean(left**2)), 1e-300), 0.0, 1.0))
