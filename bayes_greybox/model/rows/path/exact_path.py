"""Samples on the exact path: the judge of rows that are linear near a reference path."""

from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Float

from bayes_greybox.physics.integration.sensitivity import carried, hermite

from .forced_rate import ForcedRate
from .path_segments import departures, points_at_ends, points_at_nodes
from .reference_path import ReferencePath

MOST_CORRECTIONS = 12
"""Most corrections of a path; each is of the order of the one before times what the path has moved."""

LAST_CORRECTION = 0.1
"""Norm of the change of all samples by a correction, over their noise, that ends the corrections."""

LOOSE_CORRECTION = 0.5
"""Norm at which a path is still taken for exact where corrections no longer shrink: times of jumps are known to parts
of a step."""

Added = Callable[[Mapping[str, np.ndarray], int], Float[np.ndarray, "n n_learned"]]
"""From columns [n] and the number of a draw to what it adds to the rates of the learned states, user's units."""


def exact_samples(
    path: ReferencePath, rate: ForcedRate, added: Added, starts: Float[np.ndarray, "n_draw n_start"]
) -> Float[np.ndarray, "n_draw n_row"]:
    """Return samples of the paths that solve dx/dt = g + e_k (Φθ + f) for draws of coefficients and starts.

    Newton's method with the linear equation of the reference path: each correction answers what the path before still
    departs from the equations by, x ← x + δ with δ̇ = A δ + g(x) + e_k (Φ(x)θ + f(x)) − ẋ. The first gives what linear
    rows say. Starts of the segments are in prior standard deviations from the reference.

    Returns:
        Samples without noise, user's units; NaN where a path leaves the domain of its equations, or is not within
        `LOOSE_CORRECTION` after `MOST_CORRECTIONS`.
    """
    segments, grid, n_state = path.segments, path.segments.grid, len(path.start_sd)
    shape = (len(starts), len(grid.time), n_state)
    reference = segments.points[:, ::2, 1 : 1 + n_state]
    aims = reference[None, :, 0] + starts.reshape(shape) * path.start_sd
    ends = np.tile(reference, (len(starts), 1, 1, 1))
    sd, moved = np.repeat(path.sensor_sd, len(segments.end)), np.zeros(len(starts))
    # A draw that leaves the domain of the equations has no path; it is said by NaN.
    with np.errstate(all="ignore"):
        for _ in range(MOST_CORRECTIONS):
            jumps = np.stack([_jumps(path, rate, added, k, x) for k, x in enumerate(ends)], axis=-1)
            delta = carried(segments.response.M, np.moveaxis(aims - ends[:, :, 0], 0, -1), jumps)
            ends = ends + np.moveaxis(delta, -1, 0)
            moved = np.linalg.norm(segments.rows(delta) / sd[:, None], axis=0)
            if not np.nanmax(moved, initial=0.0) > LAST_CORRECTION:
                break
    samples = segments.rows(np.moveaxis(ends, 0, -1)).T
    samples[moved > LOOSE_CORRECTION] = np.nan
    return samples


def _jumps(path: ReferencePath, rate: ForcedRate, added: Added, draw: int, ends: np.ndarray) -> np.ndarray:
    """Return the change of δ after each step by the departure of a path from its equations."""
    grid, driven = path.segments.grid, list(path.segments.driven)

    def learned(points: np.ndarray) -> np.ndarray:
        columns = dict(zip(rate.names, points.reshape(-1, points.shape[-1])[:, 1:].T, strict=True))
        return added(columns, draw).reshape(*points.shape[:-1], len(driven))

    def rates(points: np.ndarray) -> np.ndarray:
        total = np.array(rate.known(points))
        total[..., driven] += learned(points)
        return total

    states, slope = hermite(grid.time, ends, rates(points_at_ends(grid, ends)))
    return path.segments.response.jumps(departures(rates, points_at_nodes(grid, states), slope))
