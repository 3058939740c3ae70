"""Densities of folds given the others, or given their past, in closed form given the hyperparameters."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import logsumexp
from jaxtyping import Array, Bool, Float, Int

from bayes_greybox.inference.posterior import EquationDraws, Posterior
from bayes_greybox.model.collapsed import Remainder, log_evidence, ridge
from bayes_greybox.model.likelihood import DenseDesign, Design, FeatureDesign, Hyperparameters
from bayes_greybox.model.linalg import solve_lower
from bayes_greybox.model.priors import Scales
from bayes_greybox.model.subsets import log_pattern_weights

from .leave_out import kept_starts, leave_out, log_det_of_starts
from .pointwise import ROW_BLOCK, Rows, dense_root, feature_root, weighted_rows

Members = Sequence[Int[np.ndarray, " _"]]


class _Fold(NamedTuple):
    """Folds filled up to one size: their rows, which of them count, and (R⁻¹)_FF."""

    index: Int[Array, "n_fold size"]
    counts: Bool[Array, "n_fold size"]
    precision: Float[Array, "n_fold size size"]


def fold_blocks(
    posterior: Posterior, equation: str, draws: EquationDraws, folds: Members, index: np.ndarray | None = None
) -> Iterator[tuple[Int[np.ndarray, " n_block"], Float[np.ndarray, "n_draw n_block"]]]:
    """Densities log p(y_F | y₋F, η) of every fold and draw, θ and f integrated out.

    With g = C⁻¹y and P = (C⁻¹)_FF,

        log p(y_F | y₋F, η) = ½ log|P| − ½ g_Fᵀ P⁻¹ g_F − ½ |F| log 2π,

    the block form of Sundararajan & Keerthi 2001. On the feature path P = σ⁻² ((R⁻¹)_FF − H_FᵀH_F) by Woodbury's
    identity, so a draw costs N (K + M)², as for single rows. Folds with more rows than there are columns have
    instead log p(y) − log p(y₋F), each a problem of order K + M.

    Under a spike-and-slab prior whose patterns the sampler summed they are summed here too, with and without the fold:
    a fold that alone decides about a term would need weights that the drawn patterns cannot give. With u ~ N(m, V) the
    coefficients over τ given y if all terms are in, and J = cov(u, y) C⁻¹,

        m₋F = m − J_F P⁻¹ g_F,   V₋F = V + J_F P⁻¹ J_Fᵀ,
        p(y_F | y₋F, η) = p(y_F | y₋F, η, γ = 1) Σ_γ w_γ(m, V) / Σ_γ w_γ(m₋F, V₋F),

    with the weights of `model.subsets.log_pattern_weights`. Patterns that Gibbs moves drew are given with η.

    Args:
        posterior: Gives data, frame and design; the draws may be those of another run.
        equation: Learned state.
        draws: Scaled draws.
        folds: Observations of each fold, in increasing order.
        index: Numbers of the folds wanted; None: all.

    Yields:
        Numbers of some folds, and their densities in user's units.
    """
    index = np.arange(len(folds)) if index is None else index
    frame, design = posterior.equations[equation].frame, posterior.equations[equation].design
    parameters = fold_parameters(draws)
    unit = math.log(frame.target_scale)
    size = max(len(fold) for fold in folds)
    if not _by_precision(design, size):
        whole = subset_density(design, parameters)
        for i in index:
            rest = subset_density(leave_out(posterior, equation, folds[i].tolist()).design, parameters)
            yield np.array([i]), (whole - rest - len(folds[i]) * unit)[:, None]
        return
    noise = posterior.data.noise.get(equation)
    whole_rows = None if noise is None or isinstance(design, DenseDesign) else weighted_rows(posterior, equation)
    # Only a noise with a density in the rows' own coordinates correlates them; whitened coefficients are independent.
    correlated = noise is not None and noise.square and isinstance(design, FeatureDesign)
    band = noise.precision_band(_reach(folds)) if correlated and noise is not None else None
    together = min(max(1, ROW_BLOCK // size), len(index))
    for start in range(0, len(index), together):
        part = index[start : start + together]
        # A short last block is filled up, so that it does not compile anew.
        padded = np.concatenate([part, np.full(together - len(part), part[-1])])
        stacked = _stack([folds[i] for i in padded], size, band)
        rows = None
        if isinstance(design, FeatureDesign):
            flat = np.asarray(stacked.index).ravel()
            rows = weighted_rows(posterior, equation, flat) if whole_rows is None else _rows_at(whole_rows, flat)
        values = np.asarray(_mapped(design, rows, stacked, parameters))[:, : len(part)]
        yield part, values - unit * np.array([len(folds[i]) for i in part])


def past_densities(
    posterior: Posterior,
    equation: str,
    draws: EquationDraws,
    first: Int[np.ndarray, " n_past"],
    folds: Members,
) -> Float[np.ndarray, "n_draw n_fold_and_1"]:
    """Densities log p(y_A | η) of the first rows A, and of these with one, two, … folds more, user's units.

    Their differences are log p(y_F | y_past, η) of each fold; patterns are summed as in `fold_blocks`. On the exact
    path one Cholesky factorisation of K⊥ + σ²R in the order of time serves them all.

    Args:
        posterior: Gives data, frame and design; the draws may be those of another run.
        equation: Learned state.
        draws: Scaled draws.
        first: Rows before the first fold, which hold the start of each run.
        folds: Rows of each fold, in order of time.
    """
    frame, design = posterior.equations[equation].frame, posterior.equations[equation].design
    parameters = fold_parameters(draws)
    counts = len(first) + np.cumsum([0, *map(len, folds)])
    unit = counts * math.log(frame.target_scale)
    order = np.concatenate([first, *folds])
    noise = posterior.data.noise.get(equation)
    if isinstance(design, FeatureDesign):
        n_obs = posterior.data.n_obs
        out = [np.setdiff1d(np.arange(n_obs), order[:count]) for count in counts]
        parts = [leave_out(posterior, equation, rows.tolist()).design for rows in out]
        return np.stack([subset_density(part, parameters) for part in parts], axis=1) - unit
    log_det = np.zeros(len(counts))
    if noise is not None:
        starts = [kept_starts(noise, np.sort(order[:count])) for count in counts]
        log_det = np.array([log_det_of_starts(noise, start) for start in starts if start is not None])
    values = np.asarray(_ordered(design, jnp.asarray(order), jnp.asarray(counts), parameters))
    return values - 0.5 * log_det - unit


def fold_parameters(draws: EquationDraws) -> tuple[Hyperparameters, Scales]:
    """η and the scales of θ, stacked over draws: those of the slab with odds where the patterns are summed."""
    scales = Scales(jnp.asarray(draws.prior_sd)) if draws.summed is None else draws.summed
    return jax.tree.map(jnp.asarray, draws.hyper), scales


def subset_density(design: Design, parameters: tuple[Hyperparameters, Scales]) -> Float[np.ndarray, " n_draw"]:
    """Log p(y_A | η) of the rows of a design, scaled units.

    Args:
        design: The rows.
        parameters: From `fold_parameters`.
    """
    if isinstance(design, FeatureDesign):
        # Few rows make a short factor; rows of zeros change nothing, and all subsets share one compilation.
        short = max(0, design.Phi.shape[1] + design.Psi.shape[1] + 1 - len(design.y))
        Phi, Psi, y = (np.pad(a, [(0, short), (0, 0)][: a.ndim]) for a in (design.Phi, design.Psi, design.y))
        design = replace(design, Phi=jnp.asarray(Phi), Psi=jnp.asarray(Psi), y=jnp.asarray(y))
    return np.asarray(_subset(design, parameters))


def _by_precision(design: Design, size: int) -> bool:
    """Whether P is no larger than what leaving the fold out would cost; C is factorised on the exact path anyway."""
    return isinstance(design, DenseDesign) or size <= design.Phi.shape[1] + design.Psi.shape[1]


def _stack(folds: list[np.ndarray], size: int, band: np.ndarray | None) -> _Fold:
    index = np.stack([np.concatenate([fold, np.full(size - len(fold), fold[-1])]) for fold in folds])
    counts = np.arange(size) < np.array([[len(fold)] for fold in folds])
    precision = np.broadcast_to(np.eye(size), (len(folds), size, size))
    if band is not None:
        low, high = np.minimum(index[:, :, None], index[:, None]), np.maximum(index[:, :, None], index[:, None])
        precision = band[low, high - low]
    return _Fold(jnp.asarray(index), jnp.asarray(counts), jnp.asarray(precision))


def _reach(folds: Members) -> int:
    return max(int(fold[-1] - fold[0]) for fold in folds) + 1


def _rows_at(rows: Rows, index: np.ndarray) -> Rows:
    return Rows(*(column[index] for column in rows))


@jax.jit
def _mapped(design: Design, rows: Rows | None, folds: _Fold, parameters: tuple[Hyperparameters, Scales]) -> Array:
    n_fold, size = folds.index.shape
    n_term = design.Phi.shape[1]

    def one(item: tuple[Hyperparameters, Scales]) -> Array:
        hyper, (sd, log_odds) = item
        if isinstance(design, FeatureDesign):
            assert rows is not None
            half, g, J = feature_root(design, rows, hyper, sd)
            H, g = half.T.reshape(n_fold, size, -1), g.reshape(n_fold, size)
            J = J.T.reshape(n_fold, size, n_term)
        else:
            half, g, J = dense_root(design, hyper, sd)
            H, g, J = half.T[folds.index], g[folds.index], J.T[folds.index]
        posterior = ridge(design.remove_discrepancy(design.y, hyper)[0], sd, design.n_obs)
        inverse = solve_lower(posterior.L, jnp.eye(n_term))
        m, V = posterior.mean, inverse.T @ inverse

        def fold(item: tuple[Array, Array, Array, Array, Array]) -> Array:
            H, g, J, counts, precision = item
            P = H @ H.T
            P = (precision - P) / hyper.sigma**2 if isinstance(design, FeatureDesign) else P
            # Rows that only fill up are independent, with unit variance and no residual.
            P = jnp.where(counts[:, None] & counts, P, jnp.eye(size))
            L = jnp.linalg.cholesky(P)
            z = solve_lower(L, jnp.where(counts, g, 0.0))
            value = jnp.sum(jnp.log(jnp.diag(L))) - 0.5 * (jnp.sum(z**2) + jnp.sum(counts) * math.log(2 * math.pi))
            if log_odds is None:
                return value
            G = solve_lower(L, jnp.where(counts[:, None], J, 0.0))
            without = log_pattern_weights(m - G.T @ z, V + G.T @ G, log_odds)
            return value + logsumexp(log_pattern_weights(m, V, log_odds)) - logsumexp(without)

        # Fold by fold, since batched factorisations inside a loop can deadlock (see pointwise).
        return jax.lax.map(fold, (H, g, J, folds.counts, folds.precision))

    return jax.lax.map(one, parameters)


@jax.jit
def _subset(design: Design, parameters: tuple[Hyperparameters, Scales]) -> Array:
    def one(item: tuple[Hyperparameters, Scales]) -> Array:
        hyper, (sd, log_odds) = item
        remainder, _ = design.remove_discrepancy(design.y, hyper)
        return log_evidence(remainder, sd, log_odds, design.n_obs)

    return jax.lax.map(one, parameters)


@jax.jit
def _ordered(design: DenseDesign, order: Array, counts: Array, parameters: tuple[Hyperparameters, Scales]) -> Array:
    """Densities of the first rows in an order, without log|R|."""

    def one(item: tuple[Hyperparameters, Scales]) -> Array:
        hyper, (sd, log_odds) = item
        C = design.covariance(hyper) + hyper.sigma**2 * jnp.eye(len(design.y))
        L = jnp.linalg.cholesky(C[order[:, None], order])
        left = solve_lower(L, jnp.column_stack([design.Phi, design.y])[order])
        log_det = jnp.concatenate([jnp.zeros(1), 2 * jnp.cumsum(jnp.log(jnp.diag(L)))])

        def first(count: Array) -> Array:
            # L is triangular: what f leaves of the first rows does not know the later ones.
            known = jnp.where((jnp.arange(len(order)) < count)[:, None], left, 0.0)
            return log_evidence(Remainder(known[:, :-1], known[:, -1], log_det[count]), sd, log_odds, 1.0 * count)

        return jax.lax.map(first, counts)

    return jax.lax.map(one, parameters)
