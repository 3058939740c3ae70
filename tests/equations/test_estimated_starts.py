"""Where a record starts, as a fit to samples estimates it, against least squares of the whole equation."""

import numpy as np
import pytest
from fabricated import estimated, fabricate, oscillator
from sampled_oscillator import SIMULATION, force, sampled
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

import bayes_greybox as bg
from bayes_greybox.equations.of_posterior import estimated_starts


def model(**rows):
    return bg.GreyBox({"v": ["y**3"]}, simulation=SIMULATION, rows=bg.TrajectoryRows(**rows), discrepancy=None)


@pytest.fixture(scope="module")
def data():
    return sampled(lambda y, v: -0.5 * y**3, noise=0.05, n=120)


@pytest.fixture(scope="module")
def fit(data):
    return estimated(model(), data, draws=200)


def by_integration(data):
    """Least squares of the coefficient and both starts: the starts and their standard deviations."""

    def path(theta):
        k, *start = theta - 1
        rate = lambda t, x: [x[1], force(t) - 2 * x[0] - 0.15 * x[1] + k * x[0] ** 3]  # noqa: E731
        return solve_ivp(rate, (0, data.time[-1]), start, t_eval=data.time, rtol=1e-7, atol=1e-8).y[0]

    # Slopes by steps far above what the integration is off by; they are relative, so that nothing is counted from one.
    found = least_squares(lambda theta: path(theta) - data.states["y"], [1.0, 1.3, 1.0], "3-point", diff_step=1e-3)
    sigma = np.sqrt(2 * found.cost / (data.n_obs - 3))
    return found.x[1:] - 1, sigma * np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))[1:]


def test_the_start_of_a_rate_that_no_sensor_shows_is_estimated(data, fit):
    starts = estimated_starts(fit)
    assert list(starts) == ["y", "v"]
    for found, mean, sd in zip(starts.values(), *by_integration(data), strict=True):
        # 400 draws: a mean is good to a twentieth of its standard deviation, and that to four per cent.
        assert abs(found.mean - mean) < 0.3 * sd and found.sd == pytest.approx(sd, rel=0.2)


def test_exported_programs_start_there_and_say_how_surely(fit, tmp_path):
    fit.export(tmp_path / "model.py")
    text = (tmp_path / "model.py").read_text()
    space = {}
    exec(text, space)
    starts = estimated_starts(fit)
    assert space["START"] == tuple(each.mean for each in starts.values())
    (line,) = [line for line in text.splitlines() if line.startswith("# x[1]")]
    assert line.startswith("# x[1] v [m/s]: not measured, ") and " ± " in line and "where the data start" in line


@pytest.mark.slow
def test_draws_on_exact_paths_have_starts_of_their_own(fit):
    refined = fit.refine(draws=20, tune=40, chains=1, progress=False)
    drawn = refined.idata["posterior"]["v_start"].to_numpy()[0, :, 0]
    np.testing.assert_allclose([each.mean for each in estimated_starts(refined).values()], drawn.mean(axis=0))


def test_nothing_is_said_of_starts_that_are_not_estimated(data):
    assert estimated_starts(fabricate(bg.GreyBox({"v": ["y**3"]}), oscillator(20))) == {}
    forced = fabricate(*model(force=1e-3).near(data))
    assert forced.equations["v"].rows.noise.moved and estimated_starts(forced) == {}
