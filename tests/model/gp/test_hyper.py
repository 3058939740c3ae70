"""η is stated once: its sites, its packed density and the evidence must say the same."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpyro.handlers import seed, substitute, trace
from numpyro.infer.util import log_density

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.evidence.with_discrepancy import Evaluator, WithDiscrepancy
from bayes_greybox.model.estimate.evidence import Spectrum
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.gp.hyper import HyperPrior, NoisePrior
from bayes_greybox.model.priors import CustomPrior
from bayes_greybox.model.program import Program

POINTS = [(0.3, 0.6, 0.5, 0.9), (0.02, 1.7, 2.5, 0.2), (1.1, 1e-3, 0.8, 1.1)]
"""s, amplitude and two length scales."""


@pytest.mark.parametrize("point", POINTS)
def test_the_packed_density_is_that_of_the_sites(point):
    prior = HyperPrior(NoisePrior(1e-3, 0.7), 0.4, 0.9, 0.6, 2)
    values = {"noise": point[0], "amplitude": point[1], "length_scale": jnp.asarray(point[2:])}
    by_sites, sites = log_density(prior.sample, (), {}, values)
    eta = jnp.log(jnp.asarray(point))
    # Densities of the logarithms carry a Jacobian.
    assert float(prior.log_density(eta)) == pytest.approx(float(by_sites + jnp.sum(eta)), rel=1e-12)
    hyper = prior.unpack(eta)
    assert float(hyper.sigma) == pytest.approx(float(sites["sigma"]["value"]), rel=1e-14)
    assert float(hyper.amplitude) == pytest.approx(point[1], rel=1e-14)
    np.testing.assert_allclose(hyper.length_scale, point[2:], rtol=1e-14)


def test_without_f_there_is_noise_only():
    sites = trace(seed(HyperPrior(NoisePrior(1e-3, 1.0)).sample, 0)).get_trace()
    assert set(sites) == {"noise", "sigma"}


@pytest.mark.parametrize("point", POINTS)
def test_the_evidence_of_a_hypothesis_is_the_density_of_the_program(point):
    """One model, θ ~ N(0, 1), f orthogonal to the terms on the data: both integrate θ and f out exactly."""
    rng = np.random.default_rng(2)
    y, v = rng.uniform(-1, 1, (2, 60))
    data = Trajectories.from_arrays(
        np.arange(60.0), states={"y": y, "v": v}, derivatives={"v": -y + 0.4 * np.cos(3 * y) + 0.1 * v}
    )
    gp = OrthogonalGP(features=4, amplitude=0.8, length_scale=0.7, length_scale_spread=0.4)
    model = Program({"v": ["y", "v"]}, prior=CustomPrior(lambda n: jnp.ones(n)), discrepancy=gp, noise=0.6)
    equation = model.assemble(data)["v"]
    values = {"v_noise": point[0], "v_amplitude": point[1], "v_length_scale": jnp.asarray(point[2:])}
    of_program, _ = log_density(model.numpyro_model, ({"v": equation.design},), {}, values)

    Phi, Psi, target = equation.parts()
    square, n = float(target @ target), len(target)
    spectrum = Spectrum.of((Phi.T @ Phi)[None], (Phi.T @ target)[None], square, n, np.ones((1, 2)))
    hypothesis = WithDiscrepancy(
        spectrum.eigenvalues, spectrum.loading, np.zeros(1), square, n, Psi.T @ Psi, Psi.T @ target
    )
    prior = model.hyper_prior(float(equation.design.noise_floor), 2)
    evaluator = Evaluator(prior, gp.kernel, np.asarray(equation.frame.basis.frequency))
    eta = np.log(point)
    expected = float(of_program) + eta.sum()
    assert evaluator.at(hypothesis, eta) == pytest.approx(expected, abs=1e-7 * max(1.0, abs(expected)))


def test_substituted_sites_give_the_same_hyperparameters_in_the_program():
    prior = HyperPrior(NoisePrior(0.1, 1.0), 1.0, 1.0, 0.5, 1)
    values = {"noise": 0.2, "amplitude": 0.5, "length_scale": jnp.asarray([0.7])}
    hyper = seed(substitute(prior.sample, data=values), 0)()
    assert float(hyper.sigma) == pytest.approx(np.hypot(0.1, 0.2), rel=1e-14)
