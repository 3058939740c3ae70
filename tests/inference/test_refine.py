"""The exact trajectory posterior, against posteriors that are known otherwise."""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sampled_oscillator import SIMULATION, sampled
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.stats import norm

import bayes_greybox as bg
from bayes_greybox.criticism.cross_validation.cross_validate import cross_validate
from bayes_greybox.criticism.linearity import linearity
from bayes_greybox.inference.refinement import accurate, methods, refine
from bayes_greybox.inference.refinement.exact_paths import Course
from bayes_greybox.inference.refinement.methods import AdaptiveSteps, FixedSteps, Segment
from bayes_greybox.model.exact_program import ExactLikelihood

FIT = {"draws": 200, "tune": 200, "chains": 2, "progress": False}


def decay(n=8, noise=0.4, rate=0.7, seed=3):
    """Few and noisy samples of dx/dt = −k x from x(0) = 2."""
    t, rng = np.linspace(0.0, 4.0, n), np.random.default_rng(seed)
    return bg.Trajectories.from_arrays(t, states={"x": 2 * np.exp(-rate * t) + noise * rng.standard_normal(n)})


def linearity_of(fit):
    return linearity(fit, "x")


EXACT = {"draws": 500, "tune": 150, "chains": 2, "progress": False}
STATED = {"starts": {"x": (2.0, 0.5)}, "noise": {"x": (0.3, 0.5)}}


@cache
def linear(**given):
    stated = {"x": {"x": bg.priors.Coefficient(mean=-1.0, sd=0.5, upper=0.0)}}
    model = bg.GreyBox({"x": ["x"]}, rows=bg.TrajectoryRows(), discrepancy=None, coefficients=stated)
    return model.fit(decay(**given), **FIT)


@pytest.fixture(scope="module")
def bent():
    """A posterior that is far from that on linear rows: priors of rate, start and noise are stated."""
    return linear().refine(**EXACT, **STATED)


def stepwise(course):
    """The other method of integration alone."""
    return (AdaptiveSteps(course.held),)


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


@pytest.mark.parametrize("method", ["given steps", pytest.param("steps as they come", marks=pytest.mark.slow)])
def test_it_is_the_posterior_that_quadrature_finds(bent, method, monkeypatch):
    if method == "steps as they come":
        monkeypatch.setattr(Course, "methods", property(stepwise))
        bent = linear().refine(**EXACT, **STATED)
    error = bent.idata["sample_stats"]["path_error"]
    assert 0 < error.max() <= 0.01 and "standard deviations of their noise" in error.attrs["long_name"]
    (k, start, sigma), spread = by_quadrature()
    drawn = bent.idata["posterior"].dataset
    found = [-drawn["x_theta"], drawn["x_start"], drawn["x_sensor_sigma"]]
    for values, mean, sd in zip(found, (k, start, sigma), spread, strict=True):
        # Some 400 effective draws: a mean is good to a twentieth of its standard deviation.
        assert abs(float(values.mean()) - mean) < 0.25 * sd
        assert float(values.std()) == pytest.approx(sd, rel=0.2)


def test_a_second_one_of_the_same_shapes_compiles_nothing(bent):
    # Other data, another prior of the start, and terms of other size.
    other = linear(seed=8, rate=0.1)
    heard = []
    jax.monitoring.register_event_duration_secs_listener(lambda name, seconds, **_: heard.append(name))
    jax.jit(lambda x: x + 2)(0)
    compiled = [event for event in heard if "backend_compile" in event]
    assert compiled
    again = other.refine(**EXACT, starts={"x": (1.5, 0.7)}, noise={"x": (0.2, 0.4)})
    assert [event for event in heard if "backend_compile" in event] == compiled
    rates = [-float(each.idata["posterior"]["x_theta"].mean()) for each in (bent, again)]
    assert rates[1] < rates[0] - 0.3


@pytest.fixture(scope="module")
def swinging():
    """Two runs whose rows are nearly linear, with a term that is not in the equation: on linear rows and exactly."""
    data = sampled(lambda y, v: -0.5 * y**3, noise=0.02, n=40, step=0.3, runs=2)
    model = bg.GreyBox({"v": ["y**3", "y**2"]}, simulation=SIMULATION, rows=bg.TrajectoryRows(), discrepancy=None)
    fit = model.fit(data, **FIT)
    return data, fit, fit.refine(draws=200, tune=80, chains=2, progress=False)


