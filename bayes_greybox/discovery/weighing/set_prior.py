"""Prior probability of a set of suspects and effects, from the odds that a study states."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import log

import numpy as np

from bayes_greybox.discovery.evidence.evaluations import Evaluations


@dataclass(frozen=True)
class SetPrior:
    """Log prior of a set, by its parts.

    Attributes:
        n_column: Columns when it was made.
        suspects: Columns of suspects that may be in or out.
        suspected, trusted: Log prior of one that is in, and of one that is out.
        by_size: Log prior of so many effects, over the sum of what sets of as many weigh by `ways`.
        ways: For each column of an effect, the log of the number of ways to bind its name to columns.
    """

    n_column: int
    suspects: frozenset[int]
    suspected: float
    trusted: float
    by_size: tuple[float, ...]
    ways: Mapping[int, float]

    @classmethod
    def of(cls, evaluations: Evaluations, most: int, always: Sequence[int]) -> "SetPrior":
        """Prior of the sets of these columns.

        Args:
            evaluations: Columns and odds.
            most: Largest number of effects in a set.
            always: Suspects that are in every set.
        """
        statistics, odds = evaluations.statistics, evaluations.odds
        bindings: dict[str, set[str]] = {}
        effects = statistics.of_kind("effect")
        for i in effects:
            bindings.setdefault(evaluations.name(i), set()).add(evaluations.binding(i))
        ways = [len(places) for places in bindings.values() for _ in places]
        sizes = np.array([odds.another**j for j in range(max(min(most, len(ways)), 1))])
        shares = np.log(sizes / sizes.sum()) + log(odds.effects)
        # Names share a size equally, and bindings their name: a set weighs Π 1/ways, and these add up to e_k, the k-th
        # elementary symmetric polynomial of 1/ways; without second places that is the number of sets.
        sums = np.zeros(min(most, len(ways)) + 1)
        sums[0] = 1.0
        for n in ways:
            # Π (1 + x/n), one factor after another: of hundreds of them expanded in full the last term overflows.
            sums[1:] += sums[:-1] / n
        by_size = [0.0, *(float(shares[k - 1]) - log(sums[k]) for k in range(1, len(sums)))]
        return cls(
            n_column=len(statistics.columns),
            suspects=frozenset(i for i in statistics.of_kind("suspect") if i not in always),
            suspected=log(odds.suspect),
            trusted=float(np.log1p(-odds.suspect)),
            by_size=tuple(by_size),
            ways={i: log(len(bindings[evaluations.name(i)])) for i in effects},
        )

    def log(self, core: Sequence[int]) -> float:
        """Log prior of a set: of its suspects, of its number of effects, and of these among all of as many."""
        inside = sum(1 for i in core if i in self.suspects)
        effects = [i for i in core if i in self.ways]
        total = inside * self.suspected + (len(self.suspects) - inside) * self.trusted
        return total + self.by_size[len(effects)] - sum(self.ways[i] for i in effects)
