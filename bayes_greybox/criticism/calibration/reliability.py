"""Reliability of inclusion probabilities: of the terms with P(γ) = 0.8, eight in ten should be in the truth."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Float

PROBABILITY_BINS = 10
SIMULATIONS = 9999


@dataclass(frozen=True)
class Reliability:
    """Calibration of P(γ) over replicates and terms.

    Attributes:
        bins: One row a bin of probability: low, high (its edges), count, predicted and observed share of included
            terms, and lower and upper, between which 99 % of the observed shares of calibrated probabilities lie.
        terms: One row a term: expected and true number of inclusions over all replicates, and p.
        ece: Expected calibration error, Σ_b (n_b/n) |observed_b − predicted_b|.
        expected_ece: Mean ECE of calibrated probabilities; not zero, as the shares are of finite numbers.
        p: Probability that calibrated probabilities have an ECE as large.
    """

    bins: pd.DataFrame
    terms: pd.DataFrame
    ece: float
    expected_ece: float
    p: float


def reliability(
    gamma: Float[np.ndarray, "n_replicate n_term"], probability: Float[np.ndarray, "n_replicate n_term"],
    draws: Float[np.ndarray, "n_replicate n_draw n_term"], terms: Sequence[str], generator: np.random.Generator,
) -> Reliability:  # fmt: skip
    """Compare true inclusions, 0 or 1, with their posterior probabilities.

    If the probabilities are right, the true pattern is one more posterior draw. So a draw from each replicate in its
    place shows the errors of calibrated probabilities by chance, including the dependence between terms.
    """
    n, n_draw, _ = draws.shape
    flat = probability.ravel()
    index = np.minimum((flat * PROBABILITY_BINS).astype(int), PROBABILITY_BINS - 1)
    member = (index[:, None] == np.arange(PROBABILITY_BINS)).astype(float)
    count, predicted = member.sum(axis=0), flat @ member
    observed = gamma.ravel() @ member
    chosen = generator.integers(0, n_draw, (SIMULATIONS, n))
    simulated = np.stack([draws[np.arange(n), row].ravel() @ member for row in chosen])
    ece = float(np.abs(observed - predicted).sum() / len(flat))
    by_chance = np.abs(simulated - predicted).sum(axis=1) / len(flat)
    full = count > 0
    low, high = np.quantile(simulated, [0.005, 0.995], axis=0)
    edges = np.arange(PROBABILITY_BINS + 1) / PROBABILITY_BINS
    bins = pd.DataFrame({"low": edges[:-1], "high": edges[1:], "count": count.astype(int)})
    for name, values in {"predicted": predicted, "observed": observed, "lower": low, "upper": high}.items():
        bins[name] = np.divide(values, count, out=np.full(PROBABILITY_BINS, np.nan), where=full)
    by_term = pd.DataFrame(
        {
            "expected": probability.sum(axis=0),
            "included": gamma.sum(axis=0).astype(int),
            "p": [poisson_binomial_p(int(g.sum()), p) for g, p in zip(gamma.T, probability.T, strict=True)],
        },
        index=pd.Index(list(terms), name="term"),
    )
    # Rounding must not decide whether a simulated error counts as large.
    p = (1 + np.sum(by_chance >= ece * (1 - 1e-12))) / (SIMULATIONS + 1)
    return Reliability(bins, by_term, ece, float(by_chance.mean()), float(p))


def poisson_binomial_p(hits: int, probability: Float[np.ndarray, " n"]) -> float:
    """Return the two-sided p-value of a number of successes in independent trials with different probabilities.

    This is the binomial test for unequal probabilities: twice the smaller tail of the exact distribution.
    """
    distribution = np.ones(1)
    for p in probability:
        distribution = np.convolve(distribution, [1 - p, p])
    return float(min(1.0, 2 * min(distribution[: hits + 1].sum(), distribution[hits:].sum())))
