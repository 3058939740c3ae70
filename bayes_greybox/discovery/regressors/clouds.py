"""Importance-sampling proposals of several nonlinear parameters, and the weights of the values drawn from them.

Positions are shares of the logarithms of the ranges, between which priors are uniform. Points of the first grid stand
for the whole unit cube; a cloud adds points from a normal density near a mode. All of them together are a sample of the
mixture of these densities, so that a point weighs

    w_i = 1 / (n₀ + Σ_c n_c q_c(s_i)),    ∫ L(s) ds ≈ Σ_i w_i L(s_i)

(Cornuet, Marin, Mira & Robert 2012, Scand. J. Stat. 39:798, with deterministic weights).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.stats import norm, qmc

CLOUD_POINTS, TRIED_FOR_ONE = 64, 8
"""Largest number of points of a cloud, and points that are drawn for each that it needs inside the cube."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of a normal density inside the unit cube.

    Attributes:
        inside: Share of the density inside the cube.
    """

    mean: Float[np.ndarray, " d"]
    covariance: Float[np.ndarray, "d d"]
    points: Float[np.ndarray, "n d"]
    inside: float

    @classmethod
    def around(cls, mean: Float[np.ndarray, " d"], covariance: Float[np.ndarray, "d d"]) -> "Cloud":
        """Draw the points evenly, by Sobol's sequence."""
        values, vectors = np.linalg.eigh(covariance)
        # The first point of the sequence is a corner.
        white = norm.ppf(qmc.Sobol(len(mean), scramble=False).random(CLOUD_POINTS * TRIED_FOR_ONE)[1:])
        drawn = mean + (white * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
        within = np.all((drawn > 0) & (drawn < 1), axis=1)
        return cls(mean, covariance, drawn[within][:CLOUD_POINTS], max(float(np.mean(within)), 1 / len(drawn)))

    def density(self, at: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
        """Return the density inside the cube."""
        values, vectors = np.linalg.eigh(self.covariance)
        values = np.maximum(values, np.finfo(float).tiny)
        square = np.sum(((at - self.mean) @ vectors) ** 2 / values, axis=-1)
        return np.exp(-0.5 * (square + np.sum(np.log(2 * np.pi * values)))) / self.inside


def weights_of(at: Float[np.ndarray, "n d"], drawn: Sequence[Cloud | None]) -> Float[np.ndarray, " n"]:
    """Return the log prior weights of points."""
    clouds = {id(cloud): cloud for cloud in drawn if cloud is not None}
    total = np.full(len(at), float(sum(cloud is None for cloud in drawn)))
    for cloud in clouds.values():
        total += len(cloud.points) * cloud.density(at)
    return -np.log(total)
