"""Sets of effects and suspects, weighed under one noise of the rows: P(effect) is a sum over the sets that hold it.

A set is what is in the model beside the user's own terms: columns of suspects and of effects. Corrections of the
simulation's coefficients are summed over within each set. All single columns and all pairs are weighed, and around the
best sets every neighbour (one more, one less, one other), until no better one is found: Occam's window (Madigan &
Raftery 1994, JASA 89:1535). Effects that show only together are found as the pair that they are.
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from math import log

import numpy as np

from bayes_greybox.discovery.suspects.channels import DELAY
from bayes_greybox.discovery.suspects.memory import Memory
from bayes_greybox.model.evidence import Spectrum, coefficients, marginal

from .evaluations import Evaluations, Parametric, one_pattern
from .inner_parameters import refine
from .ranges import limited, log_ranges, small
from .set_prior import SetPrior

PLAIN, RECALIBRATED, REST, MEMORY = "plain", "recalibrated", "rest", "memory"
"""What an explanation is beside its set: nothing, corrections alone, or a rest: a function of the states, or of what
they were before."""

WINDOW = 12.0
"""Sets more than so many nats below the best one are not looked at any further."""

BEAM, EXPANDED = 16, 5
"""Sets whose neighbours by one more or one less are weighed, and those whose neighbours by one other are."""

WEIGHED = 160
"""Sets whose corrections are summed over in full, at most."""

SEEDS = 2
"""Values of an inner parameter that take part in pairs: the best ones alone."""

TWO_SORTS = 0.5
"""Of the probability of a rest, the share of one that stands with the states; the other is a process in time's."""

REMEMBERS = {False: 0.5, True: 0.25}
"""Share of a memory in a rest that stands, in place of f; and in one in time, beside the process."""

SUSPECTS_AT_MOST = 2
"""More errors of the sensors at once are a story, not an explanation; those that are in every set count too."""

WITH_REST, FINALISTS = 24, 4
"""Sets whose evidence with a rest is taken at a common mode, and those whose is integrated, at most."""

SURE = 0.15
"""Standard error of a log evidence above which chains settle it, where chains may run."""

BENT = 3
"""Effects with an inner parameter whose grid is refined as if they were alone: the best of them."""


