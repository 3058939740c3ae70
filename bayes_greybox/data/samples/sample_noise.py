"""Noise level of samples from the samples alone: differences of high order remove what is smooth, and keep noise."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

ORDERS = (4, 6, 8, 10, 12)  # orders of the differences; those of order k remove polynomials below degree k
# Ratio of normalised differences of one order to those of the order before from which on they are white noise, alike in
# all orders. A smooth signal falls below it unless it has fewer than about three and a half samples a period.
WHITE_RATIO = 0.75
# Share of half a column's range below which noise is none: the rounding of a file, or a solver's tolerance. It is no
# share of the largest value, as the place of zero (pressure, absolute position) is arbitrary.
NOISELESS_SHARE = 1e-6
ROUNDINGS = 2.0  # roundings of the largest value, in the precision of its numbers, below which noise is none either
FEWEST_DIFFERENCES = 10  # fewest differences from which noise is estimated; with fewer the states are taken as exact
MOST_DIFFERENCES = 20_000  # most differences from which noise is estimated; more are evenly thinned
OUTLYING = 5.0  # robust standard deviations beyond which a difference is a kink or a gross error, and left out
MEDIAN_SQUARED_NORMAL = 0.4549364231195725  # median of the square of a standard normal number


def sample_noise(
    time: Float[np.ndarray, " n"], values: Float[np.ndarray, "n k"], run_lengths: Sequence[int]
) -> Float[np.ndarray, " k"]:
    """Estimate the standard deviation of the white noise of each column, user's units; 0 where differences show none.

    Divided differences over k + 1 neighbours of one run, their weights scaled to unit norm, have the variance of the
    noise whatever the steps. Orders are tried one after the other until one shows `WHITE_RATIO` of the order before it:
    that is the noise. No difference spans two runs.

    Noise that is not white, such as the rest that a smoothing filter leaves, is not seen; a state that is kicked at
    random from sample to sample looks noisy.
    """
    least = _least_noise(values)
    # Without their level, differences of samples have no rounding of it.
    values = values - np.mean(values, axis=0, keepdims=True) if len(values) else values
    noise, before = np.zeros(values.shape[1]), np.full(values.shape[1], np.nan)
    open_ = np.max(np.abs(values), axis=0, initial=0.0) > 0
    for order in ORDERS:
        rows = windows(run_lengths, order + 1, MOST_DIFFERENCES)
        if len(rows) < FEWEST_DIFFERENCES or not open_.any():
            break
        weights = _difference_weights(time[rows])
        size = np.array([_typical(np.sum(weights * column[rows], axis=1)) for column in values.T])
        open_ = open_ & (size > least)
        white = open_ & (size > WHITE_RATIO * before)
        noise[white], open_ = size[white], open_ & ~white
        before = size
    return noise


def windows(run_lengths: Sequence[int], m: int, most: int) -> Int[np.ndarray, "n_window m"]:
    """Return the rows of windows of m neighbours within one run, evenly thinned to `most` windows."""
    lengths = np.asarray(run_lengths)
    starts = np.concatenate([[0], np.cumsum(lengths)[:-1]])
    first = np.concatenate([start + np.arange(max(n - m + 1, 0)) for start, n in zip(starts, lengths, strict=True)])
    if len(first) > most:
        first = first[np.linspace(0, len(first) - 1, most).astype(int)]
    return first.astype(int)[:, None] + np.arange(m)


def _least_noise(values: Float[np.ndarray, "n k"]) -> Float[np.ndarray, " k"]:
    """Return the level that noise has to exceed: a share of half the range, and the rounding of the numbers."""
    if not len(values):
        return np.zeros(values.shape[1])
    largest = np.max(np.abs(values), axis=0)
    with np.errstate(over="ignore"):
        # Values that single precision holds exactly were recorded in it, whatever their type is by now.
        single = np.all(values.astype(np.float32) == values, axis=0)
    eps = np.where(single, np.finfo(np.float32).eps, np.finfo(float).eps)
    return np.maximum(NOISELESS_SHARE * np.ptp(values, axis=0) / 2, ROUNDINGS * eps * largest)


def _difference_weights(time: Float[np.ndarray, "n_window m"]) -> Float[np.ndarray, "n_window m"]:
    """Return weights of the divided difference over each window, w_j ∝ 1/∏_{l≠j}(t_j − t_l), of unit norm."""
    inside = (time - time[:, :1]) / (time[:, -1:] - time[:, :1])
    apart = inside[:, :, None] - inside[:, None, :] + np.eye(time.shape[1])
    weights = 1.0 / np.prod(apart, axis=2)
    return weights / np.linalg.norm(weights, axis=1, keepdims=True)


def _typical(differences: Float[np.ndarray, " n"]) -> float:
    """Return the RMS of the differences that are no outliers; 0 where more than half of them vanish."""
    square = differences**2
    kept = square[square <= OUTLYING**2 * np.median(square) / MEDIAN_SQUARED_NORMAL]
    return float(np.sqrt(np.mean(kept)))
