"""A prior of the user's own whose log odds of inclusion differ from term to term."""

import itertools
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pandas as pd
import pytest
from fabricated import fabricate
from scipy import stats
from scipy.special import logsumexp

import bayes_greybox as bg
from bayes_greybox.criticism.cross_validation.fold_densities import fold_densities, fold_parameters
from bayes_greybox.inference.posterior import SLAB
from bayes_greybox.model.priors import Scales

SMALL = {"draws": 40, "tune": 40, "chains": 2, "progress": False}
ODDS = (3.0, -1.0, 0.5)


@dataclass(frozen=True)
class OwnOdds:
    """τ is sampled, the odds of each term are the user's."""

    log_odds: tuple[float, ...] = ODDS

    def scales(self, n_term, n_obs, sigma):
        tau = numpyro.sample("tau", dist.LogNormal(0.0, 0.5))
        return Scales(jnp.full(n_term, tau), jnp.asarray(self.log_odds))


class SameAsPackage:
    """The package's spike-and-slab, written by a user."""

    def scales(self, n_term, n_obs, sigma):
        pi = numpyro.sample("pi", dist.Beta(1.0, 1.0))
        tau = numpyro.sample("tau", dist.LogNormal(0.0, 0.5))
        return Scales(jnp.full(n_term, tau), jnp.full(n_term, jnp.log(pi) - jnp.log1p(-pi)))


@pytest.fixture(scope="module")
def data():
    rng, t = np.random.default_rng(0), 0.1 * np.arange(24)
    y = rng.uniform(-1, 1, 24)
    rate = -y + 0.4 * y**2 + 0.3 * rng.standard_normal(24)
    return bg.Trajectories.from_arrays(t, states={"y": y}, derivatives={"y": rate})


def fitted(prior, data):
    return bg.GreyBox({"y": ["y", "y**2", "y**3"]}, prior=prior, discrepancy=None).fit(data, **SMALL)


@pytest.fixture(scope="module")
def fit(data):
    return fitted(OwnOdds(), data)


@pytest.fixture(scope="module")
def read_again(fit, tmp_path_factory):
    path = tmp_path_factory.mktemp("own") / "run.nc"
    fit.save(path)
    return bg.load(path)


def log_density(Phi, y, tau, sigma, log_odds):
    """log p(y | η), the 2^K patterns summed one by one."""
    terms = []
    for pattern in itertools.product((0.0, 1.0), repeat=Phi.shape[1]):
        inside = np.asarray(pattern)
        weight = -np.sum(np.logaddexp(0.0, np.where(inside > 0, -log_odds, log_odds)))
        covariance = sigma**2 * np.eye(len(y)) + tau**2 * (Phi * inside) @ Phi.T
        terms.append(weight + stats.multivariate_normal(cov=covariance).logpdf(y))
    return logsumexp(terms)


def test_draws_have_the_odds_of_each_term(fit):
    summed = fit.summed("y")
    tau = fit.idata["posterior"]["y_tau"].to_numpy().reshape(-1)
    np.testing.assert_array_equal(summed.log_odds, np.broadcast_to(ODDS, (80, 3)))
    np.testing.assert_allclose(summed.sd, np.repeat(tau[:, None], 3, axis=1), rtol=1e-12)
    thinned = fit.summed("y", 10)
    assert thinned.sd.shape == (10, 3)


def test_inclusion_is_that_of_the_patterns_summed_one_by_one(fit):
    draws, summed, equation = fit.draws("y"), fit.summed("y"), fit.equations["y"]
    Phi, _, y = equation.parts()
    i = 7
    tau, sigma = float(summed.sd[i, 0]), float(draws.hyper.sigma[i])
    odds = np.array(ODDS)
    whole = log_density(Phi, y, tau, sigma, odds)
    found = fit.idata["posterior_details"]["y_inclusion"].to_numpy().reshape(-1, 3)[i]
    for j in range(3):
        # p(y, γ_j = 1): odds so large that the term is always in, times its probability.
        certain = np.where(np.arange(3) == j, 700.0, odds)
        inside = log_density(Phi, y, tau, sigma, certain) - np.logaddexp(0.0, -odds[j])
        assert found[j] == pytest.approx(np.exp(inside - whole), rel=1e-8)


