"""Averages of neighbouring samples, for sensors that are read much more often than anything moves.

The mean of m samples x_i around their mean time t̄ is x(t̄) + ½ Var(t_i) x″ + O(h⁴), h the length of the block; with x″
by second differences of the means only the last part is left. Averages of white noise are white, and only motion within
a block is lost.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from bayes_greybox.data.trajectories import Trajectories

from .clipping import clipped_states

ENOUGH = 1000  # fewest samples that are left
# Ratio of the longest block without a visible loss to the block that is used. The loss of a smooth motion goes with the
# fourth power of a block's length and its variance with the eighth: it is at most 1.5⁻⁸ = 0.04 of the noise then.
SAFE = 1.5
FEWEST_RUN_AVERAGES = 4  # fewest averages of a run
FLAT = 1e-12  # share of a column's size below which its loss is none
# Largest step over the usual one: no block reaches over a gap, nor one of a dense record over motion that a sparser
# record shows.
UNEVEN = 2.0
# Fourth moment of the noise over the square of its second from which on outliers would spoil averages; it is 3 for
# normal noise, within 0.11 for the fewest samples that are averaged.
TAILS = 5.0


def longest_block(data: Trajectories, test: Trajectories | None = None) -> int:
    """Return how many neighbouring samples may be averaged without a loss, in held-out data too; 1 for none.

    The loss of a smooth motion continues from one sample to the next: samples less a spline through the averages are
    correlated with the sample before. Noise alone is not, apart from the small share of each sample in its own average.
    Nothing is averaged in states without noise or with outliers, beside an input that changes, from a sensor that was
    at the end of its range, or across gaps.
    """
    most = data.n_obs // ENOUGH
    if most < 2 or not all(_able(each) for each in (data, test) if each is not None):
        return 1
    if test is not None and not 1 / UNEVEN < test.usual_step / data.usual_step < UNEVEN:
        return 1
    longest, m = 1, 2
    while m <= SAFE * most and not any(_spoiled(each, m) for each in (data, test) if each is not None):
        longest, m = m, max(m + 1, int(1.2 * m))
    return max(1, min(most, int(longest / SAFE)))


def _able(data: Trajectories) -> bool:
    """Return True if the data are even samples of states that nothing drives, within the ranges of their sensors."""
    measured = data.derivatives or data.noise or data.filter is not None or data.samples is not None
    if measured or data.unseen is not None or any(np.ptp(values) > 0 for values in data.inputs.values()):
        return False
    steps = np.diff(data.time)[np.diff(data.run) == 0]
    return bool(len(steps) and np.max(steps) < UNEVEN * np.median(steps)) and not clipped_states(data)


def _spoiled(data: Trajectories, m: int) -> bool:
    """Return True if blocks of m samples are too long for a run, or visibly lose something of a state."""
    if min(data.run_lengths) // m < FEWEST_RUN_AVERAGES:
        return True
    means = averaged(data, m)
    return any(_lost(data, means, name) for name in data.states)


def averaged(data: Trajectories, m: int) -> Trajectories:
    """Average blocks of m samples; the last samples of a run that fill no block are left out."""
    if m < 2:
        return data
    blocks = np.concatenate([rows[: len(rows) // m * m].reshape(-1, m) for rows in data.run_rows])
    times = data.time[blocks]
    time, spread, run = times.mean(axis=1), times.var(axis=1), data.run[blocks[:, 0]]

    def average(values: np.ndarray) -> np.ndarray:
        means = values[blocks].mean(axis=1)
        return means - 0.5 * spread * _bends(time, means, run)

    dropped = data.dropped + data.n_obs - blocks.size
    means = replace(data, time=time, run=run, dropped=dropped, **data.each_column(average))
    return means.remarked(f"neighbouring samples are averaged, {m} at a time")


def _bends(time: np.ndarray, values: np.ndarray, run: np.ndarray) -> Float[np.ndarray, " n"]:
    """Return second derivatives by differences of three neighbours; an end has that of the next sample."""
    bends = np.zeros(len(values))
    for r in np.unique(run):
        rows = np.flatnonzero(run == r)
        if len(rows) > 2:
            slopes = np.diff(values[rows]) / np.diff(time[rows])
            inside = 2 * np.diff(slopes) / (time[rows][2:] - time[rows][:-2])
            bends[rows] = np.concatenate([inside[:1], inside, inside[-1:]])
    return bends


def _lost(data: Trajectories, means: Trajectories, name: str) -> bool:
    """Return True if averages lose something of a state that shows, or if its noise has outliers."""
    residuals, earlier = [], []
    for rows, blocks in zip(data.run_rows, means.run_rows, strict=True):
        time, mean_time = data.time[rows], means.time[blocks]
        inside = (time > mean_time[0]) & (time < mean_time[-1])
        between = data.column(name)[rows] - CubicSpline(mean_time, means.column(name)[blocks])(time)
        residuals.append(between[1:][inside[1:]])
        earlier.append(between[:-1][inside[1:]])
    now, then = np.concatenate(residuals), np.concatenate(earlier)
    square = np.mean(now**2)
    if np.sqrt(square) <= FLAT * np.max(np.abs(data.column(name))):
        return False
    return bool(now @ then > 0 or np.mean(now**4) > TAILS * square**2)
