"""Parameters that are learned in fits: posterior, equations, files and programs."""

import runpy

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import kstest, norm

import bayes_greybox as bg
from bayes_greybox.inference.whole_rate import whole_rate

TRUE = {"m": 2.2, "k": 30.0, "c": 0.8}
GIVEN = {"m": bg.Parameter(2.0, sd=0.3, bounds=(0.0, None), unit="kg"), "k": bg.Parameter(28.0, sd=5.0), "c": 0.8}
FORMULAS = {"y": "v", "v": "(F - k*y - c*v)/m"}
NOISE = 0.05


def drive(t):
    return 20 * np.sin(1.3 * t) + 12 * np.sin(2.9 * t + 1)


def rate(t, x, m, k, c):
    return [x[1], (drive(t) - k * x[0] - c * x[1]) / m]


@pytest.fixture(scope="module")
def data():
    t = np.linspace(0, 10, 201)
    y, v = solve_ivp(rate, (0, 10), [0.1, 0.0], t_eval=t, args=tuple(TRUE.values()), rtol=1e-9, atol=1e-9).y
    a = rate(t, (y, v), **TRUE)[1] + NOISE * np.random.default_rng(3).standard_normal(len(t))
    units = {"t": "s", "y": "m", "v": "m/s", "F": "N"}
    return bg.Trajectories.from_arrays(
        t, states={"y": y, "v": v}, derivatives={"v": a}, inputs={"F": drive(t)}, units=units
    )


@pytest.fixture(scope="module")
def fit(data):
    model = bg.GreyBox(simulation=FORMULAS, parameters=GIVEN, discrepancy=None)
    return model.fit(data, draws=500, tune=300, chains=2, seed=1, progress=False)


def test_the_posterior_is_that_of_the_formula(fit, data):
    """By a grid over both parameters, with σ integrated out under p(σ) ∝ 1/σ."""
    m, k = np.meshgrid(np.linspace(2.17, 2.23, 61), np.linspace(29.7, 30.3, 61), indexing="ij")
    y, v, u, a = (data.column("y"), data.column("v"), data.column("F"), data.rate("v"))
    simulated = (u - k[..., None] * y - 0.8 * v) / m[..., None]
    square = np.sum((a - simulated) ** 2, axis=-1)
    log = -0.5 * len(a) * np.log(square) + norm.logpdf(m, 2.0, 0.3) + norm.logpdf(k, 28.0, 5.0)
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    table = fit.summary().loc["v"]
    for name, grid in (("m", m), ("k", k)):
        mean = np.sum(weight * grid)
        sd = np.sqrt(np.sum(weight * (grid - mean) ** 2))
        assert table.loc[name, "mean"] == pytest.approx(mean, abs=0.15 * sd)
        assert table.loc[name, "sd"] == pytest.approx(sd, rel=0.15)


def test_tables_have_the_unit_that_was_stated(fit):
    table = fit.inclusion().loc["v"]
    assert table.loc["m", "unit"] == "kg"
    # Of a number without a stated unit nothing is supposed.
    assert table.loc["k", "unit"] == ""


def test_the_equation_is_the_formula_with_its_values(fit):
    text = str(fit)
    assert "d(v)/dt = (F − c·v − k·y)/m" in text
    assert "m = 2.2" in text and "c = 0.8(given)" in text
    assert r"\frac{F - c v - k y}{m}" in fit.to_latex()


def test_the_simulation_has_the_whole_share_of_the_variance(fit):
    shares = fit.discrepancy().loc["v"]
    assert shares["simulation"] == pytest.approx(1.0, abs=0.01)
    assert shares["dictionary"] == pytest.approx(0.0, abs=0.01)


def test_a_file_keeps_the_parameters(fit, tmp_path):
    fit.save(tmp_path / "fit.nc")
    again = bg.load(tmp_path / "fit.nc")
    assert again.model.parameters == fit.model.parameters
    assert str(again) == str(fit)


def test_a_program_has_them_by_name(fit, tmp_path):
    fit.export(tmp_path / "plant.py")
    program = runpy.run_path(str(tmp_path / "plant.py"))
    means = fit.summary().loc["v", "mean"]
    assert program["m"] == means["m"] and program["c"] == 0.8
    x, u = np.array([0.1, 0.2]), np.array([3.0])
    own = (3.0 - means["k"] * 0.1 - 0.8 * 0.2) / means["m"]
    np.testing.assert_allclose(program["rhs"](0.0, x, u)[1], own)
    np.testing.assert_allclose(fit.to_callable()(0.0, x, u)[1], own)
    # Draws are of the tangent at the estimate, whose mean is at the mean.
    np.testing.assert_allclose(fit.to_callable(draws=200)(0.0, x, u)[:, 1].mean(), own, atol=1e-3)
    fit.export(tmp_path / "plant.c")
    assert "static const double m = " in (tmp_path / "plant.c").read_text()


def test_free_runs_follow_the_formula_of_each_draw(fit, data):
    """Far from the estimate a tangent is another rate."""
    of_fit = whole_rate(fit.model.simulator(data), fit.learned(), data.columns)
    frame = fit.equations["v"].frame
    for m, k in ((1.0, 20.0), (4.0, 45.0)):
        scaled = np.array([m, k]) / frame.coefficient_scale
        at = jnp.zeros(()), jnp.array([0.1, 0.2]), jnp.array([3.0])
        found = of_fit(*at, {"v": (jnp.asarray(scaled), jnp.zeros(0))})
        np.testing.assert_allclose(found, [0.2, (3.0 - k * 0.1 - 0.8 * 0.2) / m], rtol=1e-12)


@pytest.mark.slow
def test_where_the_data_say_nothing_the_posterior_is_the_prior():
    """Only the sum of two parameters is seen: beside a well-known one the other has what its prior leaves."""
    rng = np.random.default_rng(5)
    t = np.linspace(0, 5, 60)
    y = np.exp(-t)
    # Nothing drives the machine: the gain of the drive is not seen.
    data = bg.Trajectories.from_arrays(
        t, states={"y": y}, derivatives={"y": -y + 0.01 * rng.standard_normal(60)}, inputs={"u": 1e-9 * np.sin(t)}
    )
    parameters = {"a": bg.Parameter(1.1, sd=0.5), "gain": bg.Parameter(3.0, sd=0.7)}
    model = bg.GreyBox(simulation={"y": "gain*u - a*y"}, parameters=parameters, discrepancy=None)
    fit = model.fit(data, draws=1000, tune=300, chains=2, seed=2, progress=False)
    theta = fit.idata["posterior"]["y_theta"].to_numpy()[..., list(fit.inclusion().loc["y"].index).index("gain")]
    thinned = theta.ravel()[::4]
    assert kstest(thinned, norm(3.0, 0.7).cdf).pvalue > 0.001


def test_a_model_may_be_given_other_parameters(fit):
    changed = fit.model.at({"m": 2.5})
    assert changed.parameters["m"].here == 2.5 and changed.parameters["m"].value == 2.0
    assert bg.GreyBox(simulation=FORMULAS, parameters=GIVEN).equations == ("v",)
    assert bg.GreyBox(simulation=FORMULAS, parameters={"m": 2.0, "k": 30.0, "c": 0.8}).equations == ()
