"""Smoothed path of a system from noisy samples of some of its states, where its equations may lack something.

    dx = rhs(t, x, u) dt + E q dW,    y = H x + noise of relative variances r

is smoothed by Kalman filters that are linearised along the latest path (Bell 1994, SIAM J. Optim. 4:626: Gauss and
Newton's method on the posterior of the path). The ratio λ = q²/σ² is chosen by the likelihood of the innovations, in
which σ² is profiled out; λ → 0 is a path that the equations allow. E has a column for each unknown force: where it
acts, and how large it is beside the others.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .sensitivity import Grid, Response, filled_length, triples

TRIED_SHARES = (1.0, 0.5, 0.25, 0.1, 0.0)
"""Shares of a change of the path, of which the largest is taken that keeps the equations defined."""


class Observed(NamedTuple):
    """Samples at the ends of steps, NaN where there is none; noise variances over σ²; mean, SD of the first state."""

    values: Float[Any, "n_segment n_end n_output"]
    variances: Float[Any, " n_output"]
    mean: Float[Any, "n_segment n_state"]
    sd: Float[Any, " n_state"]


class Steps(NamedTuple):
    """Linear steps x₊ = M x + c + B w, w white with the variance λ σ² / length, held over a step.

    Steps of no length do nothing.
    """

    M: Float[Any, "n_segment n_step n_state n_state"]
    c: Float[Any, "n_segment n_step n_state"]
    B: Float[Any, "n_segment n_step n_state n_force"]
    length: Float[Any, "n_segment n_step"]


def steps_along(
    time: Float[np.ndarray, "n_segment n_node"], ends: Float[np.ndarray, "n_segment n_end n_state"],
    response: Response, departure: Float[np.ndarray, "n_segment n_step 3 n_state"],
    E: Float[np.ndarray, "n_state n_force"],
) -> Steps:  # fmt: skip
    """Linearise along a path, of which the rates depart by `departure`; E has the rates by each unknown force."""
    length = np.diff(time[:, ::2], axis=1)
    c = ends[:, 1:] + response.jumps(departure) - np.einsum("snij,snj->sni", response.M, ends[:, :-1])
    # Nothing moves in no time, wherever a filter left the ends of such a step.
    c = np.where(length[..., None] > 0, c, 0.0)
    return Steps(response.M, c, response.b.sum(axis=-2) @ E, length)


def smooth(
    steps: Steps, observed: Observed, outputs: tuple[int, ...], ratio: float
) -> Float[np.ndarray, "n_segment n_end n_state"]:
    """Return the posterior mean of the path of linear steps at their ends, given the ratio λ.

    `outputs` are the indices of the states that are sampled.
    """
    return np.asarray(_smooth(*_padded(steps, observed), outputs, ratio)[0])[:, : steps.M.shape[1] + 1]


def log_likelihoods(
    steps: Steps, observed: Observed, outputs: tuple[int, ...], ratios: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return the log likelihoods of several ratios λ, σ² profiled out, in one run of their filters."""
    return np.asarray(_log_likelihoods(*_padded(steps, observed), outputs, ratios))


def filtered(
    rate: Callable[..., Array], grid: Grid, observed: Observed, outputs: tuple[int, ...],
    E: Float[np.ndarray, "n_state n_force"], ratio: float, args: object,
) -> Float[np.ndarray, "n_segment n_end n_state"]:  # fmt: skip
    """Return the path of the extended Kalman filter, which needs no path before it to be linearised along.

    Where a sample would take it out of the domain of the equations, it goes only part of the way, or stays. The other
    arguments are those of `smooth` and `steps_along`; `rate(t, x, u, args)` is at one point.
    """
    n_step = grid.time.shape[1] // 2
    more = filled_length(n_step) - n_step
    # Steps of no length are appended, because the number of steps changes with the time scales of each trial.
    time, inputs = (np.pad(x, ((0, 0), (0, 2 * more), *((0, 0),) * (x.ndim - 2)), mode="edge") for x in grid)
    values = np.pad(np.asarray(observed.values), ((0, 0), (0, more), (0, 0)), constant_values=np.nan)
    pieces, observed = (triples(time), triples(inputs)), observed._replace(values=values)
    return np.asarray(_filtered(rate, pieces, observed, outputs, E, ratio, args))[:, : n_step + 1]


