"""Log evidence of inclusion sets under every noise point, the scale of the noise integrated out.

y ~ N(X_S θ, v R), θ ~ N(0, D⁻¹), a flat prior on log v. With G = X_SᵀR⁻¹X_S, b = X_SᵀR⁻¹y and A = G + v D:

    log p(y | S, R, v) = −½ [(n − k) log v + log|A| − log|D| + log|R| + (yᵀR⁻¹y − bᵀA⁻¹b)/v] − ½ n log 2π

v is at its mode, (yᵀR⁻¹y − bᵀA⁻¹b)/n up to terms of order k/n, and log p bends there by −n/2 in log v (Laplace): the
peak over log v is 1/√(2n) wide, which no grid of a bearable step resolves.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import eigh

from bayes_greybox.running.threads import in_threads

from .latent_force import LatentForce
from .points import LATENT_FORCE, LAW, MEMORY, RATIO_DECADES, SENSOR_NOISE, NoisePoint
from .table import RegressorTable

TINY = 1e-10
"""Spectral density, over its largest, below which a feature of f carries nothing."""


@dataclass(frozen=True)
class Gram:
    """Products [y X]ᵀ R⁻¹ [y X] and log|R| under every noise point.

    `n_obs` white values are in the rows. `most` is the largest standard deviation of the discrepancy, over the target:
    it is a part of the gap, or would need effects that happen to cancel it.
    """

    points: tuple[NoisePoint, ...]
    products: Float[np.ndarray, "n_point n_column n_column"]
    log_det: Float[np.ndarray, " n_point"]
    n_obs: float
    most: float = np.inf


@dataclass(frozen=True)
class Basis:
    """Whitened features of a discrepancy, rotated so that they are independent under every ratio.

    With eigenvalues a of the features' products and ratio r, R⁻¹ shrinks direction k by r²/(1 + r² a_k). Their standard
    deviation, as forces `acting` at the samples, is 1 on average.
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
        """Return (I − F s Fᵀ)^½ of rows that are white but for the discrepancy, s = r²/(1 + r² a)."""
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

    The squared-exponential kernel's spectral density up to a factor (Solin & Särkkä 2020, eq. 20).
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

    def fill(places: Sequence[int]) -> int:
        first, ratios = points[places[0]], np.array([points[k].ratio for k in places])
        force = forces[first.shape]
        if first.kind in (LATENT_FORCE, SENSOR_NOISE):
            white, logs = force.whiten(Z, first.scale, ratios, first.kind == SENSOR_NOISE)
            for j, k in enumerate(places):
                products[k] = white[:, j].T @ white[:, j]
            log_det[places] = logs.sum(axis=0)
            return len(Z)
        white, logs = force.whiten_at(first, Z)
        products[places], log_det[places] = white.T @ white, logs.sum()
        if first.kind in (LAW, MEMORY):
            basis = discrepancy_basis(table, first, force)
            projected = basis.features.T @ white
            for k, ratio in zip(places, ratios, strict=True):
                products[k] -= projected.T @ (basis.shrunk(ratio)[:, None] * projected)
                log_det[k] += basis.log_det(ratio)
        return len(white)

    # Rows of noise that repeats itself are fewer once they are white.
    n_white = min(in_threads(fill, shared.values()))
    return Gram(tuple(points), products, log_det, float(n_white), table.force.gap)


UNIT_RIDGE = 1e-13
"""Added to the diagonal of products of unit columns, of which two may be equal."""

SCALE_STEPS = 3
"""Number of steps to the mode of v; the shift by D is of order k/n smaller in each."""

FIRST_SCALE = 1e-8
"""First v, over the target's: small enough for the fit to be that without a prior, and above its rounding."""


