"""The public demonstration of neural FMUs: its data, its FMU, and what a study of it records."""

import shutil

import numpy as np
import pytest

import bayes_greybox as bg
from bayes_greybox.physics.catalogue.loading import load_catalogue
from bayes_greybox.physics.simulation.reading import simulation_of
from benchmarks.runner import Asked
from benchmarks.spring_pendulum.plant import NAMES, plant
from benchmarks.spring_pendulum.run import TRAIN, UNSEEN, cases, off, pendulums, sampled, score
from benchmarks.spring_pendulum.truth import path, truth, without_friction

CASE, CONTROL = pendulums()["1-mm-4-effects"], pendulums()["1-mm-nothing"]


def true_rates(x):
    s, v = x
    return np.array([v, 10 * (1 - s) - 0.05 * v - np.sign(v) * (0.25 + 0.5 * np.exp(-2 * abs(v)))])


def test_the_path_is_the_published_one_and_sticks():
    """FMIFlux.jl, gh-pages 139be2f, dev/examples/simple_hybrid_ME: the first and last positions that it prints."""
    t, x = path(*TRAIN)
    assert len(t) == 501
    np.testing.assert_allclose(x[0, :4], [0.5, 0.5002131418, 0.5008548875, 0.5019281658], rtol=0, atol=1e-9)
    # By a tolerance of its own solver, whose last positions are 1e-12 apart: the mass has stopped.
    np.testing.assert_allclose(x[0, -3:], 1.06686856, rtol=0, atol=5e-6)
    assert np.all(x[1, -3:] == 0) and np.all(x[1, 10:-4] != 0)
    # It stays where the spring pulls less than 0.75 N, and starts where it pulls more.
    assert np.all(path((1.07, 0.0), 1.0)[1][0] == 1.07) and path((1.08, 0.0), 1.0)[1][1, -1] < 0


def test_free_runs_of_the_true_rates_are_right_and_those_of_the_simulation_are_not():
    assert max(off(true_rates, CASE, *record) for record in (TRAIN, UNSEEN)) < 1e-3
    assert min(off(lambda x: np.array([x[1], 10 * (1.1 - x[0])]), CASE, *record) for record in (TRAIN, UNSEEN)) > 0.1
    assert off(lambda x: np.array([x[1], 10 * (1.1 - x[0])]), CONTROL, *TRAIN) < 1e-6


def test_what_is_lacking_is_in_the_catalogue_with_its_sign():
    entries = {effect.slug: effect for effect in load_catalogue("mechanical")}
    assert all(entries[slug].sign in (0, np.sign(value)) for slug, value in truth().items())
    # The whole difference of the rates, on the path.
    s, v = path(*UNSEEN)[1]
    values = {"constant-force": 1, "viscous-damping": v, "coulomb-friction": np.sign(v)}
    values["exponential-stribeck-friction"] = np.sign(v) * np.exp(-2 * np.abs(v))
    lacking = sum(truth()[slug] * value for slug, value in values.items())
    np.testing.assert_allclose(lacking, true_rates(np.array([s, v]))[1] - 10 * (1.1 - s), rtol=0, atol=1e-12)


def test_the_noise_is_that_of_the_case_and_the_same_again():
    made, again = (sampled(CASE, TRAIN, (0, 1)) for _ in range(2))
    np.testing.assert_array_equal(made.states["s"], again.states["s"])
    assert made.state_names == ("s",) and not made.derivative_names
    assert np.std(made.states["s"] - path(*TRAIN)[1][0]) == pytest.approx(1e-3, rel=0.1)
    quiet = sampled(CONTROL, TRAIN, (0, 1)).states["s"] - without_friction(*TRAIN)[1][0]
    assert np.std(quiet) == pytest.approx(1e-3, rel=0.1)


@pytest.mark.skipif(not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="there is no C compiler")
def test_the_fmu_is_the_pendulum_without_friction(tmp_path):
    pytest.importorskip("fmpy", reason="FMPy is not installed (extra fmu)")
    own = simulation_of(bg.FMU(plant(tmp_path), states=NAMES), ("s", "v"), ())
    x = np.random.default_rng(0).normal(size=(20, 2))
    rates = own.rates(np.zeros(20), x, np.zeros((20, 0)))
    np.testing.assert_allclose(rates, np.column_stack([x[:, 1], 10 * (1.1 - x[:, 0])]), rtol=0, atol=1e-13)


def row(**changed):
    found = {
        "case": "a", "replicate": 0, "verdict": "named", "added": {"b": 0.99}, "likely": {},
        "laws": {"v": 0.999, "": 0.7}, "missed": [], "wrong": [], "covered": {"b": True}, "rmse": [0.001, 0.002],
        "rmse_before": [0.2, 0.1], "seconds": 1.0,
    }  # fmt: skip
    return {**found, **changed}


def test_a_row_says_names_and_errors_in_millimetres():
    table = score([row(), {"case": "b", "replicate": 1, "refused": "no"}])["cases"]
    assert (
        table.loc["a", "names"] == "b 0.990"
        and table.loc["a", "unseen"] == 2.0
        and table.loc["a", "covered"] == "1 of 1"
        and table.loc["a", "laws"] == "of v 0.999, of nothing 0.700"
    )
    assert table.loc["b", "verdict"] == "refused" and np.isnan(table.loc["b", "train"])


def test_a_case_that_does_not_exist_is_refused(tmp_path):
    with pytest.raises(bg.InputError, match="There is no case 'x'"):
        cases(Asked(tmp_path, only=["x"]))
