"""Expected information against closed forms, and its bounds."""

import numpy as np
from scipy.stats import multivariate_normal

from bayes_greybox.discovery.next_experiment.information import (
    Products,
    entropy,
    expected_information,
    marginal_starts,
)


def products(y: np.ndarray, mean: np.ndarray, A: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q, h and G of one outcome under one component, σ = 1."""
    r = y - mean
    return np.array([r @ r]), (A.T @ r)[None], (A.T @ A)[None]


def test_density_is_the_dense_gaussian_and_two_experiments_share_their_coefficients():
    rng = np.random.default_rng(0)
    y, mean, A = rng.standard_normal(9), rng.standard_normal(9), rng.standard_normal((9, 2))
    parts = [Products(*products(y[own], mean[own], A[own])) for own in (slice(0, 5), slice(5, 9))]
    dense = multivariate_normal.logpdf(y, mean=mean, cov=A @ A.T + np.eye(9)) + 4.5 * np.log(2 * np.pi)  # pyright: ignore[reportArgumentType]
    assert np.isclose(parts[0].beside(parts[1]).log_density()[0], dense)


def test_starts_of_an_experiment_are_integrated_out():
    rng = np.random.default_rng(1)
    y, mean, A = rng.standard_normal(6), rng.standard_normal(6), rng.standard_normal((6, 3))
    whole = Products(*products(y, mean, A)).log_density()
    assert np.allclose(Products(*marginal_starts(*products(y, mean, A), 1)).log_density(), whole)


def test_information_of_two_known_means_is_that_of_quadrature():
    rng = np.random.default_rng(2)
    n, d, truth = 4000, 2.0, np.repeat([0, 1], 4000)
    y = rng.standard_normal(2 * n) + d * truth
    found = expected_information(-0.5 * np.stack([y**2, (y - d) ** 2], axis=1), truth, [0.5, 0.5])
    grid = np.linspace(-9, 11, 20001)
    f = [np.exp(-0.5 * (grid - m) ** 2) / np.sqrt(2 * np.pi) for m in (0.0, d)]
    both = 0.5 * (f[0] + f[1])
    exact = sum(0.5 * np.sum(each * np.log2(each / both)) for each in f) * (grid[1] - grid[0])
    # A false failure at four standard errors has probability 6e-5.
    assert abs(found.bits - exact) < 4 * found.error
    assert found.error < 0.02


def test_nothing_is_learned_from_equal_predictions_and_all_from_distant_ones():
    truth = np.repeat([0, 1], 10)
    assert np.isclose(expected_information(np.zeros((20, 2)), truth, [0.3, 0.7]).bits, 0.0)
    apart = np.where(truth[:, None] == [0, 1], 0.0, -1e3)
    assert np.isclose(expected_information(apart, truth, [0.3, 0.7]).bits, entropy([0.3, 0.7]))
