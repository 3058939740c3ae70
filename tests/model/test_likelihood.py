"""The likelihood as a NumPyro distribution: handlers, prediction, vectorisation, SVI, sampling."""

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import pytest
from numpyro.handlers import condition, seed, substitute, trace
from numpyro.infer import SVI, Predictive, Trace_ELBO
from numpyro.infer.autoguide import AutoNormal
from numpyro.infer.util import log_density

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.gp.hyper import Hyperparameters
from bayes_greybox.model.likelihood import CollapsedNormal
from bayes_greybox.model.priors import Normal, Scales, SpikeAndSlab
from bayes_greybox.model.program import Program

SITES = {"v_noise", "v_amplitude", "v_length_scale", "v_tau"}


@pytest.fixture(scope="module")
def data():
    rng = np.random.default_rng(0)
    y, v = rng.uniform(-1, 1, (2, 50))
    rate = -(y**3) - 0.2 * v + 0.2 * np.sin(4 * y) + 0.05 * rng.standard_normal(50)
    return Trajectories.from_arrays(np.arange(50.0), states={"y": y, "v": v}, derivatives={"v": rate})


@pytest.fixture(scope="module")
def program():
    return Program({"v": ["y", "v", "y**3"]}, prior=Normal(), discrepancy=OrthogonalGP(features=4))


@pytest.fixture(scope="module")
def designs(program, data):
    return program.designs(data)


def test_it_is_a_plain_numpyro_model(program, designs):
    sites = trace(seed(program.numpyro_model, 0)).get_trace(designs)
    latent = {n for n, s in sites.items() if s["type"] == "sample" and not s["is_observed"]}
    assert latent == SITES
    assert sites["v_y"]["is_observed"] and isinstance(sites["v_y"]["fn"], CollapsedNormal)
    assert not trace(seed(program.numpyro_model, 0)).get_trace(designs, observed=False)["v_y"]["is_observed"]


def test_substitute_condition_and_log_density_agree(program, designs):
    values = {
        "v_noise": jnp.asarray(0.2),
        "v_amplitude": jnp.asarray(0.5),
        "v_length_scale": jnp.asarray([0.7, 1.1]),
        "v_tau": jnp.asarray(0.9),
    }
    total, sites = log_density(program.numpyro_model, (designs,), {}, values)
    parts = sum(s["fn"].log_prob(s["value"]) for s in sites.values() if s["type"] == "sample")
    assert float(total) == pytest.approx(float(parts), rel=1e-12)
    fixed = trace(seed(substitute(program.numpyro_model, values), 0)).get_trace(designs)["v_y"]
    again = trace(seed(condition(program.numpyro_model, values), 1)).get_trace(designs)["v_y"]
    assert fixed["fn"].log_prob(fixed["value"]) == again["fn"].log_prob(again["value"])
    assert float(fixed["fn"].hyper.sigma) == pytest.approx(np.hypot(0.2, 1e-4), rel=1e-12)


def test_prior_prediction_draws_the_target(program, designs):
    draws = Predictive(program.numpyro_model, num_samples=20)(jax.random.key(0), designs, observed=False)
    assert draws["v_y"].shape == (20, *designs["v"].y.shape)
    assert np.all(np.isfinite(draws["v_y"])) and np.all(np.std(draws["v_y"], axis=0) > 0)


def test_log_prob_vectorises_over_hyperparameters(designs):
    design = designs["v"]
    sigma = jnp.asarray([0.1, 0.3, 0.5])

    def log_prob(sigma):
        hyper = Hyperparameters(sigma, jnp.asarray(0.5), jnp.ones(2))
        return CollapsedNormal(design, hyper, Scales(jnp.ones(3))).log_prob(design.y)

    together, one = jax.jit(jax.vmap(log_prob))(sigma), jax.jit(log_prob)
    np.testing.assert_allclose(together, [one(s) for s in sigma], rtol=1e-10)


