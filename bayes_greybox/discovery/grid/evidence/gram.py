"""Products of target and regressors under every noise point: all that the evidence needs of the data."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import eigh

from bayes_greybox.discovery.grid.noise.latent_force import LatentForce
from bayes_greybox.discovery.grid.noise.points import LATENT_FORCE, LAW, MEMORY, SENSOR_NOISE, NoisePoint
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
        n_obs: Number of white values that the rows carry.
        most: Largest standard deviation of the discrepancy, in units of the target: it is a part of the gap. A larger
            one would need effects that happen to cancel it.
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
        features: Rotated, whitened features.
        acting: Rotated features as forces at the samples, of unit size all together.
        eigenvalues: a.
    """

    features: Float[np.ndarray, "n_white n_kept"]
    acting: Float[np.ndarray, "n_sample n_kept"]
    eigenvalues: Float[np.ndarray, " n_kept"]

    def shrunk(self, ratio: float) -> Float[np.ndarray, " n_kept"]:
        """Return the share by which R⁻¹ shrinks each direction."""
        return ratio**2 / (1 + ratio**2 * self.eigenvalues)

    def log_det(self, ratio: float) -> float:
        """Return the part of log|R| of the discrepancy."""
        return float(np.sum(np.log1p(ratio**2 * self.eigenvalues)))

    def posterior(self, white: Float[np.ndarray, "n_white k"], ratio: float) -> Float[np.ndarray, "n_kept k"]:
        """Return the posterior mean of the weights given whitened residuals."""
        return self.shrunk(ratio)[:, None] * (self.features.T @ white)

    def whiten(self, white: Float[np.ndarray, "n_white k"], ratio: float) -> Float[np.ndarray, "n_white k"]:
        """Return (I − F s Fᵀ)^½ of rows that are white but for the discrepancy, s = r²/(1 + r² a).

        Along each direction F of square a the factor is 1/√(1 + r² a).
        """
        carried = self.eigenvalues > 1e-12 * np.max(self.eigenvalues)
        a = self.eigenvalues[carried]
        unit = self.features[:, carried] / np.sqrt(a)
        return white - unit @ ((1 - 1 / np.sqrt(1 + ratio**2 * a))[:, None] * (unit.T @ white))


def discrepancy_basis(table: RegressorTable, point: NoisePoint, force: LatentForce | None = None) -> Basis:
    """Return the basis of a point's law or memory, on the rows of the table or under another noise."""
    if point.kind == MEMORY:
        elements = table.memories[point.memory]
        features, acting = elements.rows, elements.acting
    else:
        variances = law_variances(table, point.scale)
        kept = variances > TINY * np.max(variances)
        root = np.sqrt(variances[kept])
        features, acting = table.law.rows[:, kept] * root, table.law.acting[:, kept] * root
    size = np.sqrt(np.mean(np.sum(acting**2, axis=1)))
    white = (force or table.force).whiten_plain(features / size)
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
    """Return the products under every point; there is one force for each shape of the noise."""
    Z = np.column_stack([table.target, table.columns])
    products, log_det = np.empty((len(points), Z.shape[1], Z.shape[1])), np.zeros(len(points))
    # Points that differ by their ratio alone share a filter or a basis.
    shared: dict[tuple, list[int]] = {}
    for k, point in enumerate(points):
        shared.setdefault((point.shape, point.kind, point.scale, point.memory), []).append(k)
    n_white = len(Z)
    for (shape, kind, scale, _), places in shared.items():
        force, ratios = forces[shape], np.array([points[k].ratio for k in places])
        if kind in (LATENT_FORCE, SENSOR_NOISE):
            white, logs = force.whiten(Z, scale, ratios, kind == SENSOR_NOISE)
            for j, k in enumerate(places):
                products[k] = white[:, j].T @ white[:, j]
            log_det[places] = logs.sum(axis=0)
            continue
        white, logs = force.whiten_at(points[places[0]], Z)
        n_white = len(white)
        products[places], log_det[places] = white.T @ white, logs.sum()
        if kind in (LAW, MEMORY):
            basis = discrepancy_basis(table, points[places[0]], force)
            projected = basis.features.T @ white
            for k, ratio in zip(places, ratios, strict=True):
                products[k] -= projected.T @ (basis.shrunk(ratio)[:, None] * projected)
                log_det[k] += basis.log_det(ratio)
    return Gram(tuple(points), products, log_det, float(n_white), table.force.gap)
