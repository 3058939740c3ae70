"""Averages of neighbouring samples, where sensors are read much more often than anything moves.

The mean of m samples x_i around their mean time t̄ is x(t̄) + ½ Var(t_i) x″ + O(h⁴), h the length of the block; with x″
by second differences of the means only the last part is left. Averages of white noise are white, and all that they lose
is what moves within a block.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from bayes_greybox.data.trajectories import Trajectories

from .clipping import clipped_states

ENOUGH = 1000
"""Samples that are left at least."""

SAFE = 1.5
"""Blocks are so many times shorter than the longest that lose nothing which shows: what is lost of a motion goes with
the fourth power of their length, its variance with the eighth, and is 1.5⁻⁸ = 0.04 of the noise then at most."""

FEWEST_BLOCKS = 4
"""Least number of averages of a run."""

FLAT = 1e-12
"""Share of a column's size below which it does not change."""


def longest_block(data: Trajectories) -> int:
    """Return how many neighbouring samples may be averaged without a loss; 1 for none.

    What blocks lose of a motion goes on from one sample to the next: samples less a spline through the averages are
    correlated with the sample before. Noise alone is not, but for the little that each has in its own average. Columns
    without noise are never averaged, nor are those of a sensor that was at its end.

    Args:
        data: Samples of states and inputs.
    """
    most = data.n_obs // ENOUGH
    measured = data.derivatives or data.filter is not None or data.samples is not None
    if most < 2 or measured or data.unseen is not None or clipped_states(data):
        return 1
    found = 1
    for m in range(2, int(SAFE * most) + 1):
        means = averaged(data, m)
        if min(means.run_lengths) < FEWEST_BLOCKS or any(_lost(data, means, name, m) for name in data.columns):
            break
        found = m
    return max(1, min(most, int(found / SAFE)))


def averaged(data: Trajectories, m: int) -> Trajectories:
    """Return data of blocks of so many samples; those at the end of a run that fill none are left out.

    Args:
        data: Samples of states and inputs.
        m: Samples of a block.
    """
    if m < 2:
        return data
    first = np.concatenate([[0], np.cumsum(data.run_lengths)[:-1]])
    parts = zip(first, data.run_lengths, strict=True)
    blocks = np.concatenate([np.arange(a, a + n // m * m).reshape(-1, m) for a, n in parts])
    times = data.time[blocks]
    time, spread, run = times.mean(axis=1), times.var(axis=1), data.run[blocks[:, 0]]

    def of(values: np.ndarray) -> np.ndarray:
        means = values[blocks].mean(axis=1)
        return means - 0.5 * spread * _bends(time, means, run)

    states = {name: of(values) for name, values in data.states.items()}
    inputs = {name: of(values) for name, values in data.inputs.items()}
    remark = f"neighbouring samples are averaged, {m} at a time"
    return replace(data, time=time, run=run, states=states, inputs=inputs, remarks=(*data.remarks, remark))


def _bends(time: np.ndarray, values: np.ndarray, run: np.ndarray) -> Float[np.ndarray, " n"]:
    """Return second derivatives by the differences of three neighbours; at an end those of the next one."""
    found = np.zeros(len(values))
    for r in np.unique(run):
        own = np.flatnonzero(run == r)
        if len(own) > 2:
            slopes = np.diff(values[own]) / np.diff(time[own])
            inside = 2 * np.diff(slopes) / (time[own][2:] - time[own][:-2])
            found[own] = np.concatenate([inside[:1], inside, inside[-1:]])
    return found


def _lost(data: Trajectories, means: Trajectories, name: str, m: int) -> bool:
    """Return whether averages lose something of a column that shows."""
    left, before = [], []
    for r in range(data.n_run):
        own, there = data.run == r, means.run == r
        time, values = data.time[own], data.column(name)[own]
        inside = (time > means.time[there][0]) & (time < means.time[there][-1])
        between = values - CubicSpline(means.time[there], means.column(name)[there])(time)
        left.append(between[1:][inside[1:]])
        before.append(between[:-1][inside[1:]])
    now, then = np.concatenate(left), np.concatenate(before)
    size = float(np.max(np.abs(data.column(name))))
    return bool(np.sqrt(np.mean(now**2)) > FLAT * size and now @ then > 0)
