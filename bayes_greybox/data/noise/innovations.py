"""Kalman innovations of a path that an unknown force moves, compiled for `starts_noise`.

Records are padded to a power of two in length and in columns, so that few shapes are compiled. The padding stands
behind the record, and nothing before it depends on it.
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .starts_noise import Motion

BySample = Float[np.ndarray, "n n_output"]
Gains = Float[np.ndarray, "n n_output d"]
Columns = Float[np.ndarray, "n n_output k"]

# Data come before physics, where 64-bit is switched on for everything downstream.
jax.config.update("jax_enable_x64", True)


def gains(motion: Motion, r: BySample, intensity: float) -> tuple[Gains, BySample]:
    """Return gains and variances of the innovations, sensor by sensor, for noise variances r and intensity λ."""
    M, G, fresh = (_padded(values) for values in (motion.M, motion.G, motion.fresh))
    K, S = _gains(M, G, fresh, _padded(r, 1.0), motion.start_sd, intensity, outputs=motion.outputs)
    return np.asarray(K)[: len(r)], np.asarray(S)[: len(r)]


def innovations(motion: Motion, K: Gains, y: Columns) -> Columns:
    """Return rows less their prediction from earlier samples, for gains K and rows y, each column by itself."""
    return _applied(_innovations, motion, K, y)


def adjoint(motion: Motion, K: Gains, y: Columns) -> Columns:
    """Run the transpose of `innovations` backwards; arguments as there."""
    return _applied(_adjoint, motion, K, y)


def precision_diagonal(motion: Motion, K: Gains, S: BySample) -> BySample:
    """Return 1/S + Kᵀ N K, N the covariance of the adjoint, K the gains and S the variances of the innovations."""
    arrays = (_padded(values) for values in (motion.M, motion.fresh, K, 1 / S))
    return np.asarray(_precision(*arrays, outputs=motion.outputs))[: len(S)]


def _applied(work: Callable[..., Array], motion: Motion, K: np.ndarray, y: np.ndarray) -> np.ndarray:
    n, k = len(y), y.shape[-1]
    wide = np.concatenate([y, np.zeros((*y.shape[:-1], _power_of_two(k) - k))], axis=-1)
    arrays = (_padded(values) for values in (motion.M, motion.fresh, K, wide))
    return np.asarray(work(*arrays, outputs=motion.outputs))[:n, :, :k]


def _padded(values: np.ndarray, by: float = 0.0) -> np.ndarray:
    n = len(values)
    return np.concatenate([values, np.full((_power_of_two(n) - n, *values.shape[1:]), by, dtype=values.dtype)])


def _power_of_two(n: int) -> int:
    return 1 << max(n - 1, 0).bit_length()


@partial(jax.jit, static_argnames="outputs")
def _gains(
    M: Array, G: Array, fresh: Array, r: Array, start_sd: Array, intensity: Array, outputs: tuple[int, ...]
) -> tuple[Array, Array]:
    start, eye = jnp.diag(start_sd**2), jnp.eye(len(start_sd))

    def step(P: Array, piece: tuple[Array, ...]) -> tuple[Array, tuple[Array, Array]]:
        M, G, fresh, r = piece
        P, updates = M @ jnp.where(fresh, start, P) @ M.T + intensity * G, []
        for k, output in enumerate(outputs):
            S = P[output, output] + r[k]
            K = P[output] / S
            L = eye - jnp.outer(K, eye[output])
            # Joseph's form, which stays positive
            P = L @ P @ L.T + r[k] * jnp.outer(K, K)
            updates.append((K, S))
        return P, (jnp.stack([K for K, _ in updates]), jnp.stack([S for _, S in updates]))

    return jax.lax.scan(step, start, (M, G, fresh, r))[1]


@partial(jax.jit, static_argnames="outputs")
def _innovations(M: Array, fresh: Array, K: Array, y: Array, outputs: tuple[int, ...]) -> Array:
    def step(mean: Array, piece: tuple[Array, ...]) -> tuple[Array, Array]:
        M, fresh, K, y = piece
        mean, errors = jnp.where(fresh, 0.0, M @ mean), []
        for k, output in enumerate(outputs):
            errors.append(y[k] - mean[output])
            mean = mean + jnp.outer(K[k], errors[-1])
        return mean, jnp.stack(errors)

    return jax.lax.scan(step, jnp.zeros((M.shape[-1], y.shape[-1])), (M, fresh, K, y))[1]


@partial(jax.jit, static_argnames="outputs")
def _adjoint(M: Array, fresh: Array, K: Array, y: Array, outputs: tuple[int, ...]) -> Array:
    def step(costate: Array, piece: tuple[Array, ...]) -> tuple[Array, Array]:
        M, fresh, K, y = piece
        rows = [jnp.zeros(())] * len(outputs)
        for k, output in reversed(list(enumerate(outputs))):
            rows[k] = y[k] + K[k] @ costate
            costate = costate.at[output].add(-rows[k])
        return jnp.where(fresh, 0.0, M.T @ costate), jnp.stack(rows)

    return jax.lax.scan(step, jnp.zeros((M.shape[-1], y.shape[-1])), (M, fresh, K, y), reverse=True)[1]


@partial(jax.jit, static_argnames="outputs")
def _precision(M: Array, fresh: Array, K: Array, inverse: Array, outputs: tuple[int, ...]) -> Array:
    eye = jnp.eye(M.shape[-1])

    def step(N: Array, piece: tuple[Array, ...]) -> tuple[Array, Array]:
        M, fresh, K, inverse = piece
        diagonal = [jnp.zeros(())] * len(outputs)
        for k, output in reversed(list(enumerate(outputs))):
            diagonal[k] = inverse[k] + K[k] @ N @ K[k]
            L = eye - jnp.outer(K[k], eye[output])
            N = L.T @ N @ L + jnp.outer(eye[output], eye[output]) * inverse[k]
        return jnp.where(fresh, 0.0, M.T @ N @ M), jnp.stack(diagonal)

    return jax.lax.scan(step, jnp.zeros_like(eye), (M, fresh, K, inverse), reverse=True)[1]
