"""Uniformity of values: the ECDF, its simultaneous band, and the exact p-value of leaving it."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import binom


class Band(NamedTuple):
    """Simultaneous band of F̂(z) − z, the ECDF of uniform values less their distribution, at points z in (0, 1)."""

    at: Float[np.ndarray, " n_point"]
    lower: Float[np.ndarray, " n_point"]
    upper: Float[np.ndarray, " n_point"]


def evaluation_points(n_value: int) -> Float[np.ndarray, " n_point"]:
    """Return 1/K, …, (K − 1)/K with K the number of values, but 100 at most."""
    n_point = max(min(n_value, 100), 2)
    return np.arange(1, n_point) / n_point


def ecdf_difference(values: Float[np.ndarray, " n_value"]) -> Float[np.ndarray, " n_point"]:
    """Return F̂(z) − z at the evaluation points."""
    at = evaluation_points(len(values))
    return np.searchsorted(np.sort(values), at, side="right") / len(values) - at


def uniformity_p(values: Float[np.ndarray, " n_value"]) -> float:
    """Return the exact p-value of the largest pointwise deviation of the ECDF from that of uniform values.

    The statistic is the least of the two-sided binomial tail probabilities over the evaluation points,
    γ = 2 min_i min{Bin(R_i | N, z_i), 1 − Bin(R_i − 1 | N, z_i)} (Säilynoja, Bürkner & Vehtari 2022, Eq. 11), and its
    distribution follows by recursion over the points (their Sec. 2.3), without simulation.
    """
    n, tails = len(values), _tails(len(values))
    counts = np.searchsorted(np.sort(values), evaluation_points(n), side="right")
    gamma = float(min(1.0, tails[counts, np.arange(len(counts))].min()))
    # Data on the edge of a band count as outside: γ is the level at which they just are.
    return 1.0 - _inside(n, gamma * (1 + 1e-9))


@lru_cache(maxsize=64)
def simultaneous_band(n_value: int, level: float) -> Band:
    """Return the band that the ECDF of uniform values leaves anywhere with probability `level` at most."""
    at = evaluation_points(n_value)
    # Bonferroni's γ is too small and the level itself too large; the probability steps, and `low` is the safe side.
    low, high = level / (2 * len(at)), level
    while high - low > 1e-5 * level:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if 1 - _inside(n_value, middle) <= level else (low, middle)
    lower, upper = _pointwise(n_value, low)
    return Band(at, lower / n_value - at, upper / n_value - at)


def _pointwise(n: int, gamma: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and largest count at each point whose two-sided tail probability is at least γ."""
    inside = _tails(n) >= gamma
    return np.argmax(inside, axis=0), n - np.argmax(inside[::-1], axis=0)


@lru_cache(maxsize=16)
def _tails(n: int) -> Float[np.ndarray, "n_count n_point"]:
    """Return the two-sided tail probabilities of all counts at each point."""
    counts, at = np.arange(n + 1)[:, None], evaluation_points(n)
    return 2 * np.minimum(binom.cdf(counts, n, at), binom.sf(counts - 1, n, at))


@lru_cache(maxsize=4096)
def _inside(n: int, gamma: float) -> float:
    """Return the probability that all counts of n uniform values lie in the pointwise bands of level γ.

    P(R_i = r) = Σ_s P(R_{i−1} = s) Bin(r − s | n − s, (z_i − z_{i−1})/(1 − z_{i−1})), over s and r inside.
    """
    at = evaluation_points(n)
    lower, upper = _pointwise(n, gamma)
    probability, before, z = np.ones(1), np.zeros(1, int), 0.0
    for low, high, z_next in zip(lower, upper, at, strict=True):
        counts = np.arange(low, high + 1)
        step = binom.pmf(counts - before[:, None], n - before[:, None], (z_next - z) / (1 - z))
        probability, before, z = probability @ step, counts, z_next
    return float(probability.sum())
