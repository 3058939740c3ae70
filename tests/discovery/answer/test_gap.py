"""The gap table and its free runs, from coefficients that are written down by hand."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp
from tiny_equation import CUBE, DEAD_ZONE, SQUARE, tiny_data, tiny_model, tiny_near, tiny_regressors

from bayes_greybox.data.samples.starts import Starts
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.answer.amendment import Amendment, Remainder
from bayes_greybox.discovery.answer.coefficients import Coefficients
from bayes_greybox.discovery.answer.free_runs import PATH_DRAWS, FreeRuns
from bayes_greybox.discovery.answer.gap import RATE_DRAWS, gap_rows
from bayes_greybox.discovery.answer.interval import INTERVAL_ENDS
from bayes_greybox.discovery.decision.criteria import CRITERIA
from bayes_greybox.discovery.decision.vetoes import MISFIT, NAMES_ALONE, left_over, worsened
from bayes_greybox.running.plain_values import plain_rows

CUBIC = {"hidden": lambda x: -(x**3), "noise": 0.05}


def amended(known, draws, inner=None, before=(), sigma=0.05):
    """Coefficients in user's units on the free terms, corrections and effects of the equation."""
    statistics = known
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
    known = tiny_regressors([CUBE], **CUBIC)
    (cube,) = known.of_kind("effect")
    draws = np.column_stack([np.zeros(len(coefficients)), coefficients])
    return amended(known, draws, np.full(len(coefficients), cube), sigma=sigma)


def gap(amendment, data=None, model=None, free_runs=False, part="test", **options):
    data = tiny_data(**CUBIC, seed=5) if data is None else data
    model, amendments = model or tiny_model(), {"x": amendment}
    runs = partial(FreeRuns(model, amendments), **options) if free_runs else None
    return gap_rows(model, amendments, data, part, runs)


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


def test_beside_f_the_share_that_names_alone_leave_has_a_row():
    near = tiny_near([CUBE], lambda x: -(x**3) + 0.2 * np.cos(7 * x), noise=0.05)
    amendment = with_cube([-1.0])
    f = Remainder.of(near, near.likeliest, amendment.after)
    table, _ = gap(replace(amendment, discrepancy=f))
    alone, _ = gap(amendment)
    with_f, names = (table.loc[("test", metric, "x")] for metric in ("unexplained share", NAMES_ALONE))
    pd.testing.assert_series_equal(names, alone.loc[("test", "unexplained share", "x")], check_names=False)
    assert with_f["after"] != names["after"] and NAMES_ALONE not in alone.index.get_level_values("metric")


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
    assert (row["lower"], row["upper"]) == pytest.approx(tuple(np.quantile(errors, INTERVAL_ENDS)))


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
    known = tiny_regressors([DEAD_ZONE], **CUBIC)
    zones = known.of_kind("effect")
    pair = [zones[2], zones[5]]
    _, after = amended(known, [[0.0, 1.0], [0.0, 2.0]], pair).rates({"x": np.array([1.0])}, 2)
    widths = [known.columns[i].inner["gap"] for i in pair]
    np.testing.assert_allclose(after[:, 0], [1 - widths[0], 2 * (1 - widths[1])])


def test_before_has_the_free_terms_alone_and_after_all_terms():
    known = tiny_regressors([SQUARE], **CUBIC, dictionary={"x": ["x**3"]})
    (square,) = known.of_kind("effect")
    amendment = amended(known, [[3.0, 5.0, 7.0]], [square], before=[2.0])
    before, after = amendment.rates({"x": np.array([0.5, 1.0])}, 1)
    x = np.array([0.5, 1.0])
    np.testing.assert_allclose(before, 2 * x**3)
    np.testing.assert_allclose(after[0], 3 * x**3 + 5 * x + 7 * x**2)


