"""The gap table and its free runs, from coefficients that are written down by hand."""

import numpy as np
import pytest
from tiny_equation import CUBE, DEAD_ZONE, SQUARE, tiny_data, tiny_evaluations, tiny_model

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.coefficients import Coefficients
from bayes_greybox.discovery.gap import LEVEL, PATH_DRAWS, RATE_DRAWS, Amendment, gap_rows

CUBIC = {"hidden": lambda x: -(x**3), "noise": 0.05}
TAILS = [(1 - LEVEL) / 2, (1 + LEVEL) / 2]


def amended(known, draws, inner=None, before=(), sigma=0.05):
    """Coefficients in user's units on the free terms, corrections and effects of the equation."""
    statistics = known.statistics
    draws = np.atleast_2d(np.asarray(draws, float))
    inner = np.zeros((len(draws), 0), int) if inner is None else np.asarray(inner).reshape(len(draws), -1)
    own = [*statistics.of_kind("free"), *statistics.of_kind("correction")]
    indices = (*own, *(int(column[0]) for column in inner.T))
    scale = np.array([statistics.columns[i].scale for i in own], float) / statistics.target_scale
    of_effects = [[statistics.columns[i].scale / statistics.target_scale for i in row] for row in inner]
    scaled = draws * np.column_stack([np.tile(scale, (len(draws), 1)), np.array(of_effects).reshape(inner.shape)])
    free = np.asarray(before) * scale[: len(before)]
    return Amendment(statistics, free, Coefficients(indices, scaled, inner, np.full(len(draws), 0.1)), sigma)


def with_cube(coefficients, sigma=0.05):
    """The cube with these coefficients, and no correction."""
    known = tiny_evaluations([CUBE], **CUBIC)
    (cube,) = known.statistics.of_kind("effect")
    draws = np.column_stack([np.zeros(len(coefficients)), coefficients])
    return amended(known, draws, np.full(len(coefficients), cube), sigma=sigma)


def gap(amendment, data=None, model=None, free_runs=False, part="test"):
    data = tiny_data(**CUBIC, seed=5) if data is None else data
    return gap_rows(model or tiny_model(), {"x": amendment}, data, part, free_runs)


def held_out():
    """x, the measured rate, and what the simulation says of it."""
    data = tiny_data(**CUBIC, seed=5)
    x = data.states["x"]
    return x, data.derivatives["x"], -x


# Rates


def test_the_derivative_error_is_the_mean_square_over_the_variance():
    x, rate, simulated = held_out()
    row = gap(with_cube([-0.8]))[0].loc[("test", "derivative NMSE", "x")]
    assert row["before"] == pytest.approx(np.mean((rate - simulated) ** 2) / np.var(rate))
    assert row["after"] == pytest.approx(np.mean((rate - simulated + 0.8 * x**3) ** 2) / np.var(rate))


def test_the_unexplained_share_is_less_the_noise_and_over_the_mean_square():
    x, rate, simulated = held_out()
    row = gap(with_cube([-0.5], sigma=0.04))[0].loc[("test", "unexplained share", "x")]
    size = np.mean(rate**2)
    assert row["before"] == pytest.approx((np.mean((rate - simulated) ** 2) - 0.04**2) / size)
    assert row["after"] == pytest.approx((np.mean((rate - simulated + 0.5 * x**3) ** 2) - 0.04**2) / size)


def test_the_unexplained_share_is_not_below_zero():
    row = gap(with_cube([-1.0], sigma=0.5))[0].loc[("test", "unexplained share", "x")]
    assert (row[["before", "after", "lower", "upper"]] == 0).all()


def test_what_was_closed_is_one_less_the_ratio():
    table, _ = gap(with_cube([-0.8]))
    np.testing.assert_allclose(table["closed"], 1 - table["after"] / table["before"])


def test_a_gap_that_grows_is_closed_by_less_than_nothing():
    table, _ = gap(with_cube([0.5]))
    assert (table["closed"] < 0).all()


@pytest.mark.parametrize(("coefficient", "after"), [(-1.0, False), (5.0, True)])
def test_where_there_was_no_gap_none_was_closed(coefficient, after):
    row = gap(with_cube([coefficient], sigma=0.5))[0].loc[("test", "unexplained share", "x")]
    assert row["before"] == 0 and (row["after"] > 0) == after
    assert np.isnan(row["closed"])


