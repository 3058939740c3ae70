"""One coefficient in many assets: its mean over all of them, and its spread between them.

    b_i ~ N(β_i, s_i²),   β_i ~ N(μ, τ²),   p(μ) ∝ 1,   τ = 0 or τ ~ HalfNormal(r/3), evenly

with b_i and s_i the posterior mean and standard deviation of each asset, and r = max(√mean b_i², min s_i). Given τ all
is Gaussian, so that one integral over τ is left (Gelman et al. 2013, Bayesian Data Analysis, 3rd ed., section 5.4,
Eqs. 5.17 to 5.21).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from bayes_greybox.running.errors import InputError

DIFFER = 1 / 3
"""Scale of the prior of τ over r, the size of the coefficients: assets of one kind differ by less than they have."""


@dataclass(frozen=True)
class Pooled:
    """A coefficient over many assets; intervals hold 90 %.

    Attributes:
        mean, sd, lower, upper: Moments and interval of μ, the mean coefficient.
        between, between_lower, between_upper: Median and interval of τ, the standard deviation between assets.
        same: Probability that all have one coefficient, τ = 0, which has 0.5 beforehand.
        each, each_sd: Moments of each asset's own β_i.
    """

    mean: float
    sd: float
    lower: float
    upper: float
    between: float
    between_lower: float
    between_upper: float
    same: float
    each: tuple[float, ...]
    each_sd: tuple[float, ...]


def pooled(mean: Sequence[float], sd: Sequence[float]) -> Pooled:
    """Pool the posterior means and standard deviations of a coefficient in each asset, in one unit, partially.

    Raises:
        InputError: Fewer than two assets, or one without a finite mean and a standard deviation above zero.
    """
    b, s = np.asarray(mean, float), np.asarray(sd, float)
    if len(b) < 2 or len(b) != len(s):
        raise InputError("A coefficient is pooled over two assets or more, each with a mean and a standard deviation.")
    if not (np.all(np.isfinite(b)) and np.all(s > 0) and np.all(np.isfinite(s))):
        raise InputError("Every asset needs a finite mean and a standard deviation above zero to be pooled.")
    scale = DIFFER * max(float(np.sqrt(np.mean(b**2))), float(np.min(s)))
    # From far below the smallest s_i to far beyond the prior's scale.
    tau = np.concatenate([[0.0], np.geomspace(1e-4 * float(np.min(s)), 8.0 * scale, 800)])
    variance = s**2 + tau[:, None] ** 2
    precision = np.sum(1 / variance, axis=1)
    # μ | τ, b ~ N(μ̂, V)  (5.20)
    centre, V = np.sum(b / variance, axis=1) / precision, 1 / precision
    # p(b | τ) ∝ V^½ Π (s_i² + τ²)^-½ exp(−(b_i − μ̂)²/2(s_i² + τ²))  (5.21)
    log_b = 0.5 * np.log(V) - 0.5 * np.sum(np.log(variance) + (b - centre[:, None]) ** 2 / variance, axis=1)
    log_prior = np.log(2) - 0.5 * np.log(2 * np.pi) - np.log(scale) - 0.5 * (tau / scale) ** 2
    edges = np.concatenate([[0.0], (tau[1:] + tau[:-1]) / 2, [tau[-1]]])
    log_weight = log_b + log_prior + np.log(np.diff(edges))
    log_differ = float(np.logaddexp.reduce(log_weight))
    same = float(1 / (1 + np.exp(np.clip(log_differ - log_b[0], -700, 700))))
    weight = (1 - same) * np.exp(log_weight - log_differ)
    weight[0] += same
    on_the_whole = float(weight @ centre)
    spread = float(np.sqrt(weight @ (V + (centre - on_the_whole) ** 2)))
    # Quantiles of a mixture of Gaussians.
    ends = float(np.min(centre - 8 * np.sqrt(V))), float(np.max(centre + 8 * np.sqrt(V)))
    lower, upper = (
        float(cast(float, brentq(lambda x, p=p: weight @ ndtr((x - centre) / np.sqrt(V)) - p, *ends)))
        for p in (0.05, 0.95)
    )
    low, middle, high = np.interp([0.05, 0.5, 0.95], np.cumsum(weight), np.concatenate([[0.0], edges[2:]]))
    # β_i | τ, b: a share s_i²/(s_i² + τ²) of the whole's
    share = s**2 / variance
    own = (1 - share) * b + share * centre[:, None]
    own_variance = (1 - share) * s**2 + share**2 * V[:, None]
    each = weight @ own
    each_sd = np.sqrt(weight @ (own_variance + (own - each) ** 2))
    whole = (on_the_whole, spread, lower, upper, float(middle), float(low), float(high), same)
    return Pooled(*whole, tuple(each.tolist()), tuple(each_sd.tolist()))
