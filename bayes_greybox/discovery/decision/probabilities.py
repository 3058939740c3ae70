"""Probabilities of effects, of corrections, of sensor errors and of what remains, summed over the hypotheses.

An effect whose contribution is no larger than what remains unexplained beside it may be its imitation: its probability
counts with the share of the two together that it closes, see `trusted`. So does that of a sensor error. A correction
imitates nothing: the term is in the simulation, and its coefficient beside whatever remains is a statement about these
data.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from bayes_greybox.discovery.grid.hypotheses.weigh import Hypothesis, Weighed
from bayes_greybox.discovery.grid.noise.points import DISCREPANCIES, UNNAMED
from bayes_greybox.discovery.grid.table import CORRECTION, EFFECT, SENSOR, Regressor

from .criteria import Criteria

NO_GAP, RECALIBRATE, INSTRUMENT, UNKNOWN, EFFECTS = "no gap", "recalibrate", "instrument", "unknown", "effects"
"""Kinds of hypotheses, by what they say is wrong."""

STOPS = (NO_GAP, RECALIBRATE, INSTRUMENT, UNKNOWN)
"""Kinds that name no effect."""


class Share(NamedTuple):
    """Probability and agreement of all hypotheses that hold something, together.

    Attributes:
        probability: Their posterior probability.
        agreement: Their probability averaged over bagged records.
    """

    probability: float = 0.0
    agreement: float = 0.0

    def plus(self, hypothesis: Hypothesis, trust: float) -> "Share":
        """Return it with another hypothesis."""
        return Share(self.probability + trust * hypothesis.probability, self.agreement + trust * hypothesis.agreement)


@dataclass(frozen=True, eq=False)
class Probabilities:
    """Probabilities over all hypotheses.

    Attributes:
        weighed: The hypotheses.
        criteria: Numbers that decide.
    """

    weighed: Weighed
    criteria: Criteria

    def members(self, hypothesis: Hypothesis, kind: str) -> list[tuple[int, Regressor, float]]:
        """Return a hypothesis's regressors of one kind: column, regressor, and what its probability counts with."""
        of_kind = self.alone(hypothesis, kind)
        stacked = self._stacked([each for _, each, _ in of_kind])
        return [(i, each, trust * stacked(each)) for i, each, trust in of_kind]

    def alone(self, hypothesis: Hypothesis, kind: str) -> list[tuple[int, Regressor, float]]:
        """Return the same as `members` without the discount of stacked effects."""
        regressors = self.weighed.table.regressors
        sizes = zip(hypothesis.members, hypothesis.sizes, hypothesis.beside, hypothesis.against, strict=True)
        return [
            (i, regressors[i], 1.0 if kind == CORRECTION else trusted(size, left, against))
            for i, size, left, against in sizes
            if regressors[i].kind == kind
        ]

    def _stacked(self, effects: list[Regressor]) -> Callable[[Regressor], float]:
        """Return what effects of one quantity count with, which together may be one law that has no name."""

        def factor(effect: Regressor) -> float:
            same = [each for each in effects if each.kind == EFFECT and each.quantity == effect.quantity]
            many = len(same) > 2 or (len(same) == 2 and any(each.bends for each in same))
            return 1 - self.criteria.stacked if many and effect.kind == EFFECT else 1.0

        return factor

    def effects(self, hypothesis: Hypothesis) -> tuple[str, ...]:
        """Return the effects of a hypothesis on their columns, sorted."""
        regressors = self.weighed.table.regressors
        return tuple(sorted(regressors[i].group for i in hypothesis.members if regressors[i].kind == EFFECT))

    def says(self, hypothesis: Hypothesis) -> str:
        """Return what a hypothesis says where nothing remains beside it."""
        kinds = {self.weighed.table.regressors[i].kind for i in hypothesis.members}
        if EFFECT in kinds:
            return EFFECTS
        return RECALIBRATE if CORRECTION in kinds else INSTRUMENT if SENSOR in kinds else NO_GAP

    def remains(self, hypothesis: Hypothesis) -> float:
        """Return the probability that something of the system remains beside a hypothesis."""
        return min(sum(hypothesis.kinds[kind] for kind in UNNAMED), 1.0)

    @cached_property
    def by_kind(self) -> dict[str, float]:
        """Return the probabilities of no gap, recalibration, instrument, unknown, and effects; they sum to one."""
        found: dict[str, float] = dict.fromkeys((*STOPS, EFFECTS), 0.0)
        for h in self.weighed.hypotheses:
            effects = self.members(h, EFFECT)
            real = max((trust for *_, trust in effects), default=1 - self.remains(h))
            found[self.says(h)] += real * h.probability
            found[UNKNOWN] += (1 - real) * h.probability
        return found

    def _by(self, kind: str, key: Callable[[Regressor], str], named: bool = True) -> dict[str, Share]:
        """Return the shares of regressors of one kind by a key; in one hypothesis the surest of a key counts.

        Args:
            kind: Kind of the regressors.
            key: Name under which a regressor is summed.
            named: Whether stacked effects are discounted: not for a law whatever its name.
        """
        found = {key(each): Share() for each in self.weighed.table.regressors if each.kind == kind}
        for h in self.weighed.hypotheses:
            own: dict[str, float] = {}
            for _, each, trust in self.members(h, kind) if named else self.alone(h, kind):
                own[key(each)] = max(own.get(key(each), 0.0), trust)
            for name, trust in own.items():
                found[name] = found[name].plus(h, trust)
        return likeliest_first(found.items())

    @cached_property
    def by_effect(self) -> dict[str, Share]:
        """Return the shares of effects by slug, wherever they act, largest first."""
        return self._by(EFFECT, lambda each: each.name)

    @cached_property
    def by_place(self) -> dict[str, Share]:
        """Return the shares of effects on their own columns."""
        return self._by(EFFECT, lambda each: each.group)

    @cached_property
    def by_family(self) -> dict[str, Share]:
        """Return the shares of families of effects."""
        return self._by(EFFECT, lambda each: each.family)

    @cached_property
    def by_quantity(self) -> dict[str, Share]:
        """Return the shares of laws of the same columns, whatever their names."""
        return self._by(EFFECT, lambda each: ", ".join(each.quantity), named=False)

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
        """Return the shares of sets of effects, with what each set counts with, likeliest first."""
        found: dict[tuple[str, ...], Share] = {}
        for h in self.weighed.hypotheses:
            effects = self.members(h, EFFECT)
            if effects:
                key = self.effects(h)
                found[key] = found.get(key, Share()).plus(h, max(trust for *_, trust in effects))
        return likeliest_first(found.items())

    @cached_property
    def by_discrepancy(self) -> dict[str, float]:
        """Return the probabilities of the kinds of what remains, noise that hangs together among them."""
        every = self.weighed.hypotheses
        return {kind: sum(h.probability * h.kinds[kind] for h in every) for kind in DISCREPANCIES}

    @cached_property
    def by_memory(self) -> dict[str, float]:
        """Return the probabilities that what remains remembers, by what it remembers, largest first."""
        found = {
            memory: sum(h.probability * h.memories.get(memory, 0.0) for h in self.weighed.hypotheses)
            for memory in self.weighed.table.memories
        }
        return dict(sorted(found.items(), key=lambda item: -round(item[1], 6)))

    @cached_property
    def by_shape(self) -> dict[int, float]:
        """Return the probabilities of the shapes of the noise, by their numbers; 0 is white and normal."""
        found: dict[int, float] = {}
        for h in self.weighed.hypotheses:
            for share, point in zip(h.points, self.weighed.grid.points, strict=True):
                found[point.shape] = found.get(point.shape, 0.0) + h.probability * float(share)
        return found


def trusted(own: float, left: float, against: float = 0.0) -> float:
    """Return the probability that what has a size is no imitation of what is left beside it.

        1 − left²/⟨(a + w)²⟩ = (own² + 2 ⟨a w⟩)/(own² + 2 ⟨a w⟩ + left²)

    with a its contribution and w what is left: the share of both together that it closes. Of two that cancel each other
    neither is anything.

    Args:
        own: RMS of its contribution.
        left: RMS of the smoothed discrepancy in the band of the contribution.
        against: ⟨a w⟩, their mean product.
    """
    closed = own**2 + 2 * against
    return float(closed / (closed + left**2)) if own > 0 and closed > 0 else 0.0


def likeliest_first(items: Iterable[tuple]) -> dict:
    """Return shares in the order of their probability; those that differ by rounding alone stay in order."""
    return dict(sorted(items, key=lambda item: -round(item[1].probability, 6)))
