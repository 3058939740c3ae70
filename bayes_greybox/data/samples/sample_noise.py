"""How noisy the samples of a signal are, from the samples alone.

Differences of high order remove what is smooth and keep what is white.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

ORDERS = (4, 6, 8, 10, 12)
"""Orders of the differences; those of order k remove polynomials below degree k."""

WHITE_RATIO = 0.75
"""White noise leaves normalised differences of all orders alike; a smooth signal loses more than this from one order to
the next unless it has fewer than about three and a half samples a period."""

NOISELESS_SHARE = 1e-6
"""Noise below this share of half a column's range is none: the rounding of a file, or what a solver tolerates.

A share of the range and not of the largest value: where zero lies (pressure, absolute position) says nothing of noise.
"""

ROUNDINGS = 2.0
"""Nor is noise below so many roundings of the largest value, as numbers of its kind have them."""

FEWEST_DIFFERENCES = 10
"""Differences that a statement about noise needs; with fewer the states are taken as exact."""

MOST_DIFFERENCES = 20_000
"""Differences, evenly thinned, that the noise is estimated from."""

OUTLYING = 5.0
"""Differences beyond this many robust standard deviations are kinks or gross errors, and left out."""

MEDIAN_SQUARED_NORMAL = 0.4549364231195725
"""Median of the square of a standard normal number."""


def sample_noise(
    time: Float[np.ndarray, " n"], values: Float[np.ndarray, "n k"], run_lengths: Sequence[int]
) -> Float[np.ndarray, " k"]:
    """Standard deviation of the white noise of each column's samples, user's units; 0 where differences show none.

    Divided differences over k + 1 neighbours of one run, their weights scaled to unit norm, have the variance of the
    noise whatever the steps. Orders are gone through until one shows `WHITE_RATIO` of the order before it: that is the
    noise.

    Noise that is not white, such as what a smoothing filter has left, is not seen; a state that is kicked at random
    from sample to sample looks noisy.

    Args:
        time: Times of the samples.
        values: Samples by column.
        run_lengths: Samples of each run; no difference spans two.
    """
    least = _least(values)
    # Without their level, differences of samples have no rounding of it.
    values = values - np.mean(values, axis=0, keepdims=True) if len(values) else values
    found, before = np.zeros(values.shape[1]), np.full(values.shape[1], np.nan)
    open_ = np.max(np.abs(values), axis=0, initial=0.0) > 0
    for order in ORDERS:
        rows = windows(run_lengths, order + 1, MOST_DIFFERENCES)
        if len(rows) < FEWEST_DIFFERENCES or not open_.any():
            break
        weights = _difference_weights(time[rows])
        left = np.array([_typical(np.sum(weights * column[rows], axis=1)) for column in values.T])
        open_ = open_ & (left > least)
        white = open_ & (left > WHITE_RATIO * before)
        found[white], open_ = left[white], open_ & ~white
        before = left
    return found


def windows(run_lengths: Sequence[int], m: int, most: int) -> Int[np.ndarray, "n_window m"]:
    """Rows of windows of m neighbours within one run, evenly thinned to `most`.

    Args:
        run_lengths: Rows of each run.
        m: Width.
        most: Largest number of windows.
    """
    lengths = np.asarray(run_lengths)
    starts = np.concatenate([[0], np.cumsum(lengths)[:-1]])
    first = np.concatenate([start + np.arange(max(n - m + 1, 0)) for start, n in zip(starts, lengths, strict=True)])
    if len(first) > most:
        first = first[np.linspace(0, len(first) - 1, most).astype(int)]
    return first.astype(int)[:, None] + np.arange(m)


def _least(values: Float[np.ndarray, "n k"]) -> Float[np.ndarray, " k"]:
    """What noise has to exceed, by column: a share of half its range, and the rounding of its numbers."""
    if not len(values):
        return np.zeros(values.shape[1])
    largest = np.max(np.abs(values), axis=0)
    with np.errstate(over="ignore"):
        # What single precision holds to the last bit came so, whatever it is by now.
        single = np.all(values.astype(np.float32) == values, axis=0)
    eps = np.where(single, np.finfo(np.float32).eps, np.finfo(float).eps)
    return np.maximum(NOISELESS_SHARE * np.ptp(values, axis=0) / 2, ROUNDINGS * eps * largest)


def _difference_weights(time: Float[np.ndarray, "n_window m"]) -> Float[np.ndarray, "n_window m"]:
    """Weights of the divided difference over each window, w_j ∝ 1/∏_{l≠j}(t_j − t_l), of unit norm."""
    inside = (time - time[:, :1]) / (time[:, -1:] - time[:, :1])
    apart = inside[:, :, None] - inside[:, None, :] + np.eye(time.shape[1])
    weights = 1.0 / np.prod(apart, axis=2)
    return weights / np.linalg.norm(weights, axis=1, keepdims=True)


def _typical(differences: Float[np.ndarray, " n"]) -> float:
    """RMS of the differences that are no outliers; 0 where more than half of them vanish."""
    square = differences**2
    kept = square[square <= OUTLYING**2 * np.median(square) / MEDIAN_SQUARED_NORMAL]
    return float(np.sqrt(np.mean(kept)))
