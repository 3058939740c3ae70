"""Priors on the coefficients: their laws and the checks of their parameters."""

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from numpyro.handlers import seed, substitute, trace
from scipy import stats

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.priors import CustomPrior, Laplace, Normal, RegularisedHorseshoe, SpikeAndSlab
from bayes_greybox.model.program import Program
from bayes_greybox.running.errors import InputError

N_DRAW = 20_000


def _theta(prior, n_term, sigma=1.0, n_obs=100.0, fixed=None):
    """Prior draws of θ: scales from the program, θ ~ N(0, sd²)."""

    def one(key):
        key_scales, key_theta = jax.random.split(key)
        program = seed(substitute(prior.scales, fixed or {}), key_scales)
        return program(n_term, n_obs, sigma).sd * jax.random.normal(key_theta, (n_term,))

    return np.asarray(jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(0), N_DRAW)))


def test_laplace_is_marginally_laplace():
    """Kolmogorov–Smirnov at p > 1e-4: fails falsely once in 10,000 runs."""
    theta = _theta(Laplace(), 1, fixed={"tau": jnp.asarray(0.7)})[:, 0]
    assert stats.kstest(theta, stats.laplace(scale=0.7).cdf).pvalue > 1e-4
    assert stats.kstest(theta, stats.laplace(scale=0.75).cdf).pvalue < 1e-4


def test_normal_is_normal_given_tau():
    theta = _theta(Normal(), 2, fixed={"tau": jnp.asarray(0.3)})
    assert stats.kstest(theta[:, 1], stats.norm(scale=0.3).cdf).pvalue > 1e-4


def test_horseshoe_with_small_tau_ends_in_its_slab():
    """λ = ∞ leaves θ_j ~ N(0, c²), c² ~ InverseGamma(ν/2, ν s²/2): Student t, ν degrees of freedom, scale s."""
    prior = RegularisedHorseshoe(expected_active=1.0, slab_scale=1.5, slab_df=3.0)
    theta = _theta(prior, 3, fixed={"lambda": jnp.full(3, 1e12)})[:, 0]
    assert stats.kstest(theta, stats.t(3.0, scale=1.5).cdf).pvalue > 1e-4


def test_horseshoe_without_slab_is_the_horseshoe():
    prior = RegularisedHorseshoe(expected_active=1.0)
    lam = jnp.asarray([0.1, 1.0, 10.0])
    fixed = {"lambda": lam, "slab": jnp.asarray(1e30), "tau_unit": jnp.asarray(2.0)}
    scales = seed(substitute(prior.scales, fixed), 0)(3, 400.0, 0.5)
    # τ₀ = p₀/(K − p₀) · σ/√n
    tau_0 = 1.0 / 2.0 * 0.5 / 20.0
    np.testing.assert_allclose(scales.sd, 2.0 * tau_0 * lam, rtol=1e-12)
    sites = trace(seed(substitute(prior.scales, fixed), 0)).get_trace(3, 400.0, 0.5)
    assert float(sites["tau"]["value"]) == pytest.approx(2.0 * tau_0)


@pytest.mark.parametrize(("n_term", "expected"), [(9, 3.0), (3, 1.0), (1, 0.5)])
def test_horseshoe_expects_a_third_of_the_terms(n_term, expected):
    sites = trace(seed(RegularisedHorseshoe().scales, 0)).get_trace(n_term, 100.0, 1.0)
    tau_0 = float(sites["tau"]["value"] / sites["tau_unit"]["value"])
    assert tau_0 == pytest.approx(expected / (n_term - expected) / 10.0)


def test_horseshoe_needs_fewer_active_terms_than_terms():
    with pytest.raises(InputError, match="expected_active=4"):
        seed(RegularisedHorseshoe(expected_active=4.0).scales, 0)(4, 100.0, 1.0)


def test_spike_and_slab_sums_small_dictionaries_and_samples_large_ones():
    small = seed(SpikeAndSlab().scales, 0)(12, 100.0, 1.0)
    assert small.log_odds is not None and np.all(small.sd > 0)
    sites = trace(seed(SpikeAndSlab().scales, 0)).get_trace(13, 100.0, 1.0)
    assert sites["gamma"]["value"].shape == (13,)
    large = seed(SpikeAndSlab().scales, 0)(13, 100.0, 1.0)
    assert large.log_odds is None
    np.testing.assert_array_equal(large.sd, sites["gamma"]["value"] * sites["tau"]["value"])


def test_spike_and_slab_odds_are_those_of_pi():
    scales = seed(substitute(SpikeAndSlab().scales, {"pi": jnp.asarray(0.2)}), 0)(3, 100.0, 1.0)
    np.testing.assert_allclose(scales.log_odds, np.log(0.25), rtol=1e-14)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Normal(scale=0.0), r"Normal\(scale=0.0\) must be positive"),
        (lambda: Laplace(scale=-1.0), r"Laplace\(scale=-1.0\)"),
        (lambda: RegularisedHorseshoe(slab_scale=0.0), "slab_scale=0.0"),
        (lambda: RegularisedHorseshoe(slab_df=-2.0), "slab_df=-2.0"),
        (lambda: RegularisedHorseshoe(expected_active=0.0), "expected_active=0.0"),
        (lambda: SpikeAndSlab(a=0.0), "a=0.0"),
        (lambda: SpikeAndSlab(b=float("nan")), "b=nan"),
        (lambda: SpikeAndSlab(slab_scale=-1.0), "slab_scale=-1.0"),
        (lambda: SpikeAndSlab(enumerate_up_to=-1), r"SpikeAndSlab\(enumerate_up_to=-1\) must be at least 0"),
    ],
)
def test_parameters_must_be_positive(make, words):
    with pytest.raises(InputError, match=words):
        make()


def test_a_users_own_prior_is_a_numpyro_program():
    prior = CustomPrior(lambda n: numpyro.sample("sd", dist.HalfCauchy(1.0).expand([n]).to_event(1)))
    data = Trajectories.from_arrays(
        np.arange(9.0), states={"y": np.sin(np.arange(9.0))}, derivatives={"y": np.cos(np.arange(9.0))}
    )
    program = Program({"y": ["y", "y**2"]}, prior=prior, discrepancy=None)
    sites = trace(seed(program.numpyro_model, 0)).get_trace(program.designs(data))
    assert sites["y_sd"]["value"].shape == (2,)
    np.testing.assert_array_equal(sites["y_y"]["fn"].scales.sd, sites["y_sd"]["value"])
    # One number serves all coefficients.
    np.testing.assert_array_equal(CustomPrior(lambda n: 0.5).scales(3, 10.0, 1.0).sd, np.full(3, 0.5))