@pytest.mark.slow
def test_its_paths_are_those_of_another_integrator(swinging):
    data, _, fit = swinging
    own = data.run == 0
    t, measured, size = data.time[own], data.states["y"][own], float(np.sqrt(np.mean(data.states["y"] ** 2)))
    force = CubicSpline(t, data.inputs["F"][own])
    drawn = fit.idata["posterior"].dataset.isel(chain=0)
    said = fit.idata["log_likelihood"]["v_rate"].to_numpy()[0][:, own]
    for s in (0, 7, 199):
        cubic, sigma = float(drawn["v_theta"][s, 0]), float(drawn["v_sigma"][s]) * fit.equations["v"].rows.gain
        start = drawn["v_start"][s, 0].to_numpy()
        path = solve_ivp(
            lambda time, x, k=cubic: [x[1], force(time) - 2 * x[0] - 0.15 * x[1] + k * x[0] ** 3], (t[0], t[-1]),
            start, t_eval=t, rtol=1e-12, atol=1e-12, max_step=0.3, method="DOP853",
        ).y[0]  # fmt: skip
        density = norm.logpdf(measured, path, sigma)
        # A path that is off by ε moves a density by z ε/σ + ε²/2σ²; the error said is up to a share of what is left.
        off = 1e-6 * (size + np.abs(path)) / sigma
        allowed = np.abs(measured - path) / sigma * off + off**2 / 2 + 1e-9
        assert np.all(np.abs(said[s] - density) <= allowed)


def test_paths_that_turn_out_inaccurate_are_sampled_again_on_half_steps(monkeypatch):
    runs, sampled_on = [], accurate.Paths._errors

    def counted(self, rows, points, known):
        runs.append((len(points), int(np.min(known.likelihood.along.grid.number))))
        return sampled_on(self, rows, points, known)

    monkeypatch.setattr(accurate, "ERROR_MARGIN", 1e12)
    monkeypatch.setattr(accurate.Paths, "_errors", counted)
    fit = linear().refine(**EXACT | {"draws": 250}, **STATED)
    # One step a sample does at the draws of linear rows, where anything does, and not at the exact ones.
    finest = max(steps for _, steps in runs)
    assert [steps for n, steps in runs if n == 500] == [2**k for k in range(int(np.log2(finest)) + 1)] and finest > 1
    assert fit.idata["sample_stats"]["path_error"].max() <= 0.01


def test_paths_that_no_steps_follow_are_refused(monkeypatch):
    monkeypatch.setattr(accurate, "ACCURATE", 1e-30)
    with pytest.raises(bg.InputError, match="No steps .* follow the exact paths at .* accurately: finer ones"):
        linear().refine(**EXACT, **STATED)


@pytest.mark.parametrize(
    ("lost", "message"),
    [
        (lambda n: n >= 0, "at the fit's own estimate leave all bounds.*: nothing can be sampled around it"),
        (lambda n: n > 0, "at more than a tenth of the fit's draws leave all bounds.*: state what is known of"),
        pytest.param(
            lambda n: n == 499, "at exact draws leave all bounds.*: state what is known of", marks=pytest.mark.slow
        ),
    ],
)
def test_it_is_said_where_there_is_no_path(lost, message, monkeypatch):
    errors = accurate.Paths._errors

    def some(self, values, points, argument):
        found = errors(self, values, points, argument)
        return tuple(np.where(lost(np.arange(len(points))), np.inf, each) for each in found)

    # On the finest steps at once.
    monkeypatch.setattr(methods, "FIRST_TOLERANCE", methods.FINEST_TOLERANCE)
    monkeypatch.setattr(Course, "methods", property(stepwise))
    monkeypatch.setattr(accurate.Paths, "_errors", some)
    # Of 500 exact draws, more than there are linear ones, the last.
    with pytest.raises(bg.InputError, match=message):
        linear().refine(**EXACT | {"draws": 250}, **STATED)


