"""Which sets of effects and suspects are weighed: those near the likeliest one, found by screening and neighbours.

All single columns and all pairs are screened, and around the best sets every neighbour (one more, one less, one other),
until no better one is found: Occam's window (Madigan & Raftery 1994, JASA 89:1535). Grids over inner parameters are
refined on the way. Effects that show only together are found as the pair that they are.
"""

from collections.abc import Iterable, Sequence
from itertools import combinations, product

import numpy as np

from bayes_greybox.discovery.evidence.evaluations import Evaluations
from bayes_greybox.discovery.evidence.inner_parameters import refine
from bayes_greybox.discovery.evidence.ranges import small
from bayes_greybox.discovery.evidence.ties import ranked
from bayes_greybox.discovery.suspects.channels import DELAY
from bayes_greybox.model.estimate.evidence import Spectrum, marginal

from .set_prior import SetPrior

WINDOW = 12.0
"""Sets more than so many nats below the best one are not looked at any further."""

BEAM, EXPANDED = 16, 5
"""Sets whose neighbours by one more or one less are weighed, and those whose neighbours by one other are."""

WEIGHED = 160
"""Sets whose corrections are summed over in full, at most."""

SEEDS = 2
"""Values of an inner parameter that take part in pairs: the best ones alone."""

SUSPECTS_AT_MOST = 2
"""More errors of the sensors at once are a story, not an explanation; those that are in every set count too."""

BENT = 3
"""Effects with an inner parameter whose grid is refined as if they were alone: the best of them."""


