"""Occam's window over inclusion sets (Madigan & Raftery 1994): all singles, then neighbours of the best."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from bayes_greybox.discovery.grid.table import EFFECT, FREE, SENSOR, Regressor
from bayes_greybox.discovery.ties import ranked

Set = tuple[int, ...]
"""Regressors of an inclusion set, sorted."""

Sets = Sequence[Set]


@dataclass(frozen=True)
class Reach:
    """Limits of a search.

    Attributes:
        effects: Largest number of effects in a set.
        sensors: Largest number of sensor errors in a set.
        members: Largest number of regressors that are not free.
        beam: Number of the likeliest sets whose neighbours are weighed.
        swapped: Number of the likeliest sets of which one regressor is exchanged for any other, once nothing else
            changes.
        window: Nats behind the likeliest set within which sets are kept.
        kept: Largest number of sets that are kept.
    """

    effects: int = 3
    sensors: int = 2
    members: int = 6
    beam: int = 24
    swapped: int = 3
    window: float = 12.0
    kept: int = 400


def search(
    regressors: Sequence[Regressor], log_weights: Callable[[Sets], Float[np.ndarray, " n_set"]], reach: Reach
) -> list[Set]:
    """Return the sets within the window, likeliest first; among equal ones those of earlier regressors come first."""
    space = _Space(regressors, reach)
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

    def __init__(self, regressors: Sequence[Regressor], reach: Reach) -> None:
        self.regressors, self.reach = regressors, reach
        self.free = tuple(i for i, each in enumerate(regressors) if each.kind == FREE)
        self.optional = [i for i, each in enumerate(regressors) if each.kind != FREE]
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
        """Return the sets with any other regressor in the place of one."""
        return [
            other
            for _, without in self._without_one(members)
            for other in self.neighbours(without)
            if len(other) == len(members)
        ]

    def _without_one(self, members: Set) -> list[tuple[int, Set]]:
        return [(i, tuple(j for j in members if j != i)) for i in members if self.regressors[i].kind != FREE]

    def _fits(self, members: Set) -> bool:
        kinds = [self.regressors[i].kind for i in members]
        return (
            len(members) - len(self.free) <= self.reach.members
            and kinds.count(EFFECT) <= self.reach.effects
            and kinds.count(SENSOR) <= self.reach.sensors
        )
