"""Exact paths of a model over the segments of its rows, and the samples on them; JAX follows their derivatives."""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.whole_rate import WholeRate
from bayes_greybox.model.rows.path.path_segments import WIDE
from bayes_greybox.model.rows.path.reference_path import ReferencePath
from bayes_greybox.physics.integrate import (
    Limits,
    Samples,
    between_samples,
    curvature_of,
    cut,
    follow_piece,
    joined,
    limits_of,
)

TOLERANCE = 1e-6
"""Of the integrator, relative and over the states' sizes: below the noise of sensors, and a method of order 5 does."""


class Segment(NamedTuple):
    """Times and inputs of one segment with the second derivatives of their run's splines, filled up to the longest."""

    time: Float[np.ndarray, " n"]
    inputs: Float[np.ndarray, "n p"]
    curvature: Float[np.ndarray, "n p"]


@dataclass(frozen=True, eq=False)
class ExactPaths:
    """Samples on the paths that solve the equations from given starts.

    Attributes:
        rate: Of all states.
        segments: All of the same length.
        kinds: Interpolation of each input; lines are splines that are not curved.
        sizes: Of the states.
        at: Segment, sample in it and state of each row.
    """

    rate: WholeRate
    segments: tuple[Segment, ...]
    kinds: tuple[str, ...]
    sizes: Float[np.ndarray, " d"]
    at: Int[np.ndarray, "n_row 3"]

    @classmethod
    def along(
        cls, path: ReferencePath, samples: Trajectories, rate: WholeRate, interpolation: str | None
    ) -> "ExactPaths":
        """Paths over the segments of a reference path.

        Args:
            path: The reference.
            samples: What it was found from.
            rate: Of all states, inside an integrator.
            interpolation: Of the inputs between samples, each input's own by default.
        """
        every, end = path.ends, path.segments.end
        inputs, runs = samples.matrix(samples.input_names), [samples.run == r for r in range(samples.n_run)]
        curvature = np.zeros_like(inputs)
        for own in runs:
            # As the rows have them, by run.
            kind = interpolation or between_samples(samples.time[own], inputs[own])
            curvature[own] = curvature_of(jnp.asarray(samples.time[own]), jnp.asarray(inputs[own]), kind)[1]
        kinds = ("zoh" if interpolation == "zoh" else "cubic",) * inputs.shape[1]
        rows = [np.flatnonzero(every[:, 0] == k) for k in range(path.n_segment)]
        n = max(map(len, rows))
        place = np.empty(len(every), int)
        for own in rows:
            place[own] = np.arange(len(own))
        at = np.concatenate(
            [np.column_stack([end[:, 0], place[path.seen], np.full(len(end), k)]) for k in path.segments.outputs]
        )
        segments = tuple(_filled(samples.time[own], inputs[own], curvature[own], n) for own in rows)
        return cls(rate, segments, kinds, path.start_sd / WIDE, at)

    def __call__(self, args: Any, starts: Float[Array, "n_segment d"]) -> Float[Array, " n_row"]:
        """Samples without noise, user's units; NaN from where a path is lost.

        Args:
            args: Of the rate.
            starts: States at the first sample of each segment.
        """
        each = [self._cut(segment, x0) for segment, x0 in zip(self.segments, starts, strict=True)]
        every = jax.tree.map(lambda *parts: jnp.stack(parts), *each)
        states = jax.vmap(lambda one: self._path(args, *one))(every)
        return states[tuple(self.at.T)]

    def _cut(self, segment: Segment, x0: Array) -> tuple[Array, Samples, Limits]:
        t = jnp.asarray(segment.time)
        samples, _ = cut(t, segment.inputs, self.kinds, segment.curvature)
        return t, samples, limits_of(t, x0, self.sizes)

    def _path(self, args: Any, t: Array, samples: Samples, limits: Limits) -> Float[Array, "n d"]:
        follow = partial(
            follow_piece, self.rate, limits=limits, args=args, kinds=self.kinds, rtol=TOLERANCE, atol=TOLERANCE,
            solver=diffrax.Tsit5(), adjoint=diffrax.ForwardMode(),
        )  # fmt: skip
        start = limits.x0, jnp.array(True)
        _, pieces = jax.lax.scan(lambda start, piece: follow(start, Samples(*piece)), start, samples)
        return joined(limits.x0, t, *pieces[:2])[0]


def _filled(time: np.ndarray, inputs: np.ndarray, curvature: np.ndarray, n: int) -> Segment:
    """Further samples after the last, which no row is at."""
    more = n - len(time)
    step = time[-1] - time[-2] if len(time) > 1 else 1.0
    held = np.repeat(inputs[-1:], more, axis=0)
    return Segment(
        np.concatenate([time, time[-1] + step * np.arange(1, more + 1)]),
        np.concatenate([inputs, held]),
        np.concatenate([curvature, np.zeros_like(held)]),
    )