def test_distribution_passes_through_jit_as_a_pytree(designs):
    design = designs["v"]
    hyper = Hyperparameters(jnp.asarray(0.3), jnp.asarray(0.5), jnp.ones(2))
    likelihood = CollapsedNormal(design, hyper, Scales(jnp.ones(3)))
    outside = likelihood.log_prob(design.y)
    inside = jax.jit(lambda d: d.log_prob(d.design.y))(likelihood)
    assert float(inside) == pytest.approx(float(outside), rel=1e-12)


@pytest.mark.slow
def test_variational_inference_climbs(program, designs):
    guide = AutoNormal(program.numpyro_model)
    svi = SVI(program.numpyro_model, guide, numpyro.optim.Adam(0.05), Trace_ELBO())
    losses = np.asarray(svi.run(jax.random.key(0), 60, designs, progress_bar=False).losses)
    assert np.all(np.isfinite(losses))
    assert losses[-10:].mean() < losses[:10].mean() - 10


@pytest.mark.parametrize("variant", ["projected", "conditioned"])
@pytest.mark.parametrize("path", ["hsgp", "exact"])
def test_draws_have_the_dense_covariance(data, path, variant):
    """E z zᵀ of 20,000 draws, whitened by the law that `log_prob` uses, is the identity.

    Each entry of the mean of z zᵀ has standard error at most √2/√20000; 6 of them leave 2e-9 a side for each
    of at most 1275 entries, 3e-6 a case.
    """
    gp = OrthogonalGP(features=4, path=path, variant=variant)
    design = Program({"v": ["y", "v", "y**3"]}, prior=Normal(), discrepancy=gp).designs(data)["v"]
    hyper = Hyperparameters(jnp.asarray(0.3), jnp.asarray(0.8), jnp.asarray([0.7, 1.1]))
    sd = jnp.asarray([0.5, 1.0, 0.2])
    likelihood = CollapsedNormal(design, hyper, Scales(sd))
    n_draw = 20_000
    draws = np.asarray(jax.jit(lambda key: likelihood.sample(key, (n_draw,)))(jax.random.key(1)))

    if path == "hsgp":
        log_root, U = design.weight_prior(hyper)
        factor = np.asarray(design.Psi) * np.exp(np.asarray(log_root))
        factor = factor if U is None else factor - factor @ np.asarray(U) @ np.asarray(U).T
        K = factor @ factor.T
    else:
        K = np.asarray(design.covariance(hyper))
    Phi = np.asarray(design.Phi) * np.asarray(sd)
    C = Phi @ Phi.T + K + 0.3**2 * np.eye(len(K))
    # The last compressed row is the length of the rest of the noise, over all rows folded into it.
    C[-1, -1] += 0.3**2 * (float(design.n_obs) - len(K))
    whitened = np.linalg.solve(np.linalg.cholesky(C), draws.T)
    moment = whitened @ whitened.T / n_draw
    assert np.abs(moment - np.eye(len(C))).max() < 6 * np.sqrt(2 / n_draw)


def test_spike_and_slab_draws_leave_terms_out(data):
    program = Program({"v": ["y", "v", "y**3"]}, prior=SpikeAndSlab(), discrepancy=None)
    design = program.designs(data)["v"]
    hyper = Hyperparameters(jnp.asarray(1e-3), jnp.ones(()), jnp.ones(0))

    @jax.jit
    def sample(log_odds):
        scales = Scales(jnp.ones(3), jnp.full(3, log_odds))
        return CollapsedNormal(design, hyper, scales).sample(jax.random.key(0), (4000,))

    assert np.abs(np.asarray(sample(-50.0))[:, :3]).max() < 1e-2
    half = sample(0.0)
    # All three out: probability 1/8, standard error 0.0052; |z| < 5.
    silent = np.mean(np.abs(np.asarray(half)[:, :3]).max(axis=1) < 1e-2)
    assert abs(silent - 0.125) < 5 * np.sqrt(0.125 * 0.875 / 4000)


def test_a_dense_design_has_no_weights_to_sample(data):
    exact = Program({"v": ["y"]}, prior=Normal(), discrepancy=OrthogonalGP(path="exact"))
    with pytest.raises(ValueError, match="path='hsgp'"):
        seed(exact.designs(data)["v"].sampled_weights, 0)(None)
