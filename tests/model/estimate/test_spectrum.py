"""The evidence without f, against normal densities by hand."""

import numpy as np
import pytest
from fabricated import oscillator
from scipy.stats import multivariate_normal

from bayes_greybox.model.estimate.evidence import LEAST_FLOOR, Spectrum, marginal
from bayes_greybox.model.estimate.likeliest import likeliest
from bayes_greybox.model.gp.hyper import NoisePrior
from bayes_greybox.model.program import Program
from bayes_greybox.physics.coefficient import Coefficient

SIGMA = np.array([0.3, 1.0, 2.0])


@pytest.mark.parametrize("n_column", [0, 1, 9])
def test_given_sigma_it_is_the_density_of_the_data(n_column):
    rng = np.random.default_rng(0)
    X, y, sd = rng.standard_normal((12, n_column)), rng.standard_normal(12), np.full(n_column, 0.7)
    found = Spectrum.of(X.T @ X, X.T @ y, y @ y, len(y), sd).log_density(SIGMA)
    expected = [multivariate_normal.logpdf(y, cov=s**2 * np.eye(12) + 0.7**2 * X @ X.T) for s in SIGMA]
    np.testing.assert_allclose(found, expected)


@pytest.mark.parametrize("n_column", [0, 2])
def test_a_batch_has_what_each_has_alone(n_column):
    rng = np.random.default_rng(1)
    X, y, sd = rng.standard_normal((12, n_column)), rng.standard_normal(12), rng.uniform(0.5, 1, (4, n_column))
    batch = Spectrum.of(X.T @ X, X.T @ y, y @ y, len(y), sd)
    each = [Spectrum.of(X.T @ X, X.T @ y, y @ y, len(y), row) for row in sd]
    np.testing.assert_allclose(batch.log_density(SIGMA), [one.log_density(SIGMA) for one in each])
    noise = NoisePrior(0.0, 1.0)
    evidence = marginal(batch, noise).log_evidence
    np.testing.assert_allclose(evidence, [float(marginal(one, noise).log_evidence) for one in each])


def test_at_the_least_floor_a_term_too_many_is_as_unlikely_as_it_is_at_others():
    rng = np.random.default_rng(0)
    X = rng.standard_normal((1000, 3))
    y = X[:, :2] @ [0.8, -0.6]
    for floor in (1e-4, LEAST_FLOOR):
        noisy = y + floor * rng.standard_normal(1000)
        G, g = X.T @ X, X.T @ noisy
        sets = [
            Spectrum.of(G[:k, :k], g[:k], noisy @ noisy, 1000, np.ones(k)) for k in (2, 3)
        ]  # fmt: skip
        few, many = (float(marginal(each, NoisePrior(floor, 1.0)).log_evidence) for each in sets)
        # log(√n/σ) less half a χ² of one degree of freedom, beyond nine once in 370 times
        assert np.log(np.sqrt(1000) / (1.5 * floor)) - 4.5 - 1 < few - many < np.log(np.sqrt(1000) / floor) + 1


def test_coefficients_of_which_something_is_stated_are_as_uncertain_as_the_residuals_say():
    """A bound far away says nothing: those of all terms are then as uncertain as without it."""
    terms = {"v": ["y**3", "v", "sin(3*y)"]}
    bound = Program(terms, discrepancy=None, coefficients={"v": {"v": Coefficient(upper=1e3)}})
    (plain,) = Program(terms, discrepancy=None).assemble(oscillator(200)).values()
    (stated,) = bound.assemble(oscillator(200)).values()
    assert len(likeliest(plain).terms) == 3
    np.testing.assert_allclose(likeliest(stated).sd, likeliest(plain).sd, rtol=0.05)
