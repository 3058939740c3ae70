"""All 2^K inclusion patterns at once against one Gaussian evidence for each."""

import itertools

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from bayes_greybox.model.algebra.collapsed import Regression, log_pattern_weights, patterns, spike_and_slab


def _regression(n_term, sigma, collinear, n_row=9, seed=0):
    """Whitened rows T, q of y = T θ + ε with half of the coefficients zero."""
    rng = np.random.default_rng(seed + n_term)
    Phi = rng.standard_normal((n_row, n_term))
    if n_term > 1:
        Phi[:, -1] = Phi[:, 0] + collinear * Phi[:, -1]
    theta = np.where(np.arange(n_term) % 2, 0.0, 1.0)
    y = Phi @ theta + sigma * rng.standard_normal(n_row)
    return Phi / sigma, y / sigma


def _evidences(T, q, tau, log_odds, digits=50):
    """log p(q, γ) for every pattern, by the n × n covariance I + Σ γ_j τ_j² t_j t_jᵀ in high precision."""
    n, k = T.shape
    with mpmath.workdps(digits):
        T_, q_ = mpmath.matrix(T.tolist()), mpmath.matrix(q.tolist())
        out = []
        for pattern in itertools.product((1, 0), repeat=k):
            covariance = mpmath.eye(n)
            prior = mpmath.mpf(0)
            for j, inside in enumerate(pattern):
                sign = -1 if inside else 1
                prior -= mpmath.log1p(mpmath.exp(sign * mpmath.mpf(float(log_odds[j]))))
                if inside:
                    covariance += mpmath.mpf(float(tau[j])) ** 2 * T_[:, j] * T_[:, j].T
            L = mpmath.cholesky(covariance)
            z = []
            for i in range(n):
                z.append((q_[i] - sum(L[i, m] * z[m] for m in range(i))) / L[i, i])
            log_det = 2 * sum(mpmath.log(L[i, i]) for i in range(n))
            out.append(prior - (sum(v**2 for v in z) + log_det + n * mpmath.log(2 * mpmath.pi)) / 2)
        return [float(value) for value in out]


@pytest.mark.parametrize(
    ("sigma", "collinear"), [(0.5, 1.0), (0.5, 1e-3), (1e-4, 1.0)], ids=["plain", "collinear", "tiny-sigma"]
)
@pytest.mark.parametrize("n_term", range(1, 7))
def test_weights_are_the_evidences_of_all_patterns(n_term, sigma, collinear):
    T, q = _regression(n_term, sigma, collinear)
    tau, log_odds = np.linspace(0.5, 1.5, n_term), np.linspace(-2.0, 1.0, n_term)
    regression = Regression(jnp.asarray(T), jnp.asarray(q), jnp.zeros(()))
    total, log_weight = jax.jit(spike_and_slab, static_argnums=3)(
        regression, jnp.asarray(tau), jnp.asarray(log_odds), float(len(q))
    )
    expected = np.array(_evidences(T, q, tau, log_odds))
    largest = expected.max()
    expected_total = largest + np.log(np.sum(np.exp(expected - largest)))
    assert float(total) == pytest.approx(expected_total, abs=1e-7)
    # Patterns that leave out what the data demand lie 1e8 nats below at the small σ: relative there, absolute
    # near.
    np.testing.assert_allclose(np.asarray(log_weight), expected - expected_total, rtol=1e-8, atol=1e-6)


def test_patterns_come_in_the_order_of_the_weights():
    # Independent a posteriori: each weight is a product over terms, so the order of the bits shows.
    mean, variance, log_odds = (
        np.array([0.3, -1.0, 2.0]),
        np.array([0.5, 0.2, 0.9]),
        np.array([0.0, 1.0, -1.0]),
    )
    got = log_pattern_weights(jnp.asarray(mean), jnp.diag(jnp.asarray(variance)), jnp.asarray(log_odds))
    log_in = -np.log1p(np.exp(-log_odds))
    log_out = -np.log1p(np.exp(log_odds)) - 0.5 * np.log(variance) - 0.5 * mean**2 / variance
    bits = patterns(3)
    assert bits.shape == (8, 3) and len(np.unique(bits, axis=0)) == 8
    np.testing.assert_allclose(got, bits @ log_in + (1 - bits) @ log_out, rtol=1e-12)


@pytest.mark.parametrize(("sigma", "collinear"), [(0.5, 1.0), (0.5, 1e-6), (1e-4, 1e-2)])
def test_gradients_are_finite_and_those_of_finite_differences(sigma, collinear):
    T, q = _regression(4, sigma, collinear)
    regression = Regression(jnp.asarray(T), jnp.asarray(q), jnp.zeros(()))

    def value(parameters):
        return spike_and_slab(regression, jnp.exp(parameters[:4]), parameters[4:], 9.0)[0]

    at = jnp.asarray([0.1, -0.3, 0.2, 0.0, -1.0, 0.5, 0.0, 1.0])
    gradient = jax.jit(jax.grad(value))(at)
    h = 1e-4 * jnp.eye(8)
    values = jax.jit(jax.vmap(value))
    np.testing.assert_allclose(gradient, (values(at + h) - values(at - h)) / 2e-4, rtol=1e-5, atol=1e-5)


def test_hopeless_odds_and_absent_terms_stay_finite():
    T, q = _regression(3, 5.0, 1.0)
    regression = Regression(jnp.asarray(T), jnp.asarray(q), jnp.zeros(()))
    total, log_weight = spike_and_slab(regression, jnp.ones(3), jnp.asarray([-800.0, 800.0, 0.0]), 9.0)
    assert np.isfinite(total)
    inclusion = np.exp(np.asarray(log_weight)) @ patterns(3)
    assert inclusion[0] == 0 and inclusion[1] == 1 and 0 < inclusion[2] < 1
