"""Compiled programs that one fit leaves to the next."""

from dataclasses import dataclass, field

import jax
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest

import bayes_greybox as bg
from bayes_greybox.inference.sampler import programs as module
from bayes_greybox.inference.settings import Sampling
from bayes_greybox.model.priors import Scales

RUN = {"draws": 30, "tune": 40, "chains": 1, "progress": False}


def data(seed=2, n=40):
    return bg.systems.oscillator().simulate(np.linspace(0, 8, n), noise=0.2, seed=seed)


def model_of(terms=("y", "y**3"), **parts):
    return bg.GreyBox({"ydot": list(terms)}, **({"prior": bg.Normal(), "discrepancy": None} | parts))


def fitted(run=data, seed=0, **parts):
    return model_of(**parts).fit(run(), seed=seed, **RUN)


def programs_of(tune=RUN["tune"], **parts):
    """Programs of a fit that is not made, and the argument of theirs."""
    model = model_of(**parts)
    designs = {name: each.design for name, each in model.assemble(data()).items()}
    return module.programs_for(model, designs, Sampling(tune=tune)), designs


@pytest.fixture(scope="module")
def first():
    return fitted()


def theta(fit):
    return fit.idata["posterior"]["ydot_theta"].to_numpy()


def test_equal_priors_and_shapes_share_them():
    shared = [programs_of(**parts)[0] for parts in ({}, {"terms": ("ydot", "y**5")}, {"prior": bg.Normal(scale=1.0)})]
    assert shared[0] is shared[1] is shared[2]


@pytest.mark.slow
def test_equal_priors_and_shapes_share_them_and_draw_as_if_they_did_not(first):
    # Rows are folded into as many as there are columns: other terms, and more data, have the same shapes.
    others = {
        "seed": fitted(seed=5),
        "data": fitted(lambda: data(seed=3, n=60)),
        "terms": fitted(terms=("ydot", "y**5")),
        "equal prior": fitted(prior=bg.Normal(scale=1.0)),
    }
    assert all(other.programs is first.programs for other in others.values())
    module._shared.cache_clear()
    alone = fitted(lambda: data(seed=3, n=60))
    assert alone.programs is not first.programs
    np.testing.assert_array_equal(theta(alone), theta(others["data"]))


@pytest.mark.parametrize(
    "parts",
    [{"prior": bg.Normal(scale=2.0)}, {"noise": 0.5}, {"tune": 41}, {"terms": ("y",)}],
    ids=["prior", "noise", "tune", "shape"],
)
def test_what_is_compiled_into_them_is_not_shared(parts):
    programs, _ = programs_of()
    assert programs_of()[0] is programs is not programs_of(**parts)[0]


@dataclass
class Changing:
    """A prior that its user may change between fits."""

    scale: float = 0.5

    def scales(self, n_term, n_obs, sigma):
        return Scales(np.ones(n_term) * numpyro.sample("tau", dist.HalfNormal(self.scale)))


class Own(Changing):
    """The same, equal to itself alone."""

    __eq__ = object.__eq__
    __hash__ = object.__hash__


class Read(bg.Normal):
    """A prior that reads what it was not given."""

    width = 1.0

    def scales(self, n_term, n_obs, sigma):
        return Scales(np.ones(n_term) * numpyro.sample("tau", dist.HalfNormal(self.width)))


@dataclass(frozen=True)
class Listed:
    """A prior that has no hash, for its list."""

    widths: list = field(default_factory=lambda: [0.5, 2.0])

    def scales(self, n_term, n_obs, sigma):
        return Scales(np.array(self.widths) * numpyro.sample("tau", dist.HalfNormal(1.0)))


def change_scale(prior, value):
    prior.scale = value


def change_class(prior, value):
    Read.width = value


@pytest.mark.parametrize(
    ("prior", "change"), [(Changing(), change_scale), (Own(), change_scale), (Read(), change_class)]
)
def test_a_prior_that_was_changed_counts_as_it_is(prior, change):
    def largest():
        programs, designs = programs_of(prior=prior)
        return np.abs(programs.prior(designs, jax.random.PRNGKey(0))["ydot_theta"]).max()

    change(prior, 1e-6)
    shrunk = largest()
    change(prior, 5.0)
    assert shrunk < 1e-3 < 0.1 < largest()


@pytest.mark.slow
def test_so_it_does_in_a_fit():
    prior = Changing(1e-6)
    shrunk = fitted(prior=prior)
    change_scale(prior, 5.0)
    assert np.abs(theta(shrunk)).max() < 1e-3 < 0.1 < np.abs(theta(fitted(prior=prior))).max()


@pytest.mark.slow
@pytest.mark.parametrize(
    "parts", [{"prior": Listed()}, {"discrepancy": bg.OrthogonalGP(variables=["y"], features=[4])}]
)
def test_what_has_no_hash_is_fitted_all_the_same(parts):
    assert np.all(np.isfinite(theta(fitted(**parts))))
