"""Pareto-smoothed importance sampling over the draws of a run."""

import math

import numpy as np
from jaxtyping import Float

from bayes_greybox.criticism.convergence import array_stats
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.running.errors import InputError

MIN_DRAWS = 25
"""Fewest draws with a tail that Pareto smoothing can fit."""


def smoothed_weights(
    log_ratio: Float[np.ndarray, "n_fold n_draw"], r_eff: float = 1.0
) -> tuple[Float[np.ndarray, "n_fold n_draw"], Float[np.ndarray, " n_fold"]]:
    """Return normalised log weights, w ∝ exp(log ratio) smoothed (Vehtari et al. 2024), and k̂, for each fold."""
    log_weight = np.full(log_ratio.shape, -math.log(log_ratio.shape[1]))
    khat = np.zeros(len(log_ratio))
    # PSIS refuses equal ratios, which need no smoothing.
    varies = np.ptp(log_ratio, axis=1) > 0
    if varies.any():
        log_weight[varies], khat[varies] = array_stats().psislw(-log_ratio[varies], r_eff=r_eff, axis=-1)
    return log_weight, khat


def smoothed(
    values: Float[np.ndarray, "n_draw n_fold"], log_ratio: Float[np.ndarray, "n_draw n_fold"], r_eff: float
) -> tuple[Float[np.ndarray, " n_fold"], Float[np.ndarray, " n_fold"], Float[np.ndarray, " n_fold"]]:
    """Return elpd_F = log Σ_s w_s p(y_F | …, η_s), the log of the plain mean of the densities, and k̂ of each fold."""
    log_weight, khat = smoothed_weights(log_ratio.T, r_eff)
    return np.logaddexp.reduce(log_weight + values.T, axis=1), log_mean(values), khat


def log_mean(values: Float[np.ndarray, "n_draw n_fold"]) -> Float[np.ndarray, " n_fold"]:
    """Return the log of the mean density over the draws."""
    return np.logaddexp.reduce(values, axis=0) - math.log(len(values))


def khat_threshold(n_draw: int) -> float:
    """Return min(1 − 1/log₁₀ S, 0.7) for S draws (Vehtari, Simpson, Gelman, Yao & Gabry 2024)."""
    return min(1 - 1 / math.log10(n_draw), 0.7)


def count_draws(posterior: Posterior, at_most: int | None) -> int:
    """Return the number of draws after thinning; raise InputError if there are fewer than MIN_DRAWS."""
    group = posterior.idata["posterior"].dataset
    n_draw = group.sizes["chain"] * group.sizes["draw"]
    n_draw = n_draw if at_most is None else min(n_draw, at_most)
    if n_draw < MIN_DRAWS:
        raise InputError(f"Cross-validation needs at least {MIN_DRAWS} posterior draws, not {n_draw}: raise draws.")
    return n_draw


def relative_efficiency(posterior: Posterior, equation: str, n_draw: int) -> float:
    """Return effective over actual draws, averaged over hyperparameters and coefficients of the equation, at most 1."""
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
