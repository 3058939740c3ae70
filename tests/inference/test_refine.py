"""The exact trajectory posterior, against posteriors that are known otherwise."""

from dataclasses import replace

import numpy as np
import pytest
from sampled_oscillator import SIMULATION, sampled
from scipy.stats import norm

import bayes_greybox as bg
from bayes_greybox.criticism.cross_validation.loo import loo
from bayes_greybox.criticism.linearity import linearity
from bayes_greybox.model.exact_program import ExactLikelihood

FIT = {"draws": 200, "tune": 200, "chains": 2, "progress": False}


def decay(n=8, noise=0.4, rate=0.7, seed=3):
    """Few and noisy samples of dx/dt = −k x from x(0) = 2."""
    t, rng = np.linspace(0.0, 4.0, n), np.random.default_rng(seed)
    return bg.Trajectories.from_arrays(t, states={"x": 2 * np.exp(-rate * t) + noise * rng.standard_normal(n)})


def linearity_of(fit):
    return linearity(fit, "x")


@pytest.fixture(scope="module")
def bent():
    """A posterior that is far from that on linear rows: priors of rate, start and noise are stated."""
    stated = {"x": {"x": bg.priors.Coefficient(mean=-1.0, sd=0.5, upper=0.0)}}
    model = bg.GreyBox({"x": ["x"]}, rows=bg.TrajectoryRows(), discrepancy=None, coefficients=stated)
    fit = model.fit(decay(), **FIT)
    return fit.refine(draws=500, tune=150, chains=2, progress=False, starts={"x": (2.0, 0.5)}, noise={"x": (0.3, 0.5)})


def by_quadrature():
    """Means and standard deviations of k, x(0) and σ on a grid."""
    data = decay()
    k, x0, s = np.meshgrid(
        np.linspace(1e-3, 3.5, 120), np.linspace(0.2, 3.8, 80), np.geomspace(0.05, 2, 80), indexing="ij"
    )
    log = -0.5 * ((k - 1) / 0.5) ** 2 - 0.5 * ((x0 - 2) / 0.5) ** 2 - 0.5 * (np.log(s / 0.3) / 0.5) ** 2
    for t, x in zip(data.time, data.states["x"], strict=True):
        log += -0.5 * ((x - x0 * np.exp(-k * t)) / s) ** 2 - np.log(s)
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    means = [float(np.sum(weight * q)) for q in (k, x0, s)]
    return means, [float(np.sqrt(np.sum(weight * (q - m) ** 2))) for q, m in zip((k, x0, s), means, strict=True)]


def test_it_is_the_posterior_that_quadrature_finds(bent):
    (k, start, sigma), spread = by_quadrature()
    drawn = bent.idata["posterior"].dataset
    found = [-drawn["x_theta"], drawn["x_start"], drawn["x_sensor_sigma"]]
    for values, mean, sd in zip(found, (k, start, sigma), spread, strict=True):
        # Some 400 effective draws: a mean is good to a twentieth of its standard deviation.
        assert abs(float(values.mean()) - mean) < 0.25 * sd
        assert float(values.std()) == pytest.approx(sd, rel=0.2)


def test_where_rows_are_nearly_linear_it_is_their_posterior_given_the_terms_that_are_in():
    data = sampled(lambda y, v: -0.5 * y**3, noise=0.02, n=40, step=0.3, runs=2)
    model = bg.GreyBox({"v": ["y**3", "y**2"]}, simulation=SIMULATION, rows=bg.TrajectoryRows(), discrepancy=None)
    fit = model.fit(data, **FIT)
    refined = fit.refine(draws=200, tune=80, chains=2, progress=False)
    group = fit.drawn()
    alone = group["v_theta"].to_numpy()[group["v_gamma"].to_numpy()[..., 1] == 0][:, 0]
    theta = refined.idata["posterior"]["v_theta"].to_numpy()
    assert np.all(theta[..., 1] == 0)
    assert abs(theta[..., 0].mean() - alone.mean()) < 0.35 * alone.std()
    assert theta[..., 0].std() == pytest.approx(alone.std(), rel=0.25)
    # How probable each term is, the linear rows have told.
    np.testing.assert_allclose(refined.inclusion()["inclusion"], fit.inclusion()["inclusion"], atol=1e-12)
    assert refined.idata["posterior"]["v_start"].shape[2:] == (2, 2)
    truth = sampled(lambda y, v: -0.5 * y**3, noise=0.0, n=40, step=0.3, runs=2).states["y"]
    predicted = refined.idata["posterior_predictive"]["v_rate"].mean(("chain", "draw")).to_numpy()
    error = refined.equations["v"].rows.gain * predicted - truth
    assert np.sqrt(np.mean(error**2)) < 0.5 * 0.02 * np.std(truth)


