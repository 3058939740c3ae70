"""Evidence of sets of regressors, against dense normal densities integrated over the scale of the noise."""

from itertools import combinations

import numpy as np
import pytest
from scipy.special import logsumexp

from bayes_greybox.discovery.grid.log_evidence import Gram, log_evidences, modes
from bayes_greybox.discovery.grid.points import LATENT_FORCE, NO_DISCREPANCY, NoisePoint

N = 80
POINTS = (NoisePoint(NO_DISCREPANCY), NoisePoint(LATENT_FORCE, 1.0, 0.3))
FLOOR = 1e-12


def correlated(r=1.0, tau=3.0):
    """White noise, and noise with a part that hangs together."""
    lag = np.abs(np.arange(N)[:, None] - np.arange(N))
    return [np.eye(N), np.eye(N) + r**2 * np.exp(-lag / tau)]


def gram_of(y, X, covariances=None):
    Z, covariances = np.column_stack([y, X]), covariances or correlated()
    products = np.array([Z.T @ np.linalg.solve(R, Z) for R in covariances])
    logs = np.array([np.linalg.slogdet(R)[1] for R in covariances])
    return Gram(POINTS[: len(covariances)], products, logs, float(N))


def some(seed=0, k=6, noise=0.3):
    rng = np.random.default_rng(seed)
    X = rng.standard_normal((N, k))
    X /= np.sqrt(np.mean(X**2, axis=0))
    return X @ rng.standard_normal(k) + noise * rng.standard_normal(N), X


def dense(y, X, precision, R):
    """log ∫ N(y; 0, v R + X D⁻¹ Xᵀ) d log v, by a fine sum around the residual's own variance."""
    white = np.linalg.solve(np.linalg.cholesky(R), np.column_stack([y, X]))
    left = white[:, 0] - white[:, 1:] @ np.linalg.lstsq(white[:, 1:], white[:, 0], rcond=1e-12)[0]
    u = np.log(np.mean(left**2)) + np.linspace(-2, 3, 501)
    logs = np.empty(len(u))
    for k, log_v in enumerate(u):
        C = np.exp(log_v) * R + (X / precision) @ X.T
        _, log_det = np.linalg.slogdet(C)
        logs[k] = -0.5 * (N * np.log(2 * np.pi) + log_det + y @ np.linalg.solve(C, y))
    return logsumexp(logs) + np.log(u[1] - u[0])


def laplace_error(k, n=N):
    """By how much Laplace's approximation is below, at most.

    Without a prior on θ the integral over log v is Γ((n−k)/2) (S/2)^(−(n−k)/2), and by Stirling's formula the
    approximation at v = S/n is (k² + 2k + 2/3)/4n below it.
    """
    return (k**2 + 2 * k + 2 / 3) / (4 * n)


@pytest.mark.parametrize("noise", [0.3, 1e-4])
@pytest.mark.parametrize("size", [0, 1, 2, 3, 4])
def test_evidence_is_that_of_a_dense_density(size, noise):
    """On precise data, too: the mode of v is then far below the target's square."""
    y, X = some(k=max(size, 1), noise=noise)
    X = np.column_stack([X, np.random.default_rng(9).standard_normal((N, 6 - X.shape[1]))])
    precision = np.geomspace(0.01, 4.0, 6)
    sets = [tuple(range(size)), *list(combinations(range(6), size))[-2:]]
    found = log_evidences(gram_of(y, X), precision, sets, FLOOR)
    for own, logs in zip(sets, found, strict=True):
        for log, R in zip(logs, correlated(), strict=True):
            below = dense(y, X[:, list(own)], precision[list(own)], R) - log
            # What the prior takes of the mode is of the same order.
            assert -0.01 < below < 1.5 * laplace_error(size) + 0.01


def test_sets_of_all_sizes_are_as_one_by_one():
    y, X = some()
    every = [(0, 3), (), (2,), (1, 2, 5), (4,), (0, 1, 2, 3, 4, 5)]
    gram, precision = gram_of(y, X), np.ones(6)
    together = log_evidences(gram, precision, every, FLOOR)
    for own, logs in zip(every, together, strict=True):
        np.testing.assert_allclose(log_evidences(gram, precision, [own], FLOOR)[0], logs, rtol=1e-12)


