"""How far a posterior on linear rows is from that of the exact paths: importance weights, and their k̂."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.model.rows.equation_rows import Columns, EquationRows

from .convergence import array_stats
from .cross_validation.psis import MIN_DRAWS, khat_threshold

DRAWS = 200
"""Posterior draws whose exact paths are followed."""

POINTS = 2_000_000
"""Points of all paths together: of long records fewer draws are followed, down to `MIN_DRAWS`."""

ELSEWHERE = 0.2
"""Probability that may lie elsewhere in the exact posterior, where k̂ is large."""

FAINT = 700.0
"""Logarithm of what a weight is over the largest, at least: exp still has a value."""


class Linearity(NamedTuple):
    """How far a posterior on linear rows is from the exact one.

    Attributes:
        khat: k̂ of the weights exact over linear; zero where rows are linear, NaN where it is not known.
        limit: k̂ up to which the draws can stand for the exact posterior by their weights.
        elsewhere: ½ E|w/E w − 1|, the total variation distance, which no probability is off by more than; estimated,
            and too small where hardly a draw is where the exact posterior is.
    """

    khat: float
    limit: float
    elsewhere: float = 0.0

    @property
    def ok(self) -> bool:
        """Whether draws can be weighed to the exact posterior, or are so near that they need not be.

        A k̂ speaks of the tail of the weights alone, and of few draws it is rough; the distance is neither.
        """
        return not (self.khat > self.limit and self.elsewhere > ELSEWHERE)


def linearity(posterior: Posterior, equation: str) -> Linearity:
    """Follow exact paths at posterior draws, and weigh them.

    Args:
        posterior: Fitted model.
        equation: Learned state, or the rows that several share.

    Returns:
        k̂ is not known where f has no value off the data (`path="exact"`), or an unknown force is in the noise.
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
        return frame.target_scale * np.column_stack([Phi[:, own] @ draws.theta[draw, own] + f for own in acting])

    return linearity_of_paths(rows, added, frame.target_scale * np.asarray(draws.hyper.sigma))


def draws_followed(rows: EquationRows) -> int:
    """How many draws are worth following."""
    return int(np.clip(POINTS // rows.n_sample, MIN_DRAWS, DRAWS))


def linearity_of_paths(
    rows: EquationRows, added: Callable[[Columns, int], Float[np.ndarray, "n n_learned"]],
    sigma: Float[np.ndarray, " n_draw"], beside: Float[np.ndarray, "n_draw n_row"] | float = 0.0, seed: int = 0,
) -> Linearity:  # fmt: skip
    """Weights w = p(y | exact path) / p(y | linear rows) at posterior draws.

    A draw of the starts belongs to each draw of the coefficients; both densities are those of the sensors' noise. k̂ is
    that of Vehtari, Simpson, Gelman, Yao & Gabry (2024), eq. 10 for its limit; as a judge of an approximation, Yao,
    Vehtari, Simpson & Gelman (2018, ICML).

    Args:
        rows: That are linear near a model.
        added: What each draw adds to the rates of the learned states, user's units.
        sigma: Noise of each draw, user's units.
        beside: What is in the rows and not on the path, as errors of sensors that are in the model; user's units.
        seed: Of the draws of starts.
    """
    if len(sigma) < MIN_DRAWS:
        return Linearity(math.nan, math.nan)
    limit = khat_threshold(len(sigma))
    if rows.exact is None:
        return Linearity(0.0, limit)
    if rows.noise.moved:
        return Linearity(math.nan, limit)
    white = np.random.default_rng(seed).standard_normal((rows.noise.n_start, len(sigma)))
    residual = rows.target - _answered(rows, added, len(sigma)) - beside
    starts, linear = rows.noise.starts_given((residual / sigma[:, None]).T, white)
    exact = (rows.measured - rows.exact(added, (starts * sigma).T) - beside) / sigma[:, None]
    error = rows.noise.error
    # Paths that leave all bounds weigh nothing.
    with np.errstate(over="ignore", invalid="ignore"):
        square = np.sum(error.whiten(exact.T) ** 2, axis=0) - np.sum(error.whiten(linear) ** 2, axis=0)
    log_weight = np.where(np.isfinite(square), -square / 2, -np.inf)
    if not np.any(np.isfinite(log_weight)):
        return Linearity(math.inf, limit, 1.0)
    log_weight = np.maximum(log_weight - np.max(log_weight), -FAINT)
    if np.ptp(log_weight) == 0:
        return Linearity(0.0, limit)
    # One weight may be all of them.
    with np.errstate(divide="ignore", invalid="ignore"):
        khat = float(np.asarray(array_stats().psislw(-log_weight[None], r_eff=1.0, axis=-1)[1])[0])
    weight = np.exp(log_weight)
    return Linearity(khat, limit, float(np.mean(np.abs(weight / np.mean(weight) - 1)) / 2))


def _answered(
    rows: EquationRows, added: Callable[[Columns, int], Float[np.ndarray, "n n_learned"]], n_draw: int
) -> Float[np.ndarray, "n_draw n_row"]:
    """What linear rows say of the forces of each draw."""
    found = np.zeros((rows.n_row, n_draw))
    for k, acting in enumerate(rows.learned.values()):
        found += acting.operator.of(
            lambda columns, k=k: np.column_stack([added(columns, draw)[:, k] for draw in range(n_draw)]), rows.columns
        )
    return found.T
