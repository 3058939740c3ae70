"""Densities of folds given the others, or given their past, in closed form given the hyperparameters."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from bayes_greybox.inference.posterior import EquationDraws, Posterior
from bayes_greybox.model.collapsed import ridge
from bayes_greybox.model.likelihood import DenseDesign, Design, FeatureDesign, Hyperparameters
from bayes_greybox.model.linalg import solve_lower

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
    """Densities log p(y_F | y₋F, η, γ) of every fold and draw, θ and f integrated out.

    With g = C⁻¹y and P = (C⁻¹)_FF,

        log p(y_F | y₋F, η, γ) = ½ log|P| − ½ g_Fᵀ P⁻¹ g_F − ½ |F| log 2π,

    the block form of Sundararajan & Keerthi 2001. On the feature path P = σ⁻² ((R⁻¹)_FF − H_FᵀH_F) by Woodbury's
    identity, so a draw costs N (K + M)², as for single rows. Folds with more rows than there are columns have
    instead log p(y) − log p(y₋F), each a problem of order K + M.

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
    parameters = jax.tree.map(jnp.asarray, (draws.hyper, draws.prior_sd))
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
    """Densities log p(y_A | η, γ) of the first rows A, and of these with one, two, … folds more, user's units.

    Their differences are p(y_F | y_past, η, γ) of each fold. On the exact path one Cholesky factorisation of C in
    the order of time has them all.

    Args:
        posterior: Gives data, frame and design; the draws may be those of another run.
        equation: Learned state.
        draws: Scaled draws.
        first: Rows before the first fold, which hold the start of each run.
        folds: Rows of each fold, in order of time.
    """
    frame, design = posterior.equations[equation].frame, posterior.equations[equation].design
    parameters = jax.tree.map(jnp.asarray, (draws.hyper, draws.prior_sd))
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


def subset_density(design: Design, parameters: tuple) -> Float[np.ndarray, " n_draw"]:
    """Log p(y_A | η, γ) of the rows of a design, scaled units.

    Args:
        design: The rows.
        parameters: η and the prior standard deviations of θ, stacked over draws.
    """
    if isinstance(design, FeatureDesign):
        # Few rows make a short factor; rows of zeros change nothing, and all subsets share one compilation.
        short = max(0, design.Phi.shape[1] + design.Psi.shape[1] + 1 - len(design.y))
        Phi, Psi, y = (jnp.pad(a, [(0, short), (0, 0)][: a.ndim]) for a in (design.Phi, design.Psi, design.y))
        design = replace(design, Phi=Phi, Psi=Psi, y=y)
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
def _mapped(design: Design, rows: Rows | None, folds: _Fold, parameters: tuple) -> Array:
    n_fold, size = folds.index.shape

    def one(item: tuple[Hyperparameters, Array]) -> Array:
        hyper, sd = item
        if isinstance(design, FeatureDesign):
            assert rows is not None
            half, g = feature_root(design, rows, hyper, sd)
            H, g = half.T.reshape(n_fold, size, -1), g.reshape(n_fold, size)
        else:
            half, g = dense_root(design, hyper, sd)
            H, g = half.T[folds.index], g[folds.index]

        def fold(item: tuple[Array, Array, Array, Array]) -> Array:
            H, g, counts, precision = item
            P = H @ H.T
            P = (precision - P) / hyper.sigma**2 if isinstance(design, FeatureDesign) else P
            # Rows that only fill up are independent, with unit variance and no residual.
            P = jnp.where(counts[:, None] & counts, P, jnp.eye(size))
            L = jnp.linalg.cholesky(P)
            squares = jnp.sum(solve_lower(L, jnp.where(counts, g, 0.0)) ** 2)
            return jnp.sum(jnp.log(jnp.diag(L))) - 0.5 * (squares + jnp.sum(counts) * math.log(2 * math.pi))

        # Fold by fold, since batched factorisations inside a loop can deadlock (see pointwise).
        return jax.lax.map(fold, (H, g, folds.counts, folds.precision))

    return jax.lax.map(one, parameters)


@jax.jit
def _subset(design: Design, parameters: tuple) -> Array:
    def one(item: tuple[Hyperparameters, Array]) -> Array:
        hyper, sd = item
        remainder, _ = design.remove_discrepancy(design.y, hyper)
        return ridge(remainder, sd, design.n_obs).log_evidence

    return jax.lax.map(one, parameters)


@jax.jit
def _ordered(design: DenseDesign, order: Array, counts: Array, parameters: tuple) -> Array:
    """Densities of the first rows in an order, without log|R|."""

    def one(item: tuple[Hyperparameters, Array]) -> Array:
        hyper, sd = item
        Phi = design.Phi * sd
        C = Phi @ Phi.T + design.covariance(hyper) + hyper.sigma**2 * jnp.eye(len(design.y))
        L = jnp.linalg.cholesky(C[order[:, None], order])
        z = solve_lower(L, design.y[order])
        # log p(y_i | y_<i) = −½ log 2π − log L_ii − ½ z_i²
        steps = -0.5 * (math.log(2 * math.pi) + z**2) - jnp.log(jnp.diag(L))
        return jnp.concatenate([jnp.zeros(1), jnp.cumsum(steps)])[counts]

    return jax.lax.map(one, parameters)
