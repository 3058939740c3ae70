"""Occam's window over inclusion sets (Madigan & Raftery 1994): all singles, then neighbours of the best."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from bayes_greybox.discovery.grid.table import EFFECT, FREE, SENSOR, Regressor
from bayes_greybox.discovery.ties import ranked

Sets = Sequence[tuple[int, ...]]
"""Regressors of each set, sorted."""


@dataclass(frozen=True)
class Reach:
    """How far a search goes.

    Attributes:
        effects: Largest number of effects in a set.
        sensors: Largest number of sensor errors in a set.
        members: Largest number of regressors that are not free.
        beam: Sets whose neighbours are weighed.
        swapped: Likeliest sets of which one regressor is exchanged for any other, once nothing else changes.
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
) -> list[tuple[int, ...]]:
    """Return the sets within the window, likeliest first; of equal ones those of earlier regressors first.

    Args:
        regressors: One for each column; free ones are in every set.
        log_weights: Log posterior weights of sets.
        reach: How far to go.
    """
    free = tuple(i for i, each in enumerate(regressors) if each.kind == FREE)
    open_ = [i for i, each in enumerate(regressors) if each.kind != FREE]
    groups: dict[str, list[int]] = {}
    for i in open_:
        groups.setdefault(regressors[i].group, []).append(i)
    known: dict[tuple[int, ...], float] = {}

    def weigh(sets: Sets) -> None:
        fresh = [each for each in dict.fromkeys(tuple(sorted(s)) for s in sets) if each not in known]
        if fresh:
            known.update(zip(fresh, log_weights(fresh).tolist(), strict=True))

    def likeliest() -> list[tuple[int, ...]]:
        # Sets that are the same on the data differ by rounding only, which must not choose.
        return ranked(sorted(known), known.__getitem__)

    def fits(members: tuple[int, ...]) -> bool:
        own = [regressors[i] for i in members]
        return (
            len(members) - len(free) <= reach.members
            and sum(each.kind == EFFECT for each in own) <= reach.effects
            and sum(each.kind == SENSOR for each in own) <= reach.sensors
        )

    def neighbours(members: tuple[int, ...]) -> list[tuple[int, ...]]:
        taken = {regressors[i].group for i in members}
        found: list[tuple[int, ...]] = [(*members, i) for i in open_ if regressors[i].group not in taken]
        for i in members:
            if regressors[i].kind != FREE:
                without = tuple(j for j in members if j != i)
                found.append(without)
                found += [(*without, other) for other in groups[regressors[i].group] if other != i]
        return [each for each in found if fits(each)]

    def swaps(members: tuple[int, ...]) -> list[tuple[int, ...]]:
        return [
            other
            for i in members
            if regressors[i].kind != FREE
            for other in neighbours(tuple(j for j in members if j != i))
            if len(other) == len(members)
        ]

    weigh([free])
    weigh(neighbours(free))
    expanded: set[tuple[int, ...]] = {free}
    swapped: set[tuple[int, ...]] = set()
    while True:
        order = likeliest()
        least = known[order[0]] - reach.window
        best = [each for each in order[: reach.beam] if each not in expanded and known[each] > least]
        if best:
            expanded.update(best)
            weigh([other for each in best for other in neighbours(each)])
            continue
        # Of two that stand in for a third neither may be let go alone.
        best = [each for each in order[: reach.swapped] if each not in swapped]
        if not best:
            break
        swapped.update(best)
        weigh([other for each in best for other in swaps(each)])
    order = likeliest()
    least = known[order[0]] - reach.window
    return [each for each in order[: reach.kept] if known[each] > least]
