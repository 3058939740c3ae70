"""Inclusion sets: their prior, without a discrepancy and beside one, of signs and sizes, and the search among them.

A prior of a coefficient that differs from the normal one by a factor w(θ) has the normal evidence times the posterior
mean of w over its prior mean.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import log, log1p
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import log_ndtr

from bayes_greybox.discovery.odds import Odds
from bayes_greybox.discovery.ties import ranked

from .table import CORRECTION, EFFECT, FREE, SENSOR, Regressor

SURELY_WRONG = 1e-6
"""p-value below which samples of two sensors that disagree need a reason."""


@dataclass(frozen=True)
class SetPrior:
    """Log prior of sets, P(number of effects) · P(which) · Π sensor errors · P(corrections).

    P(which) is shared equally by names, and the share of a name by its places, whose log number is in `ways`. `by_size`
    is the log prior of each number of effects, over the summed weights of the sets of that size. `sure` are names of
    errors of which one at least is there: sets without any have a millionth of their prior.
    """

    regressors: tuple[Regressor, ...]
    odds: Odds
    by_size: tuple[float, ...]
    ways: Mapping[str, float]
    sure: tuple[str, ...] = ()

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
        sure = tuple(dict.fromkeys(each.sure for each in regressors if each.sure))
        return cls(tuple(regressors), odds, by_size, {name: log(n) for name, n in count.items()}, sure)

    def logs(self, sets: Sequence[Sequence[int]]) -> Float[np.ndarray, "n_set 2"]:
        """Return the log prior of each set without a discrepancy, and beside one."""
        # Shorter sets are filled up with a regressor that adds nothing, the last one.
        width, nothing = max(map(len, sets), default=0), len(self.regressors)
        padded = np.array([(*each, *(nothing,) * (width - len(each))) for each in sets], int).reshape(len(sets), width)
        weights, effects, corrections = self._by_regressor[:, padded].sum(axis=2)
        odds, n_correction = self.odds, sum(each.kind == CORRECTION for each in self.regressors)
        effects, corrections = np.rint(effects).astype(int), np.rint(corrections)
        total = weights + np.array(self.by_size)[effects]
        for name in self.sure:
            reasons = [i for i, each in enumerate(self.regressors) if each.sure == name]
            total = total + np.where(np.isin(padded, reasons).any(axis=1), 0.0, log(SURELY_WRONG))
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
    """Names that alone are weighed until the likeliest hypothesis stays, with the prior and the memories of all.

    If `complete`, only hypotheses without discrepancy are weighed.
    """

    called: frozenset[str]
    prior: SetPrior
    memories: tuple[str, ...]
    complete: bool = False


Set = tuple[int, ...]
"""Regressors of an inclusion set, sorted."""

Sets = Sequence[Set]
OfSets = Float[np.ndarray, " n_set"]

WRONG_SIGN, EXPECTED_SPREAD = 0.1, 0.3
"""Prior probability that an effect that dissipates or restores does the opposite; prior standard deviation of a
coefficient whose size is known, over it."""


def log_ranges(regressor: Regressor, mean: OfSets, sd: OfSets) -> OfSets:
    """Return the change of the log evidence of sets by the sign, the size and the limits of one of their regressors.

        log 2 (p₊ P(θ has the expected sign | y) + p₋ P(it has the other | y)),    log P(least ≤ θ ≤ most | y),
        log ∫ p(θ | y) N₊(θ; b, (0.3 b)²)/N(θ; 0, s²) dθ where θ is about b

    A mean beyond a limit is impossible: rows would be linearised near an impossible value.
    """
    total, sd = np.zeros(mean.shape), np.maximum(sd, 1e-150)
    if regressor.sign:
        right = log(1 - WRONG_SIGN) + log_ndtr(regressor.sign * mean / sd)
        total += log(2) + np.logaddexp(right, log(WRONG_SIGN) + log_ndtr(-regressor.sign * mean / sd))
    if regressor.expected:
        total += _log_near_size(mean, sd**2, regressor.expected, regressor.sd**2)
    if np.any(np.isfinite(regressor.limits)):
        # The farther end matters only to a mean that is known no better than the limits are wide.
        least, most = (limit * regressor.sd for limit in regressor.limits)
        inside = np.minimum(mean - least, most - mean) / sd
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


@dataclass(frozen=True)
class Reach:
    """Limits of a search: largest numbers of effects, of sensor errors, of regressors not free, and of sets kept.

    The neighbours of the `beam` likeliest sets are weighed, and one regressor of the `swapped` likeliest is exchanged
    for any other. Sets are kept within a `window` of nats. A sensor error that is refused is taken for an effect:
    beside a delay and a drift an offset was a constant force and a quadratic spring.
    """

    effects: int = 3
    sensors: int = 3
    members: int = 6
    beam: int = 24
    swapped: int = 3
    window: float = 12.0
    kept: int = 400


def search(
    regressors: Sequence[Regressor], log_weights: Callable[[Sets], OfSets], reach: Reach,
    among: Sequence[int] | None = None,
) -> list[Set]:  # fmt: skip
    """Return the sets of all or some regressors within the window, likeliest first; of equals the earlier first."""
    space = _Space(regressors, reach, range(len(regressors)) if among is None else sorted(among))
    weights: dict[Set, float] = {}

    def weigh(sets: Sets) -> None:
        fresh = [each for each in dict.fromkeys(tuple(sorted(s)) for s in sets) if each not in weights]
        if fresh:
            weights.update(zip(fresh, log_weights(fresh).tolist(), strict=True))

    def likeliest() -> tuple[list[Set], float]:
        # Sets that are the same on the data differ by rounding only, which must not choose.
        order = ranked(sorted(weights), weights.__getitem__)
        return order, weights[order[0]] - reach.window

    weigh([space.free])
    weigh(space.neighbours(space.free))
    expanded, swapped = {space.free}, set[Set]()
    while True:
        order, least = likeliest()
        best = [each for each in order[: reach.beam] if each not in expanded and weights[each] > least]
        if best:
            expanded.update(best)
            weigh([other for each in best for other in space.neighbours(each)])
            continue
        # Where two regressors stand in for a third, neither can be dropped alone.
        best = [each for each in order[: reach.swapped] if each not in swapped]
        if not best:
            return [each for each in order[: reach.kept] if weights[each] > least]
        swapped.update(best)
        weigh([other for each in best for other in space.swaps(each)])


class _Space:
    """Model space: the sets that a search may reach."""

    def __init__(self, regressors: Sequence[Regressor], reach: Reach, among: Iterable[int]) -> None:
        self.regressors, self.reach = regressors, reach
        self.free = tuple(i for i, each in enumerate(regressors) if each.kind == FREE)
        self.optional = [i for i in among if regressors[i].kind != FREE]
        self.groups: dict[str, list[int]] = {}
        for i in self.optional:
            self.groups.setdefault(regressors[i].group, []).append(i)

    def neighbours(self, members: Set) -> list[Set]:
        """Return the sets with one regressor more, with one less, or with another one of its group."""
        taken = {self.regressors[i].group for i in members}
        sets: list[Set] = [(*members, i) for i in self.optional if self.regressors[i].group not in taken]
        for i, without in self._without_one(members):
            sets.append(without)
            sets += [(*without, other) for other in self.groups[self.regressors[i].group] if other != i]
        return [each for each in sets if self._fits(each)]

    def swaps(self, members: Set) -> list[Set]:
        every = [other for _, without in self._without_one(members) for other in self.neighbours(without)]
        return [other for other in every if len(other) == len(members)]

    def _without_one(self, members: Set) -> list[tuple[int, Set]]:
        return [(i, tuple(j for j in members if j != i)) for i in members if self.regressors[i].kind != FREE]

    def _fits(self, members: Set) -> bool:
        kinds, reach = [self.regressors[i].kind for i in members], self.reach
        few = kinds.count(EFFECT) <= reach.effects and kinds.count(SENSOR) <= reach.sensors
        return few and len(members) - len(self.free) <= reach.members