class Search:
    """The sets that matter under one noise, by their evidence without a rest.

    Args:
        evaluations: Evidence of sets of columns.
        most: Largest number of effects in a set.
        always: Suspects that are in every set, and named in none.

    Attributes:
        version: Goes up whenever columns of an inner parameter, and with them the weights of others, change.
    """

    def __init__(self, evaluations: Evaluations, most: int, always: Sequence[int] = ()) -> None:
        self.evaluations, self.statistics, self.odds = evaluations, evaluations.statistics, evaluations.odds
        self.most, self.always = most, tuple(always)
        self._rough: dict[tuple[int, ...], float] = {}
        self._refined: set[tuple[str, tuple[str, ...]]] = set()
        self._made: SetPrior | None = None
        self._priors: dict[tuple[int, ...], float] = {}
        self.version = 0

    def likeliest(self) -> tuple[int, ...]:
        """The likeliest set without a rest."""
        top = self._search()
        while self._refine(top[:BEAM]):
            top = self._search()
        return top[0]

    def near(self) -> list[tuple[int, ...]]:
        """Sets within the window around the best one; those without an effect are always in the tables."""
        weights, columns = self._weights(), self.statistics.columns
        top = list(weights)
        near = [c for c in top if weights[c] > weights[top[0]] - WINDOW][:WEIGHED]
        bare = [c for c in top if not any(columns[i].effect is not None for i in c)][:BEAM]
        return list(dict.fromkeys([*near, (), *bare]))

    def siblings(self, cores: Sequence[tuple[int, ...]]) -> list[tuple[int, ...]]:
        """These sets, and those with other values of their inner parameters, which P(effect) is summed over."""
        found = list(cores)
        for core in cores[:BEAM]:
            for i in core:
                if self.statistics.columns[i].inner:
                    rest = tuple(j for j in core if j != i)
                    found += [tuple(sorted((*rest, k))) for k in self.evaluations.group(i)]
        return list(dict.fromkeys(found))

    def forget(self) -> None:
        """Weights of columns have changed: sets are screened anew."""
        self._rough.clear()
        self.version += 1

    def log_prior(self, core: Sequence[int]) -> float:
        """Log prior of a set: of its suspects, of its number of effects, and of these among all of as many."""
        core = tuple(core)
        if self._made is None or self._made.n_column != len(self.statistics.columns):
            self._made, self._priors = SetPrior.of(self.evaluations, self.most, self.always), {}
        if core not in self._priors:
            self._priors[core] = self._made.log(core)
        return self._priors[core]

    def weight(self, core: tuple[int, ...]) -> float:
        """Log prior times evidence of a set that was screened, corrections roughly summed."""
        return self._rough[core] + self.log_prior(core)

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
            top = list(self._weights())
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
            groups.setdefault(self._label(i), []).append(i)
        best = [ranked(g, lambda i: self._rough[(i,)])[:SEEDS] for g in groups.values()]
        return [i for group in best for i in group]

    def _allowed(self, cores: Iterable[Sequence[int]]) -> list[tuple[int, ...]]:
        """Those of these sets that may be, but for what was screened before."""
        kept = set()
        # Thousands of sets of a few columns: what is asked of each column is found once.
        binding = {i: c.effect.label for i, c in enumerate(self.statistics.columns) if c.effect is not None}
        late = {i for i in range(len(self.statistics.columns)) if self._is_delay(i)}
        for core in cores:
            key = tuple(sorted(set(core)))
            if key in kept or key in self._rough:
                continue
            effects = [i for i in key if i in binding]
            if (
                len(key) < len(core)
                or len(effects) > self.most
                or len(self.always) + len(key) - len(effects) > SUSPECTS_AT_MOST
            ):
                continue
            # Delays of several channels at once are a filter, and imitate whatever has a memory.
            delays = late.intersection((*self.always, *key))
            if len({binding[i] for i in effects}) == len(effects) and len(delays) <= 1:
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
        first = self.evaluations.indices(self.always)
        out = n_correction * np.log1p(-self.odds.correction)
        for size in sorted({len(c) for c in fresh}):
            batch = [c for c in fresh if len(c) == size]
            for start in range(0, len(batch), 2048):
                part = batch[start : start + 2048]
                indices = np.array([[*first, *c] for c in part], dtype=int).reshape(len(part), -1)
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

    def _weights(self) -> dict[tuple[int, ...], float]:
        """`weight` of all sets that were screened, the likeliest first: they are thousands."""
        self.log_prior(())
        known = self._priors
        found = {c: rough + (known[c] if c in known else self.log_prior(c)) for c, rough in self._rough.items()}
        return dict(ranked(sorted(found.items()), lambda item: item[1]))

    def _refine(self, cores: Sequence[tuple[int, ...]]) -> bool:
        """Refine the grids over inner parameters that matter, each once beside the same others; whether any was."""
        weights, columns = self._weights(), self.statistics.columns
        # On a coarse grid an effect may need others to be bent right, so the best ones are tried alone too.
        bent = [i for i in self._candidates()[0] if columns[i].inner]
        alone = ranked(bent, lambda i: self._rough.get((i,), -np.inf))[:BENT]
        pairs = [c for c in self._rough if len(c) == 2 and c[0] not in bent and c[1] in bent]
        paired = ranked(pairs, lambda c: weights[c])[:BENT]
        wanted = [(i,) for i in alone] + paired + [core for core in cores if weights[core] > weights[cores[0]] - 6.0]
        before = [column.log_weight for column in columns]
        for core in wanted:
            # Of this set with the suspects that are in every one, where it would be as likely as the best.
            level = weights[cores[0]] - self.log_prior(core)
            for i in core:
                others = tuple(sorted(self._label(j) for j in core if j != i))
                if columns[i].inner and (self._label(i), others) not in self._refined:
                    self._refined.add((self._label(i), others))
                    beside = (*self.always, *(j for j in core if j != i))
                    refine(self.evaluations, beside, self.evaluations.group(i), level)
        # Weights of old values change with new ones, whether these bring columns of their own or not.
        changed = [column.log_weight for column in self.statistics.columns] != before
        if changed:
            self.forget()
        return changed

    def _label(self, index: int) -> str:
        suspect = self.statistics.columns[index].suspect
        return suspect.key if suspect is not None else self.evaluations.binding(index)
