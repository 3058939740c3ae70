"""Prior probability of inclusion sets, beside nothing and beside a discrepancy."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import log, log1p
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.discovery.grid.table import CORRECTION, EFFECT, SENSOR, Regressor
from bayes_greybox.discovery.odds import Odds


@dataclass(frozen=True)
class SetPrior:
    """Log prior of sets.

    P(S) = P(number of effects) · P(which) · Π suspects · P(corrections), with P(which) shared equally by names, and by
    the places of a name among these.

    Attributes:
        regressors: One for each column.
        odds: Prior probabilities.
        by_size: Log prior of so many effects, over the sum of what sets of as many weigh.
        ways: Log number of groups of each name.
    """

    regressors: tuple[Regressor, ...]
    odds: Odds
    by_size: tuple[float, ...]
    ways: Mapping[str, float]

    def among(self, regressors: Sequence[Regressor]) -> "SetPrior":
        """Return the same prior of sets of some of the effects and sensor errors.

        Args:
            regressors: These, beside all free terms and corrections.
        """
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
        """Return the log prior of each set beside nothing, and beside a discrepancy.

        Args:
            sets: Regressors of each.
        """
        own, effects, corrections = self._by_regressor[:, _padded(sets, len(self.regressors))].sum(axis=2)
        odds, every = self.odds, sum(each.kind == CORRECTION for each in self.regressors)
        effects, corrections = np.rint(effects).astype(int), np.rint(corrections)
        total = own + np.array(self.by_size)[effects]
        beside = corrections * log(odds.correction) + (every - corrections) * log1p(-odds.correction)
        # Which of them are off, given that some are.
        some = beside - (log(-np.expm1(every * log1p(-odds.correction))) if every else 0.0)
        plain = np.where(corrections > 0, some + log(odds.recalibrate), log(odds.no_gap))
        plain = np.where(effects > 0, beside + log1p(-odds.remainder), plain)
        remains = np.where(effects > 0, beside + log(odds.remainder), beside + log(odds.unknown))
        return np.column_stack([total + plain, total + remains])

    @cached_property
    def _by_regressor(self) -> Float[np.ndarray, "3 n"]:
        """Return what each regressor adds to the log prior, whether it is an effect, and whether it is a correction."""
        odds, rows = self.odds, []
        for each in self.regressors:
            effect, sensor = each.kind == EFFECT, each.kind == SENSOR
            own = each.log_weight - (self.ways[each.name] if effect else 0.0)
            own += log(odds.suspect) - log1p(-odds.suspect) if sensor else 0.0
            rows.append((own, float(effect), float(each.kind == CORRECTION)))
        return np.array([*rows, (0.0, 0.0, 0.0)]).T


class Window(NamedTuple):
    """Effects, sensor errors and memories that had some probability: they alone are weighed until the likeliest stays.

    Attributes:
        called: What they are called.
        prior: Prior probability of all sets.
        memories: Everything that may be remembered.
    """

    called: frozenset[str]
    prior: SetPrior
    memories: tuple[str, ...]


def _padded(sets: Sequence[Sequence[int]], by: int) -> Int[np.ndarray, "n_set most"]:
    """Return sets of different sizes as one array."""
    most = max((len(each) for each in sets), default=0)
    return np.array([(*each, *(by,) * (most - len(each))) for each in sets], dtype=int).reshape(len(sets), most)
