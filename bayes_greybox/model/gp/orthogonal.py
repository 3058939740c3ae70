"""Kernels orthogonal to the dictionary under a measure μ: the measures, and the exact, dense kernels.

With an orthonormal dictionary Φₒ = Φ T (⟨Φₒ, Φₒᵀ⟩ = I under μ), h = ⟨Φₒ, k(·, x)⟩ and Q = ⟨⟨Φₒ, k, Φₒᵀ⟩⟩:

    projected     k − Φₒᵀ h' − hᵀ Φₒ' + Φₒᵀ Q Φₒ'      covariance of (I − P) f, f ~ GP(0, k)
    conditioned   k − hᵀ Q⁻¹ h'                        f ~ GP(0, k) given ⟨Φ, f⟩ = 0 (Plumlee & Joseph 2018)
    printed       k − Φₒᵀ Φₒ'                          as printed by Manna, Rogers & Bull; not a covariance
    none          k
"""

from typing import Any, Literal

import numpy as np
from jaxtyping import Array, Float
from scipy.stats import qmc

from bayes_greybox.model.algebra.linalg import jittered_cholesky, solve_lower

from .kernels import Kernel, gram

Variant = Literal["projected", "conditioned", "printed", "none"]

Measure = Literal["empirical", "unweighted", "box", "box-monte-carlo"]

Points = tuple[Float[Array, "_ n_var"], Float[Array, "_ n_rank"]]
"""Points in scaled units, and Φₒ there."""

QUADRATURE_NODES = {1: 64, 2: 32, 3: 16}
"""Gauss–Legendre nodes per variable; exact for polynomials of degree 2n − 1."""

LOW_DISCREPANCY_NODES = 4096
"""Sobol nodes from four variables on."""


def box_nodes(
    n_var: int, *, monte_carlo: int | None = None, seed: int = 0
) -> tuple[Float[np.ndarray, "n_node n_var"], Float[np.ndarray, " n_node"]]:
    """Return nodes and weights of the uniform probability measure on the box [−1, 1]^d.

    Tensor Gauss–Legendre for d ≤ 3, scrambled Sobol points beyond; with `monte_carlo` = n, n independent
    uniform points, as the seed paper integrates its Gram matrix.

    Returns:
        Nodes [n_node, d] in scaled units, and weights [n_node] that sum to one.
    """
    if monte_carlo is not None:
        nodes = np.random.default_rng(seed).uniform(-1.0, 1.0, size=(monte_carlo, n_var))
        return nodes, np.full(monte_carlo, 1.0 / monte_carlo)
    if n_var > max(QUADRATURE_NODES):
        sobol: Any = qmc.Sobol
        points = sobol(n_var, seed=seed).random(LOW_DISCREPANCY_NODES)
        return 2.0 * points - 1.0, np.full(LOW_DISCREPANCY_NODES, 1.0 / LOW_DISCREPANCY_NODES)
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
    variant: Variant, kernel: Kernel, amplitude: Float[Array, ""] | float, length_scale: Float[Array, " n_var"],
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