@dataclass(frozen=True)
class Explanation:
    """A set with what is beside it.

    Attributes:
        suspects: Columns of suspects.
        effects: Columns of effects.
        kind: `PLAIN`, `RECALIBRATED`, `REST` or `MEMORY`.
        log_weight: Log of prior times evidence.
        log_evidence: Without the prior.
        share_left: Share of the gap that the rest carries.
        memory: Columns of the elements of a `MEMORY`.
    """

    suspects: tuple[int, ...]
    effects: tuple[int, ...]
    kind: str
    log_weight: float
    log_evidence: float
    share_left: float = 0.0
    memory: tuple[int, ...] = ()

    @property
    def leaves_rest(self) -> bool:
        """Whether something without a name remains beside its columns."""
        return self.kind in (REST, MEMORY)

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
        self._rough: dict[tuple[int, ...], float] = {}
        self._full: dict[tuple[int, ...], Parametric] = {}
        self._refined: set[tuple[str, tuple[str, ...]]] = set()
        self._made: SetPrior | None = None

    def weigh(self, report: Callable[[str], None] = lambda text: None) -> list[Explanation]:
        """Explanations, likeliest first."""
        report("weighing sets of effects")
        self.likeliest()
        cores = self._siblings(self._near())
        found = self._plain(cores)
        if not self.in_time:
            report("weighing what is left beside them")
            found += self._with_rest(cores, found)
        found += self._with_memory(cores, found)
        return sorted(found, key=lambda e: -e.log_weight)

    def likeliest(self) -> tuple[int, ...]:
        """The likeliest set without a rest."""
        top = self._search()
        while self._refine(top[:BEAM]):
            top = self._search()
        return top[0]

    def probability(self, columns: Collection[int]) -> float:
        """Probability that one of these columns is in, among the sets that matter, corrections summed in full.

        Beside a force that remembers it may be its imitation.
        """
        cores = self._near()
        explanations = self._plain(cores)
        explanations += self._with_memory(cores, explanations)
        weight = np.exp(np.array([e.log_weight for e in explanations]) - max(e.log_weight for e in explanations))
        real = [(1 - imitated(e.share_left)) * bool(set(columns) & set(e.columns)) for e in explanations]
        return float(weight @ real / weight.sum())

    def parametric(self, columns: Sequence[int]) -> Parametric:
        """Evidence of a set without a rest, all patterns of corrections."""
        key = tuple(columns)
        if key not in self._full:
            self._full[key] = self.evaluations.parametric([key])[0]
        return self._full[key]

    # Which sets

    def _near(self) -> list[tuple[int, ...]]:
        """Sets within the window around the best one; those without an effect are always in the tables."""
        top = self._best()
        near = [c for c in top if self._rough_weight(c) > self._rough_weight(top[0]) - WINDOW][:WEIGHED]
        bare = [c for c in top if not self._parted(c)[1]][:BEAM]
        return list(dict.fromkeys([*near, (), *bare]))

    def _search(self) -> list[tuple[int, ...]]:
        effects, suspects = self._candidates()
        pool = [*suspects, *effects]
        self._screen([(), *((i,) for i in pool)])
        seeds = [*suspects, *self._seeds(effects)]
        # A sensor's error may hide which value of an inner parameter fits, so here all of them take part.
        self._screen(self._allowed(product(suspects, effects)))
        if self.most > 1:
            self._screen(self._allowed(combinations(seeds, 2)))
        before: tuple = ()
        while True:
            top = self._best()
            if tuple(top[:BEAM]) == before:
                return top
            before = tuple(top[:BEAM])
            fresh = {
                *((*core, i) for core in top[:BEAM] for i in seeds),
                *(tuple(j for j in core if j != i) for core in top[:BEAM] for i in core),
                *((*(j for j in core if j != i), k) for core in top[:EXPANDED] for i in core for k in seeds),
            }
            self._screen(self._allowed(fresh))

    def _candidates(self) -> tuple[list[int], list[int]]:
        late = any(self._is_delay(i) for i in self.always)
        every = [i for i in self.statistics.of_kind("suspect") if i not in self.always]
        suspects = [i for i in every if not (late and self._is_delay(i))]
        return self.statistics.of_kind("effect") if self.most else [], suspects

    def _seeds(self, effects: Sequence[int]) -> list[int]:
        groups: dict[str, list[int]] = {}
        for i in effects:
            groups.setdefault(self.evaluations.binding(i), []).append(i)
        best = [sorted(g, key=lambda i: -self._rough[(i,)])[:SEEDS] for g in groups.values()]
        return [i for group in best for i in group]

    def _allowed(self, cores: Iterable[Sequence[int]]) -> list[tuple[int, ...]]:
        kept = set()
        for core in cores:
            key = tuple(sorted(set(core)))
            effects = [i for i in key if self.statistics.columns[i].effect is not None]
            if (
                len(key) < len(core)
                or len(effects) > self.most
                or len(self.always) + len(key) - len(effects) > SUSPECTS_AT_MOST
            ):
                continue
            # Delays of several channels at once are a filter, and imitate whatever has a memory.
            delays = [i for i in (*self.always, *key) if i not in effects and self._is_delay(i)]
            if len({self.evaluations.binding(i) for i in effects}) == len(effects) and len(delays) <= 1:
                kept.add(key)
        return sorted(kept)

    def _is_delay(self, index: int) -> bool:
        suspect = self.statistics.columns[index].suspect
        return suspect is not None and suspect.kind == DELAY

    def _screen(self, cores: Sequence[tuple[int, ...]]) -> None:
        """Evidence with no correction and with all of them, which stand for the patterns in between."""
        fresh = [c for c in cores if c not in self._rough]
        statistics = self.statistics
        n_free, n_correction = len(statistics.of_kind("free")), len(statistics.of_kind("correction"))
        out = n_correction * np.log1p(-self.odds.correction)
        for size in sorted({len(c) for c in fresh}):
            batch = [c for c in fresh if len(c) == size]
            for start in range(0, len(batch), 2048):
                part = batch[start : start + 2048]
                indices = np.array([self.evaluations.indices((*self.always, *c)) for c in part], dtype=int)
                sd = np.array([c.sd for c in statistics.columns])[indices]
                scales = np.repeat(sd[:, None], 2 if n_correction else 1, axis=1)
                scales[:, 0, n_free : n_free + n_correction] = 0.0
                gram = statistics.products[indices[:, :, None], indices[:, None, :]][:, None]
                spectrum = Spectrum.of(
                    gram, statistics.with_target[indices][:, None], statistics.square, statistics.n_obs, scales
                )
                logs = marginal(spectrum, statistics.noise).log_evidence
                prior = np.array([out, np.log(-np.expm1(out))]) if n_correction else np.zeros(1)
                total = np.logaddexp.reduce(logs + prior, axis=1)
                suspected = np.array([c.suspect is not None for c in statistics.columns])[indices]
                if np.any(suspected):
                    products = gram[:, 0], statistics.with_target[indices], statistics.square, statistics.n_obs
                    total = np.where(small(*products, sd, suspected), total, -np.inf)
                for core, value in zip(part, total, strict=True):
                    self._rough[core] = float(value) + self.evaluations.inner_weight(core)

    def _rough_weight(self, core: tuple[int, ...]) -> float:
        return self._rough[core] + self.log_prior(core)

    def _best(self) -> list[tuple[int, ...]]:
        return sorted(self._rough, key=lambda c: -self._rough_weight(c))

    def _refine(self, cores: Sequence[tuple[int, ...]]) -> bool:
        """Refine the grids over inner parameters that matter, each once beside the same others; whether any was."""
        best, columns = self._rough_weight(cores[0]), self.statistics.columns
        # On a coarse grid an effect may need others to be bent right, so the best ones are tried alone too.
        bent = [i for i in self._candidates()[0] if columns[i].inner]
        alone = sorted(bent, key=lambda i: -self._rough.get((i,), -np.inf))[:BENT]
        pairs = [c for c in self._rough if len(c) == 2 and c[0] not in bent and c[1] in bent]
        beside = sorted(pairs, key=lambda c: -self._rough_weight(c))[:BENT]
        wanted = [(i,) for i in alone] + beside + [core for core in cores if self._rough_weight(core) > best - 6.0]
        before = len(columns)
        for core in wanted:
            for i in core:
                others = tuple(sorted(self._label(j) for j in core if j != i))
                if columns[i].inner and (self._label(i), others) not in self._refined:
                    self._refined.add((self._label(i), others))
                    refine(self.evaluations, (*self.always, *(j for j in core if j != i)), self.evaluations.group(i))
        if len(columns) > before:
            # Weights of old values changed with the new ones.
            self._rough.clear()
            self._full.clear()
        return len(self.statistics.columns) > before

    def _label(self, index: int) -> str:
        suspect = self.statistics.columns[index].suspect
        return suspect.key if suspect is not None else self.evaluations.binding(index)

    def _siblings(self, cores: Sequence[tuple[int, ...]]) -> list[tuple[int, ...]]:
        """These sets, and those with other values of their inner parameters, which P(effect) is summed over."""
        found = list(cores)
        for core in cores[:BEAM]:
            for i in core:
                if self.statistics.columns[i].inner:
                    rest = tuple(j for j in core if j != i)
                    found += [tuple(sorted((*rest, k))) for k in self.evaluations.group(i)]
        return list(dict.fromkeys(found))

    # How likely

    def log_prior(self, core: Sequence[int]) -> float:
        """Log prior of a set: of its suspects, of its number of effects, and of these among all of as many."""
        return self._prior.log(core)

    @property
    def _prior(self) -> SetPrior:
        """What `log_prior` is made of; made again where columns were added."""
        if self._made is None or self._made.n_column != len(self.statistics.columns):
            self._made = SetPrior.of(self.evaluations, self.most, self.always)
        return self._made

    def _sum_patterns(self, cores: Sequence[tuple[int, ...]]) -> None:
        keys = [(*self.always, *c) for c in cores]
        for size in sorted({len(k) for k in keys}):
            batch = [k for k in keys if len(k) == size and k not in self._full]
            for key, found in zip(batch, self.evaluations.parametric(batch), strict=True):
                self._full[key] = found

    def _plain(self, cores: Sequence[tuple[int, ...]]) -> list[Explanation]:
        """Explanations without a rest, corrections summed in full."""
        self._sum_patterns(cores)
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
                weight = fitted.all + ranges + prior + self._log_rest(core, PLAIN)
                found.append(Explanation(suspects, (), PLAIN, weight, fitted.all))
            else:
                found.append(
                    Explanation(suspects, (), PLAIN, fitted.none + ranges + prior + log(odds.no_gap), fitted.none)
                )
                if self.statistics.of_kind("correction"):
                    weight = fitted.some + ranges + prior + log(odds.recalibrate)
                    found.append(Explanation(suspects, (), RECALIBRATED, weight, fitted.some))
        return found

    def _parted(self, core: Sequence[int]) -> tuple[tuple[int, ...], tuple[int, ...]]:
        columns = self.statistics.columns
        suspects = tuple(i for i in core if columns[i].suspect is not None)
        return (*self.always, *suspects), tuple(i for i in core if columns[i].effect is not None)

    def _ranges(self, core: Sequence[int]) -> float:
        """What signs of effects and limits of suspects add; see `log_ranges`."""
        key = (*self.always, *core)
        columns = [self.statistics.columns[i] for i in key]
        if not any(limited(column) for column in columns):
            return 0.0
        fitted = self._full[key]
        mean, covariance = coefficients(*one_pattern(fitted, int(np.argmax(fitted.by_pattern))))
        start = len(mean) - len(key)
        return log_ranges(columns, mean[start:], covariance[start:, start:])

    def _with_rest(self, cores: Sequence[tuple[int, ...]], plain: Sequence[Explanation]) -> list[Explanation]:
        """Explanations with f beside the set: at the mode that f has beside the user's own terms, then in full."""
        known = self.evaluations
        weight, best = self._likely(cores, plain)
        common = known.integrated(self.always)
        gain = common.log_evidence - known.evaluator.at(known.with_features(self.always), common.mode)
        at_mode = {
            c: gain + known.evaluator.at(known.with_features((*self.always, *c)), common.mode) + known.inner_weight(c)
            for c in best
        }
        prior = {c: self.log_prior(c) + self._log_rest(c, REST) for c in best}
        finalists = [(), *sorted(best, key=lambda c: -(at_mode[c] + prior[c]))[:FINALISTS]]
        finalists += sorted(best, key=lambda c: -weight.get(c, -np.inf))[:FINALISTS]
        top = max([*(e.log_weight for e in plain), *(at_mode[c] + prior[c] for c in best)])
        found = []
        for c in best:
            value, share = at_mode[c], np.nan
            close = max(weight.get(c, -np.inf), at_mode[c] + prior[c]) > top - WINDOW
            if c == () or (c in finalists and close):
                integrated = known.settled((*self.always, *c), SURE) if close else known.integrated((*self.always, *c))
                value = integrated.log_evidence + known.inner_weight(c)
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
            if (memory := statistics.columns[i].memory) is not None:
                groups.setdefault(memory, []).append(i)
        best = self._likely(cores, plain)[1]
        self._sum_patterns([(*c, *group) for c in best for group in groups.values()])
        found = []
        for c, group in product(best, map(tuple, groups.values())):
            fitted = self._full[(*self.always, *c, *group)]
            value = fitted.all + self._ranges((*c, *group))
            prior = self.log_prior(c) + self._log_rest(c, MEMORY) - log(len(groups))
            share = known.carried(fitted, group)
            found.append(Explanation(*self._parted(c), MEMORY, value + prior, value, share, group))
        return found

    def _likely(
        self, cores: Sequence[tuple[int, ...]], plain: Sequence[Explanation]
    ) -> tuple[dict[tuple[int, ...], float], list[tuple[int, ...]]]:
        """Log weights of sets without a rest, and the sets that are weighed with one."""
        weight = {tuple(sorted(set(e.columns) - set(self.always))): e.log_weight for e in reversed(plain)}
        best = sorted(cores, key=lambda c: -weight.get(c, -np.inf))[:WITH_REST]
        # Beside the likeliest suspects without effects, and beside the likeliest sets
        bare = [c for c in best if not self._parted(c)[1]][:2]
        return weight, list(dict.fromkeys([(), *bare, *best]))

    def _log_rest(self, core: Sequence[int], kind: str) -> float:
        """Log prior of a rest of one sort beside a set."""
        share = TWO_SORTS * (self.odds.remainder if self._parted(core)[1] else self.odds.unknown)
        remembers = REMEMBERS[self.in_time] if self.statistics.of_kind("memory") else 0.0
        return log(share * (remembers if kind == MEMORY else 1 - remembers))
