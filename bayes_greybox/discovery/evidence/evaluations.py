"""Evidence of sets of effects, with and without what they leave over; each is found once."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import combinations
from typing import NamedTuple

import numpy as np

from bayes_greybox.model.estimate.evidence import Marginal, Spectrum, marginal, means

from .odds import Odds
from .sufficient_statistics import SufficientStatistics
from .ties import ranked
from .with_discrepancy import IMPORTANCE_DRAWS, Evaluator, Integrated, WithDiscrepancy

MOST_PATTERNS = 64
"""Up to so many inclusion patterns of the simulation's own terms are summed; beyond, those with at most two terms."""

TOGETHER = 256
"""Sets whose evidence is found at once, at most: memory is for no more."""


class Parametric(NamedTuple):
    """A set of effects without f, σ integrated out; log evidences carry the prior weight of inner parameters.

    Attributes:
        all: Summed over the patterns of corrections.
        none: Without corrections.
        some: With at least one, given that there is one.
        by_pattern: Of each pattern, its prior included.
        spectrum: All patterns.
        marginal: All patterns.
    """

    all: float
    none: float
    some: float
    by_pattern: np.ndarray
    spectrum: Spectrum
    marginal: Marginal


@dataclass
class Evaluations:
    """Evidence on the statistics of one equation.

    Attributes:
        statistics: Products of the equation.
        odds: Prior odds.
        evaluator: Evidence with f.
        importance_draws: Draws behind it.
        seed: Of the chains that settle what importance sampling is unsure of; None: no chains.
    """

    statistics: SufficientStatistics
    odds: Odds
    evaluator: Evaluator
    importance_draws: int = IMPORTANCE_DRAWS
    seed: int | None = None

    def __post_init__(self) -> None:
        self._with_f: dict[tuple[int, ...], Integrated] = {}
        self._start: np.ndarray | None = None

    def share(self, indices: tuple[int, ...], f: Integrated) -> float:
        """Share of the gap's square that f carries at its mode; what the free columns explain is no gap."""
        gap = self._gap(self.statistics.noise.floor**2 + np.exp(2 * f.mode[0]))
        return float(np.clip(self.evaluator.explained(self.with_features(indices), f.mode) / gap, 0.0, 1.0))

    def carried(self, fitted: Parametric, columns: Sequence[int]) -> float:
        """Share of the gap's square that the last columns of a set carry; what free columns could is no gap.

        Args:
            fitted: Evidence of the set.
            columns: Its last columns.
        """
        single, posterior = one_pattern(fitted, int(np.argmax(fitted.by_pattern)))
        theta = means(single, posterior)[-len(columns) :]
        free, G = self.statistics.of_kind("free"), self.statistics.products
        square = float(theta @ G[np.ix_(columns, columns)] @ theta)
        if free:
            across = G[np.ix_(free, columns)] @ theta
            square -= float(across @ np.linalg.lstsq(G[np.ix_(free, free)], across, rcond=1e-12)[0])
        gap = self._gap(float(posterior.weight @ posterior.sigma**2 / np.sum(posterior.weight)))
        return float(np.clip(square / gap, 0.0, 1.0))

    def apart(self, beside: Sequence[int], first: int, second: int) -> float:
        """Square of the difference of two columns' curves over the noise's, n RMS²/σ², each fitted to the target.

        Only what the free columns, the corrections, whatever their prior, and the columns beside them leave counts.

        Args:
            beside: Columns of the set that each of them completes.
            first: A column; the noise is what it leaves.
            second: Another.
        """
        own, pair = self.indices(beside), [first, second]
        G, g = self.statistics.products, self.statistics.with_target
        taken = np.linalg.pinv(G[np.ix_(own, own)], rcond=1e-12, hermitian=True)
        left = G[np.ix_(pair, pair)] - G[np.ix_(pair, own)] @ taken @ G[np.ix_(own, pair)]
        target = g[pair] - G[np.ix_(pair, own)] @ taken @ g[own]
        # A column that the others span has no curve of its own.
        size = np.diag(left)
        real = size > 1e-9 * np.diag(G)[pair]
        fitted = np.where(real, target / np.where(real, size, 1.0), 0.0)
        explained = self.parametric([(*beside, first)])[0]
        _, posterior = one_pattern(explained, int(np.argmax(explained.by_pattern)))
        s2 = float(posterior.weight @ posterior.sigma**2 / np.sum(posterior.weight))
        difference = fitted * [1, -1]
        return max(float(difference @ left @ difference), 0.0) / s2

    def _gap(self, s2: float) -> float:
        """Square of the target outside the free columns' span, less the noise's share of it."""
        return max(self._outside_free - self.statistics.n_obs * s2, 1e-12 * self.statistics.square)

    @cached_property
    def _outside_free(self) -> float:
        """Square of the target outside the free columns' span: the same for thousands of sets."""
        free = self.statistics.of_kind("free")
        own, g = self.statistics.products[np.ix_(free, free)], self.statistics.with_target[free]
        return self.statistics.square - float(g @ np.linalg.lstsq(own, g, rcond=1e-12)[0])

    def integrated(self, effects: tuple[int, ...]) -> Integrated:
        """Evidence with f; it carries no prior weight of inner parameters."""
        if effects not in self._with_f:
            found = self.evaluator.integrate(
                self.with_features(effects), start=self._start, draws=self.importance_draws
            )
            self._with_f[effects] = found
            if self._start is None:
                self._start = found.mode
        return self._with_f[effects]

    def patterns(self) -> tuple[np.ndarray, np.ndarray]:
        """Inclusion patterns of the corrections, all zeros first, and their log prior beside an effect.

        The last of several corrections has all of them by one factor, as a wrong mass, inertia or capacity has them: it
        is one number that is off, and as likely beforehand as one coefficient.
        """
        return _patterns(len(self.statistics.of_kind("correction")), self.odds.correction)

    def indices(self, effects: Sequence[int]) -> list[int]:
        """Columns of a hypothesis: free ones, corrections, effects."""
        return [*self.statistics.of_kind("free"), *self.statistics.of_kind("correction"), *effects]

    def spectrum(self, choices: Sequence[Sequence[int]]) -> Spectrum:
        """Sets of columns of one size [n_set, n_pattern, ...], without f."""
        statistics = self.statistics
        indices = np.array([self.indices(c) for c in choices], dtype=int)
        gram = statistics.products[indices[:, :, None], indices[:, None, :]][:, None]
        given = gram, statistics.with_target[indices][:, None], statistics.square, statistics.n_obs
        patterns, _ = self.patterns()
        corrections = statistics.of_kind("correction")
        first, count = len(statistics.of_kind("free")), len(corrections)
        sd = np.array([column.sd for column in statistics.columns])[indices]
        together = count > 1
        each = patterns[:-1] if together else patterns
        scales = np.repeat(sd[:, None], len(each), axis=1)
        scales[:, :, first : first + count] *= each
        found = Spectrum.of(*given, scales)
        if not together:
            return found
        # θ_j = z s_j, z ~ N(0, 1): standard deviations are shares of the nominal coefficients, whose signs they take.
        signs = np.sign([statistics.columns[i].nominal for i in corrections])
        own = slice(first, first + count)
        root = sd[:, :, None] * np.eye(indices.shape[1])
        root[:, own, own] = 0.0
        root[:, own, first] = sd[:, own] * signs
        return found.and_then(Spectrum.of_root(*given, root[:, None]))

    def parametric(self, choices: Sequence[Sequence[int]]) -> list[Parametric]:
        """Evidence without f of several sets of effects of one size, all inclusion patterns at once."""
        if not choices:
            return []
        _, log_prior = self.patterns()
        spectrum = self.spectrum(choices)
        posterior = marginal(spectrum, self.statistics.noise)
        found = []
        for k, choice in enumerate(choices):
            inner = self.inner_weight(choice)
            logs = posterior.log_evidence[k]
            by_pattern = logs + log_prior + inner
            # "Recalibrate" is told apart from "no gap" by the patterns, so their prior is that given some are in.
            some = np.logaddexp.reduce(log_prior[1:]) if len(log_prior) > 1 else 0.0
            found.append(
                Parametric(
                    all=float(np.logaddexp.reduce(by_pattern)),
                    none=float(logs[0] + inner),
                    some=float(np.logaddexp.reduce(by_pattern[1:]) - some) if len(logs) > 1 else -np.inf,
                    by_pattern=by_pattern,
                    spectrum=Spectrum(
                        spectrum.eigenvalues[k], spectrum.loading[k], spectrum.back[k], spectrum.square, spectrum.n_obs
                    ),
                    marginal=Marginal(logs, posterior.sigma[k], posterior.weight[k]),
                )
            )
        return found

    def each_parametric(self, choices: Sequence[Sequence[int]]) -> list[Parametric]:
        """`parametric` of sets of any sizes, many of one size at once: one by one they take five times as long."""
        found: dict[int, Parametric] = {}
        for size in sorted({len(choice) for choice in choices}):
            alike = [k for k, choice in enumerate(choices) if len(choice) == size]
            for start in range(0, len(alike), TOGETHER):
                part = alike[start : start + TOGETHER]
                found |= zip(part, self.parametric([choices[k] for k in part]), strict=True)
        return [found[k] for k in range(len(choices))]

    def with_features(self, effects: tuple[int, ...]) -> WithDiscrepancy:
        """The hypothesis with f, its features orthogonal to its columns in the metric of R⁻¹."""
        statistics, indices, spectrum = self.statistics, self.indices(effects), self.spectrum([effects])
        G, g = statistics.products[np.ix_(indices, indices)], statistics.with_target[indices]
        C = statistics.with_features[indices]
        # Projection on the columns through the eigenvectors of their Gram matrix that carry any weight
        values, vectors = np.linalg.eigh(G)
        kept = values > 1e-12 * max(values[-1], 1e-300) if len(values) else np.zeros(0, bool)
        root = vectors[:, kept] / np.sqrt(values[kept])
        P = root.T @ C
        return WithDiscrepancy(
            spectrum.eigenvalues[0],
            spectrum.loading[0],
            self.patterns()[1],
            statistics.square,
            statistics.n_obs,
            statistics.features - P.T @ P,
            statistics.features_target - P.T @ (root.T @ g),
        )

    def settled(self, effects: tuple[int, ...], sure: float) -> Integrated:
        """Evidence with f, by bridge sampling where its standard error exceeds `sure` and chains may run."""
        found = self.integrated(effects)
        if found.se > sure and self.seed is not None:
            again = self.evaluator.bridged(self.with_features(effects), self.seed)
            if again.se < found.se:
                self._with_f[effects] = found._replace(log_evidence=again.log_evidence, se=again.se)
        return self._with_f[effects]

    def inner_weight(self, effects: Sequence[int], gains: bool = True) -> float:
        """Log prior weight of the inner parameters of these columns, and what their set gains on rows near itself.

        Args:
            effects: Columns of the set.
            gains: Whether to add the gain: not where something beside the columns has taken it up already.
        """
        own = [self.statistics.columns[i] for i in effects]
        total = sum(column.log_weight for column in own)
        if gains and any(column.nearer is not None for column in own):
            there = {column.called for column in own}
            for column in own:
                near = column.nearer
                # Any other column could have taken up what the gain is for, and would be paid twice.
                if near is not None and there - {column.called} == near.beside:
                    total += near.gain
        return float(total)

    def name(self, index: int) -> str:
        """Slug of the effect that a column stands for."""
        effect = self.statistics.columns[index].effect
        assert effect is not None
        return effect.slug

    def binding(self, index: int) -> str:
        """Effect and the columns it is bound to."""
        effect = self.statistics.columns[index].effect
        assert effect is not None
        return effect.label

    def group(self, index: int) -> tuple[int, ...]:
        """All columns of the effect, or law, that a column belongs to, one for each value of its inner parameters."""
        own = self.statistics.columns[index]
        return tuple(i for i, c in enumerate(self.statistics.columns) if c.kind == own.kind and c.called == own.called)

    def best_of(self, name: str) -> int:
        """The column of an effect, by its slug or its binding, that fits best alone."""
        columns = [i for i in self.statistics.of_kind("effect") if name in (self.name(i), self.binding(i))]
        return ranked(columns, lambda i: self.parametric([(i,)])[0].all)[0]


def one_pattern(fitted: Parametric, pattern: int) -> tuple[Spectrum, Marginal]:
    """One inclusion pattern of a batch."""
    spectrum, posterior = fitted.spectrum, fitted.marginal
    single = replace(spectrum, **{f: getattr(spectrum, f)[pattern] for f in ("eigenvalues", "loading", "back")})
    return single, Marginal(*(value[pattern] for value in posterior))


@cache
def _patterns(count: int, probability: float) -> tuple[np.ndarray, np.ndarray]:
    most = count if 2**count <= MOST_PATTERNS else 2
    chosen = [ones for size in range(most + 1) for ones in combinations(range(count), size)]
    patterns = np.zeros((len(chosen), count), int)
    for row, ones in zip(patterns, chosen, strict=True):
        row[list(ones)] = 1
    counted = patterns.sum(axis=1)
    if count > 1:
        # All by one factor count as one.
        patterns, counted = np.vstack([patterns, np.ones((1, count), int)]), np.append(counted, 1)
    log_prior = counted * np.log(probability) + (count - counted) * np.log1p(-probability)
    return patterns, log_prior - np.logaddexp.reduce(log_prior)
