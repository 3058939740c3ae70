"""Hilbert-space features: orthonormal, in the stated order, and converging to the kernel."""

import tracemalloc

import jax.numpy as jnp
import numpy as np
import pytest

from bayes_greybox.criticism.convergence import WIDEST
from bayes_greybox.model.gp.features import HilbertBasis, default_features
from bayes_greybox.model.gp.kernels import KERNELS, gram, log_spectral_density
from bayes_greybox.running.errors import InputError

X = jnp.asarray(np.linspace(-1, 1, 41)[:, None])


def _error(name, length, boundary, size):
    """Largest error of the expansion of a unit-variance kernel on the box of the data."""
    basis = HilbertBasis(boundary, (size,))
    ell = jnp.asarray([length])
    S = np.exp(np.asarray(log_spectral_density(KERNELS[name], basis.frequency, 1.0, ell)))
    psi = np.asarray(basis(X))
    return np.abs((psi * S) @ psi.T - np.asarray(gram(KERNELS[name], X, X, 1.0, ell))).max()


def test_expansion_converges_geometrically_in_the_number_of_features():
    """The truncation error is a Gaussian tail, so it falls faster than any power."""
    errors = np.array([_error("squared_exponential", 0.5, 3.0, m) for m in (6, 10, 14, 18, 22)])
    print("relative error for 6, 10, 14, 18, 22 features: " + ", ".join(f"{error:.1e}" for error in errors))
    assert np.all(errors[1:] < 0.2 * errors[:-1])
    # Faster than geometric: each four features gain more than the four before.
    assert np.all(np.diff(errors[1:] / errors[:-1]) < 0)
    assert errors[-1] < 1e-6


def test_expansion_converges_geometrically_in_the_boundary():
    """With many features the image behind the wall is left: k(x, 2L − x') = exp(−2(L − 1)²/ℓ²) at x = x' = 1."""
    boundaries = np.array([1.25, 1.5, 2.0, 2.5, 3.0])
    errors = np.array([_error("squared_exponential", 0.6, L, 60) for L in boundaries])
    np.testing.assert_allclose(errors[:4], np.exp(-2 * (boundaries[:4] - 1) ** 2 / 0.36), rtol=1e-3)
    assert errors[-1] < 1e-6


@pytest.mark.parametrize(("boundary", "uneven"), [(2.0, 1.34), (WIDEST, 1.09)])
def test_images_behind_the_walls_make_the_variance_hardly_uneven(boundary, uneven):
    """Sum of ρ over all images is larger at the edge of the data than in its middle, most at some length scale."""
    basis, ratios = HilbertBasis(boundary, (200,)), []
    psi = np.asarray(basis(X))
    for name in KERNELS:
        for length in np.arange(0.5, 8.0, 0.25):
            S = np.exp(np.asarray(log_spectral_density(KERNELS[name], basis.frequency, 1.0, jnp.asarray([length]))))
            variance = psi**2 @ S
            ratios.append(variance.max() / variance.min())
    assert max(ratios) == pytest.approx(uneven, abs=0.006)


@pytest.mark.parametrize("name", list(KERNELS))
@pytest.mark.parametrize("length", [0.7, 1.5, 4.0])
def test_the_boundary_and_the_features_that_a_kernel_asks_for_hold_it(name, length):
    """With L = b ℓ and m = a L/ℓ the error is a few percent; at L = 2 and ℓ = 4 it is beyond half."""
    kernel = KERNELS[name]
    boundary = kernel.boundary_per_length * length
    size = int(np.ceil(kernel.features_per_unit * boundary / length))
    assert _error(name, length, boundary, size) < 0.05
    assert _error(name, 4.0, 2.0, 60) > 0.5


@pytest.mark.parametrize(("name", "nu"), [("matern32", 1.5), ("matern52", 2.5)])
def test_matern_converges_algebraically(name, nu):
    """The tail of S ~ ω^(−2ν−1) leaves an error ~ M^(−2ν)."""
    sizes = np.array([100, 200, 400])
    errors = np.array([_error(name, 0.3, 6.0, m) for m in sizes.tolist()])
    rate = -np.diff(np.log(errors)) / np.diff(np.log(sizes))
    # From below, as sizes grow: 2.96 and 2.99, 4.84 and 4.96.
    assert np.all(np.abs(rate - 2 * nu) < 0.25)


def test_basis_is_orthonormal_on_its_domain():
    L, n = 1.7, 128
    # The midpoint rule integrates these cosines exactly.
    x = -L + 2 * L * (np.arange(n) + 0.5) / n
    psi = np.asarray(HilbertBasis(L, (12,))(jnp.asarray(x[:, None])))
    np.testing.assert_allclose(psi.T @ psi * (2 * L / n), np.eye(12), atol=1e-12)


