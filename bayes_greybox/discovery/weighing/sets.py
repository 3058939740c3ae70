"""Sets of effects and suspects, weighed under one noise of the rows: P(effect) is a sum over the sets that hold it.

A set is what is in the model beside the user's own terms: columns of suspects and of effects. Corrections of the
simulation's coefficients are summed over within each set. Which sets are weighed is the `search`'s.
"""

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, islice, product
from math import log
from typing import NamedTuple

import numpy as np

from bayes_greybox.discovery.evidence.evaluations import TOGETHER, Evaluations, Parametric, one_pattern
from bayes_greybox.discovery.evidence.inner_parameters import refine
from bayes_greybox.discovery.evidence.ranges import limited, log_ranges
from bayes_greybox.discovery.evidence.ties import first_of_best, ranked
from bayes_greybox.discovery.suspects.memory import Memory
from bayes_greybox.model.estimate.evidence import coefficients

from .laws import Laws
from .search import WINDOW, Search

PLAIN, RECALIBRATED, REST, MEMORY, LAWFUL = "plain", "recalibrated", "rest", "memory", "lawful"
"""What an explanation is beside its set: nothing, corrections alone, or a rest: a function of the states, one of what
they were before, or a law next to one of the catalogue's."""

TWO_SORTS = 0.5
"""Of the probability of a rest, the share of one that stands with the states; the other is a process in time's."""

OTHER_LAWS = 0.25
"""Prior of all laws next to an effect's together, over that of the effect: a catalogue has what is usual."""

REMEMBERS = {False: 0.5, True: 0.25}
"""Share of a memory in a rest that stands, in place of f; and in one in time, beside the process."""

WITH_REST, FINALISTS = 24, 4
"""Sets whose evidence with a rest is taken at a common mode, and those whose is integrated, at most."""

TOLD = 6
"""Likeliest sets beside which inner parameters of laws are refined; beside others they have the values they have."""

SURE = 0.15
"""Standard error of a log evidence above which chains settle it, where chains may run."""


@dataclass(frozen=True)
class Explanation:
    """A set with what is beside it.

    Attributes:
        suspects: Columns of suspects.
        effects: Columns of effects.
        kind: `PLAIN`, `RECALIBRATED`, `REST`, `MEMORY` or `LAWFUL`.
        log_weight: Log of prior times evidence.
        log_evidence: Without the prior.
        share_left: Share of the gap that the rest carries.
        memory: Columns of the elements of a `MEMORY`, or that of the law.
        remembers: Probability that a `MEMORY` is one, and not a force that nobody measured; see `told`.
    """

    suspects: tuple[int, ...]
    effects: tuple[int, ...]
    kind: str
    log_weight: float
    log_evidence: float
    share_left: float = 0.0
    memory: tuple[int, ...] = ()
    remembers: float = 1.0

    @property
    def leaves_rest(self) -> bool:
        """Whether something without a name remains beside its columns."""
        return self.kind in (REST, MEMORY, LAWFUL)

    @property
    def columns(self) -> tuple[int, ...]:
        """Suspects, then effects."""
        return (*self.suspects, *self.effects)


def imitated(share: float) -> float:
    """Probability that what stands beside a rest is only its imitation: √s, the rest's RMS over that of the gap.

    Args:
        share: s, the share of the gap's square that the rest carries.
    """
    return float(np.sqrt(share))


