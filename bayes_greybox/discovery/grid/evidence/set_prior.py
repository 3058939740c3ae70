"""Prior probability of inclusion sets, without a discrepancy and beside one."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import log, log1p
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bayes_greybox.discovery.grid.table import CORRECTION, EFFECT, SENSOR, Regressor
from bayes_greybox.discovery.odds import Odds


@dataclass(frozen=True)
class SetPrior:
    """Log prior of sets.

    P(S) = P(number of effects) · P(which) · Π sensor errors · P(corrections). P(which) is shared equally by names, and
    the share of a name by its places.

    Attributes:
        regressors: One for each column.
        odds: Prior probabilities.
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
        """Return the prior of sets of these regressors.

        Args:
            regressors: One for each column.
            odds: Prior probabilities.
            most: Largest number of effects in a set.
        """
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
    """Effects, sensor errors and memories that had some probability: they alone are weighed until the likeliest stays.

    Attributes:
        called: Their names.
        prior: Prior probability of all sets.
        memories: Names of all memories.
    """

    called: frozenset[str]
    prior: SetPrior
    memories: tuple[str, ...]
