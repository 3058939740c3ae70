import jax.numpy as jnp
import numpy as np
import numpyro.distributions as dist
import pytest

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.priors import CustomPrior
from bayes_greybox.model.program import Program
from bayes_greybox.model.sites import Sites, site
from bayes_greybox.running.errors import InputError


@pytest.fixture
def data():
    rng = np.random.default_rng(0)
    y, v = rng.uniform(-1, 1, (2, 20))
    return Trajectories.from_arrays(
        np.arange(20.0),
        states={"y": y, "y_dot": v},
        derivatives={"y": v + 0.1 * rng.standard_normal(20), "y_dot": -y + 0.1 * rng.standard_normal(20)},
    )


def program(prior):
    return Program({"y": ["y_dot"], "y_dot": ["y", "y_dot"]}, prior=prior, discrepancy=None)


def test_names_are_those_of_the_model(data):
    model = program(CustomPrior(lambda n: jnp.ones(n)))
    found = model.require_own_sites(model.designs(data))
    assert found["y_dot"]["noise"] == model.sites["y_dot"].noise == "y_dot_noise"
    assert found["y"]["sigma"] == model.sites["y"].sigma == "y_sigma"
    assert model.sites["y"]["own name"] == "y_own name"


def test_a_variable_belongs_to_the_equation_with_the_longest_name():
    sites = Sites(["y", "y_dot", "y_dot_2"])
    names = ["y_tau", "y_dot_tau", "y_dot_2_tau", "z_tau", "y_dot_2_x_y"]
    assert sites.owned("y", names) == {"tau": "y_tau"}
    assert sites.owned("y_dot", names) == {"tau": "y_dot_tau"}
    assert sites.owner("z_tau") is None
    assert sites.owned("y_dot_2", names) == {"tau": "y_dot_2_tau", "x_y": "y_dot_2_x_y"}


def test_a_site_that_would_be_taken_for_another_equations_is_refused(data):
    model = program(CustomPrior(lambda n: jnp.full(n, site("dot_width", dist.HalfNormal(1.0)))))
    with pytest.raises(InputError, match="'y_dot_width' in the equation of 'y'"):
        model.require_own_sites(model.designs(data))
    alone = Program({"y": ["y_dot"]}, prior=model.prior, discrepancy=None)
    assert "dot_width" in alone.require_own_sites(alone.designs(data))["y"]


def test_a_quantity_of_the_package_belongs_where_its_whole_name_is_known():
    sites = Sites(["cable", "cable_length", "cable_prior", "cable_tau"])
    names = ["cable_length_scale", "cable_prior_sd", "cable_tau_unit", "cable_length_sigma", "cable_length_own"]
    assert sites.owned("cable", names) == {
        "length_scale": "cable_length_scale",
        "prior_sd": "cable_prior_sd",
        "tau_unit": "cable_tau_unit",
    }
    assert sites.owned("cable_length", names) == {"sigma": "cable_length_sigma", "own": "cable_length_own"}


def test_a_site_called_like_a_result_is_refused(data):
    model = program(CustomPrior(lambda n: jnp.full(n, site("theta", dist.HalfNormal(1.0)))))
    with pytest.raises(InputError, match="'theta', which the results need"):
        model.require_own_sites(model.designs(data))
