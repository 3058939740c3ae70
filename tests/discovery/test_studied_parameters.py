"""Studies of simulations with named parameters: which one is off, and by how much."""

import dataclasses
import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import bayes_greybox as bg

GIVEN = {"m": bg.Parameter(2.0, unit="kg"), "k": 30.0, "c": 0.8}

ALONE = {"catalogue": (), "settle": False, "free_runs": False, "progress": False}
"""Parameters are in question: the effects of a catalogue cost time and tell no more."""


def record(rate, start, t, noise, inputs=None, seed=1):
    x = solve_ivp(rate, (t[0], t[-1]), start, t_eval=t, rtol=1e-9, atol=1e-9).y
    a = np.array([rate(time, point)[1] for time, point in zip(t, x.T, strict=True)])
    a = a + noise * np.std(a) * np.random.default_rng(seed).standard_normal(len(t))
    return bg.Trajectories.from_arrays(t, states={"y": x[0], "v": x[1]}, derivatives={"v": a}, inputs=inputs or {})


def drive(t):
    return 20 * np.sin(1.3 * t) + 12 * np.sin(2.9 * t + 1)


@pytest.fixture(scope="module")
def study():
    t = np.linspace(0, 20, 301)
    data = record(lambda t, x: [x[1], (drive(t) - 30 * x[0] - 0.8 * x[1]) / 2.3], [0.1, 0.0], t, 0.02, {"F": drive(t)})
    model = bg.GreyBox(simulation={"y": "v", "v": "(F - k*y - c*v)/m"}, parameters=GIVEN)
    return bg.find_missing_effects(model, data, settle=False, progress=False)


def test_a_wrong_mass_is_one_parameter(study):
    assert study.verdict == "recalibrate"
    row = study.corrections.loc["v", "m"]
    assert row["probability"] > 0.99 and row["parameter"] and row["unit"] == "kg"
    # The tangent was taken anew at what was found: the value is right within what the data say.
    assert abs(row["nominal"] + row["mean"] - 2.3) < 3 * row["sd"] and row["sd"] < 0.01
    assert study.corrections.loc["v", ["k", "c"], :]["probability"].max() < 0.1
    assert study.effects["probability"].max() < 0.1


def test_the_sentence_says_what_the_value_should_be(study):
    assert re.search(r"a parameter .* \(m should be 2\.\d+ ± 0\.\d+ kg, not 2 kg\)", study.sentence)
    assert "d(v)/dt = (F − c·v − k·y)/m" in str(study) and "k = 30(given)" in str(study)


def test_the_extended_model_learns_it(study):
    parameter = study.model.parameters["m"]
    assert parameter.learned and parameter.value == 2.0 and parameter.here == pytest.approx(2.3, abs=0.02)
    assert not study.model.parameters["k"].learned
    rates = study.to_callable()(0.0, np.array([0.1, 0.2]), np.array([3.0]))
    np.testing.assert_allclose(rates[1], (3.0 - 3.0 - 0.16) / 2.3, rtol=0.01)


def test_a_file_of_a_study_keeps_it(study, tmp_path):
    study.save(tmp_path / "study.nc")
    again = bg.load(tmp_path / "study.nc")
    assert str(again) == str(study)
    assert again.model.parameters == study.model.parameters


def test_a_parameter_far_off_is_found_all_the_same():
    """The first tangent at 4 kg says of a machine of 2 kg that it weighs nothing."""
    t = np.linspace(0, 20, 301)
    data = record(lambda t, x: [x[1], (drive(t) - 30 * x[0]) / 2.0], [0.1, 0.0], t, 0.02, {"F": drive(t)})
    # A zero that is right stays what it is; nothing is divided by it.
    given = {"m": 4.0, "k": 30.0, "c": 0.0}
    model = bg.GreyBox(simulation={"y": "v", "v": "(F - k*y - c*v)/m"}, parameters=given)
    study = bg.find_missing_effects(model, data, **ALONE)
    row = study.corrections.loc["v", "m"]
    assert abs(4.0 + row["mean"] - 2.0) < 4 * row["sd"] and row["sd"] < 0.01
    assert study.corrections.loc["v", "c"]["probability"] < 0.1
    assert "m should be" in study.sentence


def test_a_learned_parameter_is_at_its_estimate_before_anything_is_weighed():
    """At the mean of its prior the curve of the exponential looks like another wrong number."""
    rng = np.random.default_rng(1)
    T = 300 + 60 * rng.uniform(size=150)
    P = 300 * np.exp(-1000 / T) + 0.01 * rng.standard_normal(150)
    data = bg.Trajectories.from_arrays(np.arange(150.0), states={}, inputs={"T": T}, outputs={"P": P})
    parameters = {"a": 300.0, "b": bg.Parameter(950.0, sd=100.0)}
    model = bg.GreyBox(simulation={"P": "a*exp(-b/T)"}, parameters=parameters)
    study = bg.find_missing_effects(model, data, **ALONE)
    assert study.verdict == "no gap"
    # Before and after are one model, where nothing was added.
    np.testing.assert_allclose(study.gap["before"], study.gap["after"], rtol=0.01)


