"""The smoothed path of samples: at the likeliest intensity of an unknown force, where the equations are defined."""

import math
from collections.abc import Iterable

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
from .path_segments import segments_of

RATIOS = 10.0 ** np.arange(-10.0, 1.1)
"""Intensities of the unknown force that are tried, q² over that of a force as large as the path's own."""

MIDDLING = 1e-2
"""Intensity that a first path is smoothed at, before it is chosen."""

PASSES = 3
"""Passes of the smoother at the intensity that was chosen."""

UNFORCED_PASSES = 10
"""Passes at most to a path that the model allows, from one near the samples."""

ARRIVED = 1e-8
"""Change of such a path by a pass, over its size, that ends them: the next one changes it by the square of that."""

LOST = (
    "No path through the samples was found: near them the equations leave their domain, or grow beyond all bounds. "
    "Check the simulation and the units, or give hidden states as data."
)


def smoothest(
    rate: ForcedRate, grid: Grid, observed: Observed, outputs: tuple[int, ...], own: float,
    E: np.ndarray, first: np.ndarray, process_noise: bool, known: tuple[float, int] | None = None,
) -> tuple[Float[np.ndarray, "n_segment n_end n_state"], float, float, int]:  # fmt: skip
    """Ends of the smoothed path at the likeliest intensity of the unknown force, that, what it gains, and the passes.

    Args:
        rate: Of all states.
        grid: Nodes.
        observed: Samples.
        outputs: Indices of the measured states.
        own: Intensity of a force as large as the path's own.
        E: Rates of the states by each unknown force.
        first: A path to begin with, NaN where there is none.
        process_noise: Whether that may be more than the least.
        known: Intensity and passes that other runs have found, which these have in common with them.
    """
    turn, fewest = 0, 0 if known is None else known[1]
    ends = first
    if not np.all(np.isfinite(first)):
        ends = filtered(rate, grid, observed, outputs, E, own * MIDDLING, rate.args)
    ratio, gained = own * MIDDLING, 0.0
    for turn in range((PASSES if process_noise else UNFORCED_PASSES) + 1):
        near = segments_of(rate, grid, ends, outputs)
        steps = steps_along(grid.time, ends, near.response, near.departure(rate.rates), E)
        if turn == 1 and known is not None:
            ratio = known[0]
        elif turn == 1 and not process_noise:
            ratio = own * float(RATIOS[0])
        elif turn == 1:
            logs = log_likelihoods(steps, observed, outputs, own * RATIOS)
            if np.any(np.isfinite(logs)):
                ratio = own * float(RATIOS[int(np.nanargmax(logs))])
                # It was looked for at so many intensities.
                gained = float(np.nanmax(logs) - np.nan_to_num(logs[0], nan=-np.inf)) - math.log(len(RATIOS))
        stronger = own * RATIOS[own * RATIOS > ratio] if process_noise else ()
        paths = (smooth(steps, observed, outputs, each).ends for each in (ratio, *stronger))
        before, ends = ends, _inside(rate, grid, ends, paths)
        if not process_noise and turn > 1 and turn >= fewest and _arrived(before, ends):
            break
    if not np.all(np.isfinite(ends)):
        raise InputError(LOST)
    return ends, ratio, gained, turn


def _arrived(before: np.ndarray, ends: np.ndarray) -> bool:
    """Whether a pass has moved no state by much of its own size."""
    moved, size = (np.max(np.abs(x), axis=(0, 1)) for x in (ends - before, ends))
    return bool(np.all(moved <= ARRIVED * size))


def _inside(
    rate: ForcedRate, grid: Grid, before: np.ndarray, paths: Iterable[np.ndarray]
) -> Float[np.ndarray, "n_segment n_end n_state"]:
    """The first of the paths after a pass that the equations are defined on.

    Where there is none, of each segment as much of the way to the first one as they are defined on. One that stays is
    a beginning: near what is found along it the next path is better.
    """
    tried = []
    for path in paths:
        tried.append(path)
        if np.all(_defined(rate, grid, path)):
            return path
    after, path, out = tried[0], tried[0].copy(), np.ones(len(before), bool)
    for part in TRIED_SHARES:
        path[out] = before[out] + part * (after[out] - before[out]) if part else before[out]
        out = ~_defined(rate, grid, path)
        if not np.any(out):
            return path
    return after


def _defined(rate: ForcedRate, grid: Grid, ends: np.ndarray) -> Bool[np.ndarray, " n_segment"]:
    """Whether a path has rates at the ends and the middles of its steps, segment by segment."""
    rates = rate.rates(np.concatenate([grid.time[:, ::2, None], ends, grid.inputs[:, ::2]], axis=-1))
    path, _ = hermite(grid.time, ends, rates)
    whole = rate.rates(np.concatenate([grid.time[..., None], path, grid.inputs], axis=-1))
    return np.all(np.isfinite(whole), axis=(1, 2))
