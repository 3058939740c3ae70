"""Agreement of the data with themselves: probabilities averaged over bagged records (Huggins & Miller 2023).

Evidence of models that are all a little wrong is overconfident and not reproducible: its differences grow like √n at
random. They differ from one record of blocks drawn with replacement to the next; the average over such records does not
pretend.
"""

import numpy as np
from jaxtyping import Float, Int

FEWEST_BAGGED_BLOCKS, MOST_BAGGED_BLOCKS = 6, 30
"""Least and largest number of contiguous blocks of a record."""

BLOCK_ROWS = 25
"""Least number of rows of a block, but where there would be fewer blocks than the least."""

BAGGED_RECORDS = 200
"""Number of bagged records: an average of 0.9 over them is known to ±√(0.9 · 0.1/200) = 0.02 at worst."""


def blocks(n: int) -> Int[np.ndarray, " n"]:
    """Return the number of the contiguous block that each of n rows belongs to."""
    count = int(np.clip(n // BLOCK_ROWS, min(FEWEST_BAGGED_BLOCKS, n), MOST_BAGGED_BLOCKS))
    return np.arange(n) * count // n


def bagged(
    logs: Float[np.ndarray, "n_hypothesis n_block"], probability: Float[np.ndarray, " n_hypothesis"], seed: int
) -> Float[np.ndarray, " n_hypothesis"]:
    """Return probabilities averaged over bagged records, to first order.

    Each hypothesis's log weight changes by Σ_b (c_b − 1) ℓ_b, with c the multinomial counts of the blocks and ℓ the log
    likelihood of a block at the hypothesis's mode.

    Args:
        logs: ℓ.
        probability: Probability of each hypothesis on the whole record.
        seed: Seed of the records.
    """
    n = logs.shape[1]
    counts = np.random.default_rng(seed).multinomial(n, np.full(n, 1 / n), size=BAGGED_RECORDS)
    log_weights = np.log(np.maximum(probability, 1e-300)) + (counts - 1.0) @ logs.T
    return np.mean(np.exp(log_weights - np.logaddexp.reduce(log_weights, axis=1, keepdims=True)), axis=0)
