"""Kalman filters of several intensities of one process at once, compiled: innovations of tables, and a smoothed state.

x_k = F_k x_{k-1} + r q_k,  z_ka = H_a x_k + s_ka e_ka. The gains are the same for every column of a table, so that the
innovations whiten all of them (de Jong 1989, Biometrika 76:663). Records are filled up to few lengths, and tables to a
multiple of columns, so that few shapes are compiled.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from bayes_greybox.physics.integration.sensitivity import filled_length
from bayes_greybox.running.compiling import compiled


class Process(NamedTuple):
    """A linear process that sensors show, one sample after the other, in stretches that start afresh.

    F leads to each sample from the one before, Q is what unit intensity adds on the way; `started` is the covariance of
    the process of unit intensity at a start, `start` that of all else.
    """

    F: Float[np.ndarray, "n d d"]
    Q: Float[np.ndarray, "n d d"]
    H: Float[np.ndarray, "p d"]
    noise: Float[np.ndarray, "n p"]
    fresh: Bool[np.ndarray, " n"]
    start: Float[np.ndarray, "d d"]
    started: Float[np.ndarray, "d d"]


def innovations(
    process: Process, ratios: Float[np.ndarray, " n_ratio"], z: Float[np.ndarray, "n p k"]
) -> tuple[Float[np.ndarray, "n p n_ratio k"], Float[np.ndarray, "n p n_ratio"]]:
    """Return the innovations of a table, each over its standard deviation, and the logarithms of their variances."""
    white, logs = _innovations(*_filled(process, z), np.asarray(ratios, float))
    return np.asarray(white)[: len(z), ..., : z.shape[2]], np.asarray(logs)[: len(z)]


def smoothed(
    process: Process, ratio: float, z: Float[np.ndarray, "n p k"], state: int
) -> tuple[Float[np.ndarray, "n k"], Float[np.ndarray, " n"]]:
    """Return the posterior mean of one state at the samples, and its variance."""
    mean, variance = _smoothed(*_filled(process, z), float(ratio), np.eye(process.F.shape[1])[state])
    return np.asarray(mean)[: len(z), : z.shape[2]], np.asarray(variance)[: len(z)]


def _filled(process: Process, z: np.ndarray) -> tuple[Process, np.ndarray]:
    """Return process and table filled up behind the record, where nothing sees it."""
    rows, columns = filled_length(len(z)) - len(z), -z.shape[2] % 32

    def longer(values: np.ndarray, by: float = 0.0) -> np.ndarray:
        return np.concatenate([values, np.full((rows, *values.shape[1:]), by, dtype=values.dtype)])

    F, Q, H, noise, fresh, start, started = process
    filled = Process(longer(F), longer(Q), H, longer(noise, 1.0), longer(fresh), start, started)
    return filled, np.pad(z, ((0, rows), (0, 0), (0, columns)))


def _updated(P: Array, H: Array, noise: Array) -> tuple[Array, Array, Array]:
    """Return gain, variance of the innovation, and the covariance after a reading, positive by Joseph's form."""
    shown = P @ H
    S = shown @ H + noise
    K = shown / S[..., None]
    left = jnp.eye(P.shape[-1]) - K[..., :, None] * H
    return K, S, left @ P @ left.swapaxes(-1, -2) + noise * K[..., :, None] * K[..., None, :]


def _gains(process: Any, ratios: Array) -> tuple[Array, Array]:
    F, Q, H, noise, fresh, start, started = process
    square = (ratios**2)[:, None, None]
    begun = start + square * started

    def step(P: Array, piece: tuple[Array, ...]) -> tuple[Array, tuple[Array, Array]]:
        F, Q, noise, fresh = piece
        P = F @ jnp.where(fresh, begun, P) @ F.T + square * Q
        gains, variances = [], []
        for a in range(H.shape[0]):
            K, S, P = _updated(P, H[a], noise[a])
            gains.append(K)
            variances.append(S)
        return P, (jnp.stack(gains), jnp.stack(variances))

    return jax.lax.scan(step, jnp.zeros((ratios.shape[0], *start.shape)), (F, Q, noise, fresh))[1]


def _filter_of(process: Any, z: Array, ratios: Array) -> tuple[Array, Array]:
    F, H, d = jnp.where(process.fresh[:, None, None], 0.0, process.F), process.H, process.F.shape[1]
    gains, variances = _gains(process, ratios)
    scale = 1 / jnp.sqrt(variances)

    # Sums that are written out become one pass over a row; products of small matrices take twice as long.
    def step(m: list[Array], piece: tuple[Array, ...]) -> tuple[list[Array], Array]:
        F, z, K, scale = piece
        m = [sum((F[i, j] * m[j] for j in range(1, d)), F[i, 0] * m[0]) for i in range(d)]
        white = []
        for a in range(H.shape[0]):
            innovation = z[a] - sum(H[a, j] * m[j] for j in range(d))
            m = [m[j] + K[a, :, j, None] * innovation for j in range(d)]
            white.append(innovation * scale[a, :, None])
        return m, jnp.stack(white)

    first = [jnp.zeros((ratios.shape[0], z.shape[2]))] * d
    return jax.lax.scan(step, first, (F, z, gains, scale))[1], jnp.log(variances)


def _smoother_of(process: Any, z: Array, ratio: Array, unit: Array) -> tuple[Array, Array]:
    F, Q, H, noise, fresh, start, started = process
    begun = start + ratio**2 * started

    def ahead(carry: tuple[Array, Array], piece: tuple[Array, ...]) -> tuple[tuple[Array, Array], tuple[Array, ...]]:
        P, m = carry
        F, Q, noise, fresh, z = piece
        P = F @ jnp.where(fresh, begun, P) @ F.T + ratio**2 * Q
        m = jnp.where(fresh, 0.0, F @ m)
        before, gains, scaled, precision = (P, m), [], [], []
        for a in range(H.shape[0]):
            innovation = z[a] - H[a] @ m
            K, S, P = _updated(P, H[a], noise[a])
            m = m + jnp.outer(K, innovation)
            gains.append(K)
            scaled.append(innovation / S)
            precision.append(1 / S)
        return (P, m), (*before, jnp.stack(gains), jnp.stack(scaled), jnp.stack(precision))

    first = jnp.zeros_like(start), jnp.zeros((start.shape[0], z.shape[2]))
    _, (P, m, K, scaled, precision) = jax.lax.scan(ahead, first, (F, Q, noise, fresh, z))

    def back(later: tuple[Array, Array], piece: tuple[Array, ...]) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        # Later innovations are summed up in r and N: mean m + P r, covariance P − P N P.
        F, fresh, P, m, K, scaled, precision = piece
        r, N = later
        for a in reversed(range(H.shape[0])):
            r = r + jnp.outer(H[a], scaled[a] - K[a] @ r)
            left = jnp.eye(len(unit)) - jnp.outer(K[a], H[a])
            N = left.T @ N @ left + precision[a] * jnp.outer(H[a], H[a])
        shown = unit @ P
        smoothed_state = unit @ m + shown @ r, shown @ unit - shown @ N @ shown
        return (jnp.where(fresh, 0.0, F.T @ r), jnp.where(fresh, 0.0, F.T @ N @ F)), smoothed_state

    nothing = jnp.zeros_like(m[0]), jnp.zeros_like(start)
    mean, variance = jax.lax.scan(back, nothing, (F, fresh, P, m, K, scaled, precision), reverse=True)[1]
    return mean, jnp.maximum(variance, 0.0)


_innovations: Any = compiled(_filter_of)
_smoothed: Any = compiled(_smoother_of)