def test_a_model_without_any_column_adds_nothing():
    known = tiny_regressors(**CUBIC, simulation=lambda t, x, u: [-x[0]])
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
    known = tiny_regressors(**CUBIC)
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
    np.testing.assert_allclose(paths["x"].after.lower, np.quantile(expected, INTERVAL_ENDS[0], axis=0), atol=1e-5)


def test_the_free_run_error_is_the_root_mean_square_over_the_standard_deviation(runs):
    data, table, _ = runs
    x, row = data.states["x"], table.loc[("test", "free-run NRMSE", "x")]
    assert row["before"] == pytest.approx(np.sqrt(np.mean((x - np.exp(-data.time)) ** 2)) / np.std(x), rel=1e-4)
    after = shown_paths([0.3, 0.4, 0.5], data.time)
    assert row["after"] == pytest.approx(np.sqrt(np.mean((x - after.mean(axis=0)) ** 2)) / np.std(x), rel=1e-3)
    errors = np.sqrt(np.mean((x - after) ** 2, axis=1)) / np.std(x)
    assert row["lower"] == pytest.approx(np.quantile(errors, INTERVAL_ENDS[0]), rel=1e-3, abs=1e-5)
    assert row["upper"] == pytest.approx(np.quantile(errors, INTERVAL_ENDS[1]), rel=1e-3)


def test_a_run_that_lasts_has_no_time_to_failure(runs):
    assert "time to failure" not in runs[1].index.get_level_values("metric")


@pytest.fixture(scope="module")
def failing():
    """Simulated ẋ = x² from 1, which is infinite at t = 1; the correction of −1 leaves nothing of it."""
    model = tiny_model(simulation={"x": "x**2"})
    known = tiny_regressors(**CUBIC, simulation={"x": "x**2"})
    data = decay(0.0, x=lambda t: 1 + 0.01 * t)
    return data, *gap(amended(known, [[-1.0]]), data=data, model=model, free_runs=True)


def test_a_free_run_that_blows_up_has_a_time_to_failure(failing):
    row = failing[1].loc[("test", "time to failure", "all")]
    assert row["before"] == pytest.approx(1.0, abs=0.06)


def test_a_free_run_that_no_longer_blows_up_has_lasted_for_ever(failing):
    row = failing[1].loc[("test", "time to failure", "all")]
    assert np.isnan(row[["after", "lower", "upper"]].astype(float)).all()


def test_never_is_null_in_a_record(failing):
    (row,) = (row for row in plain_rows(failing[1]) if row["metric"] == "time to failure")
    assert row["before"] == pytest.approx(1.0, abs=0.06) and row["after"] is None and row["upper"] is None


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
    known = tiny_regressors(**CUBIC, simulation={})
    t = np.linspace(0, 1, 20)
    data = Trajectories.from_arrays(t, states={"x": np.exp(-t), "z": t**2}, derivatives={"x": -np.exp(-t)})
    table, paths = gap(amended(known, np.zeros((1, 0))), data=data, model=tiny_model(simulation={}), free_runs=True)
    assert paths == {} and "free-run NRMSE" not in table.index.get_level_values("metric")


# What the draws of a free run hold


def test_exact_states_start_where_they_were_measured(runs):
    data, _, paths = runs
    assert paths["x"].after.sd[0] == 0.0 and paths["x"].after.mean[0] == data.states["x"][0]
    assert paths["x"].holds == "90 % band: coefficients"


def test_every_draw_has_its_own_start_and_the_model_before_the_same_ones():
    known, data = tiny_regressors(**CUBIC), decay(0.5)
    starts = Starts(np.array([[1.1]]), np.array([[0.2]]))
    table, paths = gap(amended(known, [[0.4]]), data=data, free_runs=True, starts=starts, seed=3)
    drawn = starts.draws(PATH_DRAWS, np.random.default_rng(3))[:, 0]
    expected = {"before": drawn * np.exp(-data.time), "after": drawn * np.exp(-0.6 * data.time)}
    for name, path in expected.items():
        band = getattr(paths["x"], name)
        np.testing.assert_allclose(band.mean, path.mean(axis=0), atol=1e-5)
        np.testing.assert_allclose(band.upper, np.quantile(path, INTERVAL_ENDS[1], axis=0), atol=1e-5)
    x, row = data.states["x"], table.loc[("test", "free-run NRMSE", "x")]
    for name, path in expected.items():
        assert row[name] == pytest.approx(np.sqrt(np.mean((x - path.mean(axis=0)) ** 2)) / np.std(x), rel=1e-3)
    assert paths["x"].holds == "90 % band: start"