def test_every_direction_may_have_a_boundary_of_its_own():
    x = jnp.asarray(np.random.default_rng(0).uniform(-1, 1, (20, 2)))
    both = HilbertBasis((1.5, 3.0), (4, 5))
    alone = [np.asarray(HilbertBasis(L, (m,))(x[:, [d]])) for d, (L, m) in enumerate(((1.5, 4), (3.0, 5)))]
    np.testing.assert_allclose(both(x), np.einsum("ni,nj->nij", *alone).reshape(20, -1), atol=1e-12)
    np.testing.assert_allclose(both.frequency[-1], [3 * np.pi / 3.0, 4 * np.pi / 6.0])
    np.testing.assert_array_equal(HilbertBasis((2.0, 2.0), (4, 5))(x), HilbertBasis(2.0, (4, 5))(x))
    with pytest.raises(InputError, match="one for each of the 2 variables"):
        HilbertBasis((2.0,), (4, 5))


def test_basis_has_zero_slope_at_the_boundary_and_a_constant():
    basis = HilbertBasis(2.0, (5,))
    step = 1e-4
    edge = np.asarray(basis(jnp.asarray([[2.0], [2.0 - step]])))
    # Zero slope: the difference is of second order, at most ½ (√λ step)² of the amplitude.
    assert np.abs(edge[0] - edge[1]).max() < 0.5 * (np.pi * step) ** 2
    np.testing.assert_allclose(np.asarray(basis(X))[:, 0], 0.5, rtol=1e-15)


@pytest.mark.parametrize("sizes", [(4,), (3, 5), (4, 4, 4), (3, 6, 2), (3, 2, 2, 3)])
def test_columns_are_products_in_the_order_of_the_indices(sizes):
    L = 1.5
    basis = HilbertBasis(L, sizes)
    x = np.random.default_rng(0).uniform(-1, 1, (6, len(sizes)))
    psi = np.asarray(basis(jnp.asarray(x)))
    assert psi.shape == (6, basis.size) == (6, len(basis.indices)) and basis.frequency.shape == basis.indices.shape
    for column, j in zip(psi.T, basis.indices, strict=True):
        norm = np.sqrt(np.where(j == 0, 0.5, 1.0) / L)
        np.testing.assert_allclose(column, np.prod(norm * np.cos(np.pi * j / (2 * L) * (x + L)), axis=1), atol=1e-14)
    np.testing.assert_allclose(basis.frequency, np.pi * basis.indices / (2 * L), rtol=1e-15)


def test_total_order_keeps_a_simplex_from_three_variables_on():
    assert HilbertBasis(2.0, (10, 10)).size == 100
    # #{j ≥ 0 : j₁ + j₂ + j₃ < 8} = C(10, 3)
    basis = HilbertBasis(2.0, (8, 8, 8))
    assert basis.size == 120 and basis.indices.sum(axis=1).max() == 7
    uneven = HilbertBasis(2.0, (8, 4, 4)).indices
    assert uneven[:, 0].max() == 7 and uneven[:, 1].max() == 3
    assert len(np.unique(uneven, axis=0)) == len(uneven)


@pytest.mark.parametrize("sizes", [(7,), (4, 3), (5, 3, 4), (3, 3, 3, 3)])
def test_what_is_weighted_is_the_product_with_the_features(sizes):
    rng = np.random.default_rng(0)
    basis = HilbertBasis(1.5, sizes)
    x, weight = rng.uniform(-1.5, 1.5, (50, len(sizes))), rng.standard_normal(basis.size)
    np.testing.assert_allclose(basis.weighted(x, weight), basis(x) @ weight, rtol=1e-12, atol=1e-13)


def test_defaults_stay_small():
    assert [HilbertBasis(2.0, default_features(d)).size for d in (1, 2, 3, 4)] == [20, 100, 120, 126]


def test_many_variables_cost_what_is_kept_and_not_what_is_cut():
    # Of 6**7 = 279,936 products 792 are kept; the whole would take 1000 x 279,936 x 8 bytes = 2.2 GB.
    basis = HilbertBasis(2.0, (6,) * 7)
    assert basis.size == 792
    tracemalloc.start()
    assert basis(np.zeros((1000, 7))).shape == (1000, 792)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2e8


@pytest.mark.parametrize(("boundary", "size"), [(1.5, (6,)), ((2.0, 3.0), (5, 7)), (2.0, (4, 4, 4))])
def test_the_mean_square_is_that_over_the_box(boundary, size):
    basis = HilbertBasis(boundary, size)
    # Gauss-Legendre quadrature is exact for such waves.
    node, weight = np.polynomial.legendre.leggauss(24)
    x = np.stack(np.meshgrid(*[node] * len(size), indexing="ij"), -1).reshape(-1, len(size))
    w = np.prod(np.stack(np.meshgrid(*[weight / 2] * len(size), indexing="ij"), -1).reshape(-1, len(size)), axis=1)
    np.testing.assert_allclose(w @ np.asarray(basis(x)) ** 2, basis.mean_square, rtol=1e-10)
