"""Where coefficients may be: what the signs that physics expects, and the limits of small errors, add to an evidence.

An evidence is that of Gaussian priors, symmetrical and without bounds. A prior that differs from it by a factor w(θ)
has that evidence times the posterior mean of w over its prior mean.
"""

from collections.abc import Sequence
from math import log

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import log_ndtr

from .columns import Column

WRONG_SIGN = 0.1
"""Prior probability that an effect that dissipates or restores does the opposite."""

SMALL = 5.0
"""An error of a sensor is small: at most so many of its prior standard deviations, or it is no such error."""


EXPECTED = 0.3
"""Prior standard deviation, over its size, of a coefficient whose size is known."""


def limited(column: Column) -> bool:
    """Whether a coefficient has a sign, a size or a limit."""
    return column.suspect is not None or sign_of(column) != 0 or column.expected != 0


def sign_of(column: Column) -> int:
    """The sign that physics expects of an effect; 0 where it expects none."""
    return getattr(column.effect.effect, "sign", 0) if column.effect is not None else 0


def log_ranges(columns: Sequence[Column], mean: Float[np.ndarray, " k"], covariance: Float[np.ndarray, "k k"]) -> float:
    """What signs and limits add to the log evidence of a set.

        log 2 (p₊ P(θ has the physical sign | y) + p₋ P(it has the other | y)),    log P(|θ| ≤ limit | y),
        log ∫ p(θ | y) N₊(θ; b, (`EXPECTED` b)²)/N(θ; 0, s²) dθ where θ is about b, N₊ nothing on the other side of zero

    Args:
        columns: Of the set.
        mean: Their posterior mean under symmetrical priors without bounds, in the columns' scale.
        covariance: Its covariance.
    """
    total = 0.0
    for column, at, variance in zip(columns, mean, np.diag(covariance), strict=True):
        sd = np.sqrt(max(variance, 1e-300))
        sign = sign_of(column)
        if sign:
            right, wrong = log(1 - WRONG_SIGN) + log_ndtr(sign * at / sd), log(WRONG_SIGN) + log_ndtr(-sign * at / sd)
            total += log(2) + float(np.logaddexp(right, wrong))
        if column.expected:
            total += _near_size(float(at), float(sd) ** 2, column.expected, column.sd**2)
        if column.suspect is not None:
            total += float(log_ndtr((SMALL * column.sd - abs(at)) / sd))
    return total


def _near_size(at: float, variance: float, expected: float, prior: float) -> float:
    """Log ∫ N(θ; m, v) N₊(θ; b, w)/N(θ; 0, s²) dθ, whose exponents add up to one of a Gaussian.

    With the other sign it would be another thing: what a lag takes away, a lead adds.
    """
    wide = (EXPECTED * expected) ** 2
    # A posterior is no wider than its prior, but for rounding.
    precision = max(1 / variance - 1 / prior, 0.0) + 1 / wide
    linear, square = at / variance + expected / wide, at**2 / variance + expected**2 / wide
    side = np.sign(expected)
    same = log_ndtr(side * linear / np.sqrt(precision)) - log_ndtr(1 / EXPECTED)
    return float(same) + 0.5 * (log(prior) - log(variance * wide * precision)) - 0.5 * (square - linear**2 / precision)


def small(
    gram: Float[np.ndarray, "n_set k k"], with_target: Float[np.ndarray, "n_set k"], square: float, n_row: float,
    prior_sd: Float[np.ndarray, "n_set k"], suspected: Bool[np.ndarray, "n_set k"],
) -> Bool[np.ndarray, " n_set"]:  # fmt: skip
    """Whether sets may have suspects that are as small as errors of sensors are.

    Args:
        gram: Products of the columns of each set.
        with_target: Products with the target.
        square: Of the target.
        n_row: Rows.
        prior_sd: Of each column's coefficient.
        suspected: Which columns are suspects.
    """
    theta = np.linalg.solve(gram + _ridge(gram), with_target[..., None])[..., 0]
    variance = np.maximum(square - np.sum(theta * with_target, axis=-1), 0.0) / n_row
    # A prior of no width holds its coefficient at zero.
    weight = variance[:, None] / np.maximum(prior_sd, 1e-9) ** 2
    shrunk = gram + np.eye(gram.shape[-1]) * weight[..., None] + _ridge(gram)
    inverse = np.linalg.inv(shrunk)
    theta = np.einsum("nij,nj->ni", inverse, with_target)
    sd = np.sqrt(np.maximum(np.einsum("nii->ni", inverse), 0.0) * variance[:, None])
    return ~np.any(suspected & (np.abs(theta) - 3 * sd > SMALL * prior_sd), axis=-1)


def _ridge(gram: np.ndarray) -> np.ndarray:
    """Enough for columns that are the same to be solved for."""
    return 1e-12 * np.eye(gram.shape[-1]) * np.einsum("nii->n", gram)[:, None, None]
