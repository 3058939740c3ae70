"""Agreement of the data with themselves: probabilities averaged over bagged records (Huggins & Miller 2023).

Evidence of models that are all a little wrong is sure of itself and not reproducible: its differences grow like √n at
random. A record of blocks drawn with replacement says otherwise each time, and their average does not pretend.
"""

import numpy as np
from jaxtyping import Float, Int

FEWEST_BLOCKS, MOST_BLOCKS = 6, 30
"""Least and largest number of contiguous blocks of a record."""

ROWS = 25
"""Least number of rows of a block, but where there would be fewer blocks than the least."""

REPLICATES = 200
"""Number of bagged records: an average of 0.9 over them is known to ±√(0.9 · 0.1/200) = 0.02 at worst."""


def blocks(n: int) -> Int[np.ndarray, " n"]:
    """Return the number of the contiguous block that each of n rows belongs to."""
    count = int(np.clip(n // ROWS, min(FEWEST_BLOCKS, n), MOST_BLOCKS))
    return np.arange(n) * count // n


def bagged(
    logs: Float[np.ndarray, "n_hypothesis n_block"], probability: Float[np.ndarray, " n_hypothesis"], seed: int
) -> Float[np.ndarray, " n_hypothesis"]:
    """Return probabilities averaged over bagged records, to first order.

    Each hypothesis's log weight changes by Σ_b (c_b − 1) ℓ_b, with c the multinomial counts of the blocks and ℓ the log
    likelihood of a block at the hypothesis's mode.

    Args:
        logs: ℓ.
        probability: On the whole record.
        seed: Of the records.
    """
    n = logs.shape[1]
    counts = np.random.default_rng(seed).multinomial(n, np.full(n, 1 / n), size=REPLICATES)
    each = np.log(np.maximum(probability, 1e-300)) + (counts - 1.0) @ logs.T
    return np.mean(np.exp(each - np.logaddexp.reduce(each, axis=1, keepdims=True)), axis=0)
