"""Leave-one-out densities of the measured derivative, in closed form given the hyperparameters."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float, Int

from bayes_greybox.inference.posterior import EquationDraws, Posterior
from bayes_greybox.model.frame import Frame
from bayes_greybox.model.likelihood import Design, FeatureDesign, Hyperparameters
from bayes_greybox.model.linalg import solve_lower
from bayes_greybox.model.program import measured_rate
from bayes_greybox.model.simulation import Simulation

ROW_BLOCK = 4096
"""Rows handled at once; memory is bounded by draws × one block."""

_GROUP_LIMIT = 10_000_000


class Rows(NamedTuple):
    """Rows weighted by the inverse noise correlation, R⁻¹[Φ Ψ̃ y], and diag R⁻¹, in scaled units."""

    Phi: Float[Array, "n_row n_term"]
    Psi: Float[Array, "n_row n_basis"]
    y: Float[Array, " n_row"]
    precision: Float[Array, " n_row"]


def pointwise_loo(posterior: Posterior, equation: str, at_most: int | None = None) -> Float[np.ndarray, "n_draw n_obs"]:
    """Densities log p(y_i | y₋ᵢ, η, γ) of every row and posterior draw, θ and f integrated out.

    With C = ΦDΦᵀ + K⊥ + σ²R, g = C⁻¹y and c_i = (C⁻¹)_ii,

        log p(y_i | y₋ᵢ, η, γ) = −½ log 2π + ½ log c_i − g_i² / (2 c_i)

    (Sundararajan & Keerthi 2001, Eq. 10 to 12; Bürkner, Gabry & Vehtari 2021, Eq. 10). D holds the prior
    variances of the draw, zero for excluded terms, so that under a spike-and-slab prior the draws average
    over γ. On the feature path C⁻¹ comes by Woodbury's identity from one factorisation of order K + M a draw;
    a row then costs (K + M)².

    Args:
        posterior: Fitted model.
        equation: Learned state.
        at_most: Thin the draws evenly to this many; None: all.

    Returns:
        Natural logarithms of densities of the measured derivative in user's units, so that models with
        different scalings compare. One column for each row of the data, also when the rows' noise is
        correlated. Where it is singular (spectral derivatives) the rows have no density of their own: there
        the observations are the whitened Fourier coefficients, one column for each.
    """
    draws = posterior.draws(equation, at_most)
    return np.concatenate([block for _, block in pointwise_blocks(posterior, equation, draws)], axis=1)


def log_likelihood_group(posterior: Posterior) -> dict[str, np.ndarray] | None:
    """The `log_likelihood` group: `pointwise_loo` of every draw, from which `arviz_stats.loo` gives LOO.

    The importance weights of leave-one-out are p(η | y₋ᵢ)/p(η | y) ∝ 1/p(y_i | y₋ᵢ, η), and the predictive
    density is p(y_i | y₋ᵢ, η) itself: both are what PSIS-LOO makes of a group that holds these values.

    Returns:
        `e_rate` [n_chain, n_draw, n_obs] for each equation e; None if it would hold more than 10⁷ numbers.
    """
    group = posterior.idata["posterior"].dataset
    n_chain, n_draw = group.sizes["chain"], group.sizes["draw"]
    if n_chain * n_draw * posterior.data.n_obs * len(posterior.equations) > _GROUP_LIMIT:
        return None
    return {
        f"{equation}_rate": pointwise_loo(posterior, equation).reshape(n_chain, n_draw, -1)
        for equation in posterior.equations
    }


def pointwise_blocks(
    posterior: Posterior, equation: str, draws: EquationDraws, index: Int[np.ndarray, " n_row"] | None = None
) -> Iterator[tuple[Int[np.ndarray, " n_block"], Float[np.ndarray, "n_draw n_block"]]]:
    """`pointwise_loo` block by block, of given draws and observations.

    Args:
        posterior: Gives data, frame and design; the draws may be those of another run.
        equation: Learned state.
        draws: Scaled draws.
        index: Observations wanted; None: all.

    Yields:
        Indices of the observations, and their densities.
    """
    frame, design = posterior.equations[equation].frame, posterior.equations[equation].design
    parameters = jax.tree.map(jnp.asarray, (draws.hyper, draws.prior_sd))
    log_unit = math.log(frame.target_scale)
    if not isinstance(design, FeatureDesign):
        values = np.asarray(_mapped(design, None, parameters)) - log_unit
        index = np.arange(values.shape[1]) if index is None else index
        yield index, values[:, index]
        return
    n_observation = count_observations(posterior, equation)
    index = np.arange(n_observation) if index is None else index
    block = min(ROW_BLOCK, len(index))
    whole = None if posterior.data.noise.get(equation) is None else weighted_rows(posterior, equation)
    for start in range(0, len(index), block):
        part = index[start : start + block]
        # A short last block is filled up, so that it does not compile anew.
        padded = np.concatenate([part, np.full(block - len(part), part[-1])])
        rows = (
            weighted_rows(posterior, equation, padded) if whole is None else jax.tree.map(lambda a: a[padded], whole)  # noqa: B023
        )
        yield part, np.asarray(_mapped(design, rows, parameters))[:, : len(part)] - log_unit


def count_observations(posterior: Posterior, equation: str) -> int:
    """Observations of one equation: rows, or whitened coefficients where the rows' noise is singular."""
    noise = posterior.data.noise.get(equation)
    return posterior.data.n_obs if noise is None else noise.n_white


