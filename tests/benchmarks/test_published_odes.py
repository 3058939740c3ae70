"""Published problems: what they are, that their estimate is least squares of the whole equations, and a short run."""

import json

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from typer.testing import CliRunner

from bayes_greybox.physics.terms import Term
from benchmarks.__main__ import app
from benchmarks.published_odes import run as running
from benchmarks.published_odes.problems import CELLS, FITZHUGH_NAGUMO, LOTKA_VOLTERRA
from benchmarks.published_odes.run import OTHER_MINIMUM, PUBLISHED_ODES, cases, estimate, table_row
from benchmarks.runner import Asked, perform


@pytest.mark.parametrize("problem", [LOTKA_VOLTERRA, FITZHUGH_NAGUMO], ids=lambda problem: problem.name)
def test_the_terms_with_their_coefficients_are_the_system(problem):
    x = np.random.default_rng(0).standard_normal(2)
    theta, rates = problem.coefficients(problem.truth), []
    for terms in problem.dictionary.values():
        own, theta = theta[: len(terms)], theta[len(terms) :]
        columns = {name: np.atleast_1d(value) for name, value in zip(problem.starts, x, strict=True)}
        rates.append(sum(c * Term(text).evaluate(columns)[0] for c, text in zip(own, terms, strict=True)))
    np.testing.assert_allclose(rates, problem.rates(x, problem.truth))
    np.testing.assert_allclose(problem.inverse(problem.coefficients(problem.truth)), problem.truth)


def test_draws_are_fresh_and_have_their_variance():
    cell = CELLS[0]
    noise = np.array([cell.samples(k).states["x"] for k in range(400)])
    spread = np.std(noise - noise.mean(axis=0))
    # 8400 values: a relative error of 0.8 %, at four standard errors
    assert spread == pytest.approx(np.sqrt(cell.variance), rel=0.032)
    assert np.array_equal(noise[3], cell.samples(3).states["x"]) and not np.array_equal(noise[3], noise[4])
    assert not np.array_equal(noise[3], cell.samples(3, seed=1).states["x"])


# Of the last three the first coefficients, or paths that a force moves, lead away from the estimate.
@pytest.mark.slow
@pytest.mark.parametrize(("number", "draw"), [(0, 0), (1, 0), (2, 0), (3, 0), (1, 25), (1, 76), (3, 25)])
def test_the_estimate_is_that_of_least_squares_from_the_truth(number, draw):
    """It starts at nothing and ends where an optimiser ends that starts at the truth."""
    cell = CELLS[number]
    problem, data = cell.problem, cell.samples(draw)
    measured, n = data.matrix(data.state_names).T, len(problem.truth)
    found = estimate(problem, data)

    def residual(q):
        path = solve_ivp(
            lambda t, x: problem.rates(x, q[:n]), (0, data.time[-1]), q[n:], t_eval=data.time,
            method="DOP853", rtol=1e-9, atol=1e-9,
        )  # fmt: skip
        return (path.y - measured).ravel()

    # Its slopes by steps far above what the integration is off by, or they are of its rounding.
    plain = least_squares(residual, [*problem.truth, *problem.starts.values()], "3-point", diff_step=1e-4)
    sd = np.sqrt(cell.variance * np.diag(np.linalg.inv(plain.jac.T @ plain.jac)))[:n]
    assert np.all(np.abs(found - plain.x[:n]) < 0.05 * sd)


@pytest.mark.slow
def test_a_short_run_goes_on_and_says_what_it_found(tmp_path, monkeypatch):
    asked = Asked(tmp_path, replicates=1, progress=False)
    table = perform(PUBLISHED_ODES, cases(asked), asked)["table"]
    assert list(table.index) == [cell.key for cell in CELLS] and (table["draws"] == 1).all()
    assert (table["max"] < OTHER_MINIMUM).all() and (table["above 0.5"] == 0).all()
    saved = json.loads((tmp_path / "summary.json").read_text())["table"]
    assert [row["median"] for row in saved] == pytest.approx(table["median"].tolist())
    monkeypatch.setattr(running, "estimate", None)
    assert perform(PUBLISHED_ODES, cases(asked), asked)["table"].equals(table)
    shown = CliRunner().invoke(app, ["published-odes", "--replicates", "1", "-o", str(tmp_path), "--no-progress"])
    assert shown.exit_code == 0 and "Lotka-Volterra" in shown.output


def test_draws_without_an_answer_count():
    rows = [{"parameters": None, "seconds": 1.0}, {"parameters": [2.0, 1.0, 4.0, 1.0], "seconds": 1.0}] * 2
    row = table_row(CELLS[0], [*rows, rows[1]])
    assert row["median"] == 0.0 and row["max"] == np.inf and row["above 0.5"] == 2


def test_what_is_efficient_is_near_what_was_published():
    for cell in CELLS:
        # Medians of 100 draws have a standard error of about 8 %.
        assert 0.7 < cell.efficient / cell.best < 1.3
