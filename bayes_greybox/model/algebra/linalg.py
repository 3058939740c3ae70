"""Factorisations that every density and draw goes through, and the one jitter they share."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float

from bayes_greybox.running.errors import InputError

RELATIVE_JITTER = 1e-12
"""Jitter on the diagonal of a matrix that needs one, over the scale that its entries would have."""

LEAF = 128
"""Size up to which triangular matrices are inverted by solving for the identity."""

Scalar = Float[Array, ""] | float

PerTerm = Float[Array, " n_term"]


def jittered_cholesky(matrix: Float[Array, "n n"], scale: Scalar) -> Float[Array, "n n"]:
    """Return the lower Cholesky factor of `matrix + RELATIVE_JITTER * scale * I`; the matrix may vanish."""
    # The entries' own mean is no scale: where f is orthogonal to the dictionary anyway, they are rounding errors.
    return jnp.linalg.cholesky(matrix + RELATIVE_JITTER * scale * jnp.eye(matrix.shape[-1]))


def solve_lower(factor: Float[Array, "n n"], right: Float[Array, "n ..."]) -> Float[Array, "n ..."]:
    """Return L⁻¹ B for a lower triangular L."""
    return solve_triangular(factor, right, lower=True)


def solve_lower_transposed(factor: Float[Array, "n n"], right: Float[Array, "n ..."]) -> Float[Array, "n ..."]:
    """Return L⁻ᵀ B for a lower triangular L."""
    return solve_triangular(factor, right, lower=True, trans=1)


def inverse_lower(factor: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Return L⁻¹ of a lower triangular L, by halves: [[A, 0], [B, C]]⁻¹ = [[A⁻¹, 0], [−C⁻¹ B A⁻¹, C⁻¹]].

    Solving for the identity does three times the work, since it does not know that half of the result is zero.
    """
    n = factor.shape[0]
    if n <= LEAF:
        return solve_lower(factor, jnp.eye(n))
    k = n // 2
    A, C = inverse_lower(factor[:k, :k]), inverse_lower(factor[k:, k:])
    return jnp.block([[A, jnp.zeros((k, n - k))], [-C @ (factor[k:, :k] @ A), C]])


def singular_root(covariance: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Return a root R, R Rᵀ = C, of a covariance that may be singular; eigenvalues below zero count as zero."""
    values, vectors = jnp.linalg.eigh(0.5 * (covariance + covariance.T))
    return vectors * jnp.sqrt(jnp.maximum(values, 0.0))


def require_independent(columns: Float[np.ndarray, "n_row n_term"], names: tuple[str, ...], equation: str) -> None:
    """Refuse a dictionary with terms that are zero or linearly dependent on the data.

    A QR factorisation with column pivoting of the unit-norm columns reveals the rank, and which terms a dependent one
    is a combination of. Any matrix with the Gram matrix of the dictionary will do.
    """
    norms = np.linalg.norm(columns, axis=0)
    if np.any(norms == 0):
        raise InputError(
            f"Term {names[int(np.argmin(norms))]!r} of equation {equation!r} has no effect on any measurement: if "
            "it acts on a hidden state, which nothing in the simulation passes on to a sensor, write first values of "
            "the coefficients between them into the simulation, whose corrections are learned; if not, remove it."
        )
    factors: Any = scipy.linalg.qr(columns / norms, mode="economic", pivoting=True)
    _, R, order = factors
    # Norm of what a unit column has beside the others.
    rank = int(np.sum(np.abs(np.diag(R)) > 1e-7))
    if rank == len(names):
        return
    first = order[rank]
    weights = scipy.linalg.solve_triangular(R[:rank, :rank], R[:rank, rank])
    partners = [repr(names[order[j]]) for j in np.flatnonzero(np.abs(weights) > 1e-3 * np.abs(weights).max())]
    raise InputError(
        f"Collinear terms in equation {equation!r}: on these data {names[first]!r} is a linear combination "
        f"of {', '.join(partners)}; remove one of them, or use data that tell them apart."
    )
