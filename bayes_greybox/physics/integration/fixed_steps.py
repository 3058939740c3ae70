"""Paths of dx/dt = f(t, x, u, p) and their derivatives by starts and parameters, on steps that are fixed beforehand.

    dx/dt = f(t, x, u, p),   dS/dt = ∂f/∂x S + ∂f/∂p,   S = ∂x/∂(p, x₀)

are one system to the method of Tsitouras (2011), of order 5, so that S is the derivative of the path as it is computed.
No step is rejected and no input is searched for. The program is a plain loop over the intervals between samples with
another over the steps in each, whose numbers are arguments. The caller finds the error of a path with more steps.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .solvers import diffrax

Rate = Callable[[Array, Array, Array, Array], Array]
"""(t, x [d], u [p], parameters [q]) -> dx/dt [d]."""


class Intervals(NamedTuple):
    """Intervals between the samples of a segment; those of no length change nothing.

    Inputs are coefficients of 1, b, b², b³ at the share b of an interval.
    """

    start: Float[Array, "*segment n"]
    length: Float[Array, "*segment n"]
    inputs: Float[Array, "*segment n 4 p"]


def intervals_of(
    t: Float[np.ndarray, " m"], values: Float[np.ndarray, "m p"], curvature: Float[np.ndarray, "m p"],
    held: Sequence[bool], n: int,
) -> Intervals:  # fmt: skip
    """Return n intervals between samples; inputs are held where `held`, and else follow splines of this curvature.

    Intervals after the last sample have no length; a curvature of zero is a straight line.
    """
    more = n + 1 - len(t)
    t, values, curvature = (np.pad(x, ((0, more), *((0, 0),) * (x.ndim - 1)), "edge") for x in (t, values, curvature))
    h = np.diff(t)[:, None]
    first, rise, m0, m1 = values[:-1], np.diff(values, axis=0), curvature[:-1], curvature[1:]
    rise, m0, m1 = (np.where(np.asarray(held, bool), 0.0, each) for each in (rise, m0, m1))
    # a v₀ + b v₁ + (a (a² − 1) m₀ + b (b² − 1) m₁) h²/6 with a = 1 − b, by powers of b.
    powers = [first, rise - (2 * m0 + m1) * h**2 / 6, m0 * h**2 / 2, (m1 - m0) * h**2 / 6]
    return Intervals(jnp.asarray(t[:-1]), jnp.asarray(h[:, 0]), jnp.asarray(np.stack(powers, axis=1)))


def follow(
    rate: Rate, start: Float[Array, " d"], parameters: Float[Array, " q"], intervals: Intervals, steps: Int[Array, " n"]
) -> Float[Array, "n_sample d"]:
    """Return the path at the samples, the start x₀ first, with `steps` in each interval."""
    return _loop(lambda t, x, u: rate(t, x[0], u, parameters)[None], start[None], intervals, steps)[:, 0]


def follow_with_slopes(
    rate: Rate, start: Float[Array, " d"], parameters: Float[Array, " q"], intervals: Intervals, steps: Int[Array, " n"]
) -> tuple[Float[Array, "n_sample d"], Float[Array, "n_sample q_and_d d"]]:
    """Return the path as `follow` does, and its derivatives by the parameters and then by the start."""
    q, d = len(parameters), len(start)
    by_parameters = jnp.eye(q + d)[:, :q]

    def both(t: Array, x: Array, u: Array) -> Array:
        def along(S: Array, p: Array) -> tuple[Array, Array]:
            return jax.jvp(lambda x, p: rate(t, x, u, p), (x[0], parameters), (S, p))

        slope, slopes = jax.vmap(along, out_axes=(None, 0))(x[1:], by_parameters)
        return jnp.concatenate([slope[None], slopes])

    path = _loop(both, jnp.concatenate([start[None], jnp.eye(q + d)[:, q:]]), intervals, steps)
    return path[:, 0], path[:, 1:]


def _loop(
    rate: Callable[[Array, Array, Array], Array], start: Array, intervals: Intervals, steps: Array
) -> Float[Array, "n_sample k d"]:
    # Its last stage is the next step's first, and is of no use without a step that may be rejected.
    tableau = diffrax().Tsit5.tableau

    def interval(x: Array, given: tuple[Intervals, Array]) -> tuple[Array, Array]:
        (begin, length, inputs), count = given

        def step(k: Array, x: Array) -> Array:
            h, stages = length / count, []
            for a, c in zip([(), *tableau.a_lower[:-1]], [0.0, *tableau.c[:-1]], strict=True):
                b = (k + c) / count
                u = inputs[0] + b * (inputs[1] + b * (inputs[2] + b * inputs[3]))
                at = x + h * sum(weight * stage for weight, stage in zip(a, stages, strict=True)) if stages else x
                stages.append(rate(begin + b * length, at, u))
            return x + h * sum(weight * stage for weight, stage in zip(tableau.b_sol[:-1], stages, strict=True))

        x = jax.lax.fori_loop(0, count, step, x)
        return x, x

    _, after = jax.lax.scan(interval, start, (intervals, steps))
    return jnp.concatenate([start[None], after])
