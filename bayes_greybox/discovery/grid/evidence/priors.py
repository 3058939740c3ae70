"""Prior probability of inclusion sets, without a discrepancy and beside one, and of signs and sizes of coefficients.

A prior of a coefficient that differs from the normal one by a factor w(θ) has the normal evidence times the posterior
mean of w over its prior mean.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import log, log1p
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import log_ndtr

from bayes_greybox.discovery.grid.table import CORRECTION, EFFECT, SENSOR, Regressor
from bayes_greybox.discovery.odds import Odds


@dataclass(frozen=True)
class SetPrior:
    """Log prior of sets.

    P(S) = P(number of effects) · P(which) · Π sensor errors · P(corrections). P(which) is shared equally by names, and
    the share of a name by its places.

    Attributes:
        by_size: Log prior of each number of effects, over the summed weights of the sets of that size.
        ways: Log number of groups of each name.
    """

    regressors: tuple[Regressor, ...]
    odds: Odds
    by_size: tuple[float, ...]
    ways: Mapping[str, float]

    def among(self, regressors: Sequence[Regressor]) -> "SetPrior":
        """Return the same prior for fewer effects and sensor errors, with all free terms and corrections."""
        return replace(self, regressors=tuple(regressors))

    @classmethod
    def of(cls, regressors: Sequence[Regressor], odds: Odds, most: int) -> "SetPrior":
        """Return the prior of sets of these regressors."""
        groups = {each.group: each.name for each in regressors if each.kind == EFFECT}
        count = Counter(groups.values())
        most = min(most, len(groups))
        # Sets of k effects weigh Π 1/ways; these add up to the k-th elementary symmetric polynomial.
        sums = np.zeros(most + 1)
        sums[0] = 1.0
        for name in groups.values():
            sums[1:] += sums[:-1] / count[name]
        shares = np.array([odds.another**k for k in range(max(most, 1))])
        shares = np.log(shares / shares.sum()) + log(odds.effects)
        by_size = (0.0, *(float(shares[k - 1]) - log(sums[k]) for k in range(1, most + 1)))
        return cls(tuple(regressors), odds, by_size, {name: log(n) for name, n in count.items()})

    def logs(self, sets: Sequence[Sequence[int]]) -> Float[np.ndarray, "n_set 2"]:
        """Return the log prior of each set without a discrepancy, and beside one."""
        # Shorter sets are filled up with a regressor that adds nothing, the last one.
        width, nothing = max(map(len, sets), default=0), len(self.regressors)
        padded = np.array([(*each, *(nothing,) * (width - len(each))) for each in sets], int).reshape(len(sets), width)
        weights, effects, corrections = self._by_regressor[:, padded].sum(axis=2)
        odds, n_correction = self.odds, sum(each.kind == CORRECTION for each in self.regressors)
        effects, corrections = np.rint(effects).astype(int), np.rint(corrections)
        total = weights + np.array(self.by_size)[effects]
        beside = corrections * log(odds.correction) + (n_correction - corrections) * log1p(-odds.correction)
        # Which coefficients are off, given that some are.
        some = beside - (log(-np.expm1(n_correction * log1p(-odds.correction))) if n_correction else 0.0)
        complete = np.where(corrections > 0, some + log(odds.recalibrate), log(odds.no_gap))
        complete = np.where(effects > 0, beside + log1p(-odds.remainder), complete)
        incomplete = np.where(effects > 0, beside + log(odds.remainder), beside + log(odds.unknown))
        return np.column_stack([total + complete, total + incomplete])

    @cached_property
    def _by_regressor(self) -> Float[np.ndarray, "3 n"]:
        """Return the log prior that each regressor adds, and ones for the effects and for the corrections."""
        rows = []
        for each in self.regressors:
            log_prior = each.log_weight - (self.ways[each.name] if each.kind == EFFECT else 0.0)
            log_prior += log(self.odds.suspect) - log1p(-self.odds.suspect) if each.kind == SENSOR else 0.0
            rows.append((log_prior, float(each.kind == EFFECT), float(each.kind == CORRECTION)))
        return np.array([*rows, (0.0, 0.0, 0.0)]).T


class Window(NamedTuple):
    """Names that had some probability, which alone are weighed until the likeliest stays; and what all had before it."""

    called: frozenset[str]
    prior: SetPrior
    memories: tuple[str, ...]


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
