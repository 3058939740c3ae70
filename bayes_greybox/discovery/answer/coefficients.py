"""Posterior of the coefficients of an equation, with the effects that were added to it."""

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.discovery.evidence.evaluations import Evaluations, one_pattern
from bayes_greybox.discovery.evidence.sufficient_statistics import SufficientStatistics
from bayes_greybox.discovery.suspects.channels import ChannelSuspect
from bayes_greybox.model.estimate.evidence import coefficients

MOST_CHOICES = 1000
"""Combinations of values of inner parameters that draws are taken from, at most."""

FAINT = 1e-4
"""Components of a mixture that are less likely than this share of the likeliest are left out."""


class Coefficients(NamedTuple):
    """Posterior draws for a set of columns.

    Attributes:
        indices: Columns: free, corrections, effects.
        draws: Scaled coefficients [n_draw, n_column], exactly zero for corrections that are out.
        inner: For each draw, the index of the column that stands for each added effect [n_draw, n_effect].
        sigma: Noise SD, scaled [n_draw].
        suspects: Columns of suspects in the model.
        suspect_draws: Their scaled coefficients [n_draw, n_suspect].
    """

    indices: tuple[int, ...]
    draws: Float[np.ndarray, "n_draw n_column"]
    inner: np.ndarray
    sigma: Float[np.ndarray, " n_draw"]
    suspects: tuple[int, ...] = ()
    suspect_draws: np.ndarray = np.zeros((0, 0))

    def without_memory(self, statistics: SufficientStatistics, n: int) -> "Coefficients":
        """Without the suspects after the first n, what remembers; the model's free terms take over what they can of it.

        A force that follows an input late is that input's for the most part.

        Args:
            statistics: Of the equation, under its noise.
            n: Suspects that stay.
        """
        memory, free = list(self.suspects[n:]), statistics.of_kind("free")
        kept = self._replace(suspects=self.suspects[:n], suspect_draws=self.suspect_draws[:, :n])
        if not memory or not free:
            return kept
        products, draws = statistics.products, self.draws.copy()
        taken = (
            np.linalg.pinv(products[np.ix_(free, free)], rcond=1e-12, hermitian=True) @ products[np.ix_(free, memory)]
        )
        draws[:, [self.indices.index(i) for i in free]] += self.suspect_draws[:, n:] @ taken.T
        return kept._replace(draws=draws)


class Conditional(NamedTuple):
    """Coefficients given values of inner parameters and an inclusion pattern of the corrections.

    Attributes:
        weight: Posterior probability of these values and this pattern.
        indices: Columns: free, corrections, effects.
        mean: Scaled.
        covariance: Scaled.
        sigma: Noise SD, scaled.
    """

    weight: float
    indices: tuple[int, ...]
    mean: Float[np.ndarray, " n_column"]
    covariance: Float[np.ndarray, "n_column n_column"]
    sigma: float


def plain(evaluations: Evaluations) -> np.ndarray:
    """Coefficients of the free columns with nothing else in the model, scaled."""
    fitted = evaluations.parametric([()])[0]
    return coefficients(*one_pattern(fitted, 0))[0][: len(evaluations.statistics.of_kind("free"))]


def alone(evaluations: Evaluations, index: int) -> tuple[float, float]:
    """Mean and standard deviation of one effect's scaled coefficient when it is the only one added."""
    fitted = evaluations.parametric([(index,)])[0]
    pattern = int(np.argmax(fitted.by_pattern))
    mean, covariance = coefficients(*one_pattern(fitted, pattern))
    return float(mean[-1]), float(np.sqrt(max(covariance[-1, -1], 0.0)))