def test_the_start_of_noisy_states_is_estimated():
    t, rng = np.linspace(0, 2, 401), np.random.default_rng(0)
    x = np.exp(-0.5 * t) + 0.05 * rng.standard_normal(401)
    data = Trajectories.from_arrays(t, states={"x": x}, derivatives={"x": -0.5 * x})
    _, paths = gap(amended(tiny_regressors(**CUBIC), [[0.5]]), data=data, free_runs=True)
    spread = paths["x"].after.sd[0]
    assert 0.005 < spread < 0.06
    assert abs(paths["x"].after.mean[0] - 1.0) < 4 * spread
    assert "start" in paths["x"].holds


def test_a_model_without_any_column_runs_from_noisy_starts():
    known = tiny_regressors(**CUBIC, simulation=lambda t, x, u: [-x[0]])
    model = tiny_model(simulation=lambda t, x, u: [-x[0]])
    starts = Starts(np.array([[1.0]]), np.array([[0.2]]))
    _, paths = gap(amended(known, np.zeros((3, 0))), data=decay(0.0), model=model, free_runs=True, starts=starts)
    assert paths["x"].after.sd[0] > 0.1


def test_a_free_run_has_the_inner_parameter_of_its_draw():
    known = tiny_regressors([DEAD_ZONE], **CUBIC)
    zones = known.of_kind("effect")
    pair = [zones[1], zones[-2]]
    widths = [known.columns[i].inner["gap"] for i in pair]
    data = decay(0.5)
    _, paths = gap(amended(known, [[0.0, -2.0], [0.0, -3.0]], pair), data=data, free_runs=True)
    pick = np.linspace(0, 1, PATH_DRAWS).astype(int)
    each = [
        solve_ivp(
            lambda t, x, c=c, w=w: -x + c * np.maximum(x - w, 0), (0, 2), [1.0], t_eval=data.time, rtol=1e-9, atol=1e-9
        ).y[0]
        for c, w in zip((-2.0, -3.0), widths, strict=True)
    ]
    shown = np.array([each[i] for i in pick])
    assert np.ptp(shown, axis=0).max() > 0.05
    np.testing.assert_allclose(paths["x"].after.mean, shown.mean(axis=0), atol=1e-4)
    np.testing.assert_allclose(paths["x"].after.upper, np.quantile(shown, INTERVAL_ENDS[1], axis=0), atol=1e-4)
    assert paths["x"].holds == "90 % band: coefficients, nonlinear parameters"


def test_only_columns_that_a_draw_has_are_integrated():
    known = tiny_regressors([DEAD_ZONE, SQUARE], **CUBIC)
    zones = [i for i in known.of_kind("effect") if known.columns[i].effect.slug == "dead-zone"]
    added = amended(known, [[0.0, 1.0], [0.0, 2.0]], [zones[2], zones[2]]).added(1, 2)
    assert len(added.terms) == 1 and added.weights.shape == (3, 0)
    np.testing.assert_allclose(added.coefficients, [[0.0], [1.0], [2.0]])


@cache
def bumpy(effect=None):
    """A gap of 0.8 cos 4x, which no effect is."""
    effects = [] if effect is None else [{"square": SQUARE, "dead-zone": DEAD_ZONE}[effect]]
    return tiny_near(effects, hidden=lambda x: 0.8 * np.cos(4 * x), noise=0.02, n=200)


