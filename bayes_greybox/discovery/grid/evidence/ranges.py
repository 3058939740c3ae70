"""Priors of coefficients that are no plain normal densities: expected signs and sizes, and limits of small errors.

A prior that differs from the normal one by a factor w(θ) has the normal evidence times the posterior mean of w over its
prior mean.
"""

from math import log

import numpy as np
from jaxtyping import Float
from scipy.special import log_ndtr

from bayes_greybox.discovery.grid.table import Regressor

WRONG_SIGN = 0.1
"""Prior probability that an effect that dissipates or restores does the opposite."""

EXPECTED_SPREAD = 0.3
"""Prior standard deviation, over its size, of a coefficient whose size is known."""


def log_ranges(
    regressors: tuple[Regressor, ...], mean: Float[np.ndarray, "n_set k"], sd: Float[np.ndarray, "n_set k"]
) -> Float[np.ndarray, "n_set k"]:
    """Return what signs, sizes and limits add to the log evidence.

        log 2 (p₊ P(θ has the expected sign | y) + p₋ P(it has the other | y)),    log P(|θ| ≤ limit | y),
        log ∫ p(θ | y) N₊(θ; b, (0.3 b)²)/N(θ; 0, s²) dθ where θ is about b

    Whose mean is beyond a limit is impossible: rows near it would be near what may not be.

    Args:
        regressors: One for each coefficient.
        mean: Posterior means under the normal priors.
        sd: Posterior standard deviations.
    """
    total = np.zeros(mean.shape)
    for k, each in enumerate(regressors):
        at, spread = mean[:, k], np.maximum(sd[:, k], 1e-150)
        if each.sign:
            right = log(1 - WRONG_SIGN) + log_ndtr(each.sign * at / spread)
            total[:, k] += log(2) + np.logaddexp(right, log(WRONG_SIGN) + log_ndtr(-each.sign * at / spread))
        if each.expected:
            total[:, k] += _near_size(at, spread**2, each.expected, each.sd**2)
        if np.isfinite(each.limit):
            inside = (each.limit * each.sd - np.abs(at)) / spread
            total[:, k] += np.where(inside > 0, log_ndtr(inside), -np.inf)
    return total


def _near_size(at: np.ndarray, variance: np.ndarray, expected: float, prior: float) -> np.ndarray:
    """Return log ∫ N(θ; m, v) N₊(θ; b, w)/N(θ; 0, s²) dθ, whose exponents add up to one of a normal density.

    With the data's own part N(θ; m', v') ∝ N(θ; m, v)/N(θ; 0, s²) it is −½ [(m' − b)²/(v' + w) − m'²/(v' + s²)].
    """
    wide = (EXPECTED_SPREAD * expected) ** 2
    # A posterior is no wider than its prior, but for rounding.
    own = np.maximum(1 / variance - 1 / prior, 1e-9 / prior)
    precision, linear = own + 1 / wide, at / variance + expected / wide
    center = at / (variance * own)
    same = log_ndtr(np.sign(expected) * linear / np.sqrt(precision)) - log_ndtr(1 / EXPECTED_SPREAD)
    square = (center - expected) ** 2 / (1 / own + wide) - center**2 / (1 / own + prior)
    return same + 0.5 * (log(prior) - np.log(variance * wide * precision)) - 0.5 * square
