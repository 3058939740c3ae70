"""How a path of dx/dt = rhs(t, x, u) answers a small force: the linear equation along it, on a grid of steps.

Along a path x̄ with the Jacobian A(t) = ∂rhs/∂x, forces φ(t) on the states' rates move the path by δ,

    dδ/dt = A(t) δ + φ(t),

linear in φ and in δ(t₀). It is integrated by the classical method of Runge and Kutta of order four, whose stages sit on
the ends and the middles of steps. What a force is within a step counts by its integral, so one with a kink or a jump is
replaced by the parabola nearest to it.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

ROUGH = 0.1
"""A force that departs this much from a straight line within a step, over its own size, is looked at closely."""

WITHIN = (8, 64)
"""Points within a step at which it is: the first look, and the second one where the first saw something else."""

LEAST = 8
"""Steps of a smoother, at least: programs are compiled for their powers of two."""


class Grid(NamedTuple):
    """Segments of equally many steps; those of a shorter segment end in steps of no length.

    Attributes:
        time: Ends and middles of steps.
        inputs: At these.
    """

    time: Float[np.ndarray, "n_segment n_node"]
    inputs: Float[np.ndarray, "n_segment n_node n_input"]


class Response(NamedTuple):
    """Steps of the linear equation: δ₊ = M δ + Σ b φ over the start, the middle and the end of a step.

    Attributes:
        M: Transition matrices.
        b: Response to forces at these three, each on the rate of each state.
    """

    M: Float[np.ndarray, "n_segment n_step n_state n_state"]
    b: Float[np.ndarray, "n_segment n_step n_state 3 n_state"]

    def jumps(
        self, force: Float[np.ndarray, "n_segment n_step 3 n_state"]
    ) -> Float[np.ndarray, "n_segment n_step n_state"]:
        """What forces on all states add to δ after each step."""
        return np.einsum("snitj,sntj->sni", self.b, force, optimize=True)


def respond(
    time: Float[np.ndarray, "n_segment n_node"], A: Float[np.ndarray, "n_segment n_node n_state n_state"]
) -> Response:
    """Steps of the linear equation along a path.

    Args:
        time: Ends and middles of steps.
        A: Jacobian at these.
    """
    h = (time[:, 2::2] - time[:, :-2:2])[..., None, None]
    A0, A1, A2 = A[:, :-2:2], A[:, 1::2], A[:, 2::2]
    eye = np.broadcast_to(np.eye(A.shape[-1]), A0.shape)
    # Stages of δ, then of a unit force at the start, the middle and the end.
    k2 = A1 + h / 2 * A1 @ A0
    k3 = A1 + h / 2 * A1 @ k2
    k4 = A2 + h * A2 @ k3
    M = eye + h / 6 * (A0 + 2 * k2 + 2 * k3 + k4)
    start = h / 6 * (eye + h * A1 + h**2 / 2 * A1 @ A1 + h**3 / 4 * A2 @ A1 @ A1)
    middle = h / 6 * (4 * eye + h * A1 + h * A2 + h**2 / 2 * A2 @ A1)
    end = np.broadcast_to(h / 6 * eye, A0.shape)
    return Response(M, np.stack([start, middle, end], axis=3))


def carried(
    M: Float[np.ndarray, "n_segment n_step n_state n_state"], start: Float[np.ndarray, "n_segment n_state k"],
    jump: Float[np.ndarray, "n_segment n_step n_state k"],
) -> Float[np.ndarray, "n_segment n_end n_state k"]:  # fmt: skip
    """δ at the ends of all steps, the start first: δ₊ = M δ + jump, each of k columns on its own.

    Args:
        M: Transition matrices.
        start: δ at the first node.
        jump: What is added after each step.
    """
    n_segment, n_step, n_state, k = jump.shape
    whole = np.empty((n_segment, n_step + 1, n_state, k))
    whole[:, 0] = start
    # As many blocks as steps within a block: all of them side by side from zero, then each from the end of the last.
    block = max(1, math.isqrt(n_step))
    n_block = -(-n_step // block)
    if more := n_block * block - n_step:
        M, jump = (np.pad(x, ((0, 0), (0, more), (0, 0), (0, 0))) for x in (M, jump))
    M, jump = (x.reshape(n_segment, n_block, block, n_state, x.shape[-1]) for x in (M, jump))
    moved, carry = np.empty_like(jump), np.empty_like(M)
    delta, product = np.zeros(jump[:, :, 0].shape), np.broadcast_to(np.eye(n_state), M[:, :, 0].shape)
    # What is not finite is for the caller to judge.
    with np.errstate(over="ignore", invalid="ignore"):
        for t in range(block if n_step else 0):
            delta, product = M[:, :, t] @ delta + jump[:, :, t], M[:, :, t] @ product
            moved[:, :, t], carry[:, :, t] = delta, product
        delta = start
        for n in range(n_block):
            ends = whole[:, 1 + n * block : 1 + (n + 1) * block]
            ends[:] = (carry[:, n] @ delta[:, None] + moved[:, n])[:, : ends.shape[1]]
            delta = ends[:, -1]
    return whole


def power_of_two(n: int) -> int:
    """The power of two that is not below a number, nor below `LEAST`."""
    return max(LEAST, 1 << (n - 1).bit_length())


def triples(x: Float[np.ndarray, "n_segment n_node *k"]) -> Float[np.ndarray, "n_segment n_step 3 *k"]:
    """Start, middle and end of each step."""
    return np.stack([x[:, :-2:2], x[:, 1::2], x[:, 2::2]], axis=2)


def forces(
    evaluate: Callable[[Float[np.ndarray, "n c"]], Float[np.ndarray, "n k"]],
    nodes: Float[np.ndarray, "n_segment n_node c"],
    least: Float[np.ndarray, " k"] | float = 0.0,
) -> Float[np.ndarray, "n_segment n_step 3 k"]:
    """Forces on the start, the middle and the end of steps; where one is rough, the parabola nearest to it.

    Args:
        evaluate: From c columns at any points to k forces.
        nodes: The columns at ends and middles of steps, parabolas within these.
        least: Sizes of forces below which roughness is not looked at.
    """
    values = np.asarray(evaluate(nodes.reshape(-1, nodes.shape[-1]))).reshape(*nodes.shape[:2], -1)
    found = triples(values)
    size = np.maximum(np.sqrt(np.mean(values**2, axis=(0, 1))), least)
    bent = np.abs(found[:, :, 0] - 2 * found[:, :, 1] + found[:, :, 2])
    rough = np.any(bent > ROUGH * size, axis=-1)
    for n_point in WITHIN:
        if not np.any(rough):
            break
        within = (np.arange(n_point) + 0.5) / n_point
        parabolas = np.column_stack(
            [(1 - within) * (1 - 2 * within), 4 * within * (1 - within), within * (2 * within - 1)]
        )
        points = parabolas @ triples(nodes)[rough]
        close = np.asarray(evaluate(points.reshape(-1, points.shape[-1]))).reshape(*points.shape[:2], -1)
        nearest, before = np.linalg.pinv(parabolas) @ close, found[rough]
        found[rough] = nearest
        # What is merely curved is well enough known by now; a kink or a jump is not, and is looked at once more.
        rough[rough] = np.any(np.abs(nearest - before) > ROUGH * size, axis=(-2, -1))
    return found


def hermite(
    time: Float[np.ndarray, "n_segment n_node"], ends: Float[np.ndarray, "n_segment n_end n_state"],
    rates: Float[np.ndarray, "n_segment n_end n_state"],
) -> tuple[Float[np.ndarray, "n_segment n_node n_state"], Float[np.ndarray, "n_segment n_node n_state"]]:  # fmt: skip
    """A path and its slope at ends and middles of steps: the cubics through the ends with the rates there.

    Args:
        time: Ends and middles of steps.
        ends: States at the ends.
        rates: Slopes at the ends.
    """
    h = np.diff(time[:, ::2], axis=1)[..., None]
    path, slope = (np.empty((*time.shape, ends.shape[-1])) for _ in range(2))
    path[:, ::2], slope[:, ::2] = ends, rates
    path[:, 1::2] = (ends[:, 1:] + ends[:, :-1]) / 2 + h / 8 * (rates[:, :-1] - rates[:, 1:])
    chord = np.divide(np.diff(ends, axis=1), h, out=np.zeros_like(ends[:, 1:]), where=h > 0)
    slope[:, 1::2] = np.where(h > 0, 1.5 * chord - (rates[:, :-1] + rates[:, 1:]) / 4, rates[:, 1:])
    return path, slope