def with_remainder(near, amendment):
    return replace(amendment, discrepancy=Remainder.of(near, near.weighed.before, amendment.after))


@cache
def bump():
    """f alone: no draw has the correction."""
    return with_remainder(bumpy(), amended(bumpy().regressors, [[0.0], [0.0]]))


def test_f_beside_nothing_is_the_gap():
    amendment = bump()
    x = np.linspace(-0.9, 0.9, 19)
    _, after = amendment.rates({"x": x}, RATE_DRAWS)
    np.testing.assert_allclose(after.mean(axis=0), 0.8 * np.cos(4 * x), atol=0.15)
    assert 0 < after.std(axis=0).max() < 0.2


def test_f_keeps_off_what_was_added_and_its_weights_have_their_covariance():
    near = bumpy("square")
    known = near.regressors
    (square,) = known.of_kind("effect")
    amendment = amended(known, [[0.3, -1.0], [0.3, -1.1]], [square, square])
    f = Remainder.of(near, near.weighed.before, amendment.after)
    assert set(f.indices) == {*amendment.after.indices}
    columns = known.rows.columns
    own = known.evaluate(f.indices, columns)
    across = own.T @ f.rates(columns, 7).T
    np.testing.assert_allclose(across, 0.0, atol=1e-8 * len(own))
    drawn = np.cov(f.weights(200_000).T)
    np.testing.assert_allclose(drawn, f.root.T @ f.root, atol=0.02 * np.abs(f.root.T @ f.root).max())


def test_a_column_that_no_draw_has_is_free_for_f():
    assert len(bumpy().regressors.of_kind("correction")) == 1
    assert bump().discrepancy.indices == ()


def test_rates_and_the_integrators_terms_are_the_same_function():
    near = bumpy("dead-zone")
    known = near.regressors
    zones = known.of_kind("effect")
    amendment = amended(known, [[0.3, -1.0], [0.2, -1.1], [0.0, 0.4]], [zones[2], zones[2], zones[4]])
    amendment = with_remainder(near, amendment)
    # Beyond the data too, where the features are held.
    columns = {"x": np.linspace(-3, 3, 31)}
    before, after = amendment.rates(columns, 3)
    added = amendment.added(2, 3)
    values = np.array([np.asarray(term.evaluate(columns)) for term in added.terms])
    total = added.coefficients @ values + added.weights @ np.asarray(amendment.features(columns)).T
    np.testing.assert_allclose(total, [before, before, *after], atol=1e-10)


def test_the_features_of_f_are_held_beyond_their_domain():
    amendment = bump()
    _, after = amendment.rates({"x": np.array([3.0, 30.0, -3.0, -30.0])}, 5)
    np.testing.assert_allclose(after[:, [0, 2]], after[:, [1, 3]])


def test_a_free_run_with_f_follows_what_has_no_name():
    amendment = bump()
    t = np.linspace(0, 2, 41)
    x = solve_ivp(lambda t, x: -x + 0.8 * np.cos(4 * x), (0, 2), [-0.9], t_eval=t, rtol=1e-9, atol=1e-12).y[0]
    data = Trajectories.from_arrays(t, states={"x": x}, derivatives={"x": -x + 0.8 * np.cos(4 * x)})
    table, paths = gap(amendment, data=data, free_runs=True)
    row = table.loc[("test", "free-run NRMSE", "x")]
    assert row["after"] < 0.3 * row["before"]
    assert paths["x"].holds == "90 % band: f"
    plain = gap(replace(amendment, discrepancy=None), data=data, free_runs=True)[0]
    assert plain.loc[("test", "free-run NRMSE", "x"), "after"] == pytest.approx(row["before"])


# The veto


def table(*rows):
    columns = ["data", "metric", "variable", "before", "after", "lower", "upper"]
    return pd.DataFrame(rows, columns=columns).set_index(columns[:3])


