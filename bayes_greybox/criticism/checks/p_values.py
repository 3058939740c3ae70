"""One p-value from those of several posterior draws."""

import numpy as np
from jaxtyping import Float

LEVEL = 0.01
"""Level of each test: at most one in a hundred well-specified models is called into question by it."""


def combined_p(p: Float[np.ndarray, " n_draw"]) -> float:
    """Twice the median, at most 1: a p-value whatever the dependence between the given ones.

    If each p_s is uniform, P(median ≤ α/2) ≤ P(half of all p_s ≤ α/2) ≤ 2 · α/2 by Markov's inequality (Meinshausen,
    Meier & Bühlmann 2009, JASA 104:1671, Theorem 3.1 with γ = ½).
    """
    return float(min(1.0, 2.0 * np.quantile(p, 0.5, method="higher")))
