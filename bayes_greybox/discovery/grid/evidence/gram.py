"""Products of target and regressors under every noise point: all that the evidence needs of the data."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import eigh

from bayes_greybox.discovery.grid.noise.latent_force import LatentForce
from bayes_greybox.discovery.grid.noise.points import LAW, MEMORY, SENSOR, TIME, NoisePoint
from bayes_greybox.discovery.grid.table import RegressorTable

TINY = 1e-10
"""Spectral density, over its largest, below which a feature of f carries nothing."""


@dataclass(frozen=True)
class Gram:
    """Products under every noise point; the target comes first, then the regressors.

    Attributes:
        points: Noise points.
        products: [y X]ᵀ R⁻¹ [y X] of each point.
        log_det: log|R| of each point.
        n_obs: White numbers that the rows carry.
        most: Largest standard deviation of what remains, in units of the target: it is a part of the gap. A larger one
            would need effects that happen to cancel it.
    """

    points: tuple[NoisePoint, ...]
    products: Float[np.ndarray, "n_point n_column n_column"]
    log_det: Float[np.ndarray, " n_point"]
    n_obs: float
    most: float = np.inf


@dataclass(frozen=True)
class Basis:
    """Whitened features of a discrepancy, rotated so that they are independent under every ratio.

    Its standard deviation is 1 on average over the rows; with eigenvalues a of the features' products and ratio r, R⁻¹
    shrinks direction k by r²/(1 + r² a_k).

    Attributes:
        features: Rotated, whitened.
        acting: Rotated, as forces at the samples, of unit size all together.
        eigenvalues: a.
    """

    features: Float[np.ndarray, "n_white n_kept"]
    acting: Float[np.ndarray, "n_sample n_kept"]
    eigenvalues: Float[np.ndarray, " n_kept"]

    def shrunk(self, ratio: float) -> Float[np.ndarray, " n_kept"]:
        """Return what R⁻¹ takes off each direction."""
        return ratio**2 / (1 + ratio**2 * self.eigenvalues)

    def log_det(self, ratio: float) -> float:
        """Return the part of log|R| of the discrepancy."""
        return float(np.sum(np.log1p(ratio**2 * self.eigenvalues)))

    def posterior(self, white: Float[np.ndarray, "n_white k"], ratio: float) -> Float[np.ndarray, "n_kept k"]:
        """Return the posterior mean of the weights given whitened residuals."""
        return self.shrunk(ratio)[:, None] * (self.features.T @ white)


def discrepancy_basis(table: RegressorTable, point: NoisePoint) -> Basis:
    """Return the basis of a law or of a memory.

    Args:
        table: Rows with features and elements.
        point: Which.
    """
    if point.kind == MEMORY:
        elements = table.memories[point.memory]
        features, acting = elements.rows, elements.acting
    else:
        variances = law_variances(table, point.scale)
        kept = variances > TINY * np.max(variances)
        root = np.sqrt(variances[kept])
        features, acting = table.law.rows[:, kept] * root, table.law.acting[:, kept] * root
    size = np.sqrt(np.mean(np.sum(acting**2, axis=1)))
    white = table.force.whiten(features / size, 1.0, np.zeros(1))[0][:, 0]
    eigenvalues, rotation = eigh(white.T @ white)
    return Basis(white @ rotation, acting / size @ rotation, np.maximum(eigenvalues, 0.0))


def law_variances(table: RegressorTable, length: float) -> Float[np.ndarray, " n_feature"]:
    """Return the prior variances of the weights of an f whose mean variance at the samples is one.

    The spectral density of the squared-exponential kernel up to a factor (Solin & Särkkä 2020, eq. 20).

    Args:
        table: Rows with features.
        length: Length scale, in half-widths of the box that the data fill.
    """
    log_density = -0.5 * np.sum((table.frequency * length) ** 2, axis=1)
    density = np.exp(log_density - np.max(log_density))
    return density / np.mean(table.law.acting**2 @ density)


def gram(table: RegressorTable, points: Sequence[NoisePoint], forces: Sequence[LatentForce]) -> Gram:
    """Return the products under every point.

    Args:
        table: Target and regressors at the rows.
        points: Noise points.
        forces: The rows under each shape of the noise.
    """
    Z = np.column_stack([table.target, table.columns])
    products, log_det = np.empty((len(points), Z.shape[1], Z.shape[1])), np.zeros(len(points))
    places: dict[tuple, list[int]] = {}
    n_white = len(Z)
    for k, point in enumerate(points):
        places.setdefault((point.shape, point.kind, point.scale, point.memory), []).append(k)
    for (shape, kind, scale, _), own in places.items():
        ratios = np.array([points[k].ratio for k in own])
        if kind in (TIME, SENSOR):
            white, logs = forces[shape].whiten(Z, scale, ratios, kind == SENSOR)
            for j, k in enumerate(own):
                products[k] = white[:, j].T @ white[:, j]
            log_det[own] = logs.sum(axis=0)
            continue
        white, logs = forces[shape].whiten(Z, 1.0, np.zeros(1))
        white, plain = white[:, 0], white[:, 0].T @ white[:, 0]
        n_white = len(white)
        products[own], log_det[own] = plain, logs.sum()
        if kind in (LAW, MEMORY):
            basis = discrepancy_basis(replace(table, force=forces[shape]), points[own[0]])
            with_target = basis.features.T @ white
            for k, r in zip(own, ratios, strict=True):
                products[k] -= with_target.T @ (basis.shrunk(r)[:, None] * with_target)
                log_det[k] += basis.log_det(r)
    return Gram(tuple(points), products, log_det, float(n_white), table.force.gap)
