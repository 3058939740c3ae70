"""The benchmark of speed: the same data for all, figures of known draws, and how runs that end otherwise are told."""

from dataclasses import replace

import numpy as np
import pytest

import bayes_greybox as bg
from bayes_greybox.model.gp.features import HilbertBasis, default_features
from benchmarks.runner import Asked, perform
from benchmarks.speed import problems as posing
from benchmarks.speed.contenders.listed import CONTENDERS
from benchmarks.speed.contest import contest
from benchmarks.speed.drawn import FEATURES, Drawn, Settings, tensor_features
from benchmarks.speed.figures import apart, figures, first_answer
from benchmarks.speed.problems import BOX, COMPLETE, PARTIAL, Problem, measured, problems
from benchmarks.speed.run import SPEED, contests, measure, score


def designed(data):
    """Scaled rows as the package makes them."""
    rows = bg.Trajectories.from_arrays(data.time, states=dict(data.columns), derivatives={data.equation: data.rate})
    frame = bg.GreyBox(dictionary={data.equation: data.formulas}).assemble(rows)[data.equation].frame
    return frame, np.asarray(frame.dictionary_rows(rows.columns)), np.asarray(frame.position(rows.columns))


@pytest.mark.parametrize(
    "problem", [Problem(COMPLETE, 50), Problem(PARTIAL, 50, 5), Problem(BOX, 400, 20), Problem(BOX, 300, 6, 4)]
)
def test_all_contenders_see_the_numbers_that_the_package_sees(problem):
    data = measured(problem, 1)
    scaled = data.scaled()
    frame, Phi, x = designed(data)
    assert scaled.Phi.shape == (problem.n_obs, problem.n_term) and scaled.x.shape[1] == problem.n_var
    np.testing.assert_allclose(scaled.Phi, Phi, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(scaled.x, x, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(scaled.y, data.rate / frame.target_scale, rtol=1e-9)


def test_terms_in_the_box_are_told_apart():
    for problem in problems():
        if problem.kind == BOX:
            Phi = measured(problem, 1).scaled().Phi
            assert np.linalg.cond(Phi) < 10


def test_rows_beyond_those_that_are_integrated_lie_on_the_same_path(monkeypatch):
    monkeypatch.setattr(posing, "INTEGRATED", 2000)
    few, many = measured(Problem(COMPLETE, 1001), 1), measured(Problem(COMPLETE, 40_001), 1)
    for name, column in few.columns.items():
        np.testing.assert_allclose(many.columns[name][::40], column, atol=1e-6)
    exact = -(many.columns["y"] ** 3) - 0.2 * many.columns["ydot"] ** 3
    # 40,001 values: a relative standard error of 0.35 %.
    assert np.std(many.rate - exact) == pytest.approx(0.02 * np.std(exact), rel=0.02)


def test_features_are_the_packages_own_and_others_have_no_fewer():
    for n_var, along in FEATURES.items():
        assert (along,) * n_var == default_features(n_var)
        assert tensor_features(n_var) ** n_var >= HilbertBasis(2.0, (along,) * n_var).size
        assert (tensor_features(n_var) - 1) ** n_var < HilbertBasis(2.0, (along,) * n_var).size


def drawn(scale=1.0, looks=((1.0, 1000),), stuck=0.0):
    """Independent draws of two coefficients and one hyperparameter; chains that are stuck lie apart."""
    rng = np.random.default_rng(0)
    theta = np.array([1.0, -2.0]) + scale * rng.standard_normal((2, 1000, 2))
    theta += stuck * np.arange(2)[:, None, None]
    return Drawn(theta, rng.standard_normal((2, 1000, 1)), looks, 8000.0, 3)


def test_figures_of_independent_draws():
    found = figures(drawn())
    assert found["ess_theta"] == pytest.approx(2000, rel=0.2)
    assert found["r_hat"] < 1.01 and found["divergences"] == 3
    assert found["gradients"] == pytest.approx(4.0, rel=0.25)
    # Means of 2000 draws: 1/sqrt(2000).
    np.testing.assert_allclose(found["mcse"], 0.0224, rtol=0.2)
    off, off_mcse = apart(figures(drawn(2.0)), found)
    assert off < 0.2 and off_mcse < 5
    shifted = {**found, "mean": [found["mean"][0] + 0.5, found["mean"][1]]}
    assert apart(shifted, found)[0] == pytest.approx(0.5, rel=0.1)


def test_the_first_answer_is_that_of_the_first_look_that_converged():
    looks = ((1.0, 20), (2.0, 400), (3.0, 1000))
    assert first_answer(drawn(looks=looks)) == 2.0
    assert np.isnan(first_answer(drawn(looks=looks, stuck=5.0)))
    assert figures(drawn(stuck=5.0))["r_hat"] > 1.5


def test_a_sampler_that_is_half_as_fast_takes_twice_as_long(tmp_path):
    own = {"capped": False, "failed": "", "cap": 600.0, "cpu": 20.0, "starting": 5.0, "memory": 100.0}
    rows = [
        {"problem": "p", "contender": "here", "seconds": 10.0, **own, **figures(drawn())},
        {"problem": "p", "contender": "NumPyro HSGP", "seconds": 20.0, **own, **figures(drawn())},
        {"problem": "p", "contender": "NumPyro exact", "seconds": 615.0, "cap": 600.0, "capped": True, "failed": ""},
        {"problem": "p", "contender": "PyMC HSGP", "seconds": 2.0, "cap": 600.0, "capped": False, "failed": "No pymc."},
    ]
    table = score(rows)["speed"].loc["p"]
    assert table.loc["NumPyro HSGP", "ratio"] == pytest.approx(2.0)
    assert table.loc["NumPyro HSGP", "ratio_cpu"] == pytest.approx(1.0)
    assert table.loc["NumPyro HSGP", "ratio_drawing"] == pytest.approx(3.0)
    assert table.loc["NumPyro HSGP", "off"] == 0.0
    assert table.loc["NumPyro exact", "end"] == "600 s: still in warm-up"
    assert table.loc["PyMC HSGP", "end"] == "No pymc."
    assert np.isnan(table.loc[["NumPyro exact", "PyMC HSGP"], "theta_rate"]).all()
    floor = {"what": "a gradient", "here": 2.0, "machine": 1.0, "times": 2.0}
    assert len(SPEED.show(score([*rows, floor]))) == 2


@pytest.mark.slow
def test_the_package_in_a_process_of_its_own(tmp_path):
    data = measured(Problem(BOX, 60, 3, 1), 1)
    found, costs = contest(tmp_path, "here", data, Settings(draws=40, tune=40))
    assert found.theta.shape == (2, 40, 3) and found.eta.shape == (2, 40, 4)
    assert 0 < costs["starting"] < costs["seconds"] and costs["memory"] > 100
    # The first, the middle and the last coefficient, all of unit RMS in scaled units.
    scaled = data.scaled()
    exact = np.linalg.lstsq(scaled.Phi, scaled.y, rcond=None)[0]
    np.testing.assert_allclose(found.theta.mean(axis=(0, 1)), exact, atol=0.05)


@pytest.mark.slow
def test_what_cannot_be_drawn_costs_its_row(tmp_path):
    data = measured(Problem(BOX, 60, 3, 1), 1)
    broken = type(data)(data.problem, data.columns, "nothing", data.rate, data.time)
    found, costs = contest(tmp_path, "here", broken, Settings(draws=40, tune=40))
    assert found is None and not costs["capped"] and "nothing" in costs["failed"]


def test_a_contender_is_ended_at_its_cap_and_a_second_run_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr("benchmarks.speed.contest.GRACE", 0.0)
    called = []

    def once(function, *arguments):
        called.append(arguments[1])
        return measure(*arguments)

    problem, asked = Problem(BOX, 60, 3, 1), Asked(tmp_path, progress=False)
    cases = contests(tmp_path, [problem], ["here"], Settings(draws=40, tune=40, cap=0.2))
    for _ in range(2):
        table = perform(replace(SPEED, run=once), cases, asked)["speed"]
        assert table.loc[(problem.name, "here"), "end"] == "0 s: still in warm-up"
    assert called == ["here"]
    assert {file.name for file in tmp_path.iterdir()} == {"results.jsonl", "speed.csv", "summary.json"}


def test_who_has_no_f_is_not_asked_where_terms_are_missing():
    partial = Problem(PARTIAL, 1000, 5)
    assert not CONTENDERS["PySINDy SBR"].runs(partial) and CONTENDERS["here"].runs(partial)
    assert not CONTENDERS["NumPyro exact"].runs(Problem(COMPLETE, 10_000))


@pytest.mark.slow
def test_faster_than_theta_sampled_by_hand(tmp_path):
    settings = Settings(draws=1000, tune=500, cap=900.0)
    cases = contests(tmp_path, [Problem(COMPLETE, 200)], ["here", "NumPyro exact"], settings)
    table = perform(SPEED, cases, Asked(tmp_path))["speed"]
    peer = table.xs("NumPyro exact", level="contender").iloc[0]
    assert peer["ratio"] > 20 or np.isnan(peer["ratio"])
    assert peer["off"] < 0.3 or np.isnan(peer["off"])
