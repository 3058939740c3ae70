"""Probability measures on the states, as nodes and weights: what "orthogonal" is taken with respect to."""

from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from scipy.stats import qmc

Measure = Literal["empirical", "box", "box-monte-carlo"]

QUADRATURE_NODES = {1: 64, 2: 32, 3: 16}
"""Gauss–Legendre nodes per variable; exact for polynomials of degree 2n − 1."""

LOW_DISCREPANCY_NODES = 4096
"""Sobol nodes from four variables on."""


def box_nodes(
    n_var: int, *, monte_carlo: int | None = None, seed: int = 0
) -> tuple[Float[np.ndarray, "n_node n_var"], Float[np.ndarray, " n_node"]]:
    """Nodes and weights of the uniform probability measure on the box [−1, 1]^d.

    Tensor Gauss–Legendre for d ≤ 3, scrambled Sobol points beyond; with `monte_carlo` = n, n independent
    uniform points, as the seed paper integrates its Gram matrix.

    Args:
        n_var: Number of variables d.
        monte_carlo: Number of plain Monte Carlo points, or None for quadrature.
        seed: Seed of the random points.

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
