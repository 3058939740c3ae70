"""Densities of folds given the others, or given their past; closed forms given the hyperparameters."""

import math
from collections.abc import Iterator, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import logsumexp
from jaxtyping import Array, Bool, Float, Int

from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.model.algebra.collapsed import log_pattern_weights, ridge
from bayes_greybox.model.algebra.linalg import solve_lower
from bayes_greybox.model.design import Design, WeightedRows
from bayes_greybox.model.gp.hyper import Hyperparameters
from bayes_greybox.model.likelihood import log_density
from bayes_greybox.model.priors import Scales
from bayes_greybox.running.compiling import compiled

from .row_densities import ROW_BLOCK, in_blocks

Members = Sequence[Int[np.ndarray, " _"]]


def fold_densities(
    posterior: Posterior, equation: str, parameters: tuple[Hyperparameters, Scales], folds: Members,
    index: np.ndarray | None = None,
) -> Iterator[Float[np.ndarray, "n_draw n_block"]]:  # fmt: skip
    """Yield log p(y_F | y₋F, η) of consecutive folds and every draw, θ and f integrated out; user's units.

    With g = C⁻¹y and P = (C⁻¹)_FF,

        log p(y_F | y₋F, η) = ½ log|P| − ½ g_Fᵀ P⁻¹ g_F − ½ |F| log 2π,

    the block form of Sundararajan & Keerthi 2001. On the feature path P = σ⁻² ((R⁻¹)_FF − H_FᵀH_F) by Woodbury's
    identity, so a draw costs N (K + M)², as for single rows. For folds with more rows than there are columns this is
    log p(y) − log p(y₋F), each a problem of order K + M.

    If the sampler summed over the patterns of a spike-and-slab prior, they are summed here too, with and without the
    fold: no weights of drawn patterns could represent a fold that alone decides about a term. With u ~ N(m, V) the
    coefficients over τ given y if all terms are included, and J = cov(u, y) C⁻¹,

        m₋F = m − J_F P⁻¹ g_F,   V₋F = V + J_F P⁻¹ J_Fᵀ,
        p(y_F | y₋F, η) = p(y_F | y₋F, η, γ = 1) Σ_γ w_γ(m, V) / Σ_γ w_γ(m₋F, V₋F),

    with the weights of `model.algebra.collapsed.log_pattern_weights`. Patterns that Gibbs moves drew are conditioned on
    like η; so are patterns and coefficients if any of these has bounds. The draws, from `fold_parameters`, may be those
    of another run.
    """
    index = np.arange(len(folds)) if index is None else index
    entry = posterior.equations[equation]
    unit = math.log(entry.frame.target_scale * entry.rows.gain)
    size = max(len(fold) for fold in folds)
    if entry.design.removes(size):
        whole = subset_density(entry.design, parameters)
        for i in index:
            rest = subset_density(entry.without(folds[i].tolist()).design, parameters)
            yield (whole - rest - len(folds[i]) * unit)[:, None]
        return
    weighted, blocks = entry.weighted(), entry.rows.precision_blocks(folds)
    for part, padded in in_blocks(index, max(1, ROW_BLOCK // size)):
        numbers = np.stack([np.concatenate([folds[i], np.full(size - len(folds[i]), folds[i][-1])]) for i in padded])
        counts = np.arange(size) < np.array([[len(folds[i])] for i in padded])
        stacked = jnp.asarray(counts), jnp.asarray(blocks(numbers))
        values = np.asarray(_mapped(entry.design, weighted(numbers.ravel()), *stacked, parameters))[:, : len(part)]
        yield values - unit * np.array([len(folds[i]) for i in part])


def past_densities(
    posterior: Posterior, equation: str, parameters: tuple[Hyperparameters, Scales],
    first: Int[np.ndarray, " n_past"], folds: Members,
) -> Float[np.ndarray, "n_draw n_fold_and_1"]:  # fmt: skip
    """Return the densities log p(y_A | η) of the first rows A, and of A with one, two, … folds more, user's units.

    Their differences are log p(y_F | y_past, η) of each fold, which are in order of time; patterns are summed as in
    `fold_densities`. On the exact path one Cholesky factorisation of K⊥ + σ²R in the order of time serves all.
    """
    entry = posterior.equations[equation]
    counts = len(first) + np.cumsum([0, *map(len, folds)])
    unit = counts * math.log(entry.frame.target_scale * entry.rows.gain)
    order = np.concatenate([first, *folds])
    at_once = entry.design.first_densities(order, counts, parameters)
    if at_once is not None:
        log_det = np.array([entry.rows.log_det_of(order[:count]) for count in counts])
        return at_once - 0.5 * log_det - unit
    out = [np.setdiff1d(np.arange(entry.rows.n_row), order[:count]) for count in counts]
    parts = [entry.without(rows.tolist()).design for rows in out]
    return np.stack([subset_density(part, parameters) for part in parts], axis=1) - unit


def fold_parameters(posterior: Posterior, equation: str, at_most: int | None = None) -> tuple[Hyperparameters, Scales]:
    """Return η and the scales of θ, stacked over draws: those of the slab with odds if the patterns are summed."""
    draws, summed = posterior.draws(equation, at_most), posterior.summed(equation, at_most)
    scales = Scales(jnp.asarray(draws.spread), mean=jnp.asarray(draws.mean)) if summed is None else summed
    return jax.tree.map(jnp.asarray, draws.hyper), scales


def subset_density(design: Design, parameters: tuple[Hyperparameters, Scales]) -> Float[np.ndarray, " n_draw"]:
    """Return log p(y_A | η) of the rows of a design, scaled units."""
    return np.asarray(_subset(design.padded(), parameters))


@compiled
def _subset(design: Design, parameters: tuple[Hyperparameters, Scales]) -> Array:
    return jax.lax.map(lambda item: log_density(design, *item, design.y), parameters)


@compiled
def _mapped(
    design: Design, rows: WeightedRows, counts: Bool[Array, "n_fold size"], precision: Float[Array, "n_fold size size"],
    parameters: tuple[Hyperparameters, Scales],
) -> Array:  # fmt: skip
    """Return the densities of folds padded to one size, given which rows count and (R⁻¹)_FF."""
    (n_fold, size), n_term = counts.shape, design.Phi.shape[1]

    def one(item: tuple[Hyperparameters, Scales]) -> Array:
        hyper, (sd, log_odds, mean, _) = item
        centred = design if mean is None else design.beside(mean)
        root = centred.root(rows if mean is None else rows.beside(mean), hyper, sd)
        H, g = root.H.T.reshape(n_fold, size, -1), root.g.reshape(n_fold, size)
        J = root.J.T.reshape(n_fold, size, n_term)
        posterior = ridge(centred.remove_discrepancy(centred.y, hyper)[0], sd, design.n_obs)
        m, V, certain = posterior.mean, posterior.covariance, design.coefficients.certain

        def fold(item: tuple[Array, Array, Array, Array, Array]) -> Array:
            H, g, J, counts, precision = item
            P = design.inverse(H, H, precision, hyper)
            # Padding rows are independent, with unit variance and no residual.
            P = jnp.where(counts[:, None] & counts, P, jnp.eye(size))
            L = jnp.linalg.cholesky(P)
            z = solve_lower(L, jnp.where(counts, g, 0.0))
            value = jnp.sum(jnp.log(jnp.diag(L))) - 0.5 * (jnp.sum(z**2) + jnp.sum(counts) * math.log(2 * math.pi))
            if log_odds is None:
                return value
            G = solve_lower(L, jnp.where(counts[:, None], J, 0.0))
            without = log_pattern_weights(m - G.T @ z, V + G.T @ G, log_odds, certain)
            return value + logsumexp(log_pattern_weights(m, V, log_odds, certain)) - logsumexp(without)

        # Fold by fold, since batched factorisations inside a loop can deadlock (see row_densities).
        return jax.lax.map(fold, (H, g, J, counts, precision))

    return jax.lax.map(one, parameters)
