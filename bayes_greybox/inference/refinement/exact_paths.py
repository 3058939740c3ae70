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
from bayes_greybox.model.rows.path.path_segments import WIDE
from bayes_greybox.model.rows.path.reference_path import ReferencePath
from bayes_greybox.physics.integration.adaptive_steps import between_samples, curvature_of

from .methods import AdaptiveSteps, FixedSteps, Method, Segment


class Along(NamedTuple):
    """What paths are followed along: arrays, so that what is compiled for some serves others of the same shapes.

    Attributes:
        numbers: Of the rate.
        grid: Of the method.
        at: Segment, sample in it and state of each row.
    """

    numbers: Any
    grid: Any
    at: Int[Array | np.ndarray, "n_row 3"]


@dataclass(frozen=True)
class ExactPaths:
    """Samples on the paths that solve the equations from given starts. Two with the same formulas are equal.

    Attributes:
        rate: Of all states.
        method: Of integration.
        columns: Which of the coefficients the rate of each learned state has.
    """

    rate: WholeRate
    method: Method
    columns: tuple[tuple[str, tuple[int, ...]], ...]

    def __call__(self, along: Along, theta: Array, weight: Array, starts: Array) -> Float[Array, " n_row"]:
        """Samples without noise, user's units, with their derivatives; NaN where a path is lost.

        Derivatives are found forwards, beside the paths, each start's on its own segment alone, so that whoever
        differentiates backwards pays for a product with them.

        Args:
            along: Numbers, grid and rows.
            theta: Scaled coefficients, those of all learned states [n_term].
            weight: Scaled weights of f [n_basis].
            starts: States at the first sample of each segment [n_segment, d].
        """
        flat, unravel = self._parameters(theta, weight)
        held, first = jax.lax.stop_gradient((flat, starts))
        states, slopes = self.method.with_slopes(self._rate(along, unravel), first, held, along.grid)
        segment, sample, state = along.at.T
        # x(p, x₀) = x + ∂x/∂(p, x₀) · (p − p̄, x₀ − x̄₀) at p = p̄, x₀ = x̄₀
        change = jnp.broadcast_to(flat - held, (len(segment), len(flat)))
        away = jnp.concatenate([change, (starts - first)[segment]], axis=1)
        return states[segment, sample, state] + jnp.sum(slopes[segment, sample, :, state] * away, axis=1)

    def samples(self, along: Along, theta: Array, weight: Array, starts: Array) -> Float[Array, " n_row"]:
        """The same without derivatives."""
        flat, unravel = self._parameters(theta, weight)
        return self.method.states(self._rate(along, unravel), starts, flat, along.grid)[tuple(along.at.T)]

    def _parameters(self, theta: Array, weight: Array) -> tuple[Array, Any]:
        return ravel_pytree({name: (theta[np.array(own, int)], weight) for name, own in self.columns})

    def _rate(self, along: Along, unravel: Any) -> Any:
        return lambda t, x, u, flat: self.rate(t, x, u, (along.numbers, unravel(flat)))


class Course(NamedTuple):
    """Segments of a reference path with the samples on them.

    Attributes:
        segments: Times and inputs.
        held: Whether inputs are held between samples.
        sizes: Of the states.
        at: Segment, sample in it and state of each row.
    """

    segments: tuple[Segment, ...]
    held: bool
    sizes: Float[np.ndarray, " d"]
    at: Int[Array | np.ndarray, "n_row 3"]

    @classmethod
    def of(cls, path: ReferencePath, samples: Trajectories, interpolation: str | None) -> "Course":
        """The course of a reference path.

        Args:
            path: The reference.
            samples: What it was found from.
            interpolation: Of the inputs between samples, each input's own by default.
        """
        every, end = path.ends, path.segments.end
        inputs, runs = samples.matrix(samples.input_names), [samples.run == r for r in range(samples.n_run)]
        curvature = np.zeros_like(inputs)
        for own in runs:
            # As the rows have them, by run.
            kind = interpolation or between_samples(samples.time[own], inputs[own])
            curvature[own] = curvature_of(jnp.asarray(samples.time[own]), jnp.asarray(inputs[own]), kind)[1]
        rows = [np.flatnonzero(every[:, 0] == k) for k in range(path.n_segment)]
        place = np.empty(len(every), int)
        for own in rows:
            place[own] = np.arange(len(own))
        at = np.concatenate(
            [np.column_stack([end[:, 0], place[path.seen], np.full(len(end), k)]) for k in path.segments.outputs]
        )
        segments = tuple(Segment(samples.time[own], inputs[own], curvature[own]) for own in rows)
        return cls(segments, interpolation == "zoh", path.start_sd / WIDE, at)

    @property
    def methods(self) -> tuple[Method, ...]:
        """In the order in which they are tried."""
        return FixedSteps(), AdaptiveSteps(self.held, self.segments[0].inputs.shape[1])

    def along(self, method: Method, rate: WholeRate) -> Along:
        """What paths are followed along, on the coarsest grid of a method."""
        return Along(rate.numbers, method.grid(self.segments, self.held, self.sizes), self.at)

    def error(
        self, rows: Float[np.ndarray, "n_draw n_row"], finer: Float[np.ndarray, "n_draw n_row"]
    ) -> Float[np.ndarray, " n_draw"]:
        """Largest error of each draw's path at the samples, over the size of the state and of the sample itself.

        It is infinite where there is a path on finer steps alone, and NaN where there is none.

        Args:
            rows: Samples on the paths.
            finer: Those on paths whose own error is small against it.
        """
        size = self.sizes[self.at[:, 2]] + np.abs(finer)
        with np.errstate(invalid="ignore", over="ignore"):
            off = np.abs(rows - finer) / size
        largest = np.max(np.where(np.isfinite(off), off, np.inf), axis=1)
        return np.where(np.all(np.isfinite(finer), axis=1), largest, np.nan)
