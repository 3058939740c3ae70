"""A path of dx/dt = rhs(t, x, u) on a grid, and how it answers a small force: the linear equation along it.

Along a path x̄ with the Jacobian A(t) = ∂rhs/∂x, a force φ(t) on one state's rate moves the path by δ,

    dδ/dt = A(t) δ + e φ(t),

linear in φ and in δ(t₀). Both are integrated by the classical method of Runge and Kutta of order four, whose stages sit
on the ends and the middles of steps: the grid that φ has to be known on.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Rate = Callable[[Array, Array, Array], Array]
"""(t, x [n_state], u [n_input]) -> dx/dt [n_state]."""


class Grid(NamedTuple):
    """Segments of equally many steps; those of a shorter segment end in steps of no length.

    Attributes:
        time: Ends and middles of steps.
        inputs: At these.
    """

    time: Float[Array, "n_segment n_node"]
    inputs: Float[Array, "n_segment n_node n_input"]


class Response(NamedTuple):
    """Steps of the linear equation: δ₊ = M δ + b₀ φ₀ + b₁ φ₁ + b₂ φ₂, φ at the start, the middle and the end of a step.

    Attributes:
        M: Transition matrices.
        b: Columns b₀, b₁, b₂.
    """

    M: Float[Array, "n_segment n_step n_state n_state"]
    b: Float[Array, "n_segment n_step n_state 3"]


def runge_kutta(
    rate: Callable[..., Array], time: Array, inputs: Array, x: Array, force: Array, args: object
) -> Float[Array, " n_state"]:
    """One step with a constant force on every state's rate.

    Args:
        rate: `rate(t, x, u, args)`.
        time: Start, middle and end [3].
        inputs: At these [3, n_input].
        x: State at the start.
        force: Added to the rates.
        args: What else the rate needs.
    """
    h = time[2] - time[0]
    k1 = rate(time[0], x, inputs[0], args) + force
    k2 = rate(time[1], x + h / 2 * k1, inputs[1], args) + force
    k3 = rate(time[1], x + h / 2 * k2, inputs[1], args) + force
    k4 = rate(time[2], x + h * k3, inputs[2], args) + force
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


@partial(jax.jit, static_argnums=0)
def rates_at(
    rate: Callable[..., Array], grid: Grid, ends: Float[Array, "n_segment n_end n_state"], args: object
) -> Float[Array, "n_segment n_end n_state"]:
    """Rates at the ends of steps.

    Args:
        rate: `rate(t, x, u, args)`.
        grid: Nodes.
        ends: States there.
        args: What else the rate needs.
    """
    each = jax.vmap(jax.vmap(rate, (0, 0, 0, None)), (0, 0, 0, None))
    return each(grid.time[:, ::2], ends, grid.inputs[:, ::2], args)


@partial(jax.jit, static_argnums=0)
def jacobians(
    rate: Callable[..., Array], time: Float[Array, " n"], x: Float[Array, "n n_state"], u: Float[Array, "n n_input"],
    args: object,
) -> Float[Array, "n n_state n_state"]:  # fmt: skip
    """∂rhs/∂x at some points.

    Args:
        rate: `rate(t, x, u, args)`.
        time: Times.
        x: States.
        u: Inputs.
        args: What else the rate needs.
    """
    return jax.vmap(jax.jacfwd(rate, 1), (0, 0, 0, None))(time, x, u, args)


@partial(jax.jit, static_argnums=0)
def middles(
    rate: Callable[..., Array], grid: Grid, ends: Float[Array, "n_segment n_end n_state"], args: object
) -> Float[Array, "n_segment n_step n_state"]:
    """States in the middle of steps, on the cubic through their ends and the rates there.

    Args:
        rate: `rate(t, x, u, args)`.
        grid: Nodes.
        ends: States at the ends of steps.
        args: What else the rate needs.
    """
    rates = rates_at(rate, grid, ends, args)
    h = jnp.diff(grid.time[:, ::2], axis=1)[..., None]
    return (ends[:, 1:] + ends[:, :-1]) / 2 + h / 8 * (rates[:, :-1] - rates[:, 1:])


@partial(jax.jit, static_argnums=(0, 3))
def respond(
    rate: Callable[..., Array], grid: Grid, path: Float[Array, "n_segment n_node n_state"], driven: int, args: object
) -> Response:
    """Steps of the linear equation along a path.

    Args:
        rate: As in `follow`.
        grid: Nodes.
        path: At these.
        driven: Index of the state whose rate the force acts on.
        args: What else the rate needs.
    """
    jacobian = jax.vmap(jax.vmap(jax.jacfwd(rate, 1), (0, 0, 0, None)), (0, 0, 0, None))
    A = jacobian(grid.time, path, grid.inputs, args)
    h = (grid.time[:, 2::2] - grid.time[:, :-2:2])[..., None, None]
    A0, A1, A2 = A[:, :-2:2], A[:, 1::2], A[:, 2::2]
    eye = jnp.broadcast_to(jnp.eye(path.shape[-1]), A0.shape)
    zero, e = jnp.zeros_like(eye[..., :1]), eye[..., driven : driven + 1]

    def after(y: Array, f0: Array, f1: Array, f2: Array) -> Array:
        k1 = A0 @ y + f0
        k2 = A1 @ (y + h / 2 * k1) + f1
        k3 = A1 @ (y + h / 2 * k2) + f1
        k4 = A2 @ (y + h * k3) + f2
        return y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    M = after(eye, *3 * (jnp.zeros_like(eye),))
    b = [after(zero, *forces) for forces in ((e, zero, zero), (zero, e, zero), (zero, zero, e))]
    return Response(M, jnp.concatenate(b, axis=-1))


@jax.jit
def carried(
    response: Response, start: Float[Array, "n_segment n_state k"], force: Float[Array, "n_segment n_node k"]
) -> Float[Array, "n_segment n_end n_state k"]:
    """δ at the ends of all steps, the start first.

    Args:
        response: Steps.
        start: δ at the first node.
        force: φ on ends and middles of these steps, each of k columns on its own.
    """

    def step(delta: Array, piece: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        M, b, f = piece
        after = M @ delta + b @ f
        return after, after

    M, b, forces = response.M, response.b, triples(force)
    moved = jnp.moveaxis(M, 1, 0), jnp.moveaxis(b, 1, 0), jnp.moveaxis(forces, 1, 0)
    _, ends = jax.lax.scan(step, start, moved)
    return jnp.concatenate([start[:, None], jnp.moveaxis(ends, 0, 1)], axis=1)


def triples(x: Float[Array, "n_segment n_node *k"]) -> Float[Array, "n_segment n_step 3 *k"]:
    """Start, middle and end of each step."""
    return jnp.stack([x[:, :-2:2], x[:, 1::2], x[:, 2::2]], axis=2)
