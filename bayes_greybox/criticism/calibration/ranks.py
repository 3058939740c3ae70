"""Ranks of true values among posterior draws: thinned by their autocorrelation, with random ties."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpyro.diagnostics import effective_sample_size


class Ranks(NamedTuple):
    """Ranks of true values, one for each replicate, and the effective sample size of all its draws.

    A rank is the number of `kept` thinned draws below the truth, and a random share of those equal to it. `pit` is
    (rank + U)/(kept + 1), U ~ Uniform(0, 1): uniform if the sampler is right, whatever the thinning.
    """

    rank: Int[np.ndarray, " n_replicate"]
    kept: Int[np.ndarray, " n_replicate"]
    pit: Float[np.ndarray, " n_replicate"]
    ess: Float[np.ndarray, " n_replicate"]


def rank_truths(
    truth: Float[np.ndarray, " n_replicate"], draws: Float[np.ndarray, "n_replicate n_draw"],
    generator: np.random.Generator,
) -> Ranks:  # fmt: skip
    """Rank each truth among the chain of its replicate, thinned to about as many draws as are independent.

    Ranks among correlated draws pile up at both ends (Talts et al. 2018, Sec. 5.1). Discrete quantities and exact
    zeros tie; breaking ties at random keeps the rank uniform (Modrák et al. 2023, Sec. 3).
    """
    n_draw = draws.shape[1]
    moving = np.ptp(draws, axis=1) > 0
    ess = np.full(len(truth), float(n_draw))
    if moving.any():
        # One chain, with the replicates as coordinates.
        ess[moving] = effective_sample_size(draws[moving].T[None])
    ess = np.clip(np.where(np.isfinite(ess), ess, 1.0), 1.0, n_draw)
    step = np.ceil(n_draw / ess).astype(int)
    # Counted from the end, so that the last draw, farthest from the start, is always kept.
    kept = (np.arange(n_draw)[::-1] % step[:, None]) == 0
    below = np.sum(kept & (draws < truth[:, None]), axis=1)
    ties = np.sum(kept & (draws == truth[:, None]), axis=1)
    rank, number = below + generator.integers(0, ties + 1), kept.sum(axis=1)
    return Ranks(rank, number, (rank + generator.random(len(rank))) / (number + 1), ess)