class Sets:
    """The sets under one noise.

    Args:
        evaluations: Evidence of sets of columns.
        most: Largest number of effects in a set.
        in_time: Whether the noise holds a process in time: then every explanation leaves a rest.
        always: Suspects that are in every set.
    """

    def __init__(self, evaluations: Evaluations, most: int, in_time: bool = False, always: Sequence[int] = ()) -> None:
        self.evaluations, self.statistics, self.odds = evaluations, evaluations.statistics, evaluations.odds
        self.most, self.in_time, self.always = most, in_time, tuple(always)
        self.search, self.laws = Search(evaluations, most, self.always), Laws(evaluations, self.always)
        self._full: dict[tuple[int, ...], Parametric] = {}
        self._version = 0

    def weigh(self, report: Callable[[str], None] = lambda text: None) -> list[Explanation]:
        """Explanations, likeliest first."""
        report("weighing sets of effects")
        self.likeliest()
        cores = self.search.siblings(self.search.near())
        found = self._plain(cores)
        if not self.in_time:
            report("weighing what is left beside them")
            found += self._with_rest(cores, found)
        found += self._with_memory(cores, found) + self._with_laws(found)
        return ranked(found, lambda e: e.log_weight)

    def likeliest(self) -> tuple[int, ...]:
        """The likeliest set without a rest."""
        return self.search.likeliest()

    def log_prior(self, core: Sequence[int]) -> float:
        """Log prior of a set: of its suspects, of its number of effects, and of these among all of as many."""
        return self.search.log_prior(core)

    def log_beside(self, core: Sequence[int]) -> float:
        """Log prior that nothing but corrections stands beside a set, or under a process in time that alone.

        Args:
            core: Columns of the set.
        """
        if self.in_time:
            return self._log_rest(core, PLAIN)
        odds = self.odds
        return log(1 - odds.remainder) if self._parted(core)[1] else log(odds.no_gap + odds.recalibrate)

    def probability(self, columns: Collection[int]) -> float:
        """Probability that one of these columns is in, among the sets that matter, corrections summed in full.

        Beside a force that remembers it may be its imitation.
        """
        cores = self.search.near()
        explanations = self._plain(cores)
        explanations += self._with_memory(cores, explanations) + self._with_laws(explanations)
        weight = np.exp(np.array([e.log_weight for e in explanations]) - max(e.log_weight for e in explanations))
        real = [(1 - imitated(e.share_left)) * bool(set(columns) & set(e.columns)) for e in explanations]
        return float(weight @ real / weight.sum())

    def refine(self, core: Sequence[int]) -> None:
        """Refine the values of inner parameters of a set as the search does those of the likeliest."""
        columns = self.statistics.columns
        before = [column.log_weight for column in columns]
        for i in core:
            if columns[i].inner:
                refine(self.evaluations, (*self.always, *(j for j in core if j != i)), self.evaluations.group(i))
        if [column.log_weight for column in columns] != before:
            self.reweigh()

    def reweigh(self) -> None:
        """Weights of columns have changed: evidences of sets are found anew."""
        self.search.forget()

    def parametric(self, columns: Sequence[int]) -> Parametric:
        """Evidence of a set without a rest, all patterns of corrections."""
        return self.each_parametric([columns])[0]

    def each_parametric(self, sets: Sequence[Sequence[int]]) -> list[Parametric]:
        """`parametric` of several sets."""
        self._sum_patterns(sets)
        return [self._full[tuple(columns)] for columns in sets]

    def _sum_patterns(self, sets: Sequence[Sequence[int]]) -> None:
        """Evidence of sets, those that are in every one named too, all patterns of corrections."""
        if self._version != self.search.version:
            # Weights of values of an inner parameter change with their number.
            self._full.clear()
            self._version = self.search.version
        fresh = [key for key in dict.fromkeys(map(tuple, sets)) if key not in self._full]
        self._full |= zip(fresh, self.evaluations.each_parametric(fresh), strict=True)

    def _plain(self, cores: Sequence[tuple[int, ...]]) -> list[Explanation]:
        """Explanations without a rest, corrections summed in full."""
        self._sum_patterns([(*self.always, *c) for c in cores])
        found = []
        odds = self.odds
        for core in cores:
            suspects, effects = self._parted(core)
            fitted, prior = self._full[(*self.always, *core)], self.log_prior(core)
            ranges = self._ranges(core)
            if effects:
                rest = self._log_rest(core, PLAIN) if self.in_time else log(1 - odds.remainder)
                value = fitted.all + ranges
                found.append(Explanation(suspects, effects, PLAIN, value + prior + rest, value))
            elif self.in_time:
                value = fitted.all + ranges
                found.append(Explanation(suspects, (), PLAIN, value + prior + self._log_rest(core, PLAIN), value))
            else:
                none, some = fitted.none + ranges, fitted.some + ranges
                found.append(Explanation(suspects, (), PLAIN, none + prior + log(odds.no_gap), none))
                if self.statistics.of_kind("correction"):
                    found.append(Explanation(suspects, (), RECALIBRATED, some + prior + log(odds.recalibrate), some))
        return found

    def _parted(self, core: Sequence[int]) -> tuple[tuple[int, ...], tuple[int, ...]]:
        columns = self.statistics.columns
        suspects = tuple(i for i in core if columns[i].suspect is not None)
        return (*self.always, *suspects), tuple(i for i in core if columns[i].effect is not None)

    def _ranges(self, core: Sequence[int], fitted: Parametric | None = None) -> float:
        """What signs of effects and limits of suspects add; see `log_ranges`."""
        key = (*self.always, *core)
        columns = [self.statistics.columns[i] for i in key]
        if not any(limited(column) for column in columns):
            return 0.0
        fitted = self._full[key] if fitted is None else fitted
        mean, covariance = coefficients(*one_pattern(fitted, int(np.argmax(fitted.by_pattern))))
        start = len(mean) - len(key)
        return log_ranges(columns, mean[start:], covariance[start:, start:])

    def _with_rest(self, cores: Sequence[tuple[int, ...]], plain: Sequence[Explanation]) -> list[Explanation]:
        """Explanations with f beside the set: at the mode that f has beside the user's own terms, then in full."""
        known = self.evaluations
        weight, best, others = self._likely(cores, plain)
        common = known.integrated(self.always)
        gain = common.log_evidence - known.evaluator.at(known.with_features(self.always), common.mode)
        at_mode = {
            # What a column gains on rows near itself f has for the most part taken up already.
            c: gain
            + known.evaluator.at(known.with_features((*self.always, *c)), common.mode)
            + known.inner_weight(c, gains=False)
            + others[c]
            for c in best
        }
        prior = {c: self.log_prior(c) + self._log_rest(c, REST) for c in best}
        finalists = [(), *ranked(best, lambda c: at_mode[c] + prior[c])[:FINALISTS]]
        finalists += ranked(best, lambda c: weight.get(c, -np.inf))[:FINALISTS]
        top = max([*(e.log_weight for e in plain), *(at_mode[c] + prior[c] for c in best)])
        found = []
        for c in best:
            value, share = at_mode[c], np.nan
            close = max(weight.get(c, -np.inf), at_mode[c] + prior[c]) > top - WINDOW
            if c == () or (c in finalists and close):
                integrated = known.settled((*self.always, *c), SURE) if close else known.integrated((*self.always, *c))
                value = integrated.log_evidence + known.inner_weight(c, gains=False) + others[c]
                share = known.share((*self.always, *c), integrated)
            suspects, effects = self._parted(c)
            ranges = self._ranges(c)
            found.append(Explanation(suspects, effects, REST, value + ranges + prior[c], value + ranges, share))
        known_share = [e.share_left for e in found if np.isfinite(e.share_left)]
        return [e if np.isfinite(e.share_left) else replace(e, share_left=max(known_share)) for e in found]

    def _with_memory(self, cores: Sequence[tuple[int, ...]], plain: Sequence[Explanation]) -> list[Explanation]:
        """Explanations with a force beside the set that remembers what a channel did."""
        known, statistics = self.evaluations, self.statistics
        groups: dict[Memory, list[int]] = {}
        for i in statistics.of_kind("memory"):
            # Those that are behind are no explanations: see `told`.
            if (memory := statistics.columns[i].memory) is not None and not memory.behind:
                groups.setdefault(memory, []).append(i)
        _, best, others = self._likely(cores, plain)
        self._sum_patterns([(*self.always, *c, *group) for c in best for group in groups.values()])
        found = []
        # Each memory has the same prior, in whatever number of ways its elements are taken together.
        ways = Counter(memory.text for memory in groups)
        for c, (memory, members) in product(best, groups.items()):
            group = tuple(members)
            fitted = self._full[(*self.always, *c, *group)]
            value = fitted.all + self._ranges((*c, *group)) + others[c]
            prior = self.log_prior(c) + self._log_rest(c, MEMORY) - log(len(ways) * ways[memory.text])
            share = known.carried(fitted, group)
            found.append(Explanation(*self._parted(c), MEMORY, value + prior, value, share, group))
        return found

    def _with_laws(self, plain: Sequence[Explanation]) -> list[Explanation]:
        """Explanations in which a law that is in no catalogue stands in the place of its neighbour's, or of two's."""
        # However well f does beside them: it takes what a law leaves that is nearly right.
        named = ranked((e for e in plain if e.kind == PLAIN and e.effects), lambda e: e.log_weight)[:WITH_REST]
        named = [e for e in named if e.log_weight > named[0].log_weight - WINDOW]
        # A law has inner parameters of its own: it stands in the place of all values of an effect's, once.
        columns = self.statistics.columns
        places: dict[tuple, tuple[tuple[int, ...], tuple[int, ...]]] = {}
        for e in named:
            core = tuple(i for i in e.columns if i not in self.always)
            for replaced in [*((i,) for i in e.effects), *combinations(e.effects, 2)]:
                others = tuple(j for j in core if j not in replaced)
                places.setdefault((others, *(columns[j].called for j in replaced)), (others, replaced))
        # Columns that are new change the number of all sets, and values that are new the weights of the old ones: the
        # last of both come before the first evidence.
        told = 0
        for others, replaced in places.values():
            told += told < TOLD and self.laws.tell(others, replaced)
        weighed = [_Place(*place, self.laws.nameless(*place[1])) for place in places.values()]
        found = [e for some in _batches(weighed) for e in self._lawful(some)]
        return list({(e.columns, e.memory): e for e in sorted(found, key=lambda e: e.log_weight)}.values())

    def _lawful(self, weighed: Sequence["_Place"]) -> list[Explanation]:
        """Explanations with laws at these places."""
        # Not by `_sum_patterns`: weights of a law's values change whenever it is told beside others.
        values = [(*self.always, *others, i) for others, _, laws in weighed for law in laws for i in law]
        every = iter(self.evaluations.each_parametric(values))
        found = []
        for others, replaced, laws in weighed:
            # One law in the place of two is as likely beforehand as a neighbour of either alone.
            alike = (*others, replaced[0])
            prior = self.log_prior(alike) + self.log_beside(alike) + log(OTHER_LAWS / max(len(laws), 1))
            suspects, effects = self._parted(others)
            for law in laws:
                fitted = list(islice(every, len(law)))
                best = first_of_best([each.all for each in fitted])
                own = (*others, law[best])
                value = float(np.logaddexp.reduce([each.all for each in fitted])) + self._ranges(own, fitted[best])
                share = self.evaluations.carried(fitted[best], own[-1:])
                found.append(Explanation(suspects, effects, LAWFUL, value + prior, value, share, own[-1:]))
        return found

    def _likely(
        self, cores: Sequence[tuple[int, ...]], plain: Sequence[Explanation]
    ) -> tuple[dict[tuple[int, ...], float], list[tuple[int, ...]], dict[tuple[int, ...], float]]:
        """Log weights of sets without a rest, sets that are weighed with one, and what these stand for beside.

        Where inner parameters have many values, some stand for all: the log of the weight of all values over that of
        those that are weighed is added to each.
        """
        weight = {tuple(sorted(set(e.columns) - set(self.always))): e.log_weight for e in reversed(plain)}
        order = ranked(cores, lambda c: weight.get(c, -np.inf))
        alike: dict[tuple[str, ...], list[tuple[int, ...]]] = {}
        for c in order:
            alike.setdefault(tuple(sorted(self.statistics.columns[i].called for i in c)), []).append(c)
        # The best values of the likeliest names first: many values of one would leave no place for another.
        leaders = [group[0] for group in alike.values()][: WITH_REST // 2]
        best = sorted(list(dict.fromkeys([*leaders, *order]))[:WITH_REST], key=order.index)
        # Beside the likeliest suspects without effects, and beside the likeliest sets
        bare = [c for c in best if not self._parted(c)[1]][:2]
        best = list(dict.fromkeys([(), *bare, *best]))
        others = dict.fromkeys(best, 0.0)
        for group in alike.values():
            if weighed := [c for c in group if c in others and c in weight]:
                every, some = (
                    float(np.logaddexp.reduce([weight[c] for c in each if c in weight])) for each in (group, weighed)
                )
                others |= dict.fromkeys(weighed, every - some)
        return weight, best, others

    def _log_rest(self, core: Sequence[int], kind: str) -> float:
        """Log prior of a rest of one sort beside a set."""
        share = TWO_SORTS * (self.odds.remainder if self._parted(core)[1] else self.odds.unknown)
        remembers = REMEMBERS[self.in_time] if self.statistics.of_kind("memory") else 0.0
        return log(share * (remembers if kind == MEMORY else 1 - remembers))


class _Place(NamedTuple):
    """Effects that a law can stand in the place of, beside other columns, and the values of each such law."""

    others: tuple[int, ...]
    replaced: tuple[int, ...]
    laws: Sequence[Sequence[int]]


def _batches(places: Sequence[_Place]) -> Iterator[list[_Place]]:
    """Places, as many at a time as have `TOGETHER` values of laws, or one: what is fitted to them is held no longer."""
    batch: list[_Place] = []
    count = 0
    for place in places:
        size = sum(len(law) for law in place.laws)
        if batch and count + size > TOGETHER:
            yield batch
            batch, count = [], 0
        batch.append(place)
        count += size
    if batch:
        yield batch
