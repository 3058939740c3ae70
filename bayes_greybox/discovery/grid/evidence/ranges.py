"""Priors of coefficients that are no plain normal densities: signs, sizes, and limits of small errors.

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
    regressor: Regressor, mean: Float[np.ndarray, " n_set"], sd: Float[np.ndarray, " n_set"]
) -> Float[np.ndarray, " n_set"]:
    """Return the change of the log evidence of sets by the sign, the size and the limit of one of their regressors.

        log 2 (p₊ P(θ has the expected sign | y) + p₋ P(it has the other | y)),    log P(|θ| ≤ limit | y),
        log ∫ p(θ | y) N₊(θ; b, (0.3 b)²)/N(θ; 0, s²) dθ where θ is about b

    A mean beyond a limit is impossible: rows would be linearised near an impossible value.

    Args:
        regressor: The regressor.
        mean: Posterior mean of its coefficient under the normal priors, in each set.
        sd: Posterior standard deviation.
    """
    total, sd = np.zeros(mean.shape), np.maximum(sd, 1e-150)
    if regressor.sign:
        right = log(1 - WRONG_SIGN) + log_ndtr(regressor.sign * mean / sd)
        total += log(2) + np.logaddexp(right, log(WRONG_SIGN) + log_ndtr(-regressor.sign * mean / sd))
    if regressor.expected:
        total += _log_near_size(mean, sd**2, regressor.expected, regressor.sd**2)
    if np.isfinite(regressor.limit):
        inside = (regressor.limit * regressor.sd - np.abs(mean)) / sd
        total += np.where(inside > 0, log_ndtr(inside), -np.inf)
    return total


def _log_near_size(mean: np.ndarray, variance: np.ndarray, expected: float, prior: float) -> np.ndarray:
    """Return log ∫ N(θ; m, v) N₊(θ; b, w)/N(θ; 0, s²) dθ, whose exponents add up to one of a normal density.

    With the data's own part N(θ; m', v') ∝ N(θ; m, v)/N(θ; 0, s²) it is −½ [(m' − b)²/(v' + w) − m'²/(v' + s²)].
    """
    wide = (EXPECTED_SPREAD * expected) ** 2
    # A posterior is no wider than its prior, but for rounding.
    data_precision = np.maximum(1 / variance - 1 / prior, 1e-9 / prior)
    precision, linear = data_precision + 1 / wide, mean / variance + expected / wide
    center = mean / (variance * data_precision)
    same_sign = log_ndtr(np.sign(expected) * linear / np.sqrt(precision)) - log_ndtr(1 / EXPECTED_SPREAD)
    square = (center - expected) ** 2 / (1 / data_precision + wide) - center**2 / (1 / data_precision + prior)
    return same_sign + 0.5 * (log(prior) - np.log(variance * wide * precision)) - 0.5 * square
