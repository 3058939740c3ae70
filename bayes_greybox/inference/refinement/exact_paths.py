"""Exact paths of a model over the segments of its rows, and the samples on them."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.whole_rate import WholeRate
from bayes_greybox.model.rows.path.path_segments import START_WIDTH
from bayes_greybox.model.rows.path.reference_path import ReferencePath
from bayes_greybox.physics.integration.adaptive_steps import between_samples, curvature_of, one_for_each

from .methods import AdaptiveSteps, FixedSteps, Method, Segment


class Along(NamedTuple):
    """Arrays that paths are followed along: numbers of the rate, grid of the method, segment, sample and state of rows.

    A program compiled for some serves others of the same shapes.
    """

    numbers: Any
    grid: Any
    at: Int[Array | np.ndarray, "n_row 3"]


@dataclass(frozen=True)
class ExactPaths:
    """Samples on the paths that solve the equations from given starts. Two with the same formulas are equal.

    `columns` are the indices of the coefficients in the rate of each learned state.
    """

    rate: WholeRate
    method: Method
    columns: tuple[tuple[str, tuple[int, ...]], ...]

    def __call__(self, along: Along, theta: Array, weight: Array, starts: Array) -> Float[Array, " n_row"]:
        """Return samples without noise, user's units, with their derivatives; NaN beyond the end of a path.

        Coefficients θ of all learned states [n_term] and weights of f [n_basis] are scaled; starts are the states at
        the first sample of each segment [n_segment, d]. Derivatives are integrated forwards along with the paths, those
        by a start on its own segment alone, so that reverse-mode differentiation costs a product with them.
        """
        flat, unravel = self._parameters(theta, weight)
        fixed, first = jax.lax.stop_gradient((flat, starts))
        states, slopes = self.method.with_slopes(self._rate(along, unravel), first, fixed, along.grid)
        segment, sample, state = along.at.T
        # x(p, x₀) = x + ∂x/∂(p, x₀) · (p − p̄, x₀ − x̄₀) at p = p̄, x₀ = x̄₀
        change = jnp.broadcast_to(flat - fixed, (len(segment), len(flat)))
        away = jnp.concatenate([change, (starts - first)[segment]], axis=1)
        return states[segment, sample, state] + jnp.sum(slopes[segment, sample, :, state] * away, axis=1)

    def samples(self, along: Along, theta: Array, weight: Array, starts: Array) -> Float[Array, " n_row"]:
        """Return the samples without derivatives."""
        flat, unravel = self._parameters(theta, weight)
        return self.method.states(self._rate(along, unravel), starts, flat, along.grid)[tuple(along.at.T)]

    def _parameters(self, theta: Array, weight: Array) -> tuple[Array, Any]:
        return ravel_pytree({name: (theta[np.array(index, int)], weight) for name, index in self.columns})

    def _rate(self, along: Along, unravel: Any) -> Any:
        return lambda t, x, u, flat: self.rate(t, x, u, (along.numbers, unravel(flat)))


class Course(NamedTuple):
    """Segments of a reference path, typical sizes of the states, and segment, sample and state of each row.

    Inputs have a zero-order hold between samples where `held`.
    """

    segments: tuple[Segment, ...]
    held: tuple[bool, ...]
    sizes: Float[np.ndarray, " d"]
    at: Int[Array | np.ndarray, "n_row 3"]

    @classmethod
    def of(cls, path: ReferencePath, samples: Trajectories, interpolation: str | tuple[str, ...] | None) -> "Course":
        """Return the course of a path through samples; by default each input has its own interpolation between them."""
        every, end = path.ends, path.segments.end
        inputs = samples.matrix(samples.input_names)
        curvature = np.zeros_like(inputs)
        # By run, as for the rows.
        for run in (samples.run == r for r in range(samples.n_run)):
            kind = interpolation or between_samples(samples.time[run], inputs[run])
            curvature[run] = curvature_of(samples.time[run], inputs[run], kind)[1]
        rows = [np.flatnonzero(every[:, 0] == k) for k in range(path.n_segment)]
        place = np.empty(len(every), int)
        for index in rows:
            place[index] = np.arange(len(index))
        at = np.concatenate(
            [np.column_stack([end[:, 0], place[path.seen], np.full(len(end), k)]) for k in path.segments.outputs]
        )
        segments = tuple(Segment(samples.time[index], inputs[index], curvature[index]) for index in rows)
        held = tuple(kind == "zoh" for kind in one_for_each(interpolation or "linear", inputs.shape[1]))
        return cls(segments, held, path.start_sd / START_WIDTH, at)

    @property
    def methods(self) -> tuple[Method, ...]:
        """Integration methods, in the order in which they are tried."""
        return FixedSteps(), AdaptiveSteps(self.held)

    def along(self, method: Method, rate: WholeRate) -> Along:
        """Return the arrays that paths are followed along, on the coarsest grid of a method."""
        return Along(rate.numbers, method.grid(self.segments, self.held, self.sizes), self.at)

    def error(
        self, rows: Float[np.ndarray, "n_draw n_row"], finer: Float[np.ndarray, "n_draw n_row"]
    ) -> Float[np.ndarray, " n_draw"]:
        """Return the largest error of each draw's path at the samples, over the size of the state and of the sample.

        It is infinite if a path exists on finer steps only, and NaN if none exists.
        """
        size = self.sizes[self.at[:, 2]] + np.abs(finer)
        with np.errstate(invalid="ignore", over="ignore"):
            off = np.abs(rows - finer) / size
        largest = np.max(np.where(np.isfinite(off), off, np.inf), axis=1)
        return np.where(np.all(np.isfinite(finer), axis=1), largest, np.nan)