def _padded(steps: Steps, observed: Observed) -> tuple[Steps, Observed]:
    """Append steps of no length, see `filled_length`."""
    n_step, n_state = steps.M.shape[1:3]
    more = filled_length(n_step) - n_step
    still = np.broadcast_to(np.eye(n_state), (len(steps.M), more, n_state, n_state))
    M = np.concatenate([steps.M, still], axis=1)
    c, B, length = (np.pad(np.asarray(x), ((0, 0), (0, more), *((0, 0),) * (x.ndim - 2))) for x in steps[1:])
    values = np.pad(np.asarray(observed.values), ((0, 0), (0, more), (0, 0)), constant_values=np.nan)
    return Steps(M, c, B, length), observed._replace(values=values)


@partial(jax.jit, static_argnums=(0, 3))
def _filtered(
    rate: Callable[..., Array], pieces: tuple[Array, Array], observed: Observed, outputs: tuple[int, ...], E: Array,
    ratio: Array, args: object,
) -> Array:  # fmt: skip
    H = jnp.eye(observed.mean.shape[-1])[jnp.array(outputs)]

    def defined(time: Array, x: Array, u: Array) -> Array:
        return jnp.all(jnp.isfinite(rate(time, x, u, args)))

    def update(before: Array, P: Array, time: Array, u: Array, y: Array) -> tuple[Array, Array]:
        x, after, *_ = _update(H, observed.variances, before, P, y)
        tried = before + jnp.array(TRIED_SHARES)[:, None] * (x - before)
        inside = jax.vmap(defined, in_axes=(None, 0, None))(time, tried, u)
        # A sample that was not taken in full makes nothing better known than before.
        return jnp.where(jnp.any(inside), tried[jnp.argmax(inside)], x), jnp.where(inside[0], after, P)

    def one(time: Array, inputs: Array, values: Array, mean: Array, P: Array) -> Array:
        # A step of no length before the others leads to the first sample.
        time, inputs = (jnp.concatenate([jnp.broadcast_to(x[:1, :1], x[:1].shape), x]) for x in (time, inputs))

        def forward(carry: tuple[Array, Array], piece: tuple[Array, Array, Array]) -> tuple[tuple, Array]:
            (x, P), (t, u, y) = carry, piece
            after, M, B = _step(rate, t, u, x, E, args)
            # A step that leaves the domain on its way is not taken.
            moved = jnp.all(jnp.isfinite(M)) & jnp.all(jnp.isfinite(B)) & defined(t[2], after, u[2])
            after, M = jnp.where(moved, after, x), jnp.where(moved, M, jnp.eye(len(x)))
            h = t[2] - t[0]
            B = jnp.where(moved, B, h * E)
            intensity = jnp.where(h > 0, ratio / jnp.where(h > 0, h, 1.0), 0.0)
            x, P = update(after, M @ P @ M.T + intensity * (B @ B.T), t[2], u[2], y)
            return (x, P), x

        return jax.lax.scan(forward, (mean, P), (time, inputs, values))[1]

    # One for each segment: an array that is not batched would have the loop traced once more.
    P = jnp.tile(jnp.diag(observed.sd**2), (len(observed.mean), 1, 1))
    return jax.vmap(one)(*pieces, observed.values, observed.mean, P)


