"""The worth of draws: effective sample sizes, R̂, and whether θ agrees with that of another sampler."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from .drawn import Drawn

LEAST_DRAWS = 8
"""Draws of each chain below which nothing is said of them."""


def figures(drawn: Drawn) -> dict[str, Any]:
    """Return the figures of a run.

    Returns:
        `draws` of each chain; `ess_theta` and `ess_eta`, the smallest bulk effective sample sizes; `r_hat_theta` and
        `r_hat`, the largest rank-normalised R̂ of θ and of both; `first`, seconds to the first look at which all have
        R̂ ≤ 1.01 and an effective sample size of 400, NaN where there is none; `gradients` for an effective draw of the
        slowest of both; `divergences`; `mean`, `sd` and `mcse` of each coefficient.
    """
    theta, eta = drawn.theta, drawn.eta
    found = {"draws": theta.shape[1], "divergences": drawn.divergences}
    if theta.shape[1] < LEAST_DRAWS:
        return found
    of_theta, of_eta = _mixing(theta), _mixing(eta)
    least = min(of_theta["ess"], of_eta["ess"])
    return {
        **found,
        "ess_theta": of_theta["ess"],
        "ess_eta": of_eta["ess"],
        "r_hat_theta": of_theta["r_hat"],
        "r_hat": max(of_theta["r_hat"], of_eta["r_hat"]),
        "first": first_answer(drawn),
        "gradients": drawn.gradients / least,
        "mean": theta.mean(axis=(0, 1)).tolist(),
        "sd": theta.std(axis=(0, 1)).tolist(),
        "mcse": _errors(theta).tolist(),
    }


def first_answer(drawn: Drawn) -> float:
    """Return seconds to the first look at which the draws so far had converged; NaN where they never had."""
    from bayes_greybox.criticism.convergence import MAX_R_HAT, MIN_ESS

    both = np.concatenate([drawn.theta, drawn.eta], axis=2)
    for seconds, n in drawn.looks:
        if n >= LEAST_DRAWS and n * len(both) >= MIN_ESS:
            found = _mixing(both[:, :n])
            if found["r_hat"] <= MAX_R_HAT and found["ess"] >= MIN_ESS:
                return seconds
    return math.nan


def apart(row: Mapping[str, Any], other: Mapping[str, Any]) -> tuple[float, float]:
    """Return how far the posterior means of θ are from those of another sampler, at most.

    Returns:
        In standard deviations of the other's posterior, and in standard errors of the difference of both means. NaN
        where one has no draws.
    """
    if "mean" not in row or "mean" not in other:
        return math.nan, math.nan
    off = np.abs(np.subtract(row["mean"], other["mean"]))
    return float(np.max(off / np.asarray(other["sd"]))), float(np.max(off / np.hypot(row["mcse"], other["mcse"])))


def _mixing(draws: Float[np.ndarray, "n_chain n_draw n"]) -> dict[str, float]:
    """Return the smallest bulk effective sample size and largest R̂; of chains that stand still the worst there is."""
    from bayes_greybox.criticism.convergence import array_stats

    stats = array_stats()
    ess, r_hat = [], []
    for column in np.moveaxis(draws, -1, 0):
        scaled = (column - column.mean()) / column.std() if np.ptp(column) > 0 else column
        with np.errstate(divide="ignore", invalid="ignore"):
            ess.append(float(stats.ess(scaled, method="bulk")))
            r_hat.append(float(stats.rhat(scaled, method="rank")))
    known = np.isfinite(ess) & np.isfinite(r_hat)
    return {"ess": min(ess), "r_hat": max(r_hat)} if known.all() else {"ess": math.nan, "r_hat": math.inf}


def _errors(theta: Float[np.ndarray, "n_chain n_draw n_term"]) -> Float[np.ndarray, " n_term"]:
    """Return standard errors of the posterior means."""
    from bayes_greybox.criticism.convergence import array_stats

    stats = array_stats()
    return np.array([float(stats.mcse(column, method="mean")) for column in np.moveaxis(theta, -1, 0)])
