"""Log evidence of inclusion sets under every noise point, the scale of the noise integrated out.

y ~ N(X_S θ, v R), θ ~ N(0, D⁻¹), a flat prior on log v. With G = X_SᵀR⁻¹X_S, b = X_SᵀR⁻¹y and A = G + v D:

    log p(y | S, R, v) = −½ [(n − k) log v + log|A| − log|D| + log|R| + (yᵀR⁻¹y − bᵀA⁻¹b)/v] − ½ n log 2π

v is at its mode, (yᵀR⁻¹y − bᵀA⁻¹b)/n up to terms of order k/n, and log p bends there by −n/2 in log v (Laplace): the
peak over log v is 1/√(2n) wide, which no grid of a bearable step resolves.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.discovery.grid.noise.points import RATIO_DECADES

from .gram import Gram

BATCH_VALUES = 400_000
"""Largest number of values in a batch's arrays, some 3 MB: they stay in the cache."""

UNIT_RIDGE = 1e-13
"""Added to the diagonal of products of unit columns, of which two may be equal."""

SCALE_STEPS = 3
"""Number of steps to the mode of v, from that of the fit without a prior: the shift by D is of order k/n smaller in
each."""

FIRST_SCALE = 1e-8
"""First v, over the target's: small enough for the fit to be that without a prior, and above its rounding."""


def log_evidences(
    gram: Gram, precision: Float[np.ndarray, " n_column"], sets: Sequence[Sequence[int]], floor: float
) -> Float[np.ndarray, "n_set n_point"]:
    """Return the log evidence of each set under each point.

    Args:
        gram: Products.
        precision: Prior precision of each regressor's coefficient.
        sets: Regressors of each set.
        floor: Least v: the rounding of the data.
    """
    out = np.empty((len(sets), len(gram.points)))
    for places, index in _by_size(sets):
        k = index.shape[1]
        batch = max(1, BATCH_VALUES // (len(gram.points) * max(k * (k + 1) // 2 + k, 1)))
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
    return value - 0.5 * n * np.log(2 * np.pi) + 0.5 * np.log(4 * np.pi / n) + _log_within_gap(gram, v_used)


def _log_within_gap(gram: Gram, v: Float[np.ndarray, "n_set n_point"]) -> Float[np.ndarray, "n_set n_point"]:
    """Return the log share of each point's cell of the grid in which the discrepancy is no larger than the gap."""
    with np.errstate(divide="ignore"):
        decades = np.log10([point.ratio if point.unnamed else 0.0 for point in gram.points]) + 0.5 * np.log10(v)
        return np.log(np.clip((np.log10(gram.most) - decades) / RATIO_DECADES + 0.5, 0.0, 1.0))


class Modes(NamedTuple):
    """Sets at one noise point each.

    Attributes:
        v: Scale of the noise.
        mean: Posterior means of the coefficients, in the sets' order.
        covariance: Their posterior covariances.
    """

    v: Float[np.ndarray, " n_set"]
    mean: list[Float[np.ndarray, " k"]]
    covariance: list[Float[np.ndarray, "k k"]]


def modes(
    gram: Gram, precision: Float[np.ndarray, " n_column"], sets: Sequence[Sequence[int]],
    points: Int[np.ndarray, " n_set"], floor: float,
) -> Modes:  # fmt: skip
    """Return the posterior of each set's coefficients at a noise point of its own.

    Args:
        gram: Products.
        precision: Prior precision of each regressor's coefficient.
        sets: Regressors of each set.
        points: Number of the point of each set.
        floor: Least v.
    """
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