@pytest.mark.slow
def test_paths_are_accurate_against_the_noise_of_a_sensor_that_sees_a_small_change_of_a_large_state(monkeypatch):
    """300 K with a noise of 1 mK: what is little of the temperature is much of the noise."""
    t, rng = 1.2 * np.arange(8), np.random.default_rng(4)
    data = bg.Trajectories.from_arrays(t, states={"T": 300 + np.exp(-t) + 1e-3 * rng.standard_normal(len(t))})
    model = bg.GreyBox({"T": ["T - 300"]}, rows=bg.TrajectoryRows(), discrepancy=None, prior=bg.Normal())
    kept, result = [], refine._posterior
    monkeypatch.setattr(refine, "_posterior", lambda *given: kept.append(given) or result(*given))
    model.fit(data, **FIT).refine(draws=50, tune=50, chains=1, progress=False)
    ((posterior, _, likelihood, _, sampled),) = kept
    equation, own, drawn = posterior.equations["T"], posterior.sites["T"], sampled.drawn
    rate = drawn[own.theta][0, :, 0] * equation.frame.coefficient_scale[0]
    truth = 300 + (drawn[own["start"]][0, :, 0, 0] - 300)[:, None] * np.exp(rate[:, None] * t)
    off = drawn[own["predicted"]][0] - truth
    sigma = likelihood.sigma(None, drawn[own.sigma])[0]
    assert np.median(sigma) == pytest.approx(1e-3, rel=0.6)
    # Together they move no posterior mean by more than a hundredth of its standard deviation.
    assert np.all(np.sqrt(np.sum((off / sigma) ** 2, axis=1)) < 0.01)


def test_steps_that_are_too_long_for_a_stiff_equation_are_halved_until_they_are_too_many():
    segment = Segment(np.arange(5.0), np.zeros((5, 0)), np.zeros((5, 0)))
    method = FixedSteps()
    states = jax.jit(lambda k, grid: method.states(lambda t, x, u, p: -p * x, jnp.ones((1, 1)), k, grid))
    for rate, few in ((1.0, True), (30.0, True), (1e3, False)):
        grid, errors = method.grid([segment], False, np.ones(1)), []
        while grid is not None:
            found, finer = (np.asarray(states(jnp.array([rate]), each)) for each in (grid, method.beyond(grid)))
            errors.append(float(np.max(np.abs(found - finer))))
            truth = np.exp(-rate * np.arange(5.0))[None, :, None]
            # What half steps change is the error, and more than what they leave.
            assert not errors[-1] < 1e-2 or np.max(np.abs(finer - truth)) <= max(errors[-1], 1e-12)
            grid = method.finer(grid)
        assert (np.nanmin(errors) < 1e-6) == few


@pytest.mark.slow
def test_where_rows_are_nearly_linear_it_is_their_posterior_given_the_terms_that_are_in(swinging):
    _, fit, refined = swinging
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
    error = predicted - truth
    assert np.sqrt(np.mean(error**2)) < 0.5 * 0.02 * np.std(truth)


def test_it_is_read_again_and_runs_freely(bent, tmp_path):
    assert "of exact paths" in repr(bent)
    bent.save(tmp_path / "refined.nc")
    again = bg.load(tmp_path / "refined.nc")
    assert again.sampling.exact and again.summary().equals(bent.summary())
    assert np.all(np.isfinite(bent.simulate(bent.data).states["x"].mean))
    predictive = bent.idata["posterior_predictive"]["x_rate"].to_numpy()
    sigma = float(bent.idata["posterior"]["x_sensor_sigma"].mean())
    assert 0.9 * sigma < predictive.std(axis=(0, 1)).min() < 2.5 * sigma
    prior = bent.idata["log_prior"].dataset
    assert {"x_start", "x_sensor_sigma"} <= set(prior) and np.all(prior["x_noise"] == 0)
    assert "prior" not in bent.idata.children


@pytest.mark.parametrize(
    "ask",
    [bg.Fit.checks, cross_validate, lambda fit: fit.whiteness("x"), linearity_of, bg.Fit.discrepancy, bg.Fit.trade_off],
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
