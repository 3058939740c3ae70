"""Probabilities of effects, corrections, sensor errors and discrepancies, summed over the hypotheses.

An effect that contributes no more than the discrepancy beside it may only imitate the discrepancy. Its probability is
therefore discounted by the share of the two that it closes, see `trusted`; so is that of a sensor error. A correction
is not discounted: its term is in the simulation anyway.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

from bayes_greybox.discovery.grid.points import DISCREPANCIES, UNNAMED
from bayes_greybox.discovery.grid.table import CORRECTION, EFFECT, SENSOR, Regressor
from bayes_greybox.discovery.grid.weigh import Hypothesis, Weighed
from bayes_greybox.discovery.ties import likeliest_first

from .criteria import Criteria

NO_GAP, RECALIBRATE, INSTRUMENT, UNKNOWN_KIND, EFFECTS = "no gap", "recalibrate", "instrument", "unknown", "effects"
"""Kinds of hypotheses, by the cause of the gap."""

STOPS = (NO_GAP, RECALIBRATE, INSTRUMENT, UNKNOWN_KIND)
"""Kinds that name no effect."""


class Share(NamedTuple):
    """Probability of a group of hypotheses, and its agreement: the same averaged over bagged records."""

    probability: float = 0.0
    agreement: float = 0.0

    def plus(self, hypothesis: Hypothesis, trust: float) -> "Share":
        """Return the share with one more hypothesis, discounted by `trust`."""
        return Share(self.probability + trust * hypothesis.probability, self.agreement + trust * hypothesis.agreement)


@dataclass(frozen=True, eq=False)
class Probabilities:
    """Probabilities over all hypotheses."""

    weighed: Weighed
    criteria: Criteria

    def members(self, hypothesis: Hypothesis, kind: str, stacking: bool = True) -> list[tuple[Regressor, float]]:
        """Return a hypothesis's regressors of one kind, each with its confounding discount."""
        regressors = self.weighed.table.regressors
        sizes = zip(hypothesis.members, hypothesis.sizes, hypothesis.beside, hypothesis.against, strict=True)
        discounted = [
            (regressors[i], 1.0 if kind == CORRECTION else trusted(size, left, against))
            for i, size, left, against in sizes
            if regressors[i].kind == kind
        ]
        if kind != EFFECT or not stacking:
            return discounted
        # Three effects of one quantity, or two of which one bends, may be one law without a name.
        alike = [[other for other, _ in discounted if other.quantity == each.quantity] for each, _ in discounted]
        stacked = [len(same) > 2 or (len(same) == 2 and any(one.bends for one in same)) for same in alike]
        less = 1 - self.criteria.stacked
        return [(each, trust * (less if one else 1.0)) for (each, trust), one in zip(discounted, stacked, strict=True)]

    def effects(self, hypothesis: Hypothesis) -> tuple[str, ...]:
        """Return the labels of a hypothesis's effects, sorted."""
        regressors = self.weighed.table.regressors
        return tuple(sorted(regressors[i].group for i in hypothesis.members if regressors[i].kind == EFFECT))

    def kind_of(self, hypothesis: Hypothesis) -> str:
        """Return the kind of a hypothesis without a discrepancy beside it."""
        kinds = {self.weighed.table.regressors[i].kind for i in hypothesis.members}
        if EFFECT in kinds:
            return EFFECTS
        return RECALIBRATE if CORRECTION in kinds else INSTRUMENT if SENSOR in kinds else NO_GAP

    def remains(self, hypothesis: Hypothesis) -> float:
        """Return the probability of a discrepancy of the system beside a hypothesis."""
        return min(sum(hypothesis.kinds[kind] for kind in UNNAMED), 1.0)

    @cached_property
    def by_kind(self) -> dict[str, float]:
        """Return the probabilities of no gap, recalibration, instrument, unknown, and effects; they sum to one."""
        shares: dict[str, float] = dict.fromkeys((*STOPS, EFFECTS), 0.0)
        for h in self.weighed.hypotheses:
            effects = self.members(h, EFFECT)
            real = max((trust for _, trust in effects), default=1 - self.remains(h))
            shares[self.kind_of(h)] += real * h.probability
            shares[UNKNOWN_KIND] += (1 - real) * h.probability
        return shares

    def _by(self, kind: str, key: Callable[[Regressor], str], stacking: bool = True) -> dict[str, Share]:
        """Return the shares of regressors of one kind by a key; of several in one hypothesis the surest counts."""
        shares = {key(each): Share() for each in self.weighed.table.regressors if each.kind == kind}
        for h in self.weighed.hypotheses:
            surest: dict[str, float] = {}
            for each, trust in self.members(h, kind, stacking):
                surest[key(each)] = max(surest.get(key(each), 0.0), trust)
            for name, trust in surest.items():
                shares[name] = shares[name].plus(h, trust)
        return _likeliest_first(shares)

    @cached_property
    def by_effect(self) -> dict[str, Share]:
        """Return the shares of effects by slug, wherever they act, largest first."""
        return self._by(EFFECT, lambda each: each.name)

    @cached_property
    def by_place(self) -> dict[str, Share]:
        """Return the shares of effects by label: each on its own columns."""
        return self._by(EFFECT, lambda each: each.group)

    @cached_property
    def by_quantity(self) -> dict[str, Share]:
        """Return the shares of laws by the columns that they depend on, whatever their names."""
        return self._by(EFFECT, lambda each: ", ".join(each.quantity), stacking=False)

    @cached_property
    def by_sensor(self) -> dict[str, Share]:
        """Return the shares of sensor errors."""
        return self._by(SENSOR, lambda each: each.name)

    @cached_property
    def by_correction(self) -> dict[str, Share]:
        """Return the shares of corrections, by the term's formula."""
        return self._by(CORRECTION, lambda each: each.name)

    @cached_property
    def by_set(self) -> dict[tuple[str, ...], Share]:
        """Return the shares of sets of effects, each discounted as its surest effect, likeliest first."""
        shares: dict[tuple[str, ...], Share] = {}
        for h in self.weighed.hypotheses:
            effects = self.members(h, EFFECT)
            if effects:
                key = self.effects(h)
                shares[key] = shares.get(key, Share()).plus(h, max(trust for _, trust in effects))
        return _likeliest_first(shares)

    @cached_property
    def by_discrepancy(self) -> dict[str, float]:
        """Return the probabilities of the kinds of discrepancy, correlated noise among them."""
        every = self.weighed.hypotheses
        return {kind: sum(h.probability * h.kinds[kind] for h in every) for kind in DISCREPANCIES}

    @cached_property
    def by_memory(self) -> dict[str, float]:
        """Return the probabilities of discrepancies with memory, by the memory, largest first."""
        shares = {
            memory: sum(h.probability * h.memories.get(memory, 0.0) for h in self.weighed.hypotheses)
            for memory in self.weighed.table.memories
        }
        return dict(likeliest_first(shares.items(), lambda item: item[1]))

    @cached_property
    def by_shape(self) -> dict[int, float]:
        """Return the probabilities of the noise shapes, by number; 0 is white and normal."""
        shares: dict[int, float] = {}
        for h in self.weighed.hypotheses:
            for share, point in zip(h.points, self.weighed.grid.points, strict=True):
                shares[point.shape] = shares.get(point.shape, 0.0) + h.probability * float(share)
        return shares


def trusted(own: float, left: float, against: float = 0.0) -> float:
    """Return the confounding discount of a contribution a beside a discrepancy w: the share of both that it closes.

        1 − left²/⟨(a + w)²⟩ = (own² + 2 ⟨a w⟩)/(own² + 2 ⟨a w⟩ + left²)

    with own the RMS of a, left that of w in the band of a, and ⟨a w⟩ `against`. Of two that cancel each other the
    discount is zero.
    """
    closed = own**2 + 2 * against
    return float(closed / (closed + left**2)) if own > 0 and closed > 0 else 0.0


def _likeliest_first(shares: Mapping[Any, Share]) -> dict[Any, Share]:
    return dict(likeliest_first(shares.items(), lambda item: item[1].probability))
