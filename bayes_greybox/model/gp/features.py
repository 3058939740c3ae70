"""Hilbert-space features: the eigenfunctions of the Laplacian on a box around the data."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Array, Float

from bayes_greybox.physics.formula.expressions import namespace
from bayes_greybox.running.arrays import on_device
from bayes_greybox.running.errors import InputError


@dataclass(frozen=True)
class HilbertBasis:
    """ψ_j(x) = Π_d c_{j_d} cos(√λ_{j_d} (x_d + L)), √λ_j = π j/(2L), c_0² = 1/(2L), c_j² = 1/L, on [−L, L]^d.

    With it k(x, x') ≈ Σ_j S(√λ_j) ψ_j(x) ψ_j(x'), S the spectral density (Solin & Särkkä 2020, Eq. 20;
    Riutort-Mayol et al. 2023, Eq. 9 to 11). Data live in [−1, 1]^d, so L is the boundary factor.

    The eigenfunctions have Neumann conditions (zero slope at the boundary): the Dirichlet sines of
    `numpyro.contrib.hsgp` cannot hold a discrepancy that does not depend on one of the variables, and with L = 1.5 that
    turned one posterior mode into four.

    Attributes:
        boundary: L, the same in every direction, or one for each.
        per_variable: Features m_d in each direction, j_d = 0 … m_d − 1. In more than two directions the tensor product,
            which grows as m^d, is cut at total order: Σ_d j_d (m/m_d) < m with m = max m_d.
    """

    boundary: float | tuple[float, ...]
    per_variable: tuple[int, ...]

    def __post_init__(self) -> None:
        if isinstance(self.boundary, tuple) and len(self.boundary) != len(self.per_variable):
            raise InputError(
                f"OrthogonalGP(boundary={self.boundary!r}) must be one number, or one for each of the "
                f"{len(self.per_variable)} variables."
            )

    @property
    def half_widths(self) -> Float[np.ndarray, " n_var"]:
        """L in every direction."""
        return np.broadcast_to(np.asarray(self.boundary, float), (len(self.per_variable),))

    @property
    def indices(self) -> np.ndarray:
        """Indices j as an array [n_basis, n_var], the last variable running fastest."""
        return self._growth[0]

    @property
    def size(self) -> int:
        """Number of features M."""
        return len(self.indices)

    @property
    def frequency(self) -> Float[Array, "n_basis n_var"]:
        """√λ_j in every direction."""
        return on_device(self.indices * np.pi / (2 * self.half_widths))

    @property
    def mean_square(self) -> Float[np.ndarray, " n_basis"]:
        """Mean of ψ_j² over the data's box: with their variances, that of f over it."""
        L = self.half_widths
        # The mean of cos²(ω(x + L)) over [−1, 1] is ½ + ½ cos(2ωL) sin(2ω)/(2ω), and 2ωL = jπ.
        turn = np.where(self.indices % 2, -1.0, 1.0) * np.sinc(self.indices / L)
        return np.prod(np.where(self.indices == 0, 0.5, 1.0) / L * (1 + turn) / 2, axis=1)

    def __call__(self, x: Float[Array | np.ndarray, "n_row n_var"]) -> Float[Array | np.ndarray, "n_row n_basis"]:
        """Return ψ(x) for points in scaled units."""
        values = namespace([x]).ones((x.shape[0], 1))
        for along, kept in zip(self.directions(x), self._growth[1], strict=True):
            values = (values[:, :, None] * along[:, None, :]).reshape(x.shape[0], -1)
            values = values if len(kept) == values.shape[1] else values[:, kept]
        return values

    def weighted(
        self, x: Float[np.ndarray, "n_row n_var"], weight: Float[np.ndarray, " n_basis"]
    ) -> Float[np.ndarray, " n_row"]:
        """Return ψ(x) w without ψ(x): the factor of the last direction is summed over before it is multiplied in."""
        *first, last = self.directions(x)
        *growth, kept = self._growth[1]
        values = np.ones((x.shape[0], 1))
        for along, inside in zip(first, growth, strict=True):
            values = (values[:, :, None] * along[:, None, :]).reshape(x.shape[0], -1)[:, inside]
        W = np.zeros(values.shape[1] * last.shape[1])
        W[kept] = weight
        # Σ_p ψ_p(x) Σ_q ψ_q(x_d) W_pq
        return np.einsum("np,np->n", values, last @ W.reshape(values.shape[1], -1).T)

    def directions(self, x: Float[Array | np.ndarray, "*n n_var"]) -> list[Float[Array | np.ndarray, "*n m"]]:
        """Return the factors of ψ(x) in each direction, whose products are the features."""
        xp, factors = namespace([x]), []
        for d, (m, L) in enumerate(zip(self.per_variable, self.half_widths, strict=True)):
            along = xp.cos(np.arange(m) * np.pi / (2 * L) * (x[..., d : d + 1] + L))
            factors.append(along * np.sqrt(np.where(np.arange(m) == 0, 0.5, 1.0) / L))
        return factors

    @cached_property
    def _growth(self) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        """Indices, built one variable after the other, and the places that are kept of the product with each.

        What is beyond the cut with some variables stays so with more; the whole product is never formed.
        """
        m = np.array(self.per_variable)
        indices, kept = np.zeros((1, 0), int), []
        for d in range(len(m)):
            indices = np.column_stack([np.repeat(indices, m[d], axis=0), np.tile(np.arange(m[d]), len(indices))])
            inside = (indices * (m.max() / m[: d + 1])).sum(axis=1) < m.max()
            kept.append(np.flatnonzero(inside) if len(m) > 2 else np.arange(len(indices)))
            indices = indices[kept[-1]]
        return indices, tuple(kept)


def default_features(n_var: int) -> tuple[int, ...]:
    """Return the number of features per variable when the user names none."""
    return ({1: 20, 2: 10, 3: 8}.get(n_var, 6),) * n_var
