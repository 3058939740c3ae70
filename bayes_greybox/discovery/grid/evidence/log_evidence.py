"""Log evidence of inclusion sets under every noise point, the scale of the noise integrated out.

y ~ N(X_S θ, v R), θ ~ N(0, D⁻¹), a flat prior on log v. With G = X_SᵀR⁻¹X_S, b = X_SᵀR⁻¹y and A = G + v D:

    log p(y | S, R, v) = −½ [(n − k) log v + log|A| − log|D| + log|R| + (yᵀR⁻¹y − bᵀA⁻¹b)/v] − ½ n log 2π

v is at its mode, (yᵀR⁻¹y − bᵀA⁻¹b)/n up to terms of order k/n, and log p bends there by −n/2 in log v (Laplace): the
peak over log v is 1/√(2n) wide, which no grid of a bearable step resolves.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.discovery.grid.evidence.gram import Gram
from bayes_greybox.discovery.grid.noise.points import STEP

CHUNK = 400_000
"""Largest number of values in a batch's arrays, some 3 MB: they stay in the cache."""

RIDGE = 1e-13
"""Added to products of unit columns, which may be one and the same."""

PASSES = 3
"""Number of steps to the mode of v, from that of the fit without a prior: what D moves it by is of order k/n smaller in
each."""

START = 1e-8
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
    by_size: dict[int, list[int]] = {}
    for place, each in enumerate(sets):
        by_size.setdefault(len(each), []).append(place)
    for k, places in by_size.items():
        index = np.array([sets[p] for p in places], dtype=int).reshape(len(places), k)
        chunk = max(1, CHUNK // (len(gram.points) * max(k * (k + 1) // 2 + k, 1)))
        for start in range(0, len(places), chunk):
            own = slice(start, start + chunk)
            out[places[own]] = _batch(gram, precision, index[own], floor)[0]
    return out


def _batch(
    gram: Gram, precision: np.ndarray, index: Int[np.ndarray, "n_set k"], floor: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return log evidence and v of sets of one size."""
    n, k = gram.n_obs, index.shape[1]
    square = np.broadcast_to(gram.products[:, 0, 0], (len(index), len(gram.points)))
    at = index.T + 1
    G = {(i, j): gram.products[:, at[i], at[j]].T for i in range(k) for j in range(i + 1)}
    b = [gram.products[:, 0, at[i]].T for i in range(k)]
    D = [precision[index[:, i]][:, None] for i in range(k)]
    v = v_used = np.maximum((START if k else 1.0) * square / n, floor)
    left, log_det = square, 0.0
    for _ in range(PASSES if k else 1):
        L, left, log_det = {}, square, 0.0
        z: list[np.ndarray] = []
        for i in range(k):
            for j in range(i + 1):
                value = G[i, j] - sum((L[i, q] * L[j, q] for q in range(j)), 0.0)
                if i == j:
                    ridge = v * D[i]
                    # What is in the span of the others has its prior alone, whatever the rounding.
                    L[i, i] = np.sqrt(np.maximum(value, 0.0) + ridge)
                    log_det = log_det + 2 * np.log(L[i, i])
                else:
                    L[i, j] = value / L[j, j]
            z.append((b[i] - sum((L[i, q] * z[q] for q in range(i)), 0.0)) / L[i, i])
            left = left - z[i] ** 2
        v_used = v
        v = np.maximum(left / n, floor)
    log_prior = sum((np.log(d) for d in D), 0.0)
    value = -0.5 * ((n - k) * np.log(v_used) + log_det - log_prior + gram.log_det + np.maximum(left, 0.0) / v_used)
    value = value - 0.5 * n * np.log(2 * np.pi) + 0.5 * np.log(4 * np.pi / n)
    return value + _within(gram, v_used), v_used


def _within(gram: Gram, v: Float[np.ndarray, "n_set n_point"]) -> Float[np.ndarray, "n_set n_point"]:
    """Return the log share of each point's cell of the grid in which what remains is no larger than the gap."""
    with np.errstate(divide="ignore"):
        beyond = np.log10([point.ratio if point.remains else 0.0 for point in gram.points]) + 0.5 * np.log10(v)
        return np.log(np.clip((np.log10(gram.most) - beyond) / STEP + 0.5, 0.0, 1.0))


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
    v, mean = np.empty(len(sets)), [np.zeros(0)] * len(sets)
    covariance = [np.zeros((0, 0))] * len(sets)
    by_size: dict[int, list[int]] = {}
    for place, each in enumerate(sets):
        by_size.setdefault(len(each), []).append(place)
    for k, places in by_size.items():
        index = np.array([sets[p] for p in places], dtype=int).reshape(len(places), k)
        at, own = index + 1, points[places]
        G = gram.products[own[:, None, None], at[:, :, None], at[:, None, :]]
        b, square = gram.products[own[:, None], at, 0], gram.products[own, 0, 0]
        D = precision[index][:, :, None] * np.eye(k)
        scale = np.maximum((START if k else 1.0) * square / gram.n_obs, floor)
        inverse, theta, used = np.zeros_like(G), np.zeros_like(b), scale
        for _ in range(2 * PASSES if k else 1):
            A = G + scale[:, None, None] * D
            # Unit diagonal: coefficients may be of any size.
            root = 1 / np.sqrt(np.einsum("nii->ni", A))
            unit = root[:, :, None] * root[:, None, :]
            inverse = np.linalg.inv(A * unit + RIDGE * np.eye(k)) * unit
            theta = np.einsum("nij,nj->ni", inverse, b)
            used, left = scale, square - np.sum(b * theta, axis=1)
            scale = np.maximum(left / gram.n_obs, floor)
        for row, place in enumerate(places):
            v[place], mean[place], covariance[place] = used[row], theta[row], used[row] * inverse[row]
    return Modes(v, mean, covariance)
