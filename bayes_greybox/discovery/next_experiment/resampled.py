"""A few of many weighted items that stand for all."""

import numpy as np
from jaxtyping import Float


def systematic(weights: Float[np.ndarray, " n"], n: int) -> tuple[Float[np.ndarray, " n_kept"], np.ndarray]:
    """Every n-th part of the total weight, in order (Kitagawa 1996).

    Args:
        weights: Of the items, in an order in which neighbours are alike.
        n: How many are kept, at most.

    Returns:
        Weights of those that are kept, which sum to one, and their places.
    """
    weights = np.asarray(weights, float) / np.sum(weights)
    if len(weights) <= n:
        return weights, np.arange(len(weights))
    at = np.searchsorted(np.cumsum(weights), (np.arange(n) + 0.5) / n)
    places, count = np.unique(np.minimum(at, len(weights) - 1), return_counts=True)
    return count / n, places
