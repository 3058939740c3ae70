"""Integration methods of exact paths: fixed steps, or adaptive ones where fixed steps would have to be too short.

The resolution of a method is an argument of compiled programs; it is raised until the error is small.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from bayes_greybox.physics.integration.adaptive_steps import Samples, StepSettings, cut, follow_piece, joined, limits_of
from bayes_greybox.physics.integration.fixed_steps import Intervals, Rate, follow, follow_with_slopes, intervals_of
from bayes_greybox.physics.integration.solvers import diffrax

MOST_STEPS_PER_INTERVAL = 64
"""Steps in an interval of typical length beyond which adaptive steps are fewer."""

FIRST_TOLERANCE, FINEST_TOLERANCE, TIGHTER = 1e-6, 1e-10, 0.01
"""Local tolerances of adaptive steps, relative and over the states' sizes; ratio of one to the one before."""


class Segment(NamedTuple):
    """Samples of one segment with the second derivatives of their run's splines."""

    time: Float[np.ndarray, " n"]
    inputs: Float[np.ndarray, "n p"]
    curvature: Float[np.ndarray, "n p"]


class Steps(NamedTuple):
    """Intervals of all segments, and the steps in each."""

    intervals: Intervals
    number: Int[Array, " n"]


@dataclass(frozen=True)
class FixedSteps:
    """Equally many steps in intervals of typical length and more in longer ones; no step is rejected."""

    def grid(self, segments: Sequence[Segment], held: tuple[bool, ...], sizes: Float[np.ndarray, " d"]) -> Steps:
        """Return the coarsest grid: one step between two samples at the typical distance.

        Inputs have a zero-order hold between samples where `held`; `sizes` are those of the states.
        """
        n = max(len(each.time) for each in segments) - 1
        each = [intervals_of(s.time, s.inputs, s.curvature, held, n) for s in segments]
        intervals = jax.tree.map(lambda *parts: jnp.stack(parts), *each)
        typical = np.median(np.concatenate([np.diff(s.time) for s in segments]))
        count = np.ceil(np.max(np.asarray(intervals.length), axis=0) / typical - 1e-6)
        return Steps(intervals, jnp.asarray(np.maximum(count, 1).astype(int)))

    def finer(self, grid: Steps) -> Steps | None:
        """Halve the steps; None if they are the finest."""
        return None if np.min(np.asarray(grid.number)) >= MOST_STEPS_PER_INTERVAL else self.beyond(grid)

    def beyond(self, grid: Steps) -> Steps:
        """Halve the steps, so that the change of a path is nearly its error: at order 5 a thirty-second remains."""
        return grid._replace(number=2 * grid.number)

    def states(
        self, rate: Rate, start: Float[Array, "n_segment d"], parameters: Float[Array, " q"], grid: Steps
    ) -> Float[Array, "n_segment n_sample d"]:
        """Return paths at the samples."""
        every = jax.vmap(lambda x0, intervals: follow(rate, x0, parameters, intervals, grid.number))
        return every(start, grid.intervals)

    def with_slopes(
        self, rate: Rate, start: Float[Array, "n_segment d"], parameters: Float[Array, " q"], grid: Steps
    ) -> tuple[Float[Array, "n_segment n_sample d"], Float[Array, "n_segment n_sample q_and_d d"]]:
        """Return paths at the samples, and their derivatives by the parameters and then by the start of the segment."""
        every = jax.vmap(lambda x0, intervals: follow_with_slopes(rate, x0, parameters, intervals, grid.number))
        return every(start, grid.intervals)


class Pieces(NamedTuple):
    """Samples of all segments in pieces, and the local tolerance."""

    times: Float[Array, "n_segment n_sample"]
    samples: Samples
    sizes: Float[Array, " d"]
    tolerance: Float[Array, ""]


@dataclass(frozen=True)
class AdaptiveSteps:
    """Steps as long as the local error allows, for rates that change abruptly, as friction does.

    Inputs have a zero-order hold between samples where `held`.
    """

    held: tuple[bool, ...]

    def grid(self, segments: Sequence[Segment], held: tuple[bool, ...], sizes: Float[np.ndarray, " d"]) -> Pieces:
        """Return the coarsest grid, with the first tolerance; see `FixedSteps.grid`."""
        n = max(len(each.time) for each in segments)
        filled = [_filled(each, n) for each in segments]
        cuts = [cut(jnp.asarray(s.time), s.inputs, self._kinds, s.curvature)[0] for s in filled]
        times = jnp.asarray(np.stack([s.time for s in filled]))
        samples = jax.tree.map(lambda *parts: jnp.stack(parts), *cuts)
        return Pieces(times, samples, jnp.asarray(sizes), jnp.asarray(FIRST_TOLERANCE))

    def finer(self, grid: Pieces) -> Pieces | None:
        """Tighten the tolerance; None if it is the finest."""
        return None if grid.tolerance <= FINEST_TOLERANCE * (1 + 1e-9) else self.beyond(grid)

    def beyond(self, grid: Pieces) -> Pieces:
        """Tighten the tolerance; the error of a method of order 5 is proportional to its power 5/6 or higher."""
        return grid._replace(tolerance=TIGHTER * grid.tolerance)

    def states(
        self, rate: Rate, start: Float[Array, "n_segment d"], parameters: Float[Array, " q"], grid: Pieces
    ) -> Float[Array, "n_segment n_sample d"]:
        """Return paths at the samples; NaN beyond the end of a path."""

        def one(x0: Array, times: Array, samples: Samples) -> Array:
            limits, dfx = limits_of(times, x0, grid.sizes), diffrax()
            settings = StepSettings(grid.tolerance, grid.tolerance, solver=dfx.Tsit5(), adjoint=dfx.ForwardMode())
            follow = partial(follow_piece, rate, limits=limits, args=parameters, kinds=self._kinds, settings=settings)
            _, pieces = jax.lax.scan(
                lambda start, piece: follow(start, Samples(*piece)), (x0, jnp.array(True)), samples
            )
            return jnp.asarray(joined(x0, times, *pieces[:2])[0])

        return jax.vmap(one)(start, grid.times, grid.samples)

    def with_slopes(
        self, rate: Rate, start: Float[Array, "n_segment d"], parameters: Float[Array, " q"], grid: Pieces
    ) -> tuple[Float[Array, "n_segment n_sample d"], Float[Array, "n_segment n_sample q_and_d d"]]:
        """Return paths and their derivatives at fixed steps, those that were taken."""
        q = len(parameters)

        def moved(away: Array) -> tuple[Array, Array]:
            states = self.states(rate, start + away[q:], parameters + away[:q], grid)
            return states, states

        slopes, states = jax.jacfwd(moved, has_aux=True)(jnp.zeros(q + start.shape[1]))
        return states, jnp.moveaxis(slopes, -1, 2)

    @property
    def _kinds(self) -> tuple[str, ...]:
        # Lines are splines without curvature.
        return tuple("zoh" if held else "cubic" for held in self.held)


Method = FixedSteps | AdaptiveSteps
"""Integration method. Equal methods compile to the same program; a grid is a pytree of arrays."""


def _filled(segment: Segment, n: int) -> Segment:
    """Pad a segment to n samples, which no row is at."""
    more, time = n - len(segment.time), segment.time
    step = time[-1] - time[-2] if len(time) > 1 else 1.0
    return Segment(
        np.concatenate([time, time[-1] + step * np.arange(1, more + 1)]),
        np.pad(segment.inputs, ((0, more), (0, 0)), "edge"),
        np.pad(segment.curvature, ((0, more), (0, 0))),
    )
