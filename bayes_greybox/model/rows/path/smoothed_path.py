"""The smoothed path of samples: at the likeliest intensity of an unknown force, where the equations are defined."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from bayes_greybox.physics.integration.sensitivity import Grid, hermite
from bayes_greybox.physics.integration.smoothing import (
    TRIED_SHARES,
    Observed,
    filtered,
    log_likelihoods,
    smooth,
    steps_along,
)
from bayes_greybox.running.errors import InputError

from .forced_rate import ForcedRate
from .path_segments import AtEnds, points_at_ends, points_at_nodes, segments_of

FORCE_INTENSITIES = 10.0 ** np.arange(-10.0, 1.1)
"""Intensities of the unknown force that are tried, q² over that of a force as large as the path's own."""

NO_PATH = (
    "No path through the samples was found: near them the equations leave their domain, or grow beyond all bounds. "
    "Check the simulation and the units, or give hidden states as data."
)


class Smoothed(NamedTuple):
    """A smoothed path at the ends of steps; the force of intensity `ratio` gained so many nats over the least."""

    ends: AtEnds
    ratio: float
    gained: float
    passes: int


@dataclass(frozen=True, eq=False)
class PathSmoother:
    """Smoother of samples along the equations; E are the rates of the states by each unknown force."""

    rate: ForcedRate
    grid: Grid
    observed: Observed
    outputs: tuple[int, ...]
    full_intensity: float
    E: Float[np.ndarray, "n_state n_learned"]

    def smoothest(self, first: AtEnds, process_noise: bool, shared: tuple[float, int] | None = None) -> Smoothed:
        """Return the smoothed path at the likeliest intensity of the unknown force.

        The path `first` to begin with is NaN where there is none. If `process_noise`, the intensity may be more than
        the least. Intensity and passes in `shared` are those of other runs.
        """
        grid, observed, outputs = self.grid, self.observed, self.outputs
        turn, fewest = 0, 0 if shared is None else shared[1]
        intensities = self.full_intensity * FORCE_INTENSITIES
        # A first path, before an intensity is chosen.
        ends, ratio, gained = first, self.full_intensity * 1e-2, 0.0
        if not np.all(np.isfinite(first)):
            ends = filtered(self.rate, grid, observed, outputs, self.E, ratio, self.rate.args)
        # Three passes at the chosen intensity, and at most ten to a path that the model allows.
        for turn in range(4 if process_noise else 11):
            near = segments_of(self.rate, grid, ends, outputs)
            steps = steps_along(grid.time, ends, near.response, near.departure(self.rate.rates), self.E)
            if turn == 1 and shared is not None:
                ratio = shared[0]
            elif turn == 1 and not process_noise:
                ratio = float(intensities[0])
            elif turn == 1:
                logs = log_likelihoods(steps, observed, outputs, intensities)
                if np.any(np.isfinite(logs)):
                    ratio = float(intensities[int(np.nanargmax(logs))])
                    gained = float(np.nanmax(logs) - np.nan_to_num(logs[0], nan=-np.inf))
                    # The best of so many intensities was chosen.
                    gained -= math.log(len(FORCE_INTENSITIES))
            stronger = intensities[intensities > ratio] if process_noise else ()
            paths = (smooth(steps, observed, outputs, each) for each in (ratio, *stronger))
            before, ends = ends, self._inside_domain(ends, paths)
            if not process_noise and turn > 1 and turn >= fewest and _arrived(before, ends):
                break
        if not np.all(np.isfinite(ends)):
            raise InputError(NO_PATH)
        return Smoothed(ends, ratio, gained, turn)

    def _inside_domain(self, before: np.ndarray, paths: Iterable[np.ndarray]) -> AtEnds:
        """Return the first of the paths after a pass that the equations are defined on.

        Where there is none, each segment goes as much of the way to the first one as they are defined on, or stays.
        """
        tried = []
        for path in paths:
            tried.append(path)
            if np.all(self._defined(path)):
                return path
        after, path, out = tried[0], tried[0].copy(), np.ones(len(before), bool)
        for part in TRIED_SHARES:
            path[out] = before[out] + part * (after[out] - before[out]) if part else before[out]
            out = ~self._defined(path)
            if not np.any(out):
                return path
        return after

    def _defined(self, ends: np.ndarray) -> Bool[np.ndarray, " n_segment"]:
        """Return which segments have rates at the ends and the middles of all their steps."""
        path, _ = hermite(self.grid.time, ends, self.rate.rates(points_at_ends(self.grid, ends)))
        return np.all(np.isfinite(self.rate.rates(points_at_nodes(self.grid, path))), axis=(1, 2))


def _arrived(before: np.ndarray, ends: np.ndarray) -> bool:
    """Return whether a pass has moved no state by much: the next one moves it by the square of that."""
    moved, size = (np.max(np.abs(x), axis=(0, 1)) for x in (ends - before, ends))
    return bool(np.all(moved <= 1e-8 * size))
