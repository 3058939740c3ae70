"""Integrating f and θ out of the model, given the hyperparameters: the mathematics behind the likelihood.

Everything is Gaussian given η = (length scales, amplitude, σ) and the prior scales. First f is integrated out, which
leaves an ordinary linear regression for θ (a `Remainder`); then θ is.
"""

import math
from typing import NamedTuple

import jax.numpy as jnp
from jax.scipy.special import logsumexp
from jaxtyping import Array, Float

from .linalg import jittered_cholesky, solve_lower, solve_lower_transposed
from .subsets import log_pattern_weights


class Remainder(NamedTuple):
    """What is left for θ once f is integrated out: −2 log p(y | θ, η) = ‖q − T θ‖² + log_det + n log 2π.

    T and q are residuals of ridge regressions on the features, stacked on their penalties, so that ‖q − Tθ‖² is
    computed as a sum of squares and never as a difference of large numbers.
    """

    T: Float[Array, "n_left n_term"]
    q: Float[Array, " n_left"]
    log_det: Float[Array, ""]


class FeatureSolve(NamedTuple):
    """Posterior of the standardised weights z of f: z | θ ~ N(Z_y − Z_Φ θ, (L Lᵀ)⁻¹)."""

    L: Float[Array, "n_basis n_basis"]
    Z: Float[Array, "n_basis n_term_and_1"]


class Ridge(NamedTuple):
    """Posterior of u, θ = sd · u, u ~ N(0, I): mean, lower factor of its precision, and log p(y | η, sd)."""

    mean: Float[Array, " n_term"]
    L: Float[Array, "n_term n_term"]
    log_evidence: Float[Array, ""]


def remove_features(
    Phi: Float[Array, "n_row n_term"],
    B: Float[Array, "n_row n_basis"],
    y: Float[Array, " n_row"],
    sigma: Float[Array, ""] | float,
) -> tuple[Remainder, FeatureSolve]:
    """Integrate out z ~ N(0, I) in y/σ = Φθ/σ + B z + ε, ε ~ N(0, I).

    L Lᵀ = I + BᵀB,  Z = (L Lᵀ)⁻¹ Bᵀ [Φ y]/σ,  [T q] = [[Φ y]/σ − B Z; Z].

    Args:
        Phi: Dictionary rows, whitened and compressed.
        B: Orthogonal features times prior standard deviation of their weights, over σ.
        y: Target rows.
        sigma: Noise standard deviation, scaled units.

    Returns:
        The regression left for θ (its log_det lacks n log σ², which depends on n), and the weights' posterior.
    """
    rows = jnp.column_stack([Phi, y]) / sigma
    if B.shape[1] == 0:
        nothing = jnp.zeros((0, rows.shape[1]))
        return Remainder(rows[:, :-1], rows[:, -1], jnp.zeros(())), FeatureSolve(jnp.zeros((0, 0)), nothing)
    L = jnp.linalg.cholesky(jnp.eye(B.shape[1]) + B.T @ B)
    Z = solve_lower_transposed(L, solve_lower(L, B.T @ rows))
    left = jnp.concatenate([rows - B @ Z, Z])
    return Remainder(left[:, :-1], left[:, -1], 2 * jnp.sum(jnp.log(jnp.diag(L)))), FeatureSolve(L, Z)


def remove_dense(
    Phi: Float[Array, "n_row n_term"],
    K: Float[Array, "n_row n_row"],
    y: Float[Array, " n_row"],
    sigma: Float[Array, ""] | float,
) -> tuple[Remainder, Float[Array, "n_row n_row"]]:
    """Integrate out f ~ N(0, K) at the rows themselves: [T q] = L⁻¹ [Φ y], L Lᵀ = K + σ² I; also returns L."""
    L = jnp.linalg.cholesky(K + sigma**2 * jnp.eye(K.shape[0]))
    left = solve_lower(L, jnp.column_stack([Phi, y]))
    return Remainder(left[:, :-1], left[:, -1], 2 * jnp.sum(jnp.log(jnp.diag(L)))), L


def ridge(remainder: Remainder, sd: Float[Array, " n_term"], n_obs: Float[Array, ""] | float) -> Ridge:
    """Integrate out θ = sd · u, u ~ N(0, I); a term with sd = 0 is out of the model.

    log p(y | η, sd) = −½ (‖q − T sd m‖² + ‖m‖² + log|I + sd TᵀT sd| + log_det + n log 2π).

    Args:
        remainder: The regression left for θ.
        sd: Prior standard deviation of each coefficient, scaled units.
        n_obs: Number of observations n behind the rows.
    """
    T = remainder.T * sd
    L = jnp.linalg.cholesky(jnp.eye(T.shape[1]) + T.T @ T)
    mean = solve_lower_transposed(L, solve_lower(L, T.T @ remainder.q))
    squares = jnp.sum((remainder.q - T @ mean) ** 2) + jnp.sum(mean**2)
    log_det = remainder.log_det + 2 * jnp.sum(jnp.log(jnp.diag(L)))
    return Ridge(mean, L, -0.5 * (squares + log_det + n_obs * math.log(2 * math.pi)))


def spike_and_slab(
    remainder: Remainder,
    sd: Float[Array, " n_term"],
    log_odds: Float[Array, " n_term"],
    n_obs: Float[Array, ""] | float,
) -> tuple[Float[Array, ""], Float[Array, " n_pattern"]]:
    """log p(y | η) summed over all inclusion patterns, and log p(γ | y, η) of each pattern."""
    full = ridge(remainder, sd, n_obs)
    inverse = solve_lower(full.L, jnp.eye(sd.shape[0]))
    weights = log_pattern_weights(full.mean, inverse.T @ inverse, log_odds)
    total = logsumexp(weights)
    return full.log_evidence + total, weights - total


def weight_roots(
    log_S: Float[Array, " n_basis"],
    constraints: Float[Array, "n_rank n_basis"] | None = None,
) -> tuple[Float[Array, " n_basis"], Float[Array, "n_basis n_rank"] | None]:
    """Root of the prior covariance of the feature weights: w = √S ⊙ (I − U Uᵀ) z.

    Without constraints w ~ N(0, S). With C = ⟨Φₒ, ψᵀ⟩ it is N(0, S) given C w = 0, covariance
    S − S Cᵀ (C S Cᵀ)⁻¹ C S: U spans √S Cᵀ.

    Args:
        log_S: Log spectral density at the features' frequencies. √S is taken as exp(½ log S), since S underflows.
        constraints: C for the conditioned kernel.
    """
    root = jnp.exp(0.5 * log_S)
    if constraints is None:
        return root, None
    X = root[:, None] * constraints.T
    L = jittered_cholesky(X.T @ X)
    return root, solve_lower(L, X.T).T
