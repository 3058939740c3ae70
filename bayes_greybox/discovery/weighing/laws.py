"""Columns of laws that are in no catalogue, next to an effect's or between two effects'.

A law with inner parameters is weighed as an effect is: summed over their values under the same prior, which are refined
where its own evidence is. Where it bends is not where the effect next to it does.
"""

from collections.abc import Callable, Sequence

import numpy as np

from bayes_greybox.discovery.evidence.columns import nodes
from bayes_greybox.discovery.evidence.evaluations import Evaluations
from bayes_greybox.discovery.evidence.inner_parameters import refine
from bayes_greybox.discovery.evidence.sufficient_statistics import PARALLEL
from bayes_greybox.discovery.suspects.memory import LAW, Memory
from bayes_greybox.physics.catalogue.effects import BoundEffect
from bayes_greybox.physics.catalogue.neighbours import bent, between, neighbours
from bayes_greybox.physics.terms import Term


class Laws:
    """Laws of one equation under one noise, each the columns of the values of its inner parameters.

    Args:
        evaluations: Evidence of sets; columns are added to its statistics.
        always: Suspects that are in every set.
    """

    def __init__(self, evaluations: Evaluations, always: Sequence[int] = ()) -> None:
        self.evaluations, self.statistics, self.always = evaluations, evaluations.statistics, tuple(always)
        self._refined: set[tuple[str, tuple[str, ...]]] = set()

    def next_to(self, *effects: int) -> tuple[tuple[int, ...], ...]:
        """Laws next to an effect's, or between two effects'.

        Args:
            effects: A column of it, or one of each.
        """
        each = [self.statistics.columns[i] for i in effects]
        terms = [c.term for c in each if c.term is not None and not c.term.states]
        if len(terms) < len(effects) or (len(effects) > 1 and any(c.inner for c in each)):
            return ()
        if each[0].inner and each[0].effect is not None:
            return tuple(filter(None, map(self._bent, bent(each[0].effect))))
        # What bends where an inner parameter says has no exponents, and its formula need not be read.
        columns = [c for c in self.statistics.columns if not c.inner and c.kind != "law"]
        weighed = [c.term for c in columns if c.term is not None]
        wanted = between(terms[0], terms[1], weighed) if len(terms) == 2 else neighbours(terms[0], weighed)
        return tuple(filter(None, (self._columns(term.text, lambda term=term: [(term, {})]) for term in wanted)))

    def tell(self, others: Sequence[int], effects: Sequence[int]) -> bool:
        """Refine the inner parameters of laws in the place of effects, beside others, once.

        Args:
            others: Columns of the set without the effects.
            effects: One or two.

        Returns:
            Whether there was anything to refine.
        """
        names = tuple(sorted(self.statistics.columns[j].called for j in others))
        fresh = False
        for law in self.next_to(*effects):
            first = self.statistics.columns[law[0]]
            if first.inner and (first.called, names) not in self._refined:
                self._refined.add((first.called, names))
                refine(self.evaluations, (*self.always, *others), law)
                fresh = True
        return fresh

    def nameless(self, *effects: int) -> list[tuple[int, ...]]:
        """Laws next to effects where they are none of the catalogue's: far from where it bends one may become another.

        Args:
            effects: One or two.
        """
        return [law for law in map(self._nameless, self.next_to(*effects)) if law]

    def _bent(self, law: BoundEffect) -> tuple[int, ...]:
        rows = self.statistics.rows
        return self._columns(law.text(), lambda: nodes(law, rows.columns, self.statistics.path, effect=None, law=law))

    def _columns(self, text: str, items: Callable[[], Sequence[tuple[Term, dict]]]) -> tuple[int, ...]:
        """Columns of a law, those that it has by now or new ones; none where they cannot be told from the model's."""
        columns, memory = self.statistics.columns, Memory(LAW, text)
        known = [i for i, c in enumerate(columns) if c.kind == "law" and c.memory == memory]
        if known:
            return tuple(known)
        before = len(columns)
        self.statistics.add("law", [(term, {**about, "memory": memory}) for term, about in items()])
        return tuple(range(before, len(self.statistics.columns)))

    def _nameless(self, law: tuple[int, ...]) -> tuple[int, ...]:
        statistics = self.statistics
        if not statistics.columns[law[0]].inner:
            return law
        named = [i for kind in ("free", "correction", "effect") for i in statistics.of_kind(kind)]
        size = np.diag(statistics.products)
        alike = statistics.products[np.ix_(law, named)] ** 2 > (1 - PARALLEL) * np.outer(size[list(law)], size[named])
        return tuple(i for i, same in zip(law, np.any(alike, axis=1), strict=True) if not same)
