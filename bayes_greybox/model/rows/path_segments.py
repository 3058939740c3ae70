"""Segments of a path with the linear equation along them: how samples answer forces and other starts."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from bayes_greybox.physics.sensitivity import Grid, Response, carried, middles, respond

from .forced_rate import Args, ForcedRate

WIDE = 10.0
"""Prior standard deviation of a start, over the size of its state."""

GROWTH = 1e3
"""A segment ends where a change of its start has grown this much: beyond it nothing is linear, nor known."""

CHUNK = 4096
"""Steps whose forces are evaluated at once."""


@dataclass(frozen=True, eq=False)
class Segments:
    """Segments of runs with their steps of the linear equation.

    Attributes:
        grid: Nodes; shorter segments end in steps of no length.
        response: Steps of the linear equation.
        outputs: Indices of the measured states.
        end: Index of the end of a step, segment by segment, at which each sample is [n_sample, 2].
    """

    grid: Grid
    response: Response
    outputs: tuple[int, ...]
    end: Int[np.ndarray, "n_sample 2"]

    def rows(self, ends: Float[np.ndarray, "n_segment n_end n_state k"]) -> Float[np.ndarray, "n_row k"]:
        """Rows from changes of the states at the ends of steps."""
        at = ends[self.end[:, 0], self.end[:, 1]]
        return np.concatenate([at[:, k] for k in self.outputs])

    def respond(
        self, force: Callable[[Int[np.ndarray, " n"]], Float[np.ndarray, "n k"]]
    ) -> Float[np.ndarray, "n_row k"]:
        """Response to forces by node, a stretch of all segments at a time; memory is bounded by a stretch.

        Args:
            force: Forces at some nodes.
        """
        n_segment, n_node = self.grid.time.shape
        node = np.arange(n_segment * n_node).reshape(n_segment, n_node)
        n_step, span = (n_node - 1) // 2, max(1, CHUNK // n_segment)
        found, delta = [], None
        for first in range(0, n_step, span):
            last = min(first + span, n_step)
            index = node[:, 2 * first : 2 * last + 1]
            values = np.asarray(force(index.ravel())).reshape(*index.shape, -1)
            if delta is None:
                delta = jnp.zeros((n_segment, self.response.M.shape[-1], values.shape[-1]))
            part = Response(*(steps[:, first:last] for steps in self.response))
            ends = np.asarray(carried(part, delta, jnp.asarray(values)))
            delta = jnp.asarray(ends[:, -1])
            # Only what is measured, where it is measured, is kept.
            inside = (self.end[:, 1] >= first + (first > 0)) & (self.end[:, 1] <= last)
            at = ends[self.end[inside, 0], self.end[inside, 1] - first][:, list(self.outputs)]
            found.append((np.flatnonzero(inside), at))
        whole = np.empty((len(self.end), len(self.outputs), found[0][1].shape[-1]))
        for rows, at in found:
            whole[rows] = at
        return np.concatenate([whole[:, k] for k in range(len(self.outputs))])


def segments_of(
    rate: ForcedRate, grid: Grid, ends: np.ndarray, outputs: tuple[int, ...], end: np.ndarray, args: Args
) -> Segments:
    """The linear equation along a path.

    Args:
        rate: Of all states.
        grid: Nodes.
        ends: The path at the ends of steps.
        outputs: Indices of the measured states.
        end: Segment and end of the step of each sample.
        args: Coefficients of the rate.
    """
    path = jnp.asarray(nodes_of(rate, grid, ends, args))
    return Segments(grid, respond(rate, grid, path, rate.driven, args), outputs, end)


def nodes_of(rate: ForcedRate, grid: Grid, ends: np.ndarray, args: Args) -> np.ndarray:
    """States on ends and middles of steps."""
    n_segment, n_end, n_state = ends.shape
    path = np.empty((n_segment, 2 * n_end - 1, n_state))
    path[:, ::2], path[:, 1::2] = ends, np.asarray(middles(rate, grid, jnp.asarray(ends), args))
    return path


def unit_starts(segments: Segments, sizes: np.ndarray) -> tuple[Array, Array]:
    """δ₀ = one size of each state, and no force."""
    n_segment, n_node = segments.grid.time.shape
    start = jnp.broadcast_to(jnp.diag(jnp.asarray(sizes)), (n_segment, len(sizes), len(sizes)))
    return start, jnp.zeros((n_segment, n_node, len(sizes)))


def pieces_of(grown: np.ndarray, sizes: np.ndarray) -> int:
    """Segments that a run is cut into, so that no change of a start grows by more than `GROWTH` within one."""
    size = np.abs(grown / sizes[:, None]).max(axis=(0, 1, 2, 3))
    largest = float(np.max(size)) if np.all(np.isfinite(size)) else math.inf
    return 1 if largest <= GROWTH else int(min(math.ceil(math.log(min(largest, 1e300)) / math.log(GROWTH)), 200))


def responses_to_starts(segments: Segments, sizes: np.ndarray) -> np.ndarray:
    """Rows' change by one prior standard deviation of each start of each segment."""
    start, force = unit_starts(segments, WIDE * sizes)
    rows = segments.rows(np.asarray(carried(segments.response, start, force)))
    own = np.tile(segments.end[:, 0], len(segments.outputs))
    n_segment = len(segments.grid.time)
    return np.hstack([np.where((own == k)[:, None], rows, 0.0) for k in range(n_segment)])


def gain_of(segments: Segments, columns: Mapping[str, np.ndarray], starts: np.ndarray, sd: np.ndarray) -> float:
    """RMS response, in what starts cannot take, of rows to forces that are powers of the path's columns."""
    powers = [(x, k, float(np.sqrt(np.mean(x ** (2 * k))))) for x in columns.values() for k in (1, 2, 3)]
    scaled = [(x, k, size) for x, k, size in powers if size > 0]
    rows = segments.respond(lambda node: np.column_stack([x[node] ** k / size for x, k, size in scaled]))
    Q, _ = np.linalg.qr(starts / sd[:, None])
    rows = rows - sd[:, None] * (Q @ (Q.T @ (rows / sd[:, None])))
    return float(np.sqrt(np.mean(rows**2)))


def moved_by(M: np.ndarray, defects: np.ndarray) -> np.ndarray:
    """δ at the ends of steps from a jump after each."""
    delta = np.zeros((M.shape[0], M.shape[1] + 1, M.shape[-1]))
    for n in range(M.shape[1]):
        delta[:, n + 1] = np.einsum("sij,sj->si", M[:, n], delta[:, n]) + defects[:, n]
    return delta


def at_nodes(
    evaluate: Callable[[Mapping[str, np.ndarray]], np.ndarray], columns: Mapping[str, np.ndarray]
) -> Callable[[np.ndarray], np.ndarray]:
    """Forces by node from what is evaluated on columns."""
    return lambda node: evaluate({name: column[node] for name, column in columns.items()})