def test_the_interval_is_that_of_the_draws():
    x, rate, simulated = held_out()
    coefficients = np.linspace(-1.2, -0.6, RATE_DRAWS)
    row = gap(with_cube(coefficients))[0].loc[("test", "derivative NMSE", "x")]
    errors = [np.mean((rate - simulated - c * x**3) ** 2) / np.var(rate) for c in coefficients]
    assert (row["lower"], row["upper"]) == pytest.approx(tuple(np.quantile(errors, TAILS)))


def test_the_error_after_is_that_of_the_mean_prediction():
    x, rate, simulated = held_out()
    row = gap(with_cube(np.linspace(-2.0, 0.4, RATE_DRAWS)))[0].loc[("test", "derivative NMSE", "x")]
    # The mean coefficient is −0.8, whose error is far below that of most draws.
    assert row["after"] == pytest.approx(np.mean((rate - simulated + 0.8 * x**3) ** 2) / np.var(rate))
    assert row["after"] < 0.5 * (row["lower"] + row["upper"])


def test_draws_beyond_the_number_shown_are_thinned_evenly_from_first_to_last():
    coefficients = np.linspace(-1.0, -0.5, 10 * RATE_DRAWS)
    _, after = with_cube(coefficients).rates({"x": np.array([1.0])}, RATE_DRAWS)
    assert after.shape == (RATE_DRAWS, 1)
    assert (after[0, 0], after[-1, 0]) == pytest.approx((-1.0, -0.5))


def test_a_draw_is_evaluated_with_its_own_inner_parameter():
    known = tiny_evaluations([DEAD_ZONE], **CUBIC)
    zones = known.statistics.of_kind("effect")
    pair = [zones[2], zones[5]]
    _, after = amended(known, [[0.0, 1.0], [0.0, 2.0]], pair).rates({"x": np.array([1.0])}, 2)
    widths = [known.statistics.columns[i].inner["gap"] for i in pair]
    np.testing.assert_allclose(after[:, 0], [1 - widths[0], 2 * (1 - widths[1])])


def test_before_has_the_free_terms_alone_and_after_all_terms():
    known = tiny_evaluations([SQUARE], **CUBIC, dictionary={"x": ["x**3"]})
    (square,) = known.statistics.of_kind("effect")
    amendment = amended(known, [[3.0, 5.0, 7.0]], [square], before=[2.0])
    before, after = amendment.rates({"x": np.array([0.5, 1.0])}, 1)
    x = np.array([0.5, 1.0])
    np.testing.assert_allclose(before, 2 * x**3)
    np.testing.assert_allclose(after[0], 3 * x**3 + 5 * x + 7 * x**2)


def test_a_model_without_any_column_adds_nothing():
    known = tiny_evaluations(**CUBIC, simulation=lambda t, x, u: [-x[0]])
    before, after = amended(known, np.zeros((3, 0))).rates({"x": np.array([0.5, 1.0])}, 3)
    np.testing.assert_array_equal(before, 0.0)
    np.testing.assert_array_equal(after, np.zeros((3, 2)))


def test_data_without_the_rate_have_no_row_of_rates():
    plain = tiny_data(**CUBIC)
    bare = Trajectories.from_arrays(plain.time, states=dict(plain.states))
    table, paths = gap(with_cube([-1.0]), data=bare)
    assert table.empty and paths == {}
    assert table.index.names == ["data", "metric", "variable"]


def test_rows_are_those_of_the_part_they_were_asked_for():
    table, _ = gap(with_cube([-1.0]), part="train")
    assert set(table.index.get_level_values("data")) == {"train"}


# Free runs


def decay(c, n=41, start=1.0, x=None):
    """Rows of ẋ = −x + c x, or of any path."""
    t = np.linspace(0, 2, n)
    x = start * np.exp((c - 1) * t) if x is None else x(t)
    return Trajectories.from_arrays(t, states={"x": x}, derivatives={"x": (c - 1) * x})