def draw_coefficients(
    evaluations: Evaluations, base: Sequence[int], n_draw: int, seed: int, suspects: Sequence[int] = (),
    remainder: float = 0.0, *, some: bool = False, none: bool = False,
) -> Coefficients:  # fmt: skip
    """Posterior draws of all coefficients given the effects of `base`, inner parameters and corrections averaged.

    Args:
        evaluations: Evidence of the equation.
        base: One column for each effect.
        n_draw: Number of draws.
        seed: Their seed.
        suspects: Suspects that are in the model with them.
        remainder: Probability that f remains, which makes the noise smaller.
        some: Whether at least one correction is in.
        none: Whether none is.
    """
    rng = np.random.default_rng(seed)
    suspects = tuple(suspects)
    choices, drawn_as = _choices(evaluations, suspects, base, rng)
    evaluated = evaluations.parametric([(*suspects, *c) for c in choices])
    logs = np.array([[*np.ravel(v.by_pattern)] for v in evaluated]) + drawn_as[:, None]
    patterns = _patterns(logs.shape[1], some, none)
    n_pattern, logs = len(patterns), logs[:, patterns]
    flat = np.exp(logs - np.logaddexp.reduce(logs, axis=None)).ravel()
    picks = rng.choice(len(flat), size=n_draw, p=flat / flat.sum())
    own = [*evaluations.statistics.of_kind("free"), *evaluations.statistics.of_kind("correction")]
    beta, inner, sigma = (
        np.zeros((n_draw, len(own) + len(suspects) + len(base))),
        np.zeros((n_draw, len(base)), int),
        np.zeros(n_draw),
    )
    # Where f remains, the noise is smaller; the coefficients' scatter shrinks with it.
    s_f = evaluations.statistics.noise.sigma(evaluations.integrated((*suspects, *base)).mode[0]) if remainder else 0.0
    for pick in np.unique(picks):
        rows = np.flatnonzero(picks == pick)
        choice, pattern = choices[pick // n_pattern], patterns[pick % n_pattern]
        one, single = one_pattern(evaluated[pick // n_pattern], int(pattern))
        mean, covariance = coefficients(one, single)
        node = rng.choice(len(single.sigma), size=len(rows), p=single.weight / single.weight.sum())
        sigma[rows] = single.sigma[node]
        values, vectors = np.linalg.eigh(covariance)
        spread = vectors * np.sqrt(np.maximum(values, 0))
        wide = np.ones(len(rows))
        with_f = rng.random(len(rows)) < remainder
        wide[with_f] = s_f / sigma[rows][with_f]
        sigma[rows[with_f]] = s_f
        beta[rows] = mean + wide[:, None] * (rng.standard_normal((len(rows), len(values))) @ spread.T)
        inner[rows] = choice
    first, last = len(own), len(own) + len(suspects)
    kept = np.hstack([beta[:, :first], beta[:, last:]])
    return Coefficients((*own, *base), kept, inner, sigma, suspects, beta[:, first:last])


def conditional(
    evaluations: Evaluations, base: Sequence[int], suspects: Sequence[int] = (), *, some: bool = False,
    none: bool = False,
) -> list[Conditional]:  # fmt: skip
    """Posterior of all coefficients given the effects of `base`, as the components of a mixture.

    Neighbours in the list have like values of inner parameters.

    Args:
        evaluations: Evidence of the equation.
        base: One column for each effect.
        suspects: Suspects that are in the model with them, and left out of the result.
        some: Whether at least one correction is in.
        none: Whether none is.
    """
    suspects = tuple(suspects)
    choices, drawn_as = _choices(evaluations, suspects, base, np.random.default_rng(0))
    order = sorted(range(len(choices)), key=lambda i: choices[i])
    choices, drawn_as = [choices[i] for i in order], drawn_as[order]
    evaluated = evaluations.parametric([(*suspects, *c) for c in choices])
    logs = np.array([[*np.ravel(v.by_pattern)] for v in evaluated]) + drawn_as[:, None]
    patterns = _patterns(logs.shape[1], some, none)
    flat = np.exp(logs[:, patterns] - np.logaddexp.reduce(logs[:, patterns], axis=None))
    own = [*evaluations.statistics.of_kind("free"), *evaluations.statistics.of_kind("correction")]
    kept = [*range(len(own)), *range(len(own) + len(suspects), len(own) + len(suspects) + len(base))]
    found = []
    # Pattern by pattern, so that inner parameters rise within each.
    for k, pattern in enumerate(patterns):
        for choice, fitted, weight in zip(choices, evaluated, flat[:, k], strict=True):
            if weight > FAINT * np.max(flat):
                one, single = one_pattern(fitted, int(pattern))
                mean, covariance = coefficients(one, single)
                sigma = float(single.sigma @ single.weight / np.sum(single.weight))
                of = (*own, *choice)
                found.append(Conditional(float(weight), of, mean[kept], covariance[np.ix_(kept, kept)], sigma))
    return found


def sensor_errors(statistics: SufficientStatistics, coefficients: Coefficients) -> dict[ChannelSuspect, float]:
    """Mean sizes of the suspects in the model, in their units."""
    return {
        suspect: float(size) * statistics.target_scale / statistics.columns[i].scale
        for i, size in zip(coefficients.suspects, coefficients.suspect_draws.mean(axis=0), strict=True)
        if (suspect := statistics.columns[i].suspect) is not None
    }


def _patterns(count: int, some: bool, none: bool) -> Int[np.ndarray, " n_pattern"]:
    """Inclusion patterns of the corrections with at least one, with none, or all of them; the first has none."""
    patterns = np.arange(count)
    return patterns[:1] if none else patterns[1:] if some else patterns


def _choices(
    evaluations: Evaluations, suspects: tuple[int, ...], base: Sequence[int], rng: np.random.Generator
) -> tuple[list[tuple[int, ...]], Float[np.ndarray, " n_choice"]]:
    """Combinations of values of inner parameters that carry their posterior, and what each weighs for being drawn.

    All of them where they are few. Else combinations are drawn from the product of the posteriors of each effect beside
    the others, and weigh how often they were drawn over how often they would be: the heaviest alone would be those of
    the middle, and intervals too short.
    """
    if not base:
        return [()], np.zeros(1)
    each = [_likely(evaluations, suspects, base, i) for i in base]
    if np.prod([float(len(values)) for values, _ in each]) <= MOST_CHOICES:
        every = list(product(*(values for values, _ in each)))
        return every, np.zeros(len(every))
    places = np.column_stack([rng.choice(len(values), MOST_CHOICES, p=weight) for values, weight in each])
    found, count = np.unique(places, axis=0, return_counts=True)
    expected = sum(np.log(weight)[found[:, k]] for k, (_, weight) in enumerate(each))
    choices = [tuple(values[i] for i, (values, _) in zip(row, each, strict=True)) for row in found.tolist()]
    return choices, np.log(count) - expected


def _likely(
    evaluations: Evaluations, suspects: tuple[int, ...], base: Sequence[int], index: int
) -> tuple[list[int], Float[np.ndarray, " n_value"]]:
    """Columns of one added effect that carry its posterior over the inner parameters, and their shares of it."""
    group = evaluations.group(index)
    order = [(*suspects, *(i if j == index else j for j in base)) for i in group]
    log_z = np.array([v.all for v in evaluations.parametric(order)])
    weight = np.exp(log_z - np.logaddexp.reduce(log_z))
    kept = [k for k in np.argsort(-weight)[:MOST_CHOICES] if weight[k] > 1e-3]
    return [group[k] for k in kept], weight[kept] / np.sum(weight[kept])
