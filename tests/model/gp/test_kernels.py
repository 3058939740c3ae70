"""Kernels and their spectral densities."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpyro.contrib.hsgp.spectral_densities import (
    spectral_density_matern,
    spectral_density_squared_exponential,
)

from bayes_greybox.model.gp.kernels import KERNELS, gram, log_spectral_density

SMOOTHNESS = {"matern32": 1.5, "matern52": 2.5}


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("name", list(KERNELS))
def test_spectral_density_is_numpyros(name, dim):
    omega = np.random.default_rng(dim).uniform(-4, 4, (20, dim))
    amplitude, length = 0.7, 1.3
    got = jnp.exp(log_spectral_density(KERNELS[name], jnp.asarray(omega), amplitude, jnp.full(dim, length)))
    for row, value in zip(omega, got, strict=True):
        if name in SMOOTHNESS:
            expected = spectral_density_matern(dim, SMOOTHNESS[name], row, amplitude**2, length)
        else:
            expected = spectral_density_squared_exponential(dim, row, amplitude**2, length)
        assert float(value) == pytest.approx(float(expected), rel=1e-12)


@pytest.mark.parametrize("name", list(KERNELS))
def test_spectral_density_is_the_fourier_transform(name):
    # S(ω) = ∫ k(r) cos(ωr) dr by Simpson's rule; the Matérn kernels' kink at r = 0 is a node.
    length = jnp.asarray([0.6])
    r = np.linspace(0, 40, 80_001)
    weight = np.where(np.arange(r.size) % 2, 4.0, 2.0) * (r[1] / 3)
    weight[[0, -1]] /= 2
    k = np.asarray(gram(KERNELS[name], jnp.asarray(r[:, None]), jnp.zeros((1, 1)), 0.8, length))[:, 0]
    omega = np.array([0.0, 0.5, 2.0, 5.0])
    expected = 2 * (weight * k) @ np.cos(np.outer(r, omega))
    got = np.exp(log_spectral_density(KERNELS[name], jnp.asarray(omega[:, None]), 0.8, length))
    np.testing.assert_allclose(got, expected, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("name", list(KERNELS))
def test_length_scales_belong_to_their_direction(name):
    x = jnp.asarray(np.random.default_rng(0).uniform(-1, 1, (7, 2)))
    length = jnp.asarray([0.4, 2.5])
    K = gram(KERNELS[name], x, x, 0.9, length)
    np.testing.assert_allclose(K, gram(KERNELS[name], x / length, x / length, 0.9, jnp.ones(2)), rtol=1e-12)
    np.testing.assert_allclose(np.diag(K), 0.81, rtol=1e-15)
    omega = jnp.asarray([[0.3, -1.1]])
    got = log_spectral_density(KERNELS[name], omega, 1.0, length)
    expected = log_spectral_density(KERNELS[name], omega * length, 1.0, jnp.ones(2)) + jnp.sum(jnp.log(length))
    np.testing.assert_allclose(got, expected, rtol=1e-12)


def test_logarithm_and_gradient_are_finite_where_the_density_underflows():
    omega = jnp.asarray([[30.0, 30.0]])

    def log_S(amplitude, length):
        return log_spectral_density(KERNELS["squared_exponential"], omega, amplitude, length)[0]

    length = jnp.asarray([10.0, 10.0])
    assert jnp.exp(log_S(1.0, length)) == 0.0
    assert float(log_S(1.0, length)) == pytest.approx(np.log(2 * np.pi * 100) - 90_000.0, rel=1e-12)
    gradients = jax.grad(log_S, argnums=(0, 1))(1e-12, length)
    assert float(gradients[0]) == pytest.approx(2e12)
    np.testing.assert_allclose(gradients[1], 0.1 - 9000.0, rtol=1e-12)


@pytest.mark.parametrize("name", list(KERNELS))
def test_gradient_of_the_kernel_is_finite_on_its_diagonal(name):
    x = jnp.asarray([[0.0, 0.0], [0.3, -0.2], [0.3, -0.2]])
    gradient = jax.grad(lambda length: jnp.sum(gram(KERNELS[name], x, x, 1.0, length)))(jnp.asarray([0.5, 1.5]))
    assert np.all(np.isfinite(gradient)) and np.all(gradient > 0)