@pytest.fixture(scope="module")
def runs():
    """Measured ẋ = −0.5 x; the simulation has −x, and three draws of its correction lie around 0.4."""
    known = tiny_evaluations(**CUBIC)
    data = decay(0.5)
    return data, *gap(amended(known, [[0.3], [0.4], [0.5]]), data=data, free_runs=True)


def shown_paths(corrections, t):
    """Paths of the draws that are shown."""
    pick = np.linspace(0, len(corrections) - 1, PATH_DRAWS).astype(int)
    return np.array([np.exp((corrections[i] - 1) * t) for i in pick])


def test_the_free_run_before_is_the_simulation_from_the_measured_start(runs):
    data, _, paths = runs
    np.testing.assert_allclose(paths["x"].before.mean, np.exp(-data.time), atol=1e-5)


def test_the_free_run_after_has_what_was_added(runs):
    data, _, paths = runs
    expected = shown_paths([0.3, 0.4, 0.5], data.time)
    np.testing.assert_allclose(paths["x"].after.mean, expected.mean(axis=0), atol=1e-5)
    np.testing.assert_allclose(paths["x"].after.lower, np.quantile(expected, TAILS[0], axis=0), atol=1e-5)


def test_the_free_run_error_is_the_root_mean_square_over_the_standard_deviation(runs):
    data, table, _ = runs
    x, row = data.states["x"], table.loc[("test", "free-run NRMSE", "x")]
    assert row["before"] == pytest.approx(np.sqrt(np.mean((x - np.exp(-data.time)) ** 2)) / np.std(x), rel=1e-4)
    after = shown_paths([0.3, 0.4, 0.5], data.time)
    assert row["after"] == pytest.approx(np.sqrt(np.mean((x - after.mean(axis=0)) ** 2)) / np.std(x), rel=1e-3)
    errors = np.sqrt(np.mean((x - after) ** 2, axis=1)) / np.std(x)
    assert row["lower"] == pytest.approx(np.quantile(errors, TAILS[0]), rel=1e-3, abs=1e-5)
    assert row["upper"] == pytest.approx(np.quantile(errors, TAILS[1]), rel=1e-3)


def test_a_run_that_lasts_has_no_time_to_failure(runs):
    assert "time to failure" not in runs[1].index.get_level_values("metric")


@pytest.fixture(scope="module")
def failing():
    """Simulated ẋ = x² from 1, which is infinite at t = 1; the correction of −1 leaves nothing of it."""
    model = tiny_model(simulation={"x": "x**2"})
    known = tiny_evaluations(**CUBIC, simulation={"x": "x**2"})
    data = decay(0.0, x=lambda t: 1 + 0.01 * t)
    return data, *gap(amended(known, [[-1.0]]), data=data, model=model, free_runs=True)


def test_a_free_run_that_blows_up_has_a_time_to_failure(failing):
    row = failing[1].loc[("test", "time to failure", "all")]
    assert row["before"] == pytest.approx(1.0, abs=0.06)


def test_a_free_run_that_no_longer_blows_up_has_lasted_for_ever(failing):
    row = failing[1].loc[("test", "time to failure", "all")]
    assert np.isnan(row[["after", "lower", "upper"]].astype(float)).all()


def test_a_time_to_failure_closes_nothing(failing):
    assert np.isnan(failing[1].loc[("test", "time to failure", "all"), "closed"])


def test_free_run_errors_are_of_the_time_before_the_first_failure(failing):
    data, table, paths = failing
    alive = np.isfinite(paths["x"].before.mean)
    assert 0 < alive.sum() < len(data.time)
    x, after = data.states["x"], paths["x"].after.mean
    expected = np.sqrt(np.mean((x - after)[alive] ** 2)) / np.std(x)
    assert table.loc[("test", "free-run NRMSE", "x"), "after"] == pytest.approx(expected, rel=1e-6)


def test_a_state_without_an_equation_cannot_run_freely():
    known = tiny_evaluations(**CUBIC, simulation={})
    t = np.linspace(0, 1, 20)
    data = Trajectories.from_arrays(t, states={"x": np.exp(-t), "z": t**2}, derivatives={"x": -np.exp(-t)})
    table, paths = gap(amended(known, np.zeros((1, 0))), data=data, model=tiny_model(simulation={}), free_runs=True)
    assert paths == {} and "free-run NRMSE" not in table.index.get_level_values("metric")
