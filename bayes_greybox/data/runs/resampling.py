"""Columns at other times: interpolated evenly, or thinned behind a low-pass filter."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import CubicSpline
from scipy.signal import decimate

from bayes_greybox.data.rates.differentiate import uniform_step
from bayes_greybox.data.rates.filters import GAP_STEPS
from bayes_greybox.running.errors import InputError

COARSER = 1.5  # largest ratio of a new step to the usual one: at longer steps fast motion would alias
STAMP_ROUNDING = 1e-6  # share of a step by which stamps may be off by rounding
HALF_WINDOW = 10  # rows at either edge of a decimated run that SciPy's filter of 20 factor + 1 taps reaches beyond


def even_times(time: Float[np.ndarray, " n"], step: float, name: str) -> Float[np.ndarray, " m"]:
    """Return even times from a run's first sample to its last; gaps, and steps that would alias, are refused."""
    if len(time) < 4:
        raise InputError(f'Run "{name}" has {len(time)} rows, too few to interpolate; leave it out.')
    steps = np.diff(time)
    usual, longest = float(np.median(steps)), int(np.argmax(steps))
    if steps[longest] > GAP_STEPS * usual:
        gap = f"from {time[longest]:g} to {time[longest + 1]:g}"
        raise InputError(
            f'Run "{name}" has a gap {gap}, where its usual step is {usual:.3g}; nothing is invented there: cut the '
            "run with data.trim(start, end), or read its parts as runs of their own."
        )
    if step > COARSER * usual:
        raise InputError(
            f'Run "{name}" has a sample every {usual:.6g}: at steps of {step:g} what is fast would pass for something '
            f"slow. Resample it at {usual:.6g} first, then data.decimate({round(step / usual)}), which filters it."
        )
    # A last sample that lies on the grid but for rounding belongs to it.
    count = int(np.floor((time[-1] - time[0]) / step + STAMP_ROUNDING)) + 1
    if count < 2:
        raise InputError(
            f'Run "{name}" lasts {time[-1] - time[0]:g}, less than the step {step:g}; choose a smaller one.'
        )
    return np.minimum(time[0] + step * np.arange(count), time[-1])


def interpolated(
    time: Float[np.ndarray, " n"], values: Float[np.ndarray, " n"], at: Float[np.ndarray, " m"], method: str
) -> Float[np.ndarray, " m"]:
    """Interpolate a column of one run by a cubic spline, by lines, or hold each sample up to the next."""
    if method == "cubic":
        return CubicSpline(time, values)(at)
    if method == "linear":
        return np.interp(at, time, values)
    # A time that is a stamp's but for rounding is after it.
    slack = STAMP_ROUNDING * float(np.median(np.diff(time)))
    return values[np.searchsorted(time, at + slack, side="right") - 1]


def running_integral(time: Float[np.ndarray, " n"], rate: Float[np.ndarray, "n ..."]) -> Float[np.ndarray, "n ..."]:
    """Integrate a rate from the first sample up to each, by the cubic spline through the samples."""
    return CubicSpline(time, rate).antiderivative()(time)


def decimated(
    time: Float[np.ndarray, " n"], values: Float[np.ndarray, " n"], factor: int, name: str
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Return times and values of one of so many samples behind SciPy's zero-phase low pass, edges left out."""
    # The filter of the last row must not reach beyond the run.
    last = (len(time) - 1 - HALF_WINDOW * factor) // factor
    kept = slice(HALF_WINDOW, min(-(-len(time) // factor) - HALF_WINDOW, last + 1))
    if kept.stop - kept.start < 2:
        raise InputError(
            f'Run "{name}" has {len(time)} rows: by {factor} fewer than two would be left beside the {HALF_WINDOW} at '
            "either edge, where the filter has no samples; choose a smaller factor, or leave the run out."
        )
    uniform_step(time, name)
    return time[::factor][kept], decimate(values, factor, ftype="fir", zero_phase=True)[kept]


def rows_named(rows: object, n_obs: int) -> Bool[np.ndarray, " n_obs"]:
    """Mark the rows that are named by number, a slice, or one truth value each."""
    index: Any = rows
    if not isinstance(rows, slice):
        index = np.asarray(rows)
        if index.dtype == bool and index.shape != (n_obs,):
            raise InputError(f"rows has {index.size} truth values, but the data have {n_obs} rows; give one for each.")
        if index.dtype != bool:
            if index.dtype.kind not in "iu" and index.size:
                raise InputError("rows must be numbers of rows from 0, a slice, or a truth value for each row.")
            index = index.astype(np.int64)
            if index.size and not (-n_obs <= index.min() and index.max() < n_obs):
                odd = index.max() if index.max() >= n_obs else index.min()
                raise InputError(f"There is no row {odd}; the data have {n_obs}, from 0 to {n_obs - 1}.")
    named = np.zeros(n_obs, dtype=bool)
    try:
        named[index] = True
    except (TypeError, ValueError):
        raise InputError(f"{rows!r} names no rows: the limits of a slice must be numbers of rows from 0.") from None
    return named
