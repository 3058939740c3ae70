"""How exact paths are integrated: on steps that are given, or, where these would be too short, on steps as they come.

How fine a method is, is an argument of what is compiled, and is found by halving its error until that is small.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from bayes_greybox.physics.integration.adaptive_steps import Limits, Samples, StepSettings, cut, follow_piece, joined
from bayes_greybox.physics.integration.fixed_steps import Intervals, Rate, follow, follow_with_slopes, intervals_of
from bayes_greybox.physics.integration.solvers import diffrax

MOST = 64
"""Steps in an interval of typical length beyond which steps as they come are fewer."""

FIRST, FINEST = 1e-6, 1e-10
"""Local tolerances of adaptive steps, relative and over the states' sizes."""

TIGHTER = 0.01
"""Share of the tolerance that the next one is."""


class Segment(NamedTuple):
    """Samples of one segment with the second derivatives of their run's splines."""

    time: Float[np.ndarray, " n"]
    inputs: Float[np.ndarray, "n p"]
    curvature: Float[np.ndarray, "n p"]


@runtime_checkable
class Method(Protocol):
    """A way to integrate. Two that are equal compile to the same; a grid is a pytree of arrays."""

    def grid(self, segments: Sequence[Segment], held: bool, sizes: Float[np.ndarray, " d"]) -> Any:
        """The coarsest grid over segments.

        Args:
            segments: Of any lengths.
            held: Whether inputs are held between samples.
            sizes: Of the states.
        """
        ...

    def finer(self, grid: Any) -> Any:
        """The next finer grid of the same shapes, or None where this is the finest."""
        ...

    def beyond(self, grid: Any) -> Any:
        """A grid so much finer that what a path changes by from one to the other is its error on the coarser."""
        ...

    def states(
        self, rate: Rate, start: Float[Array, "n_segment d"], parameters: Float[Array, " q"], grid: Any
    ) -> Float[Array, "n_segment n_sample d"]:
        """Paths at the samples."""
        ...

    def with_slopes(
        self, rate: Rate, start: Float[Array, "n_segment d"], parameters: Float[Array, " q"], grid: Any
    ) -> tuple[Float[Array, "n_segment n_sample d"], Float[Array, "n_segment n_sample q_and_d d"]]:
        """Paths at the samples, and their derivatives by the parameters and then by the own start."""
        ...


class Steps(NamedTuple):
    """Intervals of all segments, and the steps in each."""

    intervals: Intervals
    number: Int[Array, " n"]


@dataclass(frozen=True)
class FixedSteps:
    """As many steps in every interval, more in longer ones: neither search nor rejection."""

    def grid(self, segments: Sequence[Segment], held: bool, sizes: Float[np.ndarray, " d"]) -> Steps:
        """One step between two samples of the typical distance."""
        n = max(len(each.time) for each in segments) - 1
        each = [intervals_of(s.time, s.inputs, s.curvature, held, n) for s in segments]
        intervals = jax.tree.map(lambda *parts: jnp.stack(parts), *each)
        typical = np.median(np.concatenate([np.diff(s.time) for s in segments]))
        count = np.ceil(np.max(np.asarray(intervals.length), axis=0) / typical - 1e-6)
        return Steps(intervals, jnp.asarray(np.maximum(count, 1).astype(int)))

    def finer(self, grid: Steps) -> Steps | None:
        """Half steps."""
        return None if np.min(np.asarray(grid.number)) >= MOST else self.beyond(grid)

    def beyond(self, grid: Steps) -> Steps:
        """Half steps: of order 5, they leave a thirty-second of the error."""
        return grid._replace(number=2 * grid.number)

    def states(
        self, rate: Rate, start: Float[Array, "n_segment d"], parameters: Float[Array, " q"], grid: Steps
    ) -> Float[Array, "n_segment n_sample d"]:
        """Paths at the samples."""
        return jax.vmap(lambda x0, intervals: follow(rate, x0, parameters, intervals, grid.number))(
            start, grid.intervals
        )

    def with_slopes(
        self, rate: Rate, start: Float[Array, "n_segment d"], parameters: Float[Array, " q"], grid: Steps
    ) -> tuple[Float[Array, "n_segment n_sample d"], Float[Array, "n_segment n_sample q_and_d d"]]:
        """Paths and their derivatives."""
        return jax.vmap(lambda x0, intervals: follow_with_slopes(rate, x0, parameters, intervals, grid.number))(
            start, grid.intervals
        )


class Pieces(NamedTuple):
    """Samples of all segments in pieces, and the local tolerance."""

    times: Float[Array, "n_segment n_sample"]
    samples: Samples
    sizes: Float[Array, " d"]
    tolerance: Float[Array, ""]


@dataclass(frozen=True)
class AdaptiveSteps:
    """Steps as long as the local error lets them be, for rates that change within a hair's breadth, as friction does.

    Attributes:
        held: Whether inputs are held between samples.
        n_input: Number of inputs.
    """

    held: bool
    n_input: int

    def grid(self, segments: Sequence[Segment], held: bool, sizes: Float[np.ndarray, " d"]) -> Pieces:
        """With the first tolerance."""
        n = max(len(each.time) for each in segments)
        filled = [_filled(each, n) for each in segments]
        cuts = [cut(jnp.asarray(s.time), s.inputs, self._kinds, s.curvature)[0] for s in filled]
        times = jnp.asarray(np.stack([s.time for s in filled]))
        samples = jax.tree.map(lambda *parts: jnp.stack(parts), *cuts)
        return Pieces(times, samples, jnp.asarray(sizes), jnp.asarray(FIRST))

    def finer(self, grid: Pieces) -> Pieces | None:
        """A tighter tolerance."""
        return None if grid.tolerance <= FINEST * (1 + 1e-9) else self.beyond(grid)

    def beyond(self, grid: Pieces) -> Pieces:
        """A tighter tolerance: the error of the method of order 5 goes with its power 5/6 or higher."""
        return grid._replace(tolerance=TIGHTER * grid.tolerance)

    def states(
        self, rate: Rate, start: Float[Array, "n_segment d"], parameters: Float[Array, " q"], grid: Pieces
    ) -> Float[Array, "n_segment n_sample d"]:
        """Paths at the samples; NaN from where one is lost."""

        def one(x0: Array, times: Array, samples: Samples) -> Array:
            limits = Limits(x0, times[-1], times[-1] - times[0], grid.sizes, 1e12 * jnp.max(grid.sizes))
            dfx = diffrax()
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
        """Paths and their derivatives, those of the steps that were taken."""
        q = len(parameters)

        def moved(away: Array) -> tuple[Array, Array]:
            found = self.states(rate, start + away[q:], parameters + away[:q], grid)
            return found, found

        slopes, found = jax.jacfwd(moved, has_aux=True)(jnp.zeros(q + start.shape[1]))
        return found, jnp.moveaxis(slopes, -1, 2)

    @property
    def _kinds(self) -> tuple[str, ...]:
        # Lines are splines that are not curved.
        return ("zoh" if self.held else "cubic",) * self.n_input


def _filled(segment: Segment, n: int) -> Segment:
    """Further samples after the last, which no row is at."""
    time, inputs, curvature = segment
    more = n - len(time)
    step = time[-1] - time[-2] if len(time) > 1 else 1.0
    held = np.repeat(inputs[-1:], more, axis=0)
    return Segment(
        np.concatenate([time, time[-1] + step * np.arange(1, more + 1)]),
        np.concatenate([inputs, held]),
        np.concatenate([curvature, np.zeros_like(held)]),
    )
