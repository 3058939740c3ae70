"""The competing explanations of a gap, and their posterior probabilities given the effects already added."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bayes_greybox.inference.bridge import bridge
from bayes_greybox.inference.drift import drift_evidence
from bayes_greybox.inference.evidence import (
    IMPORTANCE_DRAWS,
    Evaluator,
    Integrated,
    Marginal,
    Spectrum,
    WithDiscrepancy,
    coefficients,
    marginal,
)

from .table import GapTable, nodes

MOST_PATTERNS = 64
"""Up to so many inclusion patterns of the simulation's own terms are summed; beyond, those with at most two terms."""

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
class Odds:
    """Prior probabilities of the explanations; stated in every result.

    Attributes:
        no_gap: Nothing is missing and every coefficient is right.
        recalibrate: Nothing is missing, but a coefficient of the simulation is off.
        unknown: Something is missing that the catalogue does not have: f alone.
        effects: One of the catalogue's effects is missing; shared equally between their names.
        another: In later rounds, one more effect is missing; `unknown` as above, and the rest says that the effects
            already added are all.
        correction: Beside an effect or f, each coefficient of the simulation is off.
        remainder: Beside an effect, f remains.
    """

    no_gap: float = 0.3
    recalibrate: float = 0.2
    unknown: float = 0.1
    effects: float = 0.4
    another: float = 0.3
    correction: float = 0.1
    remainder: float = 0.2


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
        with_discrepancy: The evidence with f, where it was integrated.
    """

    name: str
    candidate: tuple[int, ...]
    log_weight: float
    log_evidence: float
    best: int | None = None
    remainder: float = 0.0
    share_left: float = 0.0
    with_discrepancy: Integrated | None = None


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


class Coefficients(NamedTuple):
    """Posterior draws for a set of columns.

    Attributes:
        indices: Columns: free, corrections, effects.
        draws: Scaled coefficients [n_draw, n_column], exactly zero for corrections that are out.
        inner: For each draw, the index of the column that stands for each added effect [n_draw, n_effect].
        sigma: Noise SD, scaled [n_draw].
    """

    indices: tuple[int, ...]
    draws: Float[np.ndarray, "n_draw n_column"]
    inner: np.ndarray
    sigma: Float[np.ndarray, " n_draw"]


@dataclass
class Contest:
    """Evaluates explanations on one table; what was integrated once is remembered."""

    table: GapTable
    odds: Odds
    evaluator: Evaluator
    importance_draws: int = IMPORTANCE_DRAWS

    def __post_init__(self) -> None:
        self._with_f: dict[tuple[int, ...], Integrated] = {}
        self._drifts: dict[tuple[int, ...], float] = {}
        self._start: np.ndarray | None = None

    def round(self, base: Sequence[int] = ()) -> Round:
        """Posterior over explanations, given the effects of `base`.

        Args:
            base: Columns of effects already added.
        """
        base = tuple(base)
        groups = self._groups(base)
        rough = {k: max(v.all for v in self._parametric([(*base, i) for i in g])) for k, g in groups.items()}
        for key in sorted(groups, key=lambda key: -rough[key])[:FINALISTS]:
            groups[key] = list(self.refine(base, groups[key]))
        bare = self._parametric([base])[0]
        candidates = [i for group in groups.values() for i in group]
        alone = dict(zip(candidates, self._parametric([(*base, i) for i in candidates]), strict=True))
        f_bare = self._integrated(base)
        unknown = [self._explanation("unknown", base, (), bare, f_bare, only_f=True)]
        if base:
            others = [replace(self._explanation("enough", base, (), bare, None), log_weight=bare.all)]
            prior = {"enough": 1 - self.odds.another - self.odds.unknown, "unknown": self.odds.unknown}
            share = self.odds.another
        else:
            others = [
                Explanation("no gap", (), bare.none, bare.none),
                *([Explanation("recalibrate", (), bare.some, bare.some)] if self.table.of_kind("correction") else []),
            ]
            prior = {
                "no gap": self.odds.no_gap,
                "recalibrate": self.odds.recalibrate,
                "unknown": self.odds.unknown,
            }
            share = self.odds.effects
        bindings: dict[str, int] = {}
        for group in groups.values():
            bindings[self.name(group[0])] = bindings.get(self.name(group[0]), 0) + 1
        explained = self._effects(base, groups, alone, f_bare)
        found = []
        for e in (*others, *unknown, *explained):
            weight = prior.get(e.name) or share / len(bindings) / bindings[e.name]
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
        table, group = self.table, list(group)
        column = table.columns[group[0]]
        if not column.inner or column.effect is None:
            return tuple(group)
        (key,) = column.inner
        for _ in range(ZOOMS):
            values = np.array([table.columns[i].inner[key] for i in group])
            log_z = np.array([v.all for v in self._parametric([(*base, i) for i in group])])
            posterior = np.exp(log_z - np.logaddexp.reduce(log_z))
            if np.max(posterior) < 0.5:
                break
            order = np.argsort(values)
            at = int(np.flatnonzero(order == int(np.argmax(posterior)))[0])
            low = values[order[max(at - 1, 0)]]
            high = values[order[min(at + 1, len(order) - 1)]]
            fresh = np.setdiff1d(np.geomspace(low, high, ZOOM_NODES + 2), values)
            # New weights for old and new values together: each is the width of its cell under the prior.
            merged = np.sort(np.concatenate([values, fresh]))
            weights = {
                about["inner"][key]: about["log_weight"] for _, about in nodes(column.effect, table.data, merged)
            }
            for i in group:
                table.columns[i] = replace(table.columns[i], log_weight=weights[table.columns[i].inner[key]])
            new = [
                (t, {**about, "log_weight": weights[about["inner"][key]]})
                for t, about in nodes(column.effect, table.data, fresh)
            ]
            before = len(table.columns)
            table.add("effect", new)
            group += range(before, len(table.columns))
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
            effects = tuple(base) if e.best is None else (*base, e.best)
            integrated = self._with_f.get(effects)
            if integrated is None or e.log_weight < total - SETTLED or integrated.se < SURE:
                continue
            bridged = bridge(self.evaluator, self._with_features(effects), seed=seed)
            if bridged.se < integrated.se:
                self._with_f[effects] = integrated._replace(log_evidence=bridged.log_evidence, se=bridged.se)
        return self.round(base)

    def group(self, index: int) -> tuple[int, ...]:
        """All columns of the effect that a column belongs to."""
        return tuple(i for i in self.table.of_kind("effect") if self._binding(i) == self._binding(index))

    def plain(self) -> np.ndarray:
        """Coefficients of the free columns with nothing else in the model, scaled."""
        fitted = self._parametric([()])[0]
        return coefficients(*_one(fitted, 0))[0][: len(self.table.of_kind("free"))]

    def alone(self, index: int) -> tuple[float, float]:
        """Mean and standard deviation of one effect's scaled coefficient when it is the only one added."""
        fitted = self._parametric([(index,)])[0]
        pattern = int(np.argmax(fitted.by_pattern))
        mean, covariance = coefficients(*_one(fitted, pattern))
        return float(mean[-1]), float(np.sqrt(max(covariance[-1, -1], 0.0)))

    def best_of(self, slug: str) -> int:
        """The column of an effect that fits best alone."""
        columns = [i for i in self.table.of_kind("effect") if self.name(i) == slug]
        return max(columns, key=lambda i: self._parametric([(i,)])[0].all)

    def draws(self, base: Sequence[int], n_draw: int, seed: int) -> Coefficients:
        """Posterior draws of all coefficients given the effects of `base`, inner parameters and corrections averaged.

        Args:
            base: One column for each effect.
            n_draw: Number of draws.
            seed: Their seed.
        """
        rng = np.random.default_rng(seed)
        choices = list(product(*(self._likely(base, i) for i in base))) if base else [()]
        evaluated = self._parametric(choices)
        logs = np.array([[*np.ravel(v.by_pattern)] for v in evaluated])
        n_pattern = logs.shape[1]
        flat = np.exp(logs - np.logaddexp.reduce(logs, axis=None)).ravel()
        picks = rng.choice(len(flat), size=n_draw, p=flat / flat.sum())
        own = [*self.table.of_kind("free"), *self.table.of_kind("correction")]
        beta, inner, sigma = (
            np.zeros((n_draw, len(own) + len(base))),
            np.zeros((n_draw, len(base)), int),
            np.zeros(n_draw),
        )
        remainder = self._with_f.get(tuple(base))
        p_f = self._remainder(self._explanation("", tuple(base), (), self._parametric([tuple(base)])[0], remainder))
        for pick in np.unique(picks):
            rows = np.flatnonzero(picks == pick)
            choice, pattern = choices[pick // n_pattern], pick % n_pattern
            one, single = _one(evaluated[pick // n_pattern], int(pattern))
            mean, covariance = coefficients(one, single)
            node = rng.choice(len(single.sigma), size=len(rows), p=single.weight / single.weight.sum())
            sigma[rows] = single.sigma[node]
            values, vectors = np.linalg.eigh(covariance)
            spread = vectors * np.sqrt(np.maximum(values, 0))
            wide = np.ones(len(rows))
            if remainder is not None:
                # Where f remains, the noise is smaller; the coefficients' scatter shrinks with it.
                s_f = np.sqrt(self.table.noise.floor**2 + np.exp(2 * remainder.mode[0]))
                with_f = rng.random(len(rows)) < p_f
                wide[with_f] = s_f / sigma[rows][with_f]
                sigma[rows[with_f]] = s_f
            beta[rows] = mean + wide[:, None] * (rng.standard_normal((len(rows), len(values))) @ spread.T)
            inner[rows] = choice
        return Coefficients((*own, *base), beta, inner, sigma)

    def _groups(self, base: tuple[int, ...]) -> dict[str, list[int]]:
        """Columns by effect, of the effects that are not in `base`."""
        taken = {self.name(i) for i in base}
        groups: dict[str, list[int]] = {}
        for i in self.table.of_kind("effect"):
            if self.name(i) not in taken:
                groups.setdefault(self._binding(i), []).append(i)
        return groups

    def _likely(self, base: Sequence[int], index: int) -> list[int]:
        """Columns of one added effect that carry its posterior over the inner parameter."""
        group = self.group(index)
        others = [i for i in base if i != index]
        order = [tuple(i if j == index else j for j in base) for i in group] if others else [(i,) for i in group]
        log_z = np.array([v.all for v in self._parametric(order)])
        weight = np.exp(log_z - np.logaddexp.reduce(log_z))
        kept = [group[k] for k in np.argsort(-weight)[:9] if weight[k] > 1e-3]
        return kept

    def _effects(
        self,
        base: tuple[int, ...],
        groups: Mapping[str, list[int]],
        alone: Mapping[int, "_Parametric"],
        f_bare: Integrated,
    ) -> list[Explanation]:
        """Explanations by one more effect: finalists in full, the others by the evidence at the mode of f alone."""
        summed, best_f = {}, {}
        for key, group in groups.items():
            summed[key] = float(np.logaddexp.reduce([alone[i].all for i in group]))
            at_mode = [self.evaluator.at(self._with_features((*base, i)), f_bare.mode) for i in group]
            weighted = [v + self.table.columns[i].log_weight for v, i in zip(at_mode, group, strict=True)]
            best_f[key] = (
                group[int(np.argmax(weighted))],
                float(np.logaddexp.reduce(weighted)),
                float(np.max(weighted)),
            )
        top = max(summed.values(), default=0.0)
        by_f = sorted(groups, key=lambda key: -best_f[key][1])[:FINALISTS]
        by_none = [k for k in sorted(groups, key=lambda key: -summed[key])[:FINALISTS] if summed[k] > top - REACH]
        found = []
        for key, group in groups.items():
            index, total, largest = best_f[key]
            if key in {*by_f, *by_none}:
                integrated = self._integrated((*base, index))
                # The inner parameter's other values count relative to the best as they do at the common mode.
                spread = total - largest + self.table.columns[index].log_weight
            else:
                at = self.evaluator.at(self._with_features(base), f_bare.mode)
                gain = f_bare.log_evidence + self.evaluator.at(self._with_features((*base, index)), f_bare.mode) - at
                integrated = f_bare._replace(log_evidence=gain)
                spread = total - largest + self.table.columns[index].log_weight
            without = summed[key] + np.log1p(-self.odds.remainder)
            with_f = integrated.log_evidence + spread
            if key in {*by_f, *by_none}:
                likeliest = max(group, key=lambda i: alone[i].all)
                with_f = float(np.logaddexp(with_f, summed[key] + self._drift((*base, likeliest))) - np.log(2))
            with_f += np.log(self.odds.remainder)
            both = float(np.logaddexp(without, with_f))
            best = max(group, key=lambda i: alone[i].all) if without > with_f else index
            p_f = float(np.exp(with_f - both))
            share = p_f * self._share((*base, index), integrated) if key in {*by_f, *by_none} else np.nan
            found.append(Explanation(self.name(index), tuple(group), both, both, best, p_f, float(share), integrated))
        return found

    def _explanation(
        self, name: str, base: tuple[int, ...], candidate: tuple[int, ...], bare: "_Parametric", f: Integrated | None,
        only_f: bool = False,
    ) -> Explanation:  # fmt: skip
        if only_f and f is not None:
            either = float(np.logaddexp(f.log_evidence, bare.all + self._drift(base)) - np.log(2))
            return Explanation(name, candidate, either, either, None, 1.0, self._share(base, f), f)
        return Explanation(name, candidate, bare.all, bare.all, with_discrepancy=f)

    def _remainder(self, e: Explanation) -> float:
        if e.with_discrepancy is None:
            return 0.0
        without, with_f = np.log1p(-self.odds.remainder) + e.log_evidence, np.log(self.odds.remainder)
        return float(
            np.exp(
                with_f
                + e.with_discrepancy.log_evidence
                - np.logaddexp(without, with_f + e.with_discrepancy.log_evidence)
            )
        )

    def _share(self, indices: tuple[int, ...], f: Integrated) -> float:
        """Share of the gap's square that f carries at its mode."""
        s2 = self.table.noise.floor**2 + np.exp(2 * f.mode[0])
        gap = max(self.table.square - self.table.n_obs * s2, 1e-12 * self.table.square)
        return float(np.clip(self.evaluator.explained(self._with_features(indices), f.mode) / gap, 0.0, 1.0))

    def _integrated(self, effects: tuple[int, ...]) -> Integrated:
        if effects not in self._with_f:
            found = self.evaluator.integrate(
                self._with_features(effects), start=self._start, draws=self.importance_draws
            )
            self._with_f[effects] = found
            if self._start is None:
                self._start = found.mode
        return self._with_f[effects]

    def _drift(self, effects: tuple[int, ...]) -> float:
        """Log Bayes factor of residuals that hang together in time, with these effects added."""
        if effects not in self._drifts:
            table = self.table
            fitted = self._parametric([effects])[0]
            pattern = int(np.argmax(fitted.by_pattern))
            mean = coefficients(*_one(fitted, pattern))[0]
            residual = table.residual(self._indices(effects), mean)
            found = -np.inf
            if residual is not None:
                data = table.data
                found = drift_evidence(residual, data.time, data.run, table.noise, table.prior.amplitude)
            self._drifts[effects] = found
        return self._drifts[effects]

    def _patterns(self) -> tuple[np.ndarray, np.ndarray]:
        """Inclusion patterns of the corrections, all zeros first, and their log prior beside an effect."""
        k = len(self.table.of_kind("correction"))
        patterns = np.array(list(product((0, 1), repeat=k)), int).reshape(2**k, k)
        if len(patterns) > MOST_PATTERNS:
            patterns = patterns[patterns.sum(axis=1) <= 2]
        log_prior = patterns.sum(axis=1) * np.log(self.odds.correction)
        log_prior = log_prior + (k - patterns.sum(axis=1)) * np.log1p(-self.odds.correction)
        return patterns, log_prior - np.logaddexp.reduce(log_prior)

    def _indices(self, effects: Sequence[int]) -> list[int]:
        return [*self.table.of_kind("free"), *self.table.of_kind("correction"), *effects]

    def _scales(self, effects: Sequence[int]) -> np.ndarray:
        """Prior standard deviations by pattern [n_pattern, n_column]."""
        patterns, _ = self._patterns()
        sd = np.array([self.table.columns[i].sd for i in self._indices(effects)])
        n_free = len(self.table.of_kind("free"))
        scales = np.tile(sd, (len(patterns), 1))
        scales[:, n_free : n_free + patterns.shape[1]] *= patterns
        return scales

    def _parametric(self, choices: Sequence[Sequence[int]]) -> list["_Parametric"]:
        """Evidence without f of several sets of effects of one size, all inclusion patterns at once."""
        if not choices:
            return []
        _, log_prior = self._patterns()
        indices = np.array([self._indices(c) for c in choices])
        scales = np.stack([self._scales(c) for c in choices])
        gram = self.table.products[indices[:, :, None], indices[:, None, :]][:, None]
        product_y = self.table.with_target[indices][:, None]
        spectrum = Spectrum.of(gram, product_y, self.table.square, self.table.n_obs, scales)
        posterior = marginal(spectrum, self.table.noise)
        found = []
        for k, choice in enumerate(choices):
            inner = sum(self.table.columns[i].log_weight for i in choice)
            logs = posterior.log_evidence[k]
            by_pattern = logs + log_prior + inner
            # "Recalibrate" is told apart from "no gap" by the patterns, so their prior is that given some are in.
            some = np.logaddexp.reduce(log_prior[1:]) if len(log_prior) > 1 else 0.0
            found.append(
                _Parametric(
                    all=float(np.logaddexp.reduce(by_pattern)),
                    none=float(logs[0]),
                    some=float(np.logaddexp.reduce(by_pattern[1:]) - some) if len(logs) > 1 else -np.inf,
                    by_pattern=by_pattern,
                    spectrum=Spectrum(
                        spectrum.eigenvalues[k], spectrum.loading[k], spectrum.back[k], spectrum.square, spectrum.n_obs
                    ),
                    marginal=Marginal(logs, posterior.sigma[k], posterior.weight[k]),
                )
            )
        return found

    def _with_features(self, effects: tuple[int, ...]) -> WithDiscrepancy:
        """The hypothesis with f, its features orthogonal to its columns in the metric of R⁻¹."""
        table, indices = self.table, self._indices(effects)
        scales = self._scales(effects)
        G, g = table.products[np.ix_(indices, indices)], table.with_target[indices]
        spectrum = Spectrum.of(G, g, table.square, table.n_obs, scales)
        C = table.with_features[indices]
        # Projection on the columns through the eigenvectors of their Gram matrix that carry any weight
        values, vectors = np.linalg.eigh(G)
        kept = values > 1e-12 * max(values[-1], 1e-300) if len(values) else np.zeros(0, bool)
        root = vectors[:, kept] / np.sqrt(values[kept])
        P = root.T @ C
        return WithDiscrepancy(
            spectrum.eigenvalues,
            spectrum.loading,
            self._patterns()[1],
            table.square,
            table.n_obs,
            table.features - P.T @ P,
            table.features_target - P.T @ (root.T @ g),
        )

    def name(self, index: int) -> str:
        """Slug of the effect that a column stands for."""
        effect = self.table.columns[index].effect
        assert effect is not None
        return effect.slug

    def _binding(self, index: int) -> str:
        effect = self.table.columns[index].effect
        assert effect is not None
        return f"{effect.slug}({', '.join(f'{r}={c}' for r, c in sorted(effect.names.items()))})"


class _Parametric(NamedTuple):
    all: float
    none: float
    some: float
    by_pattern: np.ndarray
    spectrum: Spectrum
    marginal: Marginal


def _one(fitted: _Parametric, pattern: int) -> tuple[Spectrum, Marginal]:
    """One inclusion pattern of a batch."""
    spectrum, posterior = fitted.spectrum, fitted.marginal
    single = replace(spectrum, **{f: getattr(spectrum, f)[pattern] for f in ("eigenvalues", "loading", "back")})
    return single, Marginal(*(value[pattern] for value in posterior))
