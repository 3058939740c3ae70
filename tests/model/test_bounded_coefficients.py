"""Normal and bounded priors of single coefficients in the collapsed density, against sums and integrals by hand."""

from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm, qmc, truncnorm

import bayes_greybox as bg
from bayes_greybox.model.algebra.truncated import log_mass, truncated_quantile
from bayes_greybox.model.gp.hyper import Hyperparameters
from bayes_greybox.model.likelihood import CollapsedNormal
from bayes_greybox.model.priors import Coefficient, Scales

TERMS = ["y", "ydot", "y**3"]
HYPER = Hyperparameters(jnp.asarray(0.6), jnp.ones(()), jnp.ones(0))
TAU = 0.7


@pytest.fixture(scope="module")
def data():
    return bg.systems.oscillator().simulate(np.linspace(0, 6, 12), noise=0.5, seed=3)


def design_of(data, stated):
    model = bg.GreyBox(dictionary={"ydot": TERMS}, discrepancy=None, coefficients={"ydot": stated})
    return model.assemble(data)["ydot"]


def dense(equation):
    """Φ and y of all rows in scaled units, the scale of θ, and σ."""
    Phi, _, y = equation.parts()
    return Phi, y, equation.frame.coefficient_scale, float(HYPER.sigma)


def averaged(design, scales, n_bounded):
    """The mean of the density over the uniform numbers, by a Sobol sequence, over the density at their middle."""
    points = jnp.asarray(qmc.Sobol(n_bounded, seed=1).random(2**13))

    def one(uniform):
        return CollapsedNormal(design, HYPER, scales._replace(uniform=uniform)).log_prob(design.y)

    values = jax.jit(jax.vmap(one))(points)
    return float(jax.scipy.special.logsumexp(values) - np.log(len(points)))


def in_box(mean, covariance, low, high):
    """P(low ≤ θ ≤ high) of a normal vector of one or two entries."""
    if len(mean) == 0:
        return 1.0
    return float(multivariate_normal.cdf(high, mean, covariance, lower_limit=low, abseps=1e-9, releps=1e-9))


def test_a_normal_prior_of_one_term_is_in_the_density(data):
    equation = design_of(data, {"ydot": Coefficient(mean=-0.4, sd=0.2)})
    Phi, y, scale, sigma = dense(equation)
    mean, sd = np.array([0, -0.4 / scale[1], 0]), np.array([TAU, 0.2 / scale[1], TAU])
    scales = equation.design.coefficients.complete(Scales(jnp.full(2, TAU)))
    np.testing.assert_allclose(scales.sd, sd)
    expected = multivariate_normal(Phi @ mean, Phi @ np.diag(sd**2) @ Phi.T + sigma**2 * np.eye(len(y))).logpdf(y)
    assert float(CollapsedNormal(equation.design, HYPER, scales).log_prob(equation.design.y)) == pytest.approx(
        expected, abs=1e-9
    )


