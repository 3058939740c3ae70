"""The posterior of several equations on the same samples, read as that of any others."""

from dataclasses import replace

import numpy as np
import pytest
from predator_prey import COEFFICIENTS, by_integration, sampled

import bayes_greybox as bg

LABELS = [("x", "x"), ("x", "x*y"), ("y", "x*y"), ("y", "y")]


@pytest.fixture(scope="module")
def fit():
    model = bg.GreyBox(
        dictionary={"x": ["x", "x*y"], "y": ["x*y", "y"]}, rows=bg.TrajectoryRows(), discrepancy=None,
        prior=bg.Normal(),
    )  # fmt: skip
    return model.fit(sampled(), draws=300, tune=300, chains=2, progress=False)


def test_the_tables_are_by_equation_and_term(fit):
    table = fit.summary()
    assert list(table.index) == [*LABELS, ("x_and_y", "sigma")] and list(fit.inclusion().index) == LABELS
    truth, sd = by_integration(fit.data.samples, fit.equations["x_and_y"].rows.operator.sensor_sd)
    # 600 draws: the mean has a Monte Carlo error of 0.04 sd, and the standard deviation one of 3 %.
    np.testing.assert_allclose(table.loc[LABELS, "mean"], truth, atol=0.3 * sd.min())
    np.testing.assert_allclose(table.loc[LABELS, "sd"], sd, rtol=0.15)
    assert np.all(np.abs(table.loc[LABELS, "mean"] - COEFFICIENTS) < 4 * sd)
    assert {label for label in fit.sensitivity().index} >= set(LABELS)


def test_it_predicts_and_runs_free(fit):
    other = sampled(seed=5)
    predicted = fit.predict(other)
    assert set(predicted) == {"x", "y"} and predicted.nmse().max() < 0.01
    assert fit.simulate(other, draws=10).nrmse().max() < 0.05


def test_its_equations_are_taken_out_as_one_system(fit):
    x, y = np.random.default_rng(0).uniform(0.5, 4.0, (2, 6))
    mean = fit.inclusion()["mean"]
    by_hand = [mean["x", "x"] * x + mean["x", "x*y"] * x * y, mean["y", "x*y"] * x * y + mean["y", "y"] * y]
    for backend in ("numpy", "jax"):
        found = fit.to_callable(backend)(0.0, np.stack([x, y], axis=-1))
        np.testing.assert_allclose(found, np.stack(by_hand, axis=-1), rtol=1e-8)
    assert "\nd(x)/dt = " in repr(fit) and "\nd(y)/dt = " in repr(fit) and fit.to_latex().count("&=") == 2


def test_it_is_saved_and_read(fit, tmp_path):
    fit.save(tmp_path / "fit.nc")
    read = bg.load(tmp_path / "fit.nc")
    assert read.summary().equals(fit.summary()) and read.model.rows == fit.model.rows
    np.testing.assert_allclose(read.predict(sampled())["y"].rate.mean, fit.predict(sampled())["y"].rate.mean)


def test_its_checks_are_of_all_its_equations(fit):
    ((_, checked),) = fit.checks().table.xs("prior sensitivity", level="check").iterrows()
    assert checked["value"] == fit.sensitivity()["prior"].max() > 0


def test_a_force_found_on_its_rows_is_that_of_each_equation(fit):
    found = bg.Noise(force="fit", found={"x_and_y": {"force": 0.3, "force_share": 0.5}})
    table = bg.Fit(replace(fit.model, noise=found), fit.data, fit.sampling, fit.idata).noise
    assert list(table.index) == ["x", "y"] and list(table["force"]) == [0.3, 0.3]


def test_its_checks_are_found_by_either_equation_and_others_are_refused(fit):
    assert fit.loo_pit("y") is fit.loo_pit() and fit.whiteness("x") is fit.whiteness("x_and_y")
    with pytest.raises(bg.InputError, match="no equation 'z'; the model learns x, y"):
        fit.loo_pit("z")


def test_it_is_read_with_the_shares_of_its_variance_found(fit, tmp_path):
    found = fit.discrepancy()
    fit.save(tmp_path / "fit.nc")
    assert bg.load(tmp_path / "fit.nc").discrepancy().equals(found)


def test_its_page_is_written(fit, tmp_path):
    fit.to_html(tmp_path / "fit.html")
    text = (tmp_path / "fit.html").read_text()
    assert "d(y)/dt" in text and "the samples" in text and "x_and_y)/dt" not in text
