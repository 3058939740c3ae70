"""Leave-one-out densities of the measured derivative, in closed form given the hyperparameters."""

import math
from collections.abc import Iterator

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from bayes_greybox.inference.posterior import MOST_NUMBERS, Posterior
from bayes_greybox.model.design import Design, EquationDraws, WeightedRows
from bayes_greybox.model.gp.hyper import Hyperparameters
from bayes_greybox.running.arrays import on_device
from bayes_greybox.running.compiling import compiled

ROW_BLOCK = 4096
"""Rows that are evaluated at once; memory is bounded by draws × one block."""


def pointwise_loo(posterior: Posterior, equation: str, at_most: int | None = None) -> Float[np.ndarray, "n_draw n_obs"]:
    """Return the densities log p(y_i | y₋ᵢ, η, γ) of every row and posterior draw, θ and f integrated out.

    With C = ΦDΦᵀ + K⊥ + σ²R, g = C⁻¹y and c_i = (C⁻¹)_ii,

        log p(y_i | y₋ᵢ, η, γ) = −½ log 2π + ½ log c_i − g_i² / (2 c_i)

    (Sundararajan & Keerthi 2001, Eq. 10 to 12; Bürkner, Gabry & Vehtari 2021, Eq. 10). D holds the prior variances of
    the draw, zero for excluded terms, so that under a spike-and-slab prior the draws average over γ. Prior means are
    subtracted from y; so are coefficients with bounds, which stay at their draws like η. On the feature path C⁻¹
    follows by Woodbury's identity from one factorisation of order K + M a draw; a row then costs (K + M)².

    Returns:
        Natural logarithms of densities of the measured derivative, or of samples, in user's units, so that models with
        different scalings compare. There is one column for each row of the data, also if the rows' noise is correlated.
        If it is singular (spectral derivatives) the observations are the whitened Fourier coefficients instead.
    """
    draws = posterior.draws(equation, at_most)
    return np.concatenate(list(row_densities(posterior, equation, draws)), axis=1)


def log_likelihood_group(posterior: Posterior) -> dict[str, np.ndarray] | None:
    """Return the `log_likelihood` group: `pointwise_loo` of every draw, from which `arviz_stats.loo` computes LOO.

    The importance weights of leave-one-out are p(η | y₋ᵢ)/p(η | y) ∝ 1/p(y_i | y₋ᵢ, η), and the predictive
    density is p(y_i | y₋ᵢ, η) itself: PSIS-LOO computes both from these values.

    Returns:
        `e_rate` [n_chain, n_draw, n_obs] for each equation e; None if it would hold more than 10⁷ numbers.
    """
    group = posterior.idata["posterior"].dataset
    n_chain, n_draw = group.sizes["chain"], group.sizes["draw"]
    if n_chain * n_draw * sum(entry.rows.n_row for entry in posterior.equations.values()) > MOST_NUMBERS:
        return None
    return {
        posterior.sites[equation].rate: pointwise_loo(posterior, equation).reshape(n_chain, n_draw, -1)
        for equation in posterior.equations
    }


def kept_densities(posterior: Posterior, equation: str) -> Float[np.ndarray, "n_draw n_obs"] | None:
    """Return the densities that a fit has in its `log_likelihood` group; None without, or if an old unit is used."""
    if "log_likelihood" not in posterior.idata.children:
        return None
    rows = posterior.equations[equation].rows
    if rows.gain != 1.0:
        # Files of older versions have samples, and their densities, in the unit of a rate.
        observed = posterior.idata["observed_data"].dataset[posterior.sites[equation].rate].to_numpy()
        if not np.allclose(observed, rows.shown, rtol=1e-6, atol=1e-6 * np.abs(rows.shown).max()):
            return None
    values = posterior.idata["log_likelihood"].dataset.get(posterior.sites[equation].rate)
    return None if values is None else values.to_numpy().reshape(-1, values.shape[-1])


def row_densities(
    posterior: Posterior, equation: str, draws: EquationDraws, index: Int[np.ndarray, " n_row"] | None = None
) -> Iterator[Float[np.ndarray, "n_draw n_block"]]:
    """Yield `pointwise_loo` block by block, for some draws and observations.

    The posterior supplies data, frame and design; the scaled draws may be those of another run.
    """
    entry = posterior.equations[equation]
    log_unit = math.log(entry.frame.target_scale * entry.rows.gain)
    index = np.arange(entry.rows.n_white) if index is None else index
    weighted = entry.weighted()
    for part, padded in in_blocks(index, ROW_BLOCK):
        values = precision_terms(entry.design, weighted(padded), parameters_of(draws))
        precision, g = (np.asarray(each)[:, : len(part)] for each in values)
        yield 0.5 * (np.log(precision) - math.log(2 * math.pi) - g**2 / precision) - log_unit


def in_blocks(index: np.ndarray, size: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield numbers in blocks, and the same padded to one length, so that a short last one needs no compilation."""
    size = min(size, len(index))
    for start in range(0, len(index), size):
        part = index[start : start + size]
        yield part, np.concatenate([part, np.full(size - len(part), part[-1])])


def parameters_of(draws: EquationDraws) -> tuple[Hyperparameters, Array, Array]:
    """Return η, and the standard deviation and mean of θ, stacked over draws."""
    return on_device((draws.hyper, draws.spread, draws.mean))


@compiled
def precision_terms(
    design: Design, rows: WeightedRows, parameters: tuple[Hyperparameters, Array, Array]
) -> tuple[Array, Array]:
    """Return the diagonal of C⁻¹, and C⁻¹y, at some rows, for every draw."""

    def one(item: tuple[Hyperparameters, Array, Array]) -> tuple[Array, Array]:
        hyper, sd, mean = item
        root = design.beside(mean).root(rows.beside(mean), hyper, sd)
        return design.inverse_diagonal(root, rows, hyper), root.g

    # One draw after another: batched factorisations inside a loop have been seen to deadlock XLA's thread pool on two
    # cores (jaxlib 0.10), and on a CPU a batch of LAPACK calls is a loop anyway.
    return jax.lax.map(one, parameters)