def test_it_is_read_again_and_runs_freely(bent, tmp_path):
    assert "of exact paths" in repr(bent)
    bent.save(tmp_path / "refined.nc")
    again = bg.load(tmp_path / "refined.nc")
    assert again.sampling.exact and again.summary().equals(bent.summary())
    assert np.all(np.isfinite(bent.simulate(bent.data).states["x"].mean))
    predictive = bent.idata["posterior_predictive"]["x_rate"].to_numpy() * bent.equations["x"].rows.gain
    sigma = float(bent.idata["posterior"]["x_sensor_sigma"].mean())
    assert 0.9 * sigma < predictive.std(axis=(0, 1)).min() < 2.5 * sigma
    prior = bent.idata["log_prior"].dataset
    assert {"x_start", "x_sensor_sigma"} <= set(prior) and np.all(prior["x_noise"] == 0)
    assert "prior" not in bent.idata.children


@pytest.mark.parametrize(
    "ask", [bg.Fit.checks, loo, lambda fit: fit.whiteness("x"), linearity_of, bg.Fit.discrepancy, bg.Fit.trade_off]
)
def test_what_is_found_from_linear_rows_is_asked_of_the_fit_that_was_refined(bent, ask):
    with pytest.raises(bg.InputError, match="ask the fit that was refined"):
        ask(bent)


@pytest.mark.parametrize("own", [False, True])
def test_the_density_of_samples_is_that_of_their_noise(own):
    rng = np.random.default_rng(0)
    sensor, weight = np.repeat([0, 1], 5), rng.uniform(0.5, 2.0, 10)
    share, sigma = np.array([0.2, 1.4]), np.array([0.3, 0.7])
    measured, predicted = rng.standard_normal((2, 10))
    # R0 has the sensors' proportions, and what the noise of single rows grows with.
    sd = share[sensor] * weight
    likelihood = ExactLikelihood(
        predict=lambda *_: predicted, measured=measured, sensor=sensor, whiten=1 / sd, log_det=2 * np.sum(np.log(sd)),
        unit=2.0, share=share, start_mean=np.zeros((1, 1)), start_sd=np.ones((1, 1)),
        sensor_noise=np.ones((2, 2)) if own else None,
    )  # fmt: skip
    found = likelihood.log_density(predicted, likelihood.sigma(sigma, np.array(0.4)))
    truth = (sigma[sensor] if own else 0.8 * share[sensor]) * weight
    np.testing.assert_allclose(found, norm.logpdf(measured, predicted, truth), rtol=1e-12)
    # Of rows that know of each other the innovations are in their place; of independent ones they are the same.
    dense = replace(likelihood, whiten=np.diag(1 / sd))
    joint = dense.log_density(predicted, dense.sigma(sigma, np.array(0.4)))
    assert np.sum(joint) == pytest.approx(np.sum(found))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"starts": {"z": (0.0, 1.0)}}, "names no state"),
        ({"starts": {"x": (0.0, 0.0)}}, "standard deviation above 0"),
        ({"noise": {"z": (1.0, 1.0)}}, "must name every sensor"),
        ({"noise": {"x": (0.0, 1.0)}}, "above 0"),
    ],
)
def test_priors_of_what_there_is_not_are_refused(bent, given, message):
    with pytest.raises(bg.InputError, match=message):
        bent.refine(**given)


def test_rows_of_rates_have_no_path_and_are_exact_already():
    with pytest.raises(bg.InputError, match="posterior is exact already"):
        bg.DerivativeRows().path(decay(), ("x",), bg.GreyBox(simulation={"x": "-x"}).simulator(decay()))