@partial(jax.jit, static_argnums=2)
def _smooth(steps: Steps, observed: Observed, outputs: tuple[int, ...], ratio: Array) -> tuple[Array, Array]:
    H = jnp.eye(observed.mean.shape[-1])[jnp.array(outputs)]
    update = partial(_update, H, observed.variances)

    def one(steps: Steps, values: Array, mean: Array) -> tuple[Array, Array, Array, Array]:
        x, P, first, *start = update(mean, jnp.diag(observed.sd**2), values[0])

        def forward(carry: tuple[Array, Array], piece: tuple[Steps, Array]) -> tuple[tuple[Array, Array], tuple]:
            (x, P), ((M, c, B, h), y) = carry, piece
            intensity = jnp.where(h > 0, ratio / jnp.where(h > 0, h, 1.0), 0.0)
            x, P, terms, *sums = update(M @ x + c, M @ P @ M.T + intensity * (B @ B.T), y)
            return (x, P), (terms, *sums)

        _, (terms, *sums) = jax.lax.scan(forward, (x, P), (steps, values[1:]))

        def backward(adjoint: Array, piece: tuple) -> tuple[Array, Array]:
            terms, M = piece
            smoothed, adjoint = _smoothed(terms, adjoint)
            return M.T @ adjoint, smoothed

        adjoint, ends = jax.lax.scan(backward, jnp.zeros_like(mean), (terms, steps.M), reverse=True)
        whole = jnp.concatenate([_smoothed(first, adjoint)[0][None], ends])
        square, log_det, count = (a + jnp.sum(each) for a, each in zip(start, sums, strict=True))
        return whole, square, log_det, count

    ends, squares, log_dets, counts = jax.vmap(one)(steps, observed.values, observed.mean)
    n = jnp.sum(counts)
    sigma2 = jnp.sum(squares) / n
    return ends, -0.5 * (n * jnp.log(sigma2) + jnp.sum(log_dets))


@partial(jax.jit, static_argnums=2)
def _log_likelihoods(steps: Steps, observed: Observed, outputs: tuple[int, ...], ratios: Array) -> Array:
    # The compiler drops the way back, which likelihoods do without.
    return jax.vmap(lambda ratio: _smooth(steps, observed, outputs, ratio)[1])(ratios)


def _step(
    rate: Callable[..., Array], time: Array, inputs: Array, x: Array, E: Array, args: object
) -> tuple[Array, Array, Array]:
    """Take a step of Runge and Kutta's; return the state and its derivatives by the state and by the unknown forces."""
    h = time[2] - time[0]

    def move(x: Array, force: Array) -> Array:
        k1 = rate(time[0], x, inputs[0], args) + E @ force
        k2 = rate(time[1], x + h / 2 * k1, inputs[1], args) + E @ force
        k3 = rate(time[1], x + h / 2 * k2, inputs[1], args) + E @ force
        k4 = rate(time[2], x + h * k3, inputs[2], args) + E @ force
        return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    def moved(x: Array, force: Array) -> tuple[Array, Array]:
        after = move(x, force)
        return after, after

    (M, B), after = jax.jacfwd(moved, argnums=(0, 1), has_aux=True)(x, jnp.zeros(E.shape[1]))
    return after, M, B


def _update(H: Array, variances: Array, x: Array, P: Array, y: Array) -> tuple:
    """Filter one sample: return state, covariance, terms for the smoother, Σ v²/S, Σ log S and the number of values.

    One output is taken after the other, so that a missing one is passed over.
    """
    terms, square, log_det, count = [], jnp.zeros(()), jnp.zeros(()), jnp.zeros(())
    for h, r, sample in zip(H, variances, y, strict=True):
        there = jnp.isfinite(sample)
        S = h @ P @ h + r
        v = jnp.where(there, sample - h @ x, 0.0)
        K = jnp.where(there, P @ h / S, 0.0)
        L = jnp.eye(len(x)) - jnp.outer(K, h)
        terms.append((x, P, jnp.where(there, h / S, 0.0) * v, L))
        x, P = x + K * v, L @ P @ L.T + r * jnp.outer(K, K)
        square, log_det, count = square + v**2 / S, log_det + jnp.where(there, jnp.log(S), 0.0), count + there
    return x, P, terms, square, log_det, count


def _smoothed(terms: list, adjoint: Array) -> tuple[Array, Array]:
    """Return the smoothed state before the updates of one sample and the adjoint there (de Jong 1989, JASA 84:1085)."""
    for _, _, gained, L in reversed(terms):
        adjoint = gained + L.T @ adjoint
    x, P, _, _ = terms[0]
    return x + P @ adjoint, adjoint