@pytest.mark.parametrize("odds", [None, 0.3])
@pytest.mark.parametrize(
    "stated",
    [
        {"y": Coefficient(sign=1)},
        {"y": Coefficient(sign=1), "y**3": Coefficient(upper=-0.2)},
        {"ydot": Coefficient(mean=-0.4, sd=0.2, lower=-0.5), "y**3": Coefficient(sign=-1)},
        {"y": Coefficient(mean=-0.5, sd=0.3), "ydot": Coefficient(lower=0.0, upper=0.4)},
    ],
)
def test_the_density_is_that_of_the_restricted_prior(data, stated, odds):
    """p(y | η) = Σ_γ p(γ) N(y; Φm, C_γ) P(box | y, γ)/P(box | γ), every part of it written out."""
    equation = design_of(data, stated)
    Phi, y, scale, sigma = dense(equation)
    coefficients = equation.design.coefficients
    shared = len(coefficients.shared)
    scales = coefficients.complete(Scales(jnp.full(shared, TAU), None if odds is None else jnp.full(shared, odds)))
    mean, sd = np.zeros(3), np.full(3, TAU)
    low, high, always = np.full(3, -np.inf), np.full(3, np.inf), []
    for term, prior in stated.items():
        j = TERMS.index(term)
        low[j], high[j] = np.array(prior.interval) / scale[j]
        if prior.mean is not None:
            mean[j], sd[j] = prior.mean / scale[j], prior.sd / scale[j]
        if prior.mean is not None or not low[j] <= 0 <= high[j]:
            always.append(j)
    bounded = np.isfinite(low) | np.isfinite(high)
    total = 0.0
    for gamma in product([True, False], repeat=3) if odds is not None else [(True,) * 3]:
        gamma = np.array(gamma)
        if not gamma[always].all():
            continue
        free = [j for j in range(3) if j not in always and odds is not None]
        p_in = 1 / (1 + np.exp(-(odds or 0.0)))
        weight = np.prod([p_in if gamma[j] else 1 - p_in for j in free])
        D = np.diag(np.where(gamma, sd, 0.0) ** 2)
        C = Phi @ D @ Phi.T + sigma**2 * np.eye(len(y))
        centre, gain = np.where(gamma, mean, 0.0), D @ Phi.T @ np.linalg.inv(C)
        after, V = centre + gain @ (y - Phi @ centre), D - gain @ Phi @ D
        box = bounded & gamma
        p_after = in_box(after[box], V[np.ix_(box, box)], low[box], high[box])
        p_before = in_box(centre[box], D[np.ix_(box, box)], low[box], high[box])
        total += weight * multivariate_normal(Phi @ centre, C).pdf(y) * p_after / p_before
    # A Sobol sequence of 2^13 points leaves an error far below 1e-3 on so smooth an integrand in two dimensions.
    got = averaged(equation.design, scales, len(coefficients.bounded))
    assert got == pytest.approx(np.log(total), abs=1e-3)
    uniform = jnp.full(len(coefficients.bounded), 0.4)

    def density(tau):
        return CollapsedNormal(
            equation.design, HYPER, coefficients.complete(Scales(tau))._replace(uniform=uniform)
        ).log_prob(equation.design.y)

    assert np.all(np.isfinite(jax.grad(density)(jnp.full(shared, TAU))))


BOUNDS = [(-np.inf, 0.0), (0.0, np.inf), (2.0, 3.0), (30.0, np.inf), (-40.0, -35.0), (-np.inf, -60.0), (-1.0, 8.0)]


@pytest.mark.parametrize(("low", "high"), BOUNDS)
@pytest.mark.parametrize("u", [1e-6, 0.3, 0.999])
def test_quantiles_between_bounds_also_far_out_in_a_tail(low, high, u):
    z = truncated_quantile(jnp.asarray(u), jnp.asarray(low), jnp.asarray(high))
    assert low <= z <= high
    share = np.exp(log_mass(jnp.asarray(low), z) - log_mass(jnp.asarray(low), jnp.asarray(high)))
    assert share == pytest.approx(u, rel=1e-6, abs=1e-9)
    if abs(low) < 8 or abs(high) < 8:
        assert float(z) == pytest.approx(truncnorm.ppf(u, low, high), rel=1e-9)
        expected = np.log(norm.cdf(high) - norm.cdf(low))
        assert float(log_mass(jnp.asarray(low), jnp.asarray(high))) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("low", "high"), BOUNDS)
def test_derivatives_are_those_of_differences(low, high):
    at, step = jnp.array([0.3, low, high]), 1e-5
    for function in (lambda x: truncated_quantile(*x), lambda x: log_mass(x[1], x[2])):
        slope = jax.grad(function)(at)
        assert np.all(np.isfinite(slope))
        for i in np.flatnonzero(np.isfinite(at)):
            away = jnp.zeros(3).at[i].set(step)
            difference = (function(at + away) - function(at - away)) / (2 * step)
            assert slope[i] == pytest.approx(float(difference), rel=1e-4, abs=1e-6)
