"""The path of a system through noisy samples of some of its states, where something may be missing in its equations.

    dx = rhs(t, x, u) dt + e q dW,    y = H x + noise of relative variances r

is smoothed by Kalman filters that are linearised along the path so far (Bell 1994, SIAM J. Optim. 4:626: Gauss and
Newton's method on the posterior of the path). The ratio λ = q²/σ² is chosen by the likelihood of the innovations, in
which σ² is profiled out; λ → 0 is a path that the equations allow.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .sensitivity import Grid, runge_kutta, triples


class Observed(NamedTuple):
    """Samples at the ends of steps.

    Attributes:
        values: NaN where there is none.
        variances: Of their noise, over σ².
        mean: Expected state at the first node.
        sd: Its standard deviation.
    """

    values: Float[Array, "n_segment n_end n_output"]
    variances: Float[Array, " n_output"]
    mean: Float[Array, "n_segment n_state"]
    sd: Float[Array, " n_state"]


class Smoothed(NamedTuple):
    """A path, and what it says of the noise.

    Attributes:
        ends: States at the ends of steps.
        log_likelihood: Of λ, σ² profiled out.
        sigma: Noise of an output of relative variance one.
    """

    ends: Float[Array, "n_segment n_end n_state"]
    log_likelihood: Float[Array, ""]
    sigma: Float[Array, ""]


@partial(jax.jit, static_argnums=(0, 3, 4))
def smooth(
    rate: Callable[..., Array],
    grid: Grid,
    observed: Observed,
    outputs: tuple[int, ...],
    driven: int,
    ratio: Float[Array, ""],
    around: Float[Array, "n_segment n_end n_state"],
    known: Bool[Array, ""],
    args: object,
) -> Smoothed:
    """One pass of the smoother.

    Args:
        rate: `rate(t, x, u, args)`.
        grid: Nodes.
        observed: Samples.
        outputs: Indices of the states that are sampled.
        driven: Index of the state whose rate the unknown force acts on.
        ratio: λ.
        around: Path to linearise along.
        known: Whether there is one yet; else the filtered states themselves are.
        args: What else the rate needs.
    """
    H = jnp.eye(observed.mean.shape[-1])[jnp.array(outputs)]
    e = jnp.zeros(H.shape[1]).at[driven].set(1.0)
    results = jax.vmap(partial(_pass, rate, H, e, observed.variances, observed.sd, ratio, known, args))(
        grid.time, grid.inputs, observed.values, observed.mean, around
    )
    ends, squares, log_dets, counts = results
    n = jnp.sum(counts)
    sigma2 = jnp.sum(squares) / n
    return Smoothed(ends, -0.5 * (n * jnp.log(sigma2) + jnp.sum(log_dets)), jnp.sqrt(sigma2))


def _pass(rate, H, e, r, sd, ratio, known, args, time, inputs, values, mean, around):  # noqa: ANN001, ANN202, PLR0913, PLR0917
    """Filter and smoother of one segment (de Jong 1989): smoothed ends, Σ v²/S, Σ log S, number of samples."""

    def update(x, P, y):  # noqa: ANN001, ANN202
        # One output after the other, so that a missing one is passed over.
        terms, square, log_det, count = [], 0.0, 0.0, 0
        for k in range(H.shape[0]):
            h, there = H[k], jnp.isfinite(y[k])
            S = h @ P @ h + r[k]
            v = jnp.where(there, y[k] - h @ x, 0.0)
            K = jnp.where(there, P @ h / S, 0.0)
            L = jnp.eye(len(x)) - jnp.outer(K, h)
            terms.append((x, P, jnp.where(there, h / S, 0.0) * v, L))
            x, P = x + K * v, L @ P @ L.T + r[k] * jnp.outer(K, K)
            square, log_det, count = square + v**2 / S, log_det + jnp.where(there, jnp.log(S), 0.0), count + there
        return x, P, terms, square, log_det, count

    def step(carry, piece):  # noqa: ANN001, ANN202
        x, P, at = carry
        t, u, y, after = piece
        base = jnp.where(known, at, x)
        move = partial(runge_kutta, rate, t, u)
        M = jax.jacfwd(lambda x: move(x, 0 * x, args))(base)
        b = jax.jacfwd(lambda c: move(base, c * e, args))(0.0)
        h = t[2] - t[0]
        x_next = move(base, 0 * x, args) + M @ (x - base)
        P_next = M @ P @ M.T + jnp.where(h > 0, ratio / jnp.where(h > 0, h, 1.0), 0.0) * jnp.outer(b, b)
        x, P, terms, square, log_det, count = update(x_next, P_next, y)
        return (x, P, after), (terms, M, square, log_det, count)

    x, P, first, square, log_det, count = update(mean, jnp.diag(sd**2), values[0])
    pieces = (triples(time[None])[0], triples(inputs[None])[0])
    _, (terms, M, squares, log_dets, counts) = jax.lax.scan(step, (x, P, around[0]), (*pieces, values[1:], around[1:]))

    def back(terms, adjoint):  # noqa: ANN001, ANN202
        """Smoothed state before the updates of one sample, and the adjoint there."""
        for _, _, gained, L in reversed(terms):
            adjoint = gained + L.T @ adjoint
        x, P, _, _ = terms[0]
        return x + P @ adjoint, adjoint

    def backwards(adjoint, piece):  # noqa: ANN001, ANN202
        terms, M = piece
        smoothed, adjoint = back(terms, adjoint)
        return M.T @ adjoint, smoothed

    adjoint, ends = jax.lax.scan(backwards, jnp.zeros_like(mean), (terms, M), reverse=True)
    start, _ = back(first, adjoint)
    total = (square + jnp.sum(squares), log_det + jnp.sum(log_dets), count + jnp.sum(counts))
    return jnp.concatenate([start[None], ends]), *total


def smoothest(
    pass_at: Callable[[float, Array | None], Smoothed], ratios: Float[np.ndarray, " n"], passes: int
) -> tuple[Smoothed, float]:
    """The path at the likeliest λ, and that λ.

    Args:
        pass_at: One pass of the smoother at some λ around some path.
        ratios: Values of λ.
        passes: Passes at the λ that was chosen.
    """
    logs = np.array([float(pass_at(ratio, None).log_likelihood) for ratio in ratios])
    best = float(ratios[int(np.nanargmax(logs))])
    found = pass_at(best, None)
    for _ in range(passes):
        found = pass_at(best, found.ends)
    return found, best