def test_blocks_are_left_out_with_the_patterns_summed(fit, read_again):
    folds = [np.arange(0, 6), np.arange(6, 9)]
    for posterior in (fit, read_again):
        draws, summed = posterior.draws("y"), posterior.summed("y")
        Phi, _, y = posterior.equations["y"].parts()
        unit = np.log(posterior.equations["y"].frame.target_scale)
        values = np.hstack(list(fold_densities(posterior, "y", fold_parameters(posterior, "y"), folds)))
        for i, (f, fold) in itertools.product((0, 33, 79), enumerate(folds)):
            tau, sigma = float(summed.sd[i, 0]), float(draws.hyper.sigma[i])
            rest = np.delete(np.arange(24), fold)
            expected = log_density(Phi, y, tau, sigma, np.array(ODDS))
            expected -= log_density(Phi[rest], y[rest], tau, sigma, np.array(ODDS)) + len(fold) * unit
            assert values[i, f] == pytest.approx(expected, rel=1e-8)


@pytest.mark.slow
def test_a_users_spike_and_slab_is_judged_as_the_packages(data):
    own, package = fitted(SameAsPackage(), data), fitted(bg.SpikeAndSlab(), data)
    np.testing.assert_allclose(own.idata["posterior"]["y_theta"], package.idata["posterior"]["y_theta"], rtol=1e-9)
    pd.testing.assert_frame_equal(own.sensitivity(), package.sensitivity(), rtol=1e-6)
    scores = [bg.cross_validate(fit, scheme="block", block=4, refit=None, progress=False) for fit in (own, package)]
    assert scores[0].elpd == pytest.approx(scores[1].elpd, rel=1e-9)


def test_what_is_read_again_is_judged_as_before(fit, read_again, data, tmp_path):
    assert SLAB in read_again.idata.children
    jax.tree.map(np.testing.assert_array_equal, tuple(read_again.draws("y")), tuple(fit.draws("y")))
    pd.testing.assert_frame_equal(read_again.inclusion(), fit.inclusion())
    pd.testing.assert_frame_equal(read_again.sensitivity(), fit.sensitivity())
    read_again.save(tmp_path / "again.nc")
    twice = bg.load(tmp_path / "again.nc")
    jax.tree.map(np.testing.assert_array_equal, tuple(twice.draws("y")), tuple(fit.draws("y")))
    with pytest.raises(bg.InputError, match="prior was a Python program"):
        read_again.model.fit(data, **SMALL)


def test_a_file_without_the_odds_is_refused_rather_than_judged_without_them(read_again):
    older = bg.Fit(read_again.model, read_again.data, read_again.sampling, read_again.idata.copy())
    del older.idata[SLAB]
    assert len(older.draws("y").theta) == 80
    with pytest.raises(bg.InputError, match="prior was a Python program"):
        older.summed("y")


def test_a_program_without_odds_is_read_again_and_judged_as_before(data, tmp_path):
    program = bg.CustomPrior(lambda n: numpyro.sample("sd", dist.HalfCauchy(1.0).expand([n]).to_event(1)))
    made = fabricate(bg.GreyBox({"y": ["y", "y**2", "y**3"]}, prior=program, discrepancy=None), data, draws=20)
    fit = bg.Fit(made.model, made.data, made.sampling, made.idata)
    fit.save(tmp_path / "run.nc")
    again = bg.load(tmp_path / "run.nc")
    assert SLAB not in again.idata.children and again.summed("y") is None
    pd.testing.assert_frame_equal(again.inclusion(), fit.inclusion())
    assert again.predict(data).nmse()["y"] == pytest.approx(fit.predict(data).nmse()["y"])
    assert len(bg.compare({"a": again, "b": fit}, max_refits=0, progress=False)) == 2
