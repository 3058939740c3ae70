"""The competing explanations of a gap, and their posterior probabilities given the effects already added."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .evaluations import Evaluations, Parametric
from .sufficient_statistics import nodes

FINALISTS = 6
"""Effects whose evidence with f is integrated in full; for the others the mode of the best is used as it is."""

REACH = 12.0
"""Log evidence without f below the best at which an effect is no longer a finalist on that account."""

SETTLED, SURE = 4.0, 0.15
"""Explanations within so many nats of the total are finalists; evidence with a standard error below the second is
settled by importance sampling alone."""

ZOOMS = 4
"""How often the grid over an inner parameter is refined around its best value."""

ZOOM_NODES = 9
"""Values of an inner parameter added at each refinement."""


@dataclass(frozen=True)
class Explanation:
    """One explanation in a round: columns that are in it beside the free ones, with and without f.

    Attributes:
        name: "no gap", "recalibrate", "unknown", "enough" (later rounds: what was added suffices), or a slug.
        candidate: Indices of the columns of the candidate, one for each value of its inner parameter; empty for none.
        log_weight: Log of prior times evidence, unnormalised.
        best: Index of the candidate's best column, or None.
        remainder: Probability that f remains under this explanation.
        share_left: Share of the gap's square that f carries, averaged over whether it remains.
        with_discrepancy: The effects beside which f was integrated, if it was.
        alone: Log evidence of an effect without f.
    """

    name: str
    candidate: tuple[int, ...]
    log_weight: float
    log_evidence: float
    best: int | None = None
    remainder: float = 0.0
    share_left: float = 0.0
    with_discrepancy: tuple[int, ...] | None = None
    alone: float = -np.inf


@dataclass(frozen=True)
class Round:
    """Posterior over explanations given the columns in `base`."""

    base: tuple[int, ...]
    explanations: tuple[Explanation, ...]

    def probabilities(self) -> dict[str, float]:
        """Posterior probability by name, largest first."""
        logs: dict[str, list[float]] = {}
        for e in self.explanations:
            logs.setdefault(e.name, []).append(e.log_weight)
        total = np.logaddexp.reduce([e.log_weight for e in self.explanations])
        values = {name: float(np.exp(np.logaddexp.reduce(logs[name]) - total)) for name in logs}
        return dict(sorted(values.items(), key=lambda item: -item[1]))

    def best(self, name: str) -> Explanation:
        """The likeliest explanation of that name."""
        return max((e for e in self.explanations if e.name == name), key=lambda e: e.log_weight)


@dataclass
class Contest:
    """Weighs explanations against each other.

    Attributes:
        evaluations: Evidence of sets of effects.
    """

    evaluations: Evaluations

    def round(self, base: Sequence[int] = ()) -> Round:
        """Posterior over explanations, given the effects of `base`.

        Args:
            base: Columns of effects already added.
        """
        base, known, odds = tuple(base), self.evaluations, self.evaluations.odds
        groups = self._groups(base)
        rough = {k: max(v.all for v in known.parametric([(*base, i) for i in g])) for k, g in groups.items()}
        for key in sorted(groups, key=lambda key: -rough[key])[:FINALISTS]:
            groups[key] = list(self.refine(base, groups[key]))
        bare = known.parametric([base])[0]
        if base:
            others = [Explanation("enough", (), bare.all, bare.all)]
            prior = {"enough": 1 - odds.another - odds.unknown, "unknown": odds.unknown}
            share = odds.another
        else:
            others = [Explanation("no gap", (), bare.none, bare.none)]
            if known.statistics.of_kind("correction"):
                others.append(Explanation("recalibrate", (), bare.some, bare.some))
            prior = {"no gap": odds.no_gap, "recalibrate": odds.recalibrate, "unknown": odds.unknown}
            share = odds.effects
        names = [known.name(group[0]) for group in groups.values()]
        found = []
        for e in (*others, self._unknown(base, bare), *self._effects(base, groups)):
            # Effects share their prior by name, and a name by the ways to bind it to columns.
            weight = prior[e.name] if e.name in prior else share / len(set(names)) / names.count(e.name)
            found.append(replace(e, log_weight=e.log_weight + float(np.log(weight))))
        return Round(base, tuple(found))

    def refine(self, base: Sequence[int], group: Sequence[int]) -> tuple[int, ...]:
        """Refine the grid over an effect's inner parameter until its posterior spans several values.

        Args:
            base: Columns of the other effects.
            group: Columns of the effect.

        Returns:
            All columns of the effect, old and new.
        """
        statistics, group = self.evaluations.statistics, list(group)
        column = statistics.columns[group[0]]
        if not column.inner or column.effect is None:
            return tuple(group)
        (key,) = column.inner
        for _ in range(ZOOMS):
            values = np.array([statistics.columns[i].inner[key] for i in group])
            log_z = np.array([v.all for v in self.evaluations.parametric([(*base, i) for i in group])])
            posterior = np.exp(log_z - np.logaddexp.reduce(log_z))
            if np.max(posterior) < 0.5:
                break
            order = np.argsort(values)
            at = int(np.flatnonzero(order == int(np.argmax(posterior)))[0])
            low = values[order[max(at - 1, 0)]]
            high = values[order[min(at + 1, len(order) - 1)]]
            fresh = np.setdiff1d(np.geomspace(low, high, ZOOM_NODES + 2), values)
            if not len(fresh):
                # One value only: what the others do on these data, other columns do as well.
                break
            # New weights for old and new values together: each is the width of its cell under the prior.
            merged = np.sort(np.concatenate([values, fresh]))
            weights = {
                about["inner"][key]: about["log_weight"]
                for _, about in nodes(column.effect, statistics.rows.columns, merged)
            }
            for i in group:
                statistics.columns[i] = replace(
                    statistics.columns[i], log_weight=weights[statistics.columns[i].inner[key]]
                )
            new = [
                (t, {**about, "log_weight": weights[about["inner"][key]]})
                for t, about in nodes(column.effect, statistics.rows.columns, fresh)
            ]
            before = len(statistics.columns)
            statistics.add("effect", new)
            group += range(before, len(statistics.columns))
        return tuple(group)

    def settle(self, base: Sequence[int], seed: int) -> Round:
        """The round again, with the evidence of finalists by bridge sampling where importance sampling is not sure.

        Args:
            base: Columns of effects already added.
            seed: Seed of the chains.
        """
        found = self.round(base)
        total = np.logaddexp.reduce([e.log_weight for e in found.explanations])
        for e in found.explanations:
            if e.with_discrepancy is not None and e.log_weight > total - SETTLED:
                self.evaluations.bridged(e.with_discrepancy, SURE, seed)
        return self.round(base)

    def _groups(self, base: tuple[int, ...]) -> dict[str, list[int]]:
        """Columns by effect, of the effects that are not in `base`."""
        taken = {self.evaluations.binding(i) for i in base}
        groups: dict[str, list[int]] = {}
        for i in self.evaluations.statistics.of_kind("effect"):
            if self.evaluations.binding(i) not in taken:
                groups.setdefault(self.evaluations.binding(i), []).append(i)
        return groups

    def _unknown(self, base: tuple[int, ...], bare: Parametric) -> Explanation:
        """What is left is a function of the states, or hangs together in time: half the prior each."""
        known = self.evaluations
        f = known.integrated(base)
        of_states = f.log_evidence + known.inner_weight(base)
        either = float(np.logaddexp(of_states, bare.all + known.correlation(base)) - np.log(2))
        return Explanation("unknown", (), either, either, None, 1.0, known.share(base, f), base)

    def _effects(self, base: tuple[int, ...], groups: Mapping[str, list[int]]) -> list[Explanation]:
        """Explanations by one more effect: finalists in full, the others by the evidence at the mode of f alone."""
        known = self.evaluations
        candidates = [i for group in groups.values() for i in group]
        alone = dict(zip(candidates, known.parametric([(*base, i) for i in candidates]), strict=True))
        summed = {key: float(np.logaddexp.reduce([alone[i].all for i in group])) for key, group in groups.items()}
        # With f, at the mode that it has without any effect: the best value of an inner parameter, and their sum.
        f_bare = known.integrated(base)
        gain = f_bare.log_evidence - known.evaluator.at(known.with_features(base), f_bare.mode)
        at_mode = {i: gain + known.evaluator.at(known.with_features((*base, i)), f_bare.mode) for i in candidates}
        weighted = {i: at_mode[i] + known.inner_weight((*base, i)) for i in candidates}
        best_f = {key: max(group, key=lambda i: weighted[i]) for key, group in groups.items()}
        with_f = {key: float(np.logaddexp.reduce([weighted[i] for i in group])) for key, group in groups.items()}
        top = max(summed.values(), default=0.0)
        finalists = {*sorted(groups, key=lambda key: -with_f[key])[:FINALISTS]}
        finalists |= {k for k in sorted(groups, key=lambda key: -summed[key])[:FINALISTS] if summed[k] > top - REACH}
        found = []
        for key, group in groups.items():
            likeliest, index = max(group, key=lambda i: alone[i].all), best_f[key]
            remainder, share = with_f[key], np.nan
            if key in finalists:
                integrated = known.integrated((*base, index))
                # Other values of the inner parameter count relative to the best as they do at the common mode.
                remainder += integrated.log_evidence - at_mode[index]
                in_time = summed[key] + known.correlation((*base, likeliest))
                remainder = float(np.logaddexp(remainder, in_time) - np.log(2))
                share = known.share((*base, index), integrated)
            without = summed[key] + np.log1p(-known.odds.remainder)
            remainder += np.log(known.odds.remainder)
            both = float(np.logaddexp(without, remainder))
            p = float(np.exp(remainder - both))
            best = likeliest if without > remainder else index
            beside = (*base, index) if key in finalists else None
            found.append(
                Explanation(known.name(index), tuple(group), both, both, best, p, float(p * share), beside, summed[key])
            )
        return self._by_what_they_explain(found, alone)

    def _by_what_they_explain(self, found: list[Explanation], alone: Mapping[int, Parametric]) -> list[Explanation]:
        """Split the effects' evidence by what each explains alone, where f remains beside the best of them.

        With a flexible f beside every effect, and rows enough to pin it down, effects differ only in how easily f takes
        what they leave, not in how much that is. All of them together keep the evidence that they have.
        """
        top = max(found, key=lambda e: e.log_weight, default=None)
        if top is None or top.remainder < 0.5:
            return found
        total = np.logaddexp.reduce([e.log_weight for e in found])
        together = np.logaddexp.reduce([e.alone for e in found])
        split = []
        for e in found:
            best = max(e.candidate, key=lambda i: alone[i].all)
            weight = float(total + e.alone - together)
            split.append(replace(e, log_weight=weight, log_evidence=weight, best=best))
        return split