def test_a_parameter_of_two_equations_is_set_right_in_both():
    t = np.linspace(0, 20, 201)

    def rate(t, x, k=12.0):
        coupling = k * (x[0] - x[2])
        return [x[1], (drive(t) - 30 * x[0] - 0.8 * x[1] - coupling) / 2, x[3], coupling - 0.5 * x[3]]

    x = solve_ivp(rate, (0, 20), [0.1, 0.0, 0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-9).y
    noise = 0.02 * np.random.default_rng(2).standard_normal((2, len(t)))
    rates = np.array([rate(*each) for each in zip(t, x.T, strict=True)]).T[[1, 3]] + noise
    data = bg.Trajectories.from_arrays(
        t, states=dict(zip(("x1", "v1", "x2", "v2"), x, strict=True)),
        derivatives=dict(zip(("v1", "v2"), rates, strict=True)), inputs={"F": drive(t)},
    )  # fmt: skip
    formulas = {"x1": "v1", "v1": "(F-30*x1-0.8*v1-k*(x1-x2))/2", "x2": "v2", "v2": "k*(x1-x2)-0.5*v2"}
    study = bg.find_missing_effects(bg.GreyBox(simulation=formulas, parameters={"k": 10.0}), data, **ALONE)
    assert study.verdict == "recalibrate"
    assert (
        study.model.parameters["k"].value == pytest.approx(12.0, abs=0.05) and not study.model.parameters["k"].learned
    )


def test_two_parameters_of_one_curve_are_tied():
    t = np.linspace(0, 15, 201)
    data = record(lambda t, x: [x[1], -9.81 / 1.1 * np.sin(x[0]) - 0.1 * x[1]], [1.0, 0.0], t, 0.02)
    model = bg.GreyBox(simulation={"y": "v", "v": "-g/l*sin(y) - c*v"}, parameters={"g": 9.81, "l": 1.0, "c": 0.1})
    study = bg.find_missing_effects(model, data, **ALONE)
    assert study.verdict == "recalibrate"
    assert study.corrections.loc["v", ["g", "l"], :]["probability"].between(0.3, 0.7).all()
    assert "g or l" in study.sentence


def test_a_correction_beyond_the_bounds_is_none():
    """A mass that is known to be at most 2.1 kg is not 2.3."""
    t = np.linspace(0, 20, 301)
    data = record(lambda t, x: [x[1], (drive(t) - 30 * x[0] - 0.8 * x[1]) / 2.3], [0.1, 0.0], t, 0.02, {"F": drive(t)})
    bounded = {**GIVEN, "m": dataclasses.replace(GIVEN["m"], bounds=(1.9, 2.1))}
    model = bg.GreyBox(simulation={"y": "v", "v": "(F - k*y - c*v)/m"}, parameters=bounded)
    study = bg.find_missing_effects(model, data, **ALONE)
    assert study.corrections.loc["v", "m"]["probability"] < 0.1


@pytest.mark.slow
def test_a_time_that_only_a_hidden_state_feels_is_found_off_and_runs_free_with_it(tmp_path):
    """x' = u − z − 0.3 x with z' = (x − z)/τ, τ = 1.2 in place of 1; the rate is measured with 0.02 of noise."""
    t, tau = np.linspace(0, 40, 1201), 1.2

    def force(s):
        return np.sin(0.5 * s) + np.sin(1.1 * s + 1) + np.sin(1.9 * s + 2)

    def rates(s, x):
        return [force(s) - x[1] - 0.3 * x[0], (x[0] - x[1]) / tau]

    x, z = solve_ivp(rates, (0, 40), [0.2, 0.0], t_eval=t, rtol=1e-9, atol=1e-10).y
    rate = force(t) - z - 0.3 * x + 0.02 * np.random.default_rng(2).standard_normal(len(t))
    data = bg.Trajectories.from_arrays(t, states={"x": x}, derivatives={"x": rate}, inputs={"u": force(t)})
    model = bg.GreyBox(
        simulation={"x": "u - z - 0.3*x", "z": "(x - z)/tau"}, parameters={"tau": 1.0}, starts={"z": 0.0},
        rows=bg.DerivativeRows(),
    )  # fmt: skip
    train, test = data.split(0.7)
    found = bg.find_missing_effects(model, train, test=test, settle=False, progress=False)
    assert found.verdict == "recalibrate" and "tau should be 1.2" in found.sentence
    row = found.corrections.loc[("x", "tau")]
    assert row["probability"] > 0.9 and row["lower"] < tau - 1.0 < row["upper"]
    run = found.gap.xs("free-run NRMSE", level="metric").loc["test"]
    assert (run["before"] > 0.05).all() and (run["after"] < 0.01).all()
    found.save(tmp_path / "study.nc")
    again = bg.load(tmp_path / "study.nc")
    at = 0.0, np.array([0.5, 0.2]), np.array([1.0])
    np.testing.assert_allclose(again.to_callable(draws=1)(*at), found.to_callable(draws=1)(*at))
