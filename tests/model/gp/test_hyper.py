"""η is stated once: its sites and its packed density must say the same."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpyro.handlers import seed, substitute, trace
from numpyro.infer.util import log_density

from bayes_greybox.model.gp.hyper import HyperPrior, NoisePrior

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


def test_substituted_sites_give_the_same_hyperparameters_in_the_program():
    prior = HyperPrior(NoisePrior(0.1, 1.0), 1.0, 1.0, 0.5, 1)
    values = {"noise": 0.2, "amplitude": 0.5, "length_scale": jnp.asarray([0.7])}
    hyper = seed(substitute(prior.sample, data=values), 0)()
    assert float(hyper.sigma) == pytest.approx(np.hypot(0.1, 0.2), rel=1e-14)