def test_data_at_rest_have_no_shares_and_no_say():
    t = np.linspace(0, 2, 41)
    still = Trajectories.from_arrays(
        t, states={"x": np.zeros(41)}, derivatives={"x": np.zeros(41)}, constant="keep"
    )  # fmt: skip
    table, _ = gap(with_cube([-1.0]), data=still, free_runs=True)
    assert table[["before", "after", "lower", "upper"]].isna().all(axis=None)
    trained = gap(with_cube([3.0]), data=decay(0.5), free_runs=True, part="train")[0]
    assert worsened(pd.concat([trained, table])) == worsened(trained) != ()


NEVER = np.nan


@pytest.mark.parametrize(
    ("before", "after", "lower", "upper", "worse"),
    [
        (0.10, 0.05, 0.04, 0.06, False),
        (0.10, 0.20, 0.15, 0.25, True),
        (0.10, 0.20, 0.09, 0.25, True),
        (0.10, 0.09, 0.12, 0.25, False),
        (0.10, 0.10 * (1 + 0.9 * CRITERIA.worse), 0.10 * (1 + 0.9 * CRITERIA.worse), 0.2, False),
        (0.0, 1e-7, 1e-7, 2e-7, False),
        (0.0, 0.01, 0.01, 0.02, True),
    ],
)
def test_a_free_run_is_worse_where_its_mean_path_is(before, after, lower, upper, worse):
    key = ("test", "free-run NRMSE", "y")
    assert worsened(table((*key, before, after, lower, upper))) == ((key,) if worse else ())


@pytest.mark.parametrize(
    ("before", "after", "upper", "worse"),
    [
        (5.0, 2.0, 3.0, True),
        (5.0, 4.0, 6.0, False),
        (5.0, 4.0, NEVER, False),
        (5.0, NEVER, NEVER, False),
        (NEVER, 5.0, 6.0, True),
        (NEVER, 5.0, NEVER, True),
        (NEVER, NEVER, NEVER, False),
    ],
)
def test_a_run_that_fails_sooner_is_worse(before, after, upper, worse):
    key = ("test", "time to failure", "all")
    assert worsened(table((*key, before, after, 1.0, upper))) == ((key,) if worse else ())


@pytest.mark.parametrize(
    ("train", "test", "left"),
    [
        (1.0, 1.0, False),
        (0.9, 0.99 * CRITERIA.misfit, False),
        (0.9, 1.01 * CRITERIA.misfit, True),
        # A model that leaves some of the training samples is not worse for leaving as much of others.
        (3.0, 4.0, False),
        (3.0, 5.0, True),
    ],
)
def test_held_out_samples_deny_what_explains_the_training_samples_alone(train, test, left):
    rows = [(part, MISFIT, "v", 20.0, after, after, after) for part, after in (("train", train), ("test", test))]
    assert left_over(table(*rows)) == ({"v": test} if left else {})
    assert left_over(table(rows[0])) == left_over(table(("test", "derivative NMSE", "v", 1.0, 0.9, 0.8, 1.0))) == {}


def test_held_out_free_runs_decide_and_training_ones_only_where_there_are_none():
    better, grew = (0.1, 0.05, 0.04, 0.06), (0.1, 0.3, 0.2, 0.4)
    train = [("train", "free-run NRMSE", "y", *grew), ("train", "free-run NRMSE", "v", *better)]
    rates = ("test", "derivative NMSE", "v", *grew)
    assert worsened(table(*train, rates)) == (("train", "free-run NRMSE", "y"),)
    assert worsened(table(*train, ("test", "free-run NRMSE", "y", *better))) == ()
    assert worsened(table(rates)) == ()
    assert worsened(table(*train)[:0]) == ()


def test_the_veto_is_asked_of_a_real_table(failing):
    assert worsened(failing[1]) == ()
    grown = gap(with_cube([3.0]), data=decay(0.5), free_runs=True)[0]
    assert ("test", "free-run NRMSE", "x") in worsened(grown) or ("test", "time to failure", "all") in worsened(grown)
