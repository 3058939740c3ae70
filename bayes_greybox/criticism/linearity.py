"""Distance of a posterior on linear rows from that on exact paths: importance weights and their k̂."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.model.rows.equation_rows import Columns, EquationRows

from .cross_validation.psis import MIN_DRAWS, khat_threshold, smoothed_weights

MOST_FOLLOWED, MOST_PATH_POINTS = 200, 2_000_000
"""Most posterior draws whose exact paths are followed, and most points of all paths together."""

ELSEWHERE = 0.2
"""Largest share of the exact posterior that may lie elsewhere if k̂ is large."""


class Linearity(NamedTuple):
    """Distance of a posterior on linear rows from the exact one.

    k̂ is that of the weights, exact over linear density: zero for linear rows, NaN if unknown. Up to its limit weighted
    draws can represent the exact posterior. `elsewhere` is ½ E|w/E w − 1|, the total variation distance, which bounds
    the error of any probability; the estimate is too small if hardly any draw lies where the exact posterior is.
    """

    khat: float
    limit: float
    elsewhere: float = 0.0

    @property
    def ok(self) -> bool:
        """True if the draws, weighted or as they are, represent the exact posterior."""
        # k̂ describes only the tail of the weights, and is rough for few draws; the distance complements it.
        return not (self.khat > self.limit and self.elsewhere > ELSEWHERE)


def linearity(posterior: Posterior, equation: str) -> Linearity:
    """Follow exact paths at posterior draws, and weight the draws by them.

    k̂ is unknown if f has no values off the data (`path="exact"`), or if the noise has an unknown force.
    """
    entry = posterior.equations[equation]
    design, frame, rows = entry.design, entry.frame, entry.rows
    posterior.require_rows("Linearity is found")
    draws = posterior.draws(equation, draws_followed(rows))
    if rows.exact is not None and not design.expands and draws.f.shape[1]:
        return Linearity(math.nan, khat_threshold(max(len(draws.theta), MIN_DRAWS)))
    weight = np.asarray(draws.weight)
    acting = [[label[0] == state for label in frame.labels] for state in rows.learned]

    def added(columns: Columns, draw: int) -> np.ndarray:
        Phi = np.asarray(frame.dictionary_rows(columns))
        f = frame.f(columns, Phi, weight[draw]) if weight.shape[1] else 0.0
        return frame.target_scale * np.column_stack([Phi[:, terms] @ draws.theta[draw, terms] + f for terms in acting])

    return linearity_of_paths(rows, added, frame.target_scale * np.asarray(draws.hyper.sigma))


def draws_followed(rows: EquationRows) -> int:
    """Return the number of draws whose exact paths are followed."""
    return int(np.clip(MOST_PATH_POINTS // rows.n_sample, MIN_DRAWS, MOST_FOLLOWED))


def linearity_of_paths(
    rows: EquationRows, added: Callable[[Columns, int], Float[np.ndarray, "n n_learned"]],
    sigma: Float[np.ndarray, " n_draw"], beside: Float[np.ndarray, "n_draw n_row"] | float = 0.0,
) -> Linearity:  # fmt: skip
    """Judge the weights w = p(y | exact path) / p(y | linear rows) at posterior draws.

    Each draw of the coefficients has a draw of the starts; both densities are those of the sensors' noise. k̂ and its
    limit are those of Vehtari, Simpson, Gelman, Yao & Gabry (2024), eq. 10; Yao, Vehtari, Simpson & Gelman (2018, ICML)
    judge approximations by it. In user's units, each draw adds `added` to the rates of the learned states and has noise
    `sigma`; `beside` is the part of the rows that is not on the path, such as sensor errors in the model.
    """
    if len(sigma) < MIN_DRAWS:
        return Linearity(math.nan, math.nan)
    limit = khat_threshold(len(sigma))
    if rows.exact is None:
        return Linearity(0.0, limit)
    if rows.noise.moved:
        return Linearity(math.nan, limit)
    white = np.random.default_rng(0).standard_normal((rows.noise.n_start, len(sigma)))
    response = np.zeros((rows.n_row, len(sigma)))
    for k, acting in enumerate(rows.learned.values()):
        response += acting.operator.of(
            lambda columns, k=k: np.column_stack([added(columns, s)[:, k] for s in range(len(sigma))]), rows.columns
        )
    residual = rows.target - response.T - beside
    starts, linear = rows.noise.starts_given((residual / sigma[:, None]).T, white)
    exact = (rows.measured - rows.exact(added, (starts * sigma).T) - beside) / sigma[:, None]
    error = rows.noise.error
    # Paths that diverge have no weight.
    with np.errstate(over="ignore", invalid="ignore"):
        square = np.sum(error.whiten(exact.T) ** 2, axis=0) - np.sum(error.whiten(linear) ** 2, axis=0)
    log_weight = np.where(np.isfinite(square), -square / 2, -np.inf)
    if not np.any(np.isfinite(log_weight)):
        return Linearity(math.inf, limit, 1.0)
    # exp underflows beyond this range.
    log_weight = np.maximum(log_weight - np.max(log_weight), -700.0)
    if np.ptp(log_weight) == 0:
        return Linearity(0.0, limit)
    # A single weight may have all of the sum.
    with np.errstate(divide="ignore", invalid="ignore"):
        khat = float(smoothed_weights(log_weight[None])[1][0])
    weight = np.exp(log_weight)
    return Linearity(khat, limit, float(np.mean(np.abs(weight / np.mean(weight) - 1)) / 2))