def test_of_two_columns_that_are_one_the_second_adds_its_prior_alone():
    y, X = some(k=2)
    X = np.column_stack([X[:, 0], X[:, 0], X[:, 1]])
    precision = np.array([1.0, 4.0, 1.0])
    found = log_evidences(gram_of(y, X), precision, [(0, 1, 2)], FLOOR)[0]
    for log, R in zip(found, correlated(), strict=True):
        assert log == pytest.approx(dense(y, X, precision, R), abs=1.5 * laplace_error(3) + 0.01)
    # One coefficient, whose prior is the sum of both.
    one = log_evidences(gram_of(y, X), np.array([1 / (1 + 1 / 4), 1.0, 1.0]), [(0, 2)], FLOOR)[0]
    np.testing.assert_allclose(found, one, atol=2 * laplace_error(3))


@pytest.mark.parametrize("rounding", [-1e-12, 0.0, 1e-12])
def test_columns_that_rounding_alone_tells_apart_are_one(rounding):
    y, X = some(k=2, noise=1e-4)
    X = np.column_stack([X, X[:, 0] * (1 + rounding)])
    gram, precision = gram_of(y, X), np.ones(3)
    first, second, both = log_evidences(gram, precision, [(0, 1), (1, 2), (0, 1, 2)], FLOOR)
    np.testing.assert_allclose(first, second, atol=1e-6)
    # A prior twice as wide, and no nats for a direction that is nothing.
    np.testing.assert_allclose(both, log_evidences(gram, np.array([0.5, 1, 1]), [(0, 1)], FLOOR)[0], atol=0.05)


def test_data_without_noise_are_sure_of_their_set_and_of_no_larger_one():
    rng = np.random.default_rng(2)
    X = rng.standard_normal((N, 4))
    y = X[:, :2] @ [0.8, -0.5]
    gram = gram_of(y, X, [np.eye(N)])
    sets = [(), (0,), (0, 1), (0, 1, 2), (0, 1, 2, 3), (2, 3)]
    found = log_evidences(gram, np.ones(4), sets, FLOOR)[:, 0]
    assert np.all(np.isfinite(found)) and np.argmax(found) == 2
    assert found[2] > found[1] + 300
    # Each further column costs √(v D/(G + v D)), 15 nats at this floor.
    assert np.all(np.diff(found[2:5]) < -10)


def test_the_noise_is_no_smaller_than_its_floor():
    y, X = some(noise=0.0)
    gram, sets = gram_of(y, X, [np.eye(N)]), [tuple(range(6))]
    for floor in (1e-4, 1e-8):
        assert modes(gram, np.ones(6), sets, np.zeros(1, int), floor).v[0] == pytest.approx(floor)
        C = floor * np.eye(N) + X @ X.T
        exact = -0.5 * (N * np.log(2 * np.pi) + np.linalg.slogdet(C)[1] + y @ np.linalg.solve(C, y))
        # The same width in log v is counted as anywhere else.
        expected = exact + 0.5 * np.log(4 * np.pi / N)
        assert log_evidences(gram, np.ones(6), sets, floor)[0, 0] == pytest.approx(expected, rel=1e-6)


def test_modes_are_the_posteriors_of_ridge_regression():
    y, X = some()
    gram, precision = gram_of(y, X), np.geomspace(0.1, 10.0, 6)
    sets, points = [(1, 4), (), (0, 2, 3), (5, 4)], np.array([1, 0, 0, 1])
    found = modes(gram, precision, sets, points, FLOOR)
    for own, point, v, mean, covariance in zip(sets, points, *found, strict=True):
        R, A = correlated()[point], X[:, list(own)]
        inverse = np.linalg.inv(A.T @ np.linalg.solve(R, A) + v * np.diag(precision[list(own)]))
        np.testing.assert_allclose(mean, inverse @ A.T @ np.linalg.solve(R, y), rtol=1e-8)
        np.testing.assert_allclose(covariance, v * inverse, rtol=1e-8)
        # v is at its mode, the penalised residual over n, up to a share of (k/n)².
        left = y @ np.linalg.solve(R, y) - mean @ A.T @ np.linalg.solve(R, y)
        assert v == pytest.approx(left / N, rel=5e-3)


def test_coefficients_of_any_size_have_a_posterior():
    y, X = some(k=3)
    scale = np.array([1e-8, 1.0, 1e9])
    plain = modes(gram_of(y, X), np.ones(3), [(0, 1, 2)], np.zeros(1, int), FLOOR)
    scaled = modes(gram_of(y, X * scale), scale**2, [(0, 1, 2)], np.zeros(1, int), FLOOR)
    np.testing.assert_allclose(scaled.mean[0] * scale, plain.mean[0], rtol=1e-7)
