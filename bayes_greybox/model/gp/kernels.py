"""Stationary base kernels, and the dense ones orthogonal to the dictionary under a measure μ.

The parametrisation is NumPyro's (`numpyro.contrib.hsgp`), with its variance `alpha = amplitude**2`. Spectral
densities are kept as logarithms: S underflows at high frequencies, and the gradient of √0 is NaN.

With an orthonormal dictionary Φₒ = Φ T (⟨Φₒ, Φₒᵀ⟩ = I under μ), h = ⟨Φₒ, k(·, x)⟩ and Q = ⟨⟨Φₒ, k, Φₒᵀ⟩⟩:

    projected     k − Φₒᵀ h' − hᵀ Φₒ' + Φₒᵀ Q Φₒ'      covariance of (I − P) f, f ~ GP(0, k)
    conditioned   k − hᵀ Q⁻¹ h'                        f ~ GP(0, k) given ⟨Φ, f⟩ = 0 (Plumlee & Joseph 2018)
    printed       k − Φₒᵀ Φₒ'                          as printed by Manna, Rogers & Bull; not a covariance
    none          k
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.stats import qmc

from bayes_greybox.model.algebra.linalg import Scalar, jittered_cholesky, solve_lower


@dataclass(frozen=True)
class Kernel:
    """A stationary kernel k(x, x') = amplitude² ρ(r), r² = Σ_d (x_d − x'_d)²/ℓ_d².

    Attributes:
        name: The name used in `OrthogonalGP(kernel=...)`.
        correlation: ρ as a function of r².
        log_spectral_shape: log of the spectral density of ρ for unit length scales, as a function of Σ_d ℓ_d² ω_d² and
            of the dimension.
        features_per_unit: m ≥ `features_per_unit` × (boundary factor)/ℓ features in a direction resolve ℓ
            (Riutort-Mayol et al. 2023, Sec. 4.2).
        boundary_per_length: Least boundary factor over ℓ, or f is correlated with its image behind the wall of the
            domain (the same).
    """

    name: str
    correlation: Callable[[Array], Array]
    log_spectral_shape: Callable[[Array, int], Array]
    features_per_unit: float
    boundary_per_length: float = 4.5


def gram(
    kernel: Kernel, left: Float[Array, "n_left n_var"], right: Float[Array, "n_right n_var"], amplitude: Scalar,
    length_scale: Float[Array, " n_var"],
) -> Float[Array, "n_left n_right"]:  # fmt: skip
    """Return the covariance matrix k(x_i, x'_j) of the base kernel between points in scaled units."""
    difference = (left[:, None, :] - right[None, :, :]) / length_scale
    return amplitude**2 * kernel.correlation(jnp.sum(difference**2, axis=-1))


def log_spectral_density(
    kernel: Kernel, frequency: Float[Array, "n_basis n_var"], amplitude: Scalar, length_scale: Float[Array, " n_var"]
) -> Float[Array, " n_basis"]:
    """Return the logarithm of the spectral density of the base kernel.

    log S(ω) = 2 log amplitude + Σ_d log ℓ_d + log shape(Σ_d ℓ_d² ω_d²)   (Solin & Särkkä 2020, Eq. 4 and 20).
    """
    scaled = jnp.sum(jnp.square(frequency * length_scale), axis=-1)
    shape = kernel.log_spectral_shape(scaled, frequency.shape[-1])
    return 2 * jnp.log(amplitude) + jnp.sum(jnp.log(length_scale)) + shape


def _matern(name: str, nu: float, polynomial: Callable[[Array], Array], per_unit: float, per_length: float) -> Kernel:
    def correlation(r2: Array) -> Array:
        # The double `where` keeps the gradient of the root finite at r = 0.
        r = jnp.sqrt(2 * nu * jnp.where(r2 > 0, r2, 1.0))
        return jnp.where(r2 > 0, polynomial(r) * jnp.exp(-r), 1.0)

    def log_spectral_shape(scaled: Array, dim: int) -> Array:
        # S = 2^D π^{D/2} Γ(ν + D/2) (2ν)^ν / Γ(ν) · (2ν + ω²)^{−ν − D/2}  (Rasmussen & Williams 2006, 4.15)
        constant = dim * math.log(2) + 0.5 * dim * math.log(math.pi) + math.lgamma(nu + 0.5 * dim)
        constant = constant - math.lgamma(nu) + nu * math.log(2 * nu)
        return constant - (nu + 0.5 * dim) * jnp.log(2 * nu + scaled)

    return Kernel(name, correlation, log_spectral_shape, per_unit, per_length)


def _log_gaussian_shape(scaled: Array, dim: int) -> Array:
    # S = (2π)^{D/2} exp(−ω²/2)   (Rasmussen & Williams 2006, Sec. 4.2.1)
    return 0.5 * dim * math.log(2 * math.pi) - 0.5 * scaled


KERNELS = {
    kernel.name: kernel
    for kernel in (
        Kernel("squared_exponential", lambda r2: jnp.exp(-0.5 * r2), _log_gaussian_shape, 1.75, 3.2),
        _matern("matern32", 1.5, lambda r: 1 + r, 3.42, 4.5),
        _matern("matern52", 2.5, lambda r: 1 + r + r**2 / 3, 2.65, 4.1),
    )
}
"""Kernels by name; those listed here can be chosen in `OrthogonalGP` and in configurations."""

Variant = Literal["projected", "conditioned", "printed", "none"]

Measure = Literal["empirical", "unweighted", "box", "box-monte-carlo"]

Points = tuple[Float[Array, "_ n_var"], Float[Array, "_ n_rank"]]
"""Points in scaled units, and Φₒ there."""

QUADRATURE_NODES = {1: 64, 2: 32, 3: 16}
"""Gauss–Legendre nodes per variable; exact for polynomials of degree 2n − 1."""


def box_nodes(
    n_var: int, *, monte_carlo: int | None = None, seed: int = 0
) -> tuple[Float[np.ndarray, "n_node n_var"], Float[np.ndarray, " n_node"]]:
    """Return nodes and weights, which sum to one, of the uniform probability measure on the box [−1, 1]^d.

    Tensor Gauss–Legendre for d ≤ 3, 4096 scrambled Sobol points beyond; with `monte_carlo` = n, n independent uniform
    points, as the seed paper integrates its Gram matrix.
    """
    if monte_carlo is not None:
        nodes = np.random.default_rng(seed).uniform(-1.0, 1.0, size=(monte_carlo, n_var))
        return nodes, np.full(monte_carlo, 1.0 / monte_carlo)
    if n_var > max(QUADRATURE_NODES):
        sobol: Any = qmc.Sobol
        points = sobol(n_var, seed=seed).random(4096)
        return 2.0 * points - 1.0, np.full(len(points), 1.0 / len(points))
    x, w = np.polynomial.legendre.leggauss(QUADRATURE_NODES[n_var])
    nodes = np.stack([axis.ravel() for axis in np.meshgrid(*(x,) * n_var, indexing="ij")], axis=-1)
    weights = np.prod(np.stack(np.meshgrid(*(w / 2,) * n_var, indexing="ij")), axis=0).ravel()
    return nodes, weights


def orthonormalise(
    Phi: Float[np.ndarray, "n_node n_term"], weights: Float[np.ndarray, " n_node"]
) -> Float[np.ndarray, "n_term n_rank"]:
    """Return T such that Φ T is orthonormal under the measure with these nodes and weights, which sum to one.

    From the singular value decomposition of √w Φ, directions below 1e-10 of the largest singular value left
    out: a solve with the paper's Gram matrix H = ⟨Φ, Φᵀ⟩ that never forms H and reveals its rank.
    """
    _, singular, Vt = np.linalg.svd(np.sqrt(weights)[:, None] * Phi, full_matrices=False)
    keep = singular > 1e-10 * singular[0]
    return Vt[keep].T / singular[keep]


def orthogonal_gram(
    variant: Variant, kernel: Kernel, amplitude: Scalar, length_scale: Float[Array, " n_var"],
    left: Points, right: Points, nodes: Points,
) -> Float[Array, "n_left n_right"]:  # fmt: skip
    """Return k⊥(x_i, x'_j), lengths and amplitude in scaled units.

    Beside the nodes of μ are w Φₒ there, with the weights multiplied in.
    """

    def k(a: Array, b: Array) -> Array:
        return gram(kernel, a, b, amplitude, length_scale)

    (x, Phi), (x_, Phi_), (s, wPhi) = left, right, nodes
    if variant == "none":
        return k(x, x_)
    if variant == "printed":
        # Manna, Rogers & Bull, unnumbered equation after (5)
        return k(x, x_) - Phi @ Phi_.T
    h, h_ = k(x, s) @ wPhi, k(x_, s) @ wPhi
    Q = wPhi.T @ k(s, s) @ wPhi
    if variant == "projected":
        return k(x, x_) - Phi @ h_.T - h @ Phi_.T + Phi @ Q @ Phi_.T
    # Plumlee & Joseph 2018, Eq. (8), with hᵀ Q⁻¹ h' as a product so that it stays positive semi-definite
    L = jittered_cholesky(Q, amplitude**2)
    return k(x, x_) - solve_lower(L, h.T).T @ solve_lower(L, h_.T)