def log_evidences(
    gram: Gram, precision: Float[np.ndarray, " n_column"], sets: Sequence[Sequence[int]], floor: float
) -> Float[np.ndarray, "n_set n_point"]:
    """Return the log evidence of each set under each point."""
    out = np.empty((len(sets), len(gram.points)))
    for places, index in _by_size(sets):
        k = index.shape[1]
        # Arrays of some 3 MB stay in the cache.
        batch = max(1, 400_000 // (len(gram.points) * max(k * (k + 1) // 2 + k, 1)))
        for start in range(0, len(places), batch):
            rows = slice(start, start + batch)
            out[places[rows]] = _of_one_size(gram, precision, index[rows], floor)
    return out


def _by_size(sets: Sequence[Sequence[int]]) -> Iterator[tuple[np.ndarray, Int[np.ndarray, "n_set k"]]]:
    """Yield the places of sets of one size, with their regressors."""
    sizes = np.array([len(each) for each in sets], dtype=int)
    for k in dict.fromkeys(sizes.tolist()):
        places = np.flatnonzero(sizes == k)
        yield places, np.array([sets[p] for p in places.tolist()], dtype=int).reshape(len(places), k)


def _of_one_size(gram: Gram, precision: np.ndarray, index: Int[np.ndarray, "n_set k"], floor: float) -> np.ndarray:
    """Return the log evidence of sets of one size, by Cholesky factors that are unrolled over sets and points."""
    n, k = gram.n_obs, index.shape[1]
    square = np.broadcast_to(gram.products[:, 0, 0], (len(index), len(gram.points)))
    at = index.T + 1
    G = {(i, j): gram.products[:, at[i], at[j]].T for i in range(k) for j in range(i + 1)}
    b = [gram.products[:, 0, at[i]].T for i in range(k)]
    D = [precision[index[:, i]][:, None] for i in range(k)]
    v = v_used = np.maximum((FIRST_SCALE if k else 1.0) * square / n, floor)
    remaining, log_det = square, 0.0
    for _ in range(SCALE_STEPS if k else 1):
        L, z, remaining, log_det = {}, [], square, 0.0
        for i in range(k):
            for j in range(i + 1):
                value = G[i, j] - sum((L[i, q] * L[j, q] for q in range(j)), 0.0)
                if i == j:
                    # A column in the span of the others has its prior alone, whatever the rounding.
                    L[i, i] = np.sqrt(np.maximum(value, 0.0) + v * D[i])
                    log_det = log_det + 2 * np.log(L[i, i])
                else:
                    L[i, j] = value / L[j, j]
            z.append((b[i] - sum((L[i, q] * z[q] for q in range(i)), 0.0)) / L[i, i])
            remaining = remaining - z[i] ** 2
        v_used = v
        v = np.maximum(remaining / n, floor)
    log_prior = sum((np.log(d) for d in D), 0.0)
    misfit = np.maximum(remaining, 0.0) / v_used
    value = -0.5 * ((n - k) * np.log(v_used) + log_det - log_prior + gram.log_det + misfit)
    # Share of each point's cell of the grid in which the discrepancy is no larger than the gap.
    with np.errstate(divide="ignore"):
        decades = np.log10([point.ratio if point.unnamed else 0.0 for point in gram.points]) + 0.5 * np.log10(v_used)
        within = np.log(np.clip((np.log10(gram.most) - decades) / RATIO_DECADES + 0.5, 0.0, 1.0))
    return value - 0.5 * n * np.log(2 * np.pi) + 0.5 * np.log(4 * np.pi / n) + within


class Modes(NamedTuple):
    """Sets at one noise point each."""

    v: Float[np.ndarray, " n_set"]
    mean: list[Float[np.ndarray, " k"]]
    covariance: list[Float[np.ndarray, "k k"]]


def modes(
    gram: Gram, precision: Float[np.ndarray, " n_column"], sets: Sequence[Sequence[int]],
    points: Int[np.ndarray, " n_set"], floor: float,
) -> Modes:  # fmt: skip
    """Return the posterior of each set's coefficients at a noise point of its own."""
    v, mean, covariance = np.empty(len(sets)), [np.zeros(0)] * len(sets), [np.zeros((0, 0))] * len(sets)
    for places, index in _by_size(sets):
        k = index.shape[1]
        at, point = index + 1, points[places]
        G = gram.products[point[:, None, None], at[:, :, None], at[:, None, :]]
        b, square = gram.products[point[:, None], at, 0], gram.products[point, 0, 0]
        D = precision[index][:, :, None] * np.eye(k)
        scale = np.maximum((FIRST_SCALE if k else 1.0) * square / gram.n_obs, floor)
        inverse, theta, used = np.zeros_like(G), np.zeros_like(b), scale
        for _ in range(2 * SCALE_STEPS if k else 1):
            A = G + scale[:, None, None] * D
            # Unit diagonal: coefficients may be of any size.
            root = 1 / np.sqrt(np.einsum("nii->ni", A))
            unit = root[:, :, None] * root[:, None, :]
            inverse = np.linalg.inv(A * unit + UNIT_RIDGE * np.eye(k)) * unit
            theta = np.einsum("nij,nj->ni", inverse, b)
            used, remaining = scale, square - np.sum(b * theta, axis=1)
            scale = np.maximum(remaining / gram.n_obs, floor)
        for row, place in enumerate(places):
            v[place], mean[place], covariance[place] = used[row], theta[row], used[row] * inverse[row]
    return Modes(v, mean, covariance)
