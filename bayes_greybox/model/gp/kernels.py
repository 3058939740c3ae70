"""Stationary base kernels: correlation, and the logarithm of the spectral density.

The parametrisation is NumPyro's (`numpyro.contrib.hsgp`), with its variance `alpha = amplitude**2`. Spectral
densities are kept as logarithms: S underflows at high frequencies, and the gradient of √0 is NaN.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Float


@dataclass(frozen=True)
class Kernel:
    """A stationary kernel k(x, x') = amplitude² ρ(r), r² = Σ_d (x_d − x'_d)²/ℓ_d².

    Attributes:
        name: The name used in `OrthogonalGP(kernel=...)`.
        correlation: ρ as a function of r².
        log_spectral_shape: log of the spectral density of ρ for unit length scales, as a function of
            Σ_d ℓ_d² ω_d² and of the dimension.
        features_per_unit: m ≥ `features_per_unit` × (boundary factor)/ℓ features in a direction resolve ℓ
            (Riutort-Mayol et al. 2023, Sec. 4.2).
        boundary_per_length: The boundary factor must be at least `boundary_per_length` × ℓ, or f is correlated with
            its image behind the wall of the domain (the same, Sec. 4.2).
    """

    name: str
    correlation: Callable[[Array], Array]
    log_spectral_shape: Callable[[Array, int], Array]
    features_per_unit: float
    boundary_per_length: float = 4.5


def gram(
    kernel: Kernel,
    left: Float[Array, "n_left n_var"],
    right: Float[Array, "n_right n_var"],
    amplitude: Float[Array, ""] | float,
    length_scale: Float[Array, " n_var"],
) -> Float[Array, "n_left n_right"]:
    """Return the covariance matrix k(x_i, x'_j) of the base kernel between points in scaled units."""
    difference = (left[:, None, :] - right[None, :, :]) / length_scale
    return amplitude**2 * kernel.correlation(jnp.sum(difference**2, axis=-1))


def log_spectral_density(
    kernel: Kernel,
    frequency: Float[Array, "n_basis n_var"],
    amplitude: Float[Array, ""] | float,
    length_scale: Float[Array, " n_var"],
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
        constant = (
            dim * math.log(2)
            + 0.5 * dim * math.log(math.pi)
            + math.lgamma(nu + 0.5 * dim)
            - math.lgamma(nu)
            + nu * math.log(2 * nu)
        )
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
