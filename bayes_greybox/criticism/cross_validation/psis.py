"""Pareto-smoothed importance sampling over the draws of a run."""

import math

import numpy as np
from jaxtyping import Float

from bayes_greybox.criticism.convergence import array_stats
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.running.errors import InputError

MIN_DRAWS = 25
"""Fewer draws have no tail for Pareto smoothing to fit."""


def smoothed(
    values: Float[np.ndarray, "n_draw n_fold"], log_ratio: Float[np.ndarray, "n_draw n_fold"], r_eff: float
) -> tuple[Float[np.ndarray, " n_fold"], Float[np.ndarray, " n_fold"], Float[np.ndarray, " n_fold"]]:
    """elpd_F = log Σ_s w_s p(y_F | …, η_s), w_s ∝ exp(log ratio) smoothed (Vehtari et al. 2024).

    Returns:
        elpd, log of the plain mean of the densities, and k̂ of each fold.
    """
    values, log_ratio = values.T, log_ratio.T
    log_weight = np.full(values.shape, -math.log(values.shape[1]))
    khat = np.zeros(len(values))
    # Without any spread there is nothing to smooth, and PSIS refuses.
    varies = np.ptp(log_ratio, axis=1) > 0
    if varies.any():
        log_weight[varies], khat[varies] = array_stats().psislw(-log_ratio[varies], r_eff=r_eff, axis=-1)
    return np.logaddexp.reduce(log_weight + values, axis=1), log_mean(values.T), khat


def log_mean(values: Float[np.ndarray, "n_draw n_fold"]) -> Float[np.ndarray, " n_fold"]:
    """Log of the mean density over the draws."""
    return np.logaddexp.reduce(values, axis=0) - math.log(len(values))


def khat_threshold(n_draw: int) -> float:
    """min(1 − 1/log₁₀ S, 0.7) for S draws (Vehtari, Simpson, Gelman, Yao & Gabry 2024)."""
    return min(1 - 1 / math.log10(n_draw), 0.7)


def count_draws(posterior: Posterior, at_most: int | None) -> int:
    """Draws that are used.

    Raises:
        InputError: Fewer than MIN_DRAWS.
    """
    group = posterior.idata["posterior"].dataset
    n_draw = group.sizes["chain"] * group.sizes["draw"]
    n_draw = n_draw if at_most is None else min(n_draw, at_most)
    if n_draw < MIN_DRAWS:
        raise InputError(f"Cross-validation needs at least {MIN_DRAWS} posterior draws, not {n_draw}: raise draws.")
    return n_draw


def relative_efficiency(posterior: Posterior, equation: str, n_draw: int) -> float:
    """Effective over actual draws, mean over hyperparameters and coefficients of the equation, at most 1."""
    group = posterior.idata["posterior"].dataset
    if group.sizes["chain"] < 2 or group.sizes["draw"] < 4:
        return 1.0
    stats, sizes, own = array_stats(), [], posterior.sites[equation]
    for name in (own.sigma, own.amplitude, own.length_scale, own.theta):
        if name not in group:
            continue
        values = group[name].to_numpy()
        for draws in np.moveaxis(values.reshape(*values.shape[:2], -1), -1, 0):
            if np.ptp(draws) > 0:
                sizes.append(float(stats.ess(draws / draws.std(), method="mean")))
    return min(1.0, float(np.mean(sizes)) / n_draw) if sizes else 1.0
