"""Fewer rows to draw without losing a peak: per bin of neighbouring rows, the extremes stay."""

import numpy as np
from jaxtyping import Float, Int


def extreme_rows(values: Float[np.ndarray, " n_obs"], n_bin: int) -> Int[np.ndarray, " n_kept"]:
    """Return the numbers of the rows to draw of a long record: the smallest and the largest of each bin, in order.

    Bins are of neighbouring rows. A record of no more than `2 n_bin` rows keeps all.
    """
    n_obs = len(values)
    if n_obs <= 2 * n_bin:
        return np.arange(n_obs)
    starts = _starts(n_obs, n_bin)
    ends = np.append(starts[1:], n_obs)
    kept = [0, n_obs - 1]
    for start, end in zip(starts, ends, strict=True):
        kept += [start + int(np.argmin(values[start:end])), start + int(np.argmax(values[start:end]))]
    return np.unique(np.asarray(kept))


def outer_band(
    time: Float[np.ndarray, " n_obs"],
    lower: Float[np.ndarray, " n_obs"],
    upper: Float[np.ndarray, " n_obs"],
    n_bin: int,
) -> tuple[Float[np.ndarray, " n_kept"], Float[np.ndarray, " n_kept"], Float[np.ndarray, " n_kept"]]:
    """Return a band to draw, by time, lower and upper edge, that covers the whole band of a long record.

    Each bin of neighbouring rows has its lowest lower and its highest upper edge, drawn at its first and its last row.
    """
    n_obs = len(time)
    if n_obs <= 2 * n_bin:
        return time, lower, upper
    starts = _starts(n_obs, n_bin)
    ends = np.append(starts[1:], n_obs) - 1
    return (
        np.stack([time[starts], time[ends]], axis=1).ravel(),
        np.repeat(np.minimum.reduceat(lower, starts), 2),
        np.repeat(np.maximum.reduceat(upper, starts), 2),
    )


def every_nth(n_obs: int, most: int) -> slice:
    """Return evenly spaced rows, at most about `most` of them."""
    return slice(None, None, max(1, -(-n_obs // most)))


def _starts(n_obs: int, n_bin: int) -> Int[np.ndarray, " n_bin"]:
    return np.linspace(0, n_obs, n_bin + 1).astype(np.int64)[:-1]
