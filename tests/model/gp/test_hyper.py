"""η: its sites, and the density of log s that evidences integrate over."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpyro.handlers import seed, substitute, trace
from numpyro.infer.util import log_density

from bayes_greybox.model.gp.hyper import HyperPrior, NoisePrior


@pytest.mark.parametrize("s", [0.3, 0.02, 1.1])
def test_the_density_of_log_s_is_that_of_the_site(s):
    prior = HyperPrior(NoisePrior(1e-3, 0.7))
    by_site, sites = log_density(prior.sample, (), {}, {"noise": s})
    # The density of the logarithm carries a Jacobian.
    log_s = np.asarray(np.log(s))
    assert float(prior.noise.log_density(log_s)) == pytest.approx(float(by_site) + np.log(s), rel=1e-12)
    assert float(prior.noise.sigma(log_s)) == pytest.approx(float(sites["sigma"]["value"]), rel=1e-14)


def test_without_f_there_is_noise_only():
    sites = trace(seed(HyperPrior(NoisePrior(1e-3, 1.0)).sample, 0)).get_trace()
    assert set(sites) == {"noise", "sigma"}


def test_substituted_sites_give_the_same_hyperparameters_in_the_program():
    prior = HyperPrior(NoisePrior(0.1, 1.0), 1.0, 1.0, 0.5, 1)
    values = {"noise": 0.2, "amplitude": 0.5, "length_scale": jnp.asarray([0.7])}
    hyper = seed(substitute(prior.sample, data=values), 0)()
    assert float(hyper.sigma) == pytest.approx(np.hypot(0.1, 0.2), rel=1e-14)
