"""Power-scaling sensitivity: the change of θ and P(γ) when prior or likelihood get a little more or less weight."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

from bayes_greybox.criticism.convergence import array_stats
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.model.algebra.collapsed import Regression, patterns, spike_and_slab
from bayes_greybox.model.design import Design, EquationDraws
from bayes_greybox.running.arrays import on_device
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.traces import kept

ALPHAS = (0.99, 1.01)
"""Powers that prior and likelihood are raised to, one at a time."""

SENSITIVITY_THRESHOLD = 0.05
"""Sensitivity from which on there is a diagnosis (Kallioinen et al. 2024): five points of an inclusion probability."""

LEAST_INCLUDED, SENSITIVITY_DRAWS = 100, 2000
"""Fewest draws with a term for which the sensitivity of its coefficient is computed, and most draws used."""

CONFLICT, DOMINANT, NOT_SENSITIVE = "prior and data pull apart", "the prior decides", "fine"
"""Diagnoses: both sensitivities high; that of the prior only; neither, or that of the likelihood only."""


def sensitivity(posterior: Posterior) -> pd.DataFrame:
    """Return the power-scaling sensitivity of every coefficient and inclusion probability (Kallioinen et al. 2024).

    The posterior is reweighted to p(θ)^α p(y | θ) and p(θ) p(y | θ)^α for α close to 1. The sensitivity of a
    coefficient, given that its term is included, is the change of its distribution for each doubling of α (cumulative
    Jensen-Shannon distance), as in `arviz_stats.psense`. That of an inclusion probability is the change of the
    probability itself: the distance is relative to the smaller of P and 1 − P, and large if 1e-9 becomes 2e-9.

    The prior of a hierarchy is scaled level by level, each normalised again given the level above: every site of the
    model to the power α, N(θ_j; 0, sd_j²) to N(θ_j; 0, sd_j²/α), and π to π^α/(π^α + (1 − π)^α). Without normalising,
    a power of a density over k coefficients would multiply a pattern's weight by a factor that depends on k and on the
    units. The likelihood is p(y | θ, η) with f integrated out; `arviz_stats.psense(fit.idata, group="likelihood")`
    answers another question, as the `log_likelihood` group has leave-one-out densities.

    P(γ_j = 1) is recomputed exactly for each draw of the hyperparameters, over all patterns, under every scaling, and
    averaged with importance weights in which θ and γ are summed out; draws of γ by Gibbs moves are reweighted with
    those of θ.

    Returns:
        Table indexed by (equation, quantity), quantities the terms and "P(term)": prior, likelihood, and diagnosis
        ("fine", "the prior decides", "prior and data pull apart").
    """
    posterior.require_rows("Sensitivity is found")
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    stats = array_stats()
    for name, equation in posterior.equations.items():
        most = equation.design.worthwhile(SENSITIVITY_DRAWS)
        draws = jax.tree.map(np.asarray, posterior.draws(name, most))
        joint, *summed = _powers(posterior, name, draws, most)
        weights = _normalised(joint)
        labels = equation.frame.labels
        gamma = posterior.drawn().get(posterior.sites[name].gamma)
        included = np.ones(draws.theta.shape, bool) if gamma is None else draws.theta != 0.0
        for j, label in enumerate(labels):
            inside, theta = included[:, j], draws.theta[:, j]
            if inside.sum() >= min(LEAST_INCLUDED, len(theta)) and np.ptp(theta[inside]) > 0:
                rows[label] = _row(*(_of_draws(stats, theta[inside], weights[i : i + 2, inside]) for i in (0, 2)))
        if gamma is None:
            continue
        if summed:
            collapsed, inclusion = summed
            scaled = np.einsum("ws,wsk->wk", _normalised(collapsed), inclusion[1:])
        else:
            scaled = weights @ included
        # The change of the probability for each doubling of α, from the two sides of 1
        moved = np.abs(scaled[1::2] - scaled[::2]) / np.log2(ALPHAS[1] / ALPHAS[0])
        for j, (state, term) in enumerate(labels):
            rows[(state, f"P({term})")] = _row(*moved[:, j].tolist())
    index = pd.MultiIndex.from_tuples(list(rows), names=["equation", "quantity"])
    return pd.DataFrame(list(rows.values()), index=index, columns=["prior", "likelihood", "diagnosis"])


def _row(prior: float, likelihood: float) -> dict[str, Any]:
    diagnosis = NOT_SENSITIVE
    if prior >= SENSITIVITY_THRESHOLD:
        diagnosis = CONFLICT if likelihood >= SENSITIVITY_THRESHOLD else DOMINANT
    return {"prior": prior, "likelihood": likelihood, "diagnosis": diagnosis}


def _of_draws(stats: Any, values: Float[np.ndarray, " n_draw"], weights: Float[np.ndarray, "two n_draw"]) -> float:
    low, high = ALPHAS
    arrays = values[None], *weights[:, None]
    return float(stats.power_scale_sense(*arrays, lower_alpha=low, upper_alpha=high, chain_axis=0, draw_axis=1))


def _normalised(log_ratio: Float[np.ndarray, "four n_draw"]) -> Float[np.ndarray, "four n_draw"]:
    """Return importance weights that sum to one; α is so close to 1 that they have no tail to smooth."""
    weights = np.exp(log_ratio - log_ratio.max(axis=1, keepdims=True))
    return weights / weights.sum(axis=1, keepdims=True)


def _powers(posterior: Posterior, equation: str, draws: EquationDraws, most: int) -> tuple[np.ndarray, ...]:
    """Return log weights [four, n_draw] of each draw under the scalings; if patterns were summed, two arrays more.

    These are the log weights with θ and γ summed out, and P(γ | hyperparameters) [five, n_draw, n_term]. Scalings are
    in the order prior 0.99, prior 1.01, likelihood 0.99, likelihood 1.01; probabilities have the unscaled first.
    """
    design, values = posterior.equations[equation].design, posterior.values(equation, most)
    scales = posterior.slab(equation, most)
    summed = not design.coefficients.bounded and scales is not None
    if "log_prior" not in posterior.idata.children:
        raise InputError(
            "The fit lacks the group 'log_prior', without which prior and data cannot be told apart: its file was "
            "changed since it was saved; fit and save again."
        )
    log_prior = posterior.values(equation, most, "log_prior")
    sites = [value for quantity, value in log_prior.items() if quantity not in ("theta", "gamma")]
    shape, has_gamma = draws.theta.shape, "gamma" in values
    top = np.sum(sites, axis=0) if sites else np.zeros(shape[0])
    if scales is not None and scales.log_odds is not None:
        slab, odds = np.asarray(scales.sd), np.asarray(scales.log_odds)
    else:
        # If the pattern is a site, only its own odds count, which do not depend on the term.
        slab, odds = np.ones(shape), np.zeros(shape)
        if has_gamma:
            odds = np.broadcast_to((np.log(values["pi"]) - np.log1p(-values["pi"]))[:, None], shape)
    items = (draws.hyper, draws.theta, draws.prior_sd, top, slab, odds)
    return tuple(
        np.moveaxis(np.asarray(each), 1, 0) for each in _evaluated(summed, has_gamma)(design, on_device(items))
    )


def _evaluated(enumerated: bool, has_gamma: bool) -> Callable[..., Any]:
    def one(design: Design, item: tuple) -> tuple[Array, ...]:
        hyper, theta, sd, top, slab, log_odds = item
        coefficients = design.coefficients
        regression = design.remove_discrepancy(design.y, hyper)[0].beside(coefficients.mean)
        inside = sd > 0
        away = jnp.where(inside, theta - coefficients.mean, 0.0)
        squares = jnp.sum((away / jnp.where(inside, sd, 1.0)) ** 2)
        count = jnp.sum(inside)
        # log p(y | θ, η), up to a constant of the data
        misfit = -0.5 * (jnp.sum((regression.q - regression.T @ away) ** 2) + regression.log_det)

        def pattern(alpha: float) -> Array:
            """Return log p_α(γ | π): log π for an included term, log(1 − π) for an excluded one."""
            return -jnp.sum(jnp.logaddexp(0.0, jnp.where(inside, -alpha, alpha) * log_odds))

        joint = []
        for alpha in ALPHAS:
            level = 0.5 * count * jnp.log(alpha) - 0.5 * (alpha - 1) * squares
            level += coefficients.log_restriction(sd, alpha) - coefficients.log_restriction(sd)
            joint.append((alpha - 1) * top + level + (pattern(alpha) - pattern(1.0) if has_gamma else 0.0))
        joint += [(alpha - 1) * misfit for alpha in ALPHAS]
        if not enumerated:
            return (jnp.stack(joint),)
        powers = [(1.0, 1.0), *((alpha, 1.0) for alpha in ALPHAS), *((1.0, alpha) for alpha in ALPHAS)]
        summed = (_summed(regression, slab, log_odds, coefficients.certain, *each) for each in powers)
        total, probability = zip(*summed, strict=True)
        shift = [(alpha - 1) * top for alpha in ALPHAS] + [0.0, 0.0]
        collapsed = [value - total[0] + extra for value, extra in zip(total[1:], shift, strict=True)]
        return jnp.stack(joint), jnp.stack(collapsed), jnp.stack(probability)

    def every(design: Design, items: tuple) -> tuple[Array, ...]:
        return jax.lax.map(lambda item: one(design, item), items)

    return kept(every, (enumerated, has_gamma), "sensitivity", once=True)


def _summed(
    regression: Regression, slab: Float[Array, " n_term"], log_odds: Float[Array, " n_term"],
    certain: tuple[int, ...], prior: float, likelihood: float,
) -> tuple[Array, Array]:  # fmt: skip
    """Return log Σ_γ p_α(γ | π) p_α(y | γ, η) and P(γ_j = 1) under it.

    p_α(y | γ, η) = ∫ N(θ; 0, τ²/α) p(y | θ, η)^β dθ, α the power of the prior and β that of the likelihood: the
    evidence of the remaining regression with T and q times √β.
    """
    root = jnp.sqrt(likelihood)
    scaled = Regression(root * regression.T, root * regression.q, likelihood * regression.log_det)
    total, log_weight = spike_and_slab(scaled, slab / jnp.sqrt(prior), prior * log_odds, 0.0, certain)
    return total, jnp.exp(log_weight) @ jnp.asarray(patterns(len(slab), certain))