def scaled_rows(
    posterior: Posterior, equation: str, index: Int[np.ndarray, " n_row"] | slice = slice(None)
) -> Float[np.ndarray, "n_row n_column"]:
    """[Φ Ψ̃ y] in scaled units at rows of the training data, neither whitened nor compressed."""
    data, frame = posterior.data, posterior.equations[equation].frame
    simulation = Simulation.of(posterior.model.simulation, data.state_names, data.input_names)
    target = (measured_rate(data, equation) - simulation.on(data, equation))[index] / frame.target_scale
    return np.column_stack([*_bases(frame, {name: column[index] for name, column in data.columns.items()}), target])


def weighted_rows(posterior: Posterior, equation: str, index: Int[np.ndarray, " n_row"] | slice = slice(None)) -> Rows:
    """R⁻¹[Φ Ψ̃ y] and diag R⁻¹ at given observations; W[Φ Ψ̃ y] and ones where W is not square."""
    noise = posterior.data.noise.get(equation)
    if noise is None:
        table = scaled_rows(posterior, equation, index)
        precision = np.ones(len(table))
    else:
        table = noise.whiten(scaled_rows(posterior, equation))
        precision = np.ones(len(table))
        if noise.square:
            table, precision = noise.whiten_transpose(table), noise.precision_diagonal()
        table, precision = table[index], precision[index]
    n_term = len(posterior.equations[equation].frame.dictionary)
    return Rows(*map(jnp.asarray, (table[:, :n_term], table[:, n_term:-1], table[:, -1], precision)))


class Root(NamedTuple):
    """H, g = C⁻¹y and J = cov(u, y) C⁻¹ at some rows, with θ = sd · u, u ~ N(0, I)."""

    H: Float[Array, "n_left n_row"]
    g: Float[Array, " n_row"]
    J: Float[Array, "n_term n_row"]


def feature_root(design: FeatureDesign, rows: Rows, hyper: Hyperparameters, sd: Float[Array, " n_term"]) -> Root:
    """`Root` with C⁻¹ = σ⁻² (R⁻¹ − HᵀH) for C = σ²(R + BBᵀ), B = [Φ sd, Ψ̃ √S (I − UUᵀ)]/σ.

    C⁻¹ = σ⁻² (R⁻¹ − R⁻¹B (I + BᵀR⁻¹B)⁻¹ BᵀR⁻¹), with I + BᵀR⁻¹B = TᵀT from a QR factorisation, since the Gram
    matrix would square the condition number; H = T⁻ᵀBᵀR⁻¹.
    """
    log_root, U = design.weight_prior(hyper) if design.Psi.shape[1] else (jnp.zeros(0), None)
    root = jnp.exp(log_root)

    def scaled(Phi: Array, Psi: Array) -> Array:
        B = Psi * root
        B = B if U is None else B - (B @ U) @ U.T
        return jnp.concatenate([Phi * sd, B], axis=1) / hyper.sigma

    # The compressed rows have the Gram matrix of the whitened ones.
    B = scaled(design.Phi, design.Psi)
    n_column = B.shape[1]
    penalised = jnp.concatenate(
        [jnp.column_stack([B, design.y / hyper.sigma]), jnp.eye(n_column, n_column + 1)], axis=0
    )
    triangle = jnp.linalg.qr(penalised, mode="r")
    T, right = triangle[:n_column, :n_column], triangle[:n_column, n_column]
    weighted = scaled(rows.Phi, rows.Psi)
    half = solve_triangular(T, weighted.T, trans=1)
    g = (rows.y / hyper.sigma - weighted @ solve_triangular(T, right)) / hyper.sigma
    return Root(half, g, solve_triangular(T, half)[: len(sd)] / hyper.sigma)


def dense_root(design: Design, hyper: Hyperparameters, sd: Float[Array, " n_term"]) -> Root:
    """`Root` with C⁻¹ = HᵀH = Wᵀ (W (ΦDΦᵀ + K⊥) Wᵀ + σ²I)⁻¹ W; W left out where not square."""
    assert not isinstance(design, FeatureDesign)
    Phi = design.Phi * sd
    L = jnp.linalg.cholesky(Phi @ Phi.T + design.covariance(hyper) + hyper.sigma**2 * jnp.eye(len(design.y)))
    W = design.whitening
    half = solve_lower(L, jnp.eye(len(L)) if W is None or W.shape[0] != W.shape[1] else W)
    return Root(half, half.T @ solve_lower(L, design.y), solve_lower(L, Phi).T @ half)


def _bases(frame: Frame, columns: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    if not frame.variables:
        Phi = np.asarray(frame.dictionary_rows(columns))
        return Phi, np.zeros((len(Phi), 0))
    Phi, Psi = frame.rows(columns)
    return np.asarray(Phi), np.asarray(Psi)


@jax.jit
def _mapped(design: Design, rows: Rows | None, parameters: tuple) -> Array:
    def one(item: tuple[Hyperparameters, Array]) -> Array:
        hyper, sd = item
        if isinstance(design, FeatureDesign):
            assert rows is not None
            half, g, _ = feature_root(design, rows, hyper, sd)
            precision = (rows.precision - jnp.sum(half**2, axis=0)) / hyper.sigma**2
        else:
            half, g, _ = dense_root(design, hyper, sd)
            precision = jnp.sum(half**2, axis=0)
        return 0.5 * (jnp.log(precision) - math.log(2 * math.pi) - g**2 / precision)

    # One draw after another: batched factorisations inside a loop have been seen to deadlock XLA's thread pool on two
    # cores (jaxlib 0.10), and on a CPU a batch of LAPACK calls is a loop anyway.
    return jax.lax.map(one, parameters)
