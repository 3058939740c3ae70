"""k̂ of exact paths: small where samples pin the coefficients down, large where their posterior bends."""

from dataclasses import replace

import numpy as np
import pytest
from fabricated import estimated
from sampled_oscillator import SIMULATION, sampled

import bayes_greybox as bg
from bayes_greybox.criticism.checks.checks import checks
from bayes_greybox.criticism.cross_validation.psis import khat_threshold
from bayes_greybox.criticism.linearity import Linearity, draws_followed, linearity_of_paths
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.trajectory_rows import TrajectoryRows

CUBIC = {"hidden": lambda y, v: -0.3 * y**3}
N_DRAW = 200


def rows_near(data, **options):
    model = Program({"v": ["y**3"]}, simulation=SIMULATION, rows=TrajectoryRows(**options), discrepancy=None)
    model, data = model.near(data)
    return model.assemble(data)["v"]


def found(data, **options):
    """Of draws from the posterior of linear rows."""
    equation = rows_near(data, **options)
    Phi, y, unit = np.asarray(equation.design.Phi)[:, 0], np.asarray(equation.design.y), equation.frame
    square = Phi @ Phi
    theta = Phi @ y / square
    sigma = np.sqrt(np.sum((y - Phi * theta) ** 2) / (len(y) - 1))
    draws = theta + sigma / np.sqrt(square) * np.random.default_rng(1).standard_normal(N_DRAW)
    draws, sigma = draws * unit.coefficient_scale, np.full(N_DRAW, sigma * unit.target_scale)
    return linearity_of_paths(equation.rows, lambda at, k: draws[k] * np.asarray(at["y"])[:, None] ** 3, sigma)


def test_where_samples_pin_a_coefficient_down_the_exact_posterior_is_the_linear_one():
    sharp = found(sampled(**CUBIC, noise=0.01))
    assert sharp.ok and sharp.khat < 0.5 and sharp.elsewhere < 0.05


@pytest.mark.slow
def test_where_noise_leaves_it_open_the_exact_posterior_lies_elsewhere():
    open_ = found(sampled(**CUBIC, noise=0.5, n=60, step=0.5))
    assert open_.khat > khat_threshold(N_DRAW) == open_.limit
    assert open_.elsewhere > 0.2 and not open_.ok


def test_under_an_unknown_force_it_is_not_known():
    assert np.isnan(found(sampled(**CUBIC, noise=0.05, n=100), force=1e-3).khat)


def test_rows_of_rates_are_linear_in_coefficients():
    rows = replace(rows_near(sampled(**CUBIC, noise=0.05, n=100)).rows, exact=None)
    linear = linearity_of_paths(rows, lambda at, k: np.zeros((1, 1)), np.ones(N_DRAW))
    assert linear.ok and linear.khat == linear.elsewhere == 0.0


def test_what_is_beside_the_path_bends_nothing():
    equation = rows_near(sampled(**CUBIC, noise=0.01, n=100))
    theta, rng = equation.ridge()[0][1], np.random.default_rng(2)
    beside = rng.standard_normal((N_DRAW, equation.rows.n_row)) * np.std(equation.rows.target)

    def added(at, draw):
        return theta * np.asarray(at["y"])[:, None] ** 3

    sigma = np.full(N_DRAW, float(np.mean(equation.rows.operator.sensor_sd)) / equation.rows.gain)
    # Starts take their part of it; a linear sensor's error is the same on every path.
    assert linearity_of_paths(equation.rows, added, sigma, 1e-3 * beside).elsewhere < 0.05


def test_long_records_have_fewer_paths_followed():
    rows = rows_near(sampled(**CUBIC, noise=0.05, n=100)).rows
    assert draws_followed(rows) == N_DRAW
    long = replace(rows, columns={"y": np.zeros(10**6)})
    assert draws_followed(long) == 25


@pytest.fixture(scope="module")
def fit():
    model = bg.GreyBox({"v": ["y**3"]}, simulation=SIMULATION, rows=bg.TrajectoryRows(), discrepancy=None)
    return estimated(model, sampled(**CUBIC, noise=0.05, n=150), draws=100)


@pytest.mark.slow
def test_what_bends_is_said_once_and_fails_no_other_check(fit, monkeypatch):
    monkeypatch.setattr("bayes_greybox.criticism.checks.checks.linearity", lambda *_: Linearity(1.5, 0.5, 0.8))
    found = checks.__wrapped__(fit)
    assert sum("80% of the exact posterior lies elsewhere (k-hat 1.5)" in reason for reason in found.reasons) == 1
    assert not found.table.loc[("v", "linearity"), "ok"] and found.table.loc[("v", "prior sensitivity"), "ok"]


def test_it_is_among_the_checks_of_a_fit_on_samples(fit):
    row = fit.checks().table.loc[("v", "linearity")]
    assert row["ok"] and row["reason"] == "" and row["limit"] == khat_threshold(N_DRAW)
