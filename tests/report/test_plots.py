from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from matplotlib.collections import LineCollection, PolyCollection, QuadMesh
from matplotlib.figure import Figure

from bayes_greybox.criticism.discrepancy import DiscrepancyGrid
from bayes_greybox.report.plots import (
    plot_coefficients,
    plot_comparison,
    plot_discrepancy_over_states,
    plot_discrepancy_over_time,
    plot_predicted,
    plot_tradeoff,
    save_figures,
)
from bayes_greybox.report.plots.style import formula_or_name
from bayes_greybox.report.words.formatting import estimate, formula, unit_text
from bayes_greybox.running.errors import InputError


def texts(figure: Figure) -> list[str]:
    """Everything a reader can read; drawing first makes warnings of the layout fail the test."""
    figure.canvas.draw()
    found = [text.get_text() for text in figure.findobj(plt.Text)]
    return [text for text in found if text]


def line(ax, label: str):
    return next(found for found in ax.get_lines() if found.get_label() == label)


def coefficient_table(n_term: int = 6, equations: tuple[str, ...] = ("ydot",), **columns) -> pd.DataFrame:
    rng = np.random.default_rng(0)
    keys = [(name, f"y**{i}*ydot") for name in equations for i in range(n_term)]
    mean, sd = rng.normal(size=len(keys)), np.full(len(keys), 0.1)
    data = {"mean": mean, "sd": sd, "lower": mean - 0.16, "upper": mean + 0.16, **columns}
    return pd.DataFrame(data, index=pd.MultiIndex.from_tuples(keys, names=["equation", "term"]))


@pytest.mark.parametrize("n_term", [1, 6, 30])
def test_forest_has_a_point_an_interval_and_a_bar_for_each_term(n_term):
    table = coefficient_table(n_term, inclusion=np.linspace(0, 1, n_term), unit=["1/s**2"] * n_term)
    figure = plot_coefficients(table)
    forest, bars = figure.axes
    np.testing.assert_array_equal(line(forest, "mean").get_xdata(), table["mean"])
    intervals = [c for c in forest.collections if isinstance(c, LineCollection) and c.get_linewidth()[0] > 1]
    drawn = np.array([segment[:, 0] for segment in intervals[0].get_segments()])
    np.testing.assert_allclose(drawn, table[["lower", "upper"]])
    np.testing.assert_allclose([bar.get_width() for bar in bars.patches], table["inclusion"])
    assert bars.get_xlim() == (0, 1)
    shown = texts(figure)
    # The axis has the unit of all its terms.
    assert [text for text in shown if "1/s²" in text] == ["coefficient [1/s²]"]
    assert [label.get_text() for label in forest.get_yticklabels()] == [formula(term) for _, term in table.index]


def test_coefficients_of_different_units_have_an_axis_each():
    units = ["1/s**2", "1/m²/s²", "1/s^2", "1"]
    figure = plot_coefficients(coefficient_table(4, unit=units, inclusion=[0.9] * 4))
    forests = figure.axes[::2]
    assert [ax.get_xlabel() for ax in forests] == ["coefficient [1/s²]", "coefficient [1/(m²·s²)]", "coefficient"]
    assert [len(ax.get_yticks()) for ax in forests] == [2, 1, 1]
    titles = [ax.get_title(loc="left") for ax in forests]
    assert titles == ["Coefficients in the equation for ydot", "", ""]
    # The caller's axes hold what they were given for.
    given = plt.Figure().subplots(1, 2)
    plot_coefficients(coefficient_table(4, unit=units, inclusion=[0.9] * 4), axes=given)
    assert given[0].get_xlabel() == "coefficient, each in its own unit"
    assert any(text.endswith("1/(m²·s²)") for text in texts(given[0].figure))


def test_forest_reads_from_top_to_bottom_with_bars_beside_their_terms():
    table = coefficient_table(4, inclusion=[0.1, 0.2, 0.3, 0.4])
    forest, bars = plot_coefficients(table).axes
    assert forest.get_ylim() == bars.get_ylim()
    assert forest.yaxis_inverted()


def test_outside_rope_is_never_called_inclusion_and_no_column_means_no_bars():
    continuous = plot_coefficients(coefficient_table(outside_rope=[0.5] * 6))
    shown = " ".join(texts(continuous))
    assert "P(|θ| > ROPE)" in shown
    assert "included" not in shown and "inclusion" not in shown
    assert len(plot_coefficients(coefficient_table()).axes) == 1


def test_inclusion_goes_before_outside_rope_equation_by_equation():
    inclusion = [0.9, 0.1, np.nan, np.nan]
    table = coefficient_table(2, ("x", "y"), inclusion=inclusion, outside_rope=[1.0, 0.0, 0.7, 0.6])
    labels = [ax.get_xlabel() for ax in plot_coefficients(table).axes]
    assert labels[1] == "P(included)" and labels[3] == "P(|θ| > ROPE)"
    assert len(plot_coefficients(table, equation="y").axes) == 2


@pytest.mark.parametrize("nested", [True, False])
def test_truth_and_units_are_matched_by_equation_and_term(nested):
    table = coefficient_table(2, ("x", "y"))
    term = "y**1*ydot"
    truth = {"y": {term: 3.5}} if nested else {("y", term): 3.5}
    units = {"y": {term: "N*m"}} if nested else {("y", term): "N*m"}
    figure = plot_coefficients(table, truth=truth, units=units)
    first, other, second = figure.axes
    diamonds = line(second, "true value")
    np.testing.assert_array_equal(diamonds.get_xdata(), [3.5])
    assert diamonds.get_markerfacecolor() == "none"
    assert "true value" not in [found.get_label() for ax in (first, other) for found in ax.get_lines()]
    assert sum("[N·m]" in text for text in texts(figure)) == 1
    assert "true value" in texts(figure)
    assert second.get_xlim()[1] > 3.5


def test_what_was_stated_has_no_bar():
    table = coefficient_table(3, inclusion=[1.0, 1.0, 0.4], given=[True, True, False])
    _, bars = plot_coefficients(table).axes
    assert len(bars.patches) == 1 and [text.get_text() for text in bars.texts] == ["given", "given", "0.400"]
    learned = coefficient_table(3, outside_rope=[1.0, 1.0, 0.4], given=[True, False, False])
    assert len(plot_coefficients(learned).axes[1].patches) == 2


def test_axis_is_logarithmic_only_when_clear_coefficients_span_orders_of_magnitude():
    table = coefficient_table(3)
    table["mean"] = [1.0, -2.0, 1e-9]
    table["lower"], table["upper"] = [0.9, -2.1, -1e-3], [1.1, -1.9, 1e-3]
    assert plot_coefficients(table).axes[0].get_xscale() == "linear"
    table["mean"], table["lower"], table["upper"] = [1e4, -2.0, 0.0], [9e3, -2.1, 0.0], [1.1e4, -1.9, 0.0]
    figure = plot_coefficients(table)
    ax = figure.axes[0]
    assert ax.get_xscale() == "symlog"
    assert ax.get_xlim()[0] < -2.1 and ax.get_xlim()[1] > 1.1e4
    assert 0.0 in ax.get_xticks()
    assert plot_coefficients(table, scale="linear").axes[0].get_xscale() == "linear"
    # Neighbouring tick labels must not touch.
    figure.canvas.draw()
    boxes = [label.get_window_extent() for label in ax.get_xticklabels() if label.get_text()]
    assert all(left.x1 < right.x0 for left, right in zip(boxes, boxes[1:], strict=False))


def test_exact_zeros_everywhere_are_drawn_at_zero():
    table = coefficient_table(inclusion=[0.0] * 6)
    table[["mean", "sd", "lower", "upper"]] = 0.0
    for scale in ("auto", "symlog"):
        forest = plot_coefficients(table, scale=scale).axes[0]
        assert forest.get_xlim()[0] < 0 < forest.get_xlim()[1]
        assert "0 ± 0" in texts(forest.figure)


def test_forest_accepts_a_mean_outside_its_interval():
    table = coefficient_table(1)
    table[["mean", "sd", "lower", "upper"]] = [0.01, 0.1, 0.0, 0.0]
    assert "0.01 ± 0.10" in texts(plot_coefficients(table))


def test_formulas_are_drawn_where_they_can_be_and_names_elsewhere():
    table = coefficient_table(3, latex=[r"\dot{y}^{2}", r"\nosuchmacro{y}", None])
    labels = [label.get_text() for label in plot_coefficients(table).axes[0].get_yticklabels()]
    assert labels == [r"$\dot{y}^{2}$", "y¹·ydot", "y²·ydot"]
    assert formula_or_name("cost_$", None) == r"cost_\$"


def test_bad_tables_are_named():
    with pytest.raises(InputError, match="'sd'"):
        plot_coefficients(coefficient_table().drop(columns="sd"))
    with pytest.raises(InputError, match="no equation 'z'; it has ydot"):
        plot_coefficients(coefficient_table(), equation="z")
    with pytest.raises(InputError, match="no rows"):
        plot_coefficients(coefficient_table().iloc[:0])
    with pytest.raises(InputError, match="'weight'"):
        plot_comparison(comparison_table().drop(columns="weight"))
    with pytest.raises(InputError, match="needs 2 axes"):
        plot_comparison(comparison_table(), axes=[plt.Figure().subplots()])


@pytest.mark.parametrize(
    ("mean", "sd", "expected"),
    [
        (-1.0034, 0.0212, "−1.003 ± 0.021"),
        (-0.0004, 0.83, "0.00 ± 0.83"),
        (1234.5, 67.0, "1234 ± 67"),
        (0.0, 0.0, "0 ± 0"),
        (-4e-4, 2e-5, "(−4.00 ± 0.20)·10⁻⁴"),
        (1.0, 3e-9, "1 ± 3·10⁻⁹"),
    ],
)
def test_estimates_show_two_digits_of_their_uncertainty(mean, sd, expected):
    assert estimate(mean, sd) == expected
    assert estimate(mean, sd, "m/s**2") == expected + " m/s²"


@pytest.mark.parametrize(
    ("spelt", "written"),
    [
        *[(text, "m/s²") for text in ("m/s/s", "m/s**2", "m/s^2", "m s⁻²", "m*s**-2", "m/(s*s)", "m/s**(2)")],
        *[(text, "1/(m²·s²)") for text in ("1/m²/s²", "1/m**2/s**2", "1/(m**2*s**2)", "1/(m²·s²)", "m^-2 s^-2")],
        ("kg*m**2/s**-3", "kg·m²·s³"),
        ("m/(s*(kg/m))", "m²/(s·kg)"),
        ("m**0.5", "m^0.5"),
        ("m⁰⋅⁵", "m^0.5"),
        ("m per second", "m/second"),
        ("N*m", "N·m"),
        ("°C", "°C"),
        *[(text, "") for text in ("", "1", "dimensionless", "m/m")],
        # What is no product of powers stays as it is.
        *[(text, text) for text in ("10 m", "m/", "m**", "m**2**3", "a1/s", "m)", "(m", "m**(1/0)")],
    ],
)
def test_a_unit_is_written_one_way_however_it_is_spelt(spelt, written):
    assert unit_text(spelt) == written == unit_text(written)


def test_no_unit_is_no_text():
    assert unit_text(None) == ""


def test_a_discrepancy_that_is_small_beside_the_noise_is_pale():
    grid = map_grid()
    noise = 50.0 * max(float(np.abs(grid.mean).max()), float(grid.sd.max()))
    for ax in plot_discrepancy_over_states(grid, noise=noise).axes[:2]:
        mesh = next(c for c in ax.collections if isinstance(c, QuadMesh))
        assert mesh.get_clim()[1] == noise
        # Within a twentieth of white at the place where f is largest.
        colours = mesh.cmap(mesh.norm(mesh.get_array()[grid.inside.T.reshape(mesh.get_array().shape)]))
        assert np.min(colours[..., :3]) > 0.9


def curve_grid() -> DiscrepancyGrid:
    x = np.linspace(-1.5, 1.5, 41)
    mean, sd = 0.4 * x**3, 0.1 + 0.05 * np.abs(x)
    points = np.random.default_rng(0).uniform(-1, 1, (500, 1))
    interval = (mean - sd, mean + sd)
    inside = np.abs(x) <= 1
    return DiscrepancyGrid(
        "ydot", ("y",), (x,), mean, sd, *interval, inside, points, ("m",), "m/s**2", {"F_in": 0.5}, 0.9
    )


def map_grid(amplitude: float = 1.0) -> DiscrepancyGrid:
    x, y = np.linspace(-1.5, 1.5, 13), np.linspace(-3, 3, 17)
    mean = amplitude * (x[:, None] ** 3 + 0.2 * y[None, :])
    sd = np.full(mean.shape, 0.2)
    inside = np.hypot(x[:, None], y[None, :] / 2) < 1
    points = np.random.default_rng(0).normal(size=(20_000, 2))
    interval = (mean - 2 * sd, mean + 2 * sd)
    units = ("m", "m/s")
    return DiscrepancyGrid("ydot", ("y", "ydot"), (x, y), mean, sd, *interval, inside, points, units, "m/s**2", {}, 0.9)


def test_curve_shows_band_units_and_where_it_extrapolates():
    grid = curve_grid()
    figure = plot_discrepancy_over_states(grid)
    (ax,) = figure.axes
    assert ax.get_xlabel() == "y [m]" and ax.get_ylabel() == "discrepancy f [m/s²]"
    assert "held: F_in = 0.5" in ax.get_title(loc="left")
    solid = line(ax, "mean").get_ydata()
    np.testing.assert_array_equal(np.isfinite(solid), grid.inside)
    np.testing.assert_array_equal(line(ax, "mean, extrapolated").get_ydata(), grid.mean)
    assert len(line(ax, "data").get_xdata()) == 500
    assert {"90\u00a0% interval", "mean, extrapolated"} <= set(texts(figure))


def test_curve_without_units_and_with_support_everywhere():
    grid = replace(curve_grid(), units=("",), unit="", inside=np.ones(41, dtype=bool))
    figure = plot_discrepancy_over_states(grid, data=np.zeros((1, 1)))
    assert figure.axes[0].get_xlabel() == "y"
    assert "mean, extrapolated" not in texts(figure)


def test_map_is_symmetric_about_zero_over_the_data_and_not_transposed():
    grid = map_grid()
    figure = plot_discrepancy_over_states(grid)
    mean_mesh, sd_mesh = (next(c for c in ax.collections if isinstance(c, QuadMesh)) for ax in figure.axes[:2])
    low, high = mean_mesh.get_clim()
    assert low == -high and high == np.abs(grid.mean[grid.inside]).max()
    assert sd_mesh.get_clim()[0] == 0
    np.testing.assert_array_equal(np.asarray(mean_mesh.get_array()), grid.mean.T)
    shown = texts(figure)
    assert {"mean of f [m/s²]", "sd of f [m/s²]", "y [m]", "ydot [m/s]", "no data: extrapolated"} <= set(shown)
    assert any("excludes 0" in text for text in shown)
    assert len(line(figure.axes[0], "data").get_xdata()) <= 2000


@pytest.mark.parametrize("inside", ["some", "none", "all"])
def test_map_of_nothing_keeps_a_symmetric_range(inside):
    grid = map_grid(0.0)
    if inside != "some":
        grid = replace(grid, inside=np.full(grid.mean.shape, inside == "all"))
    figure = plot_discrepancy_over_states(grid)
    low, high = next(c for c in figure.axes[0].collections if isinstance(c, QuadMesh)).get_clim()
    assert low == -high < 0
    shown = texts(figure)
    assert not any("excludes 0" in text for text in shown)
    assert ("no data: extrapolated" in shown) == (inside != "all")


def test_three_variables_are_refused():
    with pytest.raises(InputError, match="spans 3"):
        plot_discrepancy_over_states(replace(map_grid(), variables=("a", "b", "c")))


def record(n_obs: int, n_run: int = 1):
    time = np.linspace(0, 100, n_obs)
    mean = np.sin(time)
    return time, mean, mean - 0.2, mean + 0.2, np.arange(n_obs) * n_run // n_obs


def test_time_panel_has_units_noise_lines_and_its_band():
    time, mean, lower, upper, _ = record(300)
    figure = plot_discrepancy_over_time(
        time,
        mean,
        lower,
        upper,
        equation="ydot",
        sigma=np.float64(0.3),
        time_unit="s",
        unit="m/s**2",
        level=0.5,
    )
    (ax,) = figure.axes
    assert ax.get_xlabel() == "time [s]" and ax.get_ylabel() == "discrepancy f [m/s²]"
    levels = sorted(float(found.get_ydata()[0]) for found in ax.get_lines() if len(found.get_ydata()) == 2)
    assert levels == [-0.3, 0.0, 0.3]
    np.testing.assert_array_equal(line(ax, "mean").get_ydata(), mean)
    assert {"50\u00a0% interval", "± noise sd σ"} <= set(texts(figure))


def test_long_record_is_thinned_without_losing_a_peak_or_narrowing_the_band():
    time, mean, lower, upper, _ = record(100_000)
    mean, upper = mean.copy(), upper.copy()
    mean[51_234], upper[70_001], lower[3] = 7.0, 9.0, -9.0
    ax = plot_discrepancy_over_time(time, mean, lower, upper, equation="ydot").axes[0]
    drawn = line(ax, "mean")
    assert len(drawn.get_xdata()) < 3000
    assert drawn.get_ydata().max() == 7.0 and drawn.get_ydata().min() == mean.min()
    assert drawn.get_xdata()[0] == 0 and drawn.get_xdata()[-1] == 100
    band = next(c for c in ax.collections if isinstance(c, PolyCollection)).get_paths()[0].vertices
    assert band[:, 1].max() == 9.0 and band[:, 1].min() == -9.0


@pytest.mark.parametrize(("n_run", "n_panel"), [(2, 2), (6, 6), (9, 6)])
def test_runs_get_a_panel_each_up_to_six(n_run, n_panel):
    time, mean, lower, upper, run = record(450, n_run)
    names = [f"run_{i}.csv" for i in range(n_run)]
    figure = plot_discrepancy_over_time(time, mean, lower, upper, run=run, run_names=names, equation="ydot")
    assert len(figure.axes) == n_panel
    for number, ax in enumerate(figure.axes):
        np.testing.assert_array_equal(line(ax, "mean").get_xdata(), time[run == number])
    shown = texts(figure)
    assert set(names[:n_panel]) <= set(shown)
    assert any(f"first 6 of {n_run} runs" in text for text in shown) == (n_run > 6)


@pytest.mark.parametrize("n_obs", [20, 2500, 100_000])
def test_predicted_shows_every_row_against_its_measurement(n_obs):
    time, mean, lower, upper, _ = record(n_obs)
    measured = mean + 0.05 * np.random.default_rng(0).normal(size=n_obs)
    figure = plot_predicted(
        time, measured, mean, lower, upper, equation="ydot", level=0.95, time_unit="s", unit="m/s**2"
    )
    along, across = figure.axes[:2]
    assert {"time [s]", "d(ydot)/dt [m/s²]", "measured d(ydot)/dt [m/s²]", "95\u00a0% interval", "1:1"} <= set(
        texts(figure)
    )
    assert across.get_xlim() == across.get_ylim() and across.get_aspect() == 1.0
    assert across.get_xlim()[0] < measured.min() and across.get_xlim()[1] > measured.max()
    if n_obs <= 2500:
        np.testing.assert_array_equal(line(across, "rows").get_xdata(), measured)
        np.testing.assert_array_equal(line(across, "rows").get_ydata(), mean)
    else:
        counts = next(c for c in across.collections if isinstance(c, PolyCollection)).get_array()
        assert counts is not None and counts.sum() == n_obs
    drawn = line(along, "measured").get_ydata()
    assert drawn.max() == measured.max() and drawn.min() == measured.min()


def test_predicted_draws_into_axes_of_the_caller():
    time, mean, lower, upper, run = record(200, 2)
    figure = Figure()
    axes = figure.subplots(1, 3)
    assert plot_predicted(time, mean, mean, lower, upper, run=run, equation="x", axes=axes) is figure
    assert len(figure.axes) == 3
    with pytest.raises(InputError, match="needs 3 axes"):
        plot_predicted(time, mean, mean, lower, upper, run=run, equation="x", axes=axes[:2])


def test_constant_measurements_still_have_a_range():
    time, flat = np.linspace(0, 1, 20), np.zeros(20)
    across = plot_predicted(time, flat, flat, flat - 1, flat + 1, equation="x").axes[1]
    assert across.get_xlim() == (-1.0, 1.0)


def widths(ax) -> tuple[float, float]:
    return float(np.ptp(ax.get_xlim())), float(np.ptp(ax.get_ylim()))


@pytest.mark.parametrize("spread", [0.1, 1e-12, 0.0])
def test_tradeoff_axes_share_their_scale_so_that_no_tradeoff_looks_like_none(spread):
    rng = np.random.default_rng(0)
    theta = -1 + 0.1 * rng.normal(size=2000)
    projection = spread * rng.normal(size=2000)
    figure = plot_tradeoff(theta, projection, term="y**3", equation="ydot", correlation=0.01, unit="1/s**2")
    pairs, above, right = figure.axes
    across, up = widths(pairs)
    assert across == pytest.approx(up) and across >= np.ptp(theta)
    assert pairs.get_xlabel() == "θ: coefficient of y**3 [1/s²]"
    assert pairs.get_ylabel() == "amount of y**3 that f imitates [1/s²]"
    assert above.get_xlim() == pairs.get_xlim() and right.get_ylim() == pairs.get_ylim()
    assert sum(bar.get_height() for bar in above.patches) == pytest.approx(2000)
    assert sum(bar.get_width() for bar in right.patches) == pytest.approx(2000)
    assert any("correlation 0.01" in text for text in texts(figure))


def test_contours_hold_the_stated_shares_of_a_narrow_ridge():
    rng = np.random.default_rng(0)
    theta = rng.normal(size=4000)
    projection = -theta + 0.05 * rng.normal(size=4000)
    pairs = plot_tradeoff(theta, projection, term="y", equation="y").axes[0]
    outer, inner = pairs.collections[0].get_paths()
    draws = np.stack([theta, projection], axis=1)
    # Smoothing widens an outline: the shares are 0.9 and 0.5 and somewhat more.
    assert 0.87 < outer.contains_points(draws).mean() < 0.97
    assert 0.45 < inner.contains_points(draws).mean() < 0.65


def test_exact_zeros_of_theta_are_told_apart():
    rng = np.random.default_rng(0)
    theta = np.where(rng.random(3000) < 0.6, 0.0, 0.5 + 0.1 * rng.normal(size=3000))
    figure = plot_tradeoff(theta, 0.5 - theta, term="y", equation="ydot", correlation=-1.0)
    pairs = figure.axes[0]
    assert len(line(pairs, "draws with θ exactly 0").get_xdata()) == (theta == 0).sum()
    assert len(line(pairs, "draws").get_xdata()) == (theta != 0).sum()


def test_all_zero_draws_are_drawn_and_their_correlation_is_not_invented():
    figure = plot_tradeoff(np.zeros(50), np.zeros(50), term="y", equation="x", correlation=float("nan"))
    shown = texts(figure)
    assert any("not defined" in text for text in shown) and not any("nan" in text for text in shown)
    assert not any("correlation" in t for t in texts(plot_tradeoff(np.ones(9), np.zeros(9), term="y", equation="x")))


def comparison_table() -> pd.DataFrame:
    return pd.DataFrame(
        {
            "elpd": [512.3, 510.1, 470.2],
            "se": [14.0, 14.5, 18.0],
            "elpd_diff": [0.0, -2.2, -42.1],
            "diff_se": [0.0, 1.9, 8.8],
            "p_eff": [5.0, 6.0, 8.0],
            "weight": [0.81, 0.19, 0.0],
            "worst_k": [0.41, 0.83, 0.3],
            "refits": [0, 2, 0],
        },
        index=pd.Index(["spike_and_slab", "laplace", "cost_in_$_a_$"], name="model"),
    )


@pytest.mark.parametrize("n_model", [1, 3])
def test_comparison_lists_models_best_first_with_weights_and_warnings(n_model):
    table = comparison_table().iloc[:n_model]
    figure = plot_comparison(table)
    left, right = figure.axes
    assert left.yaxis_inverted()
    assert [label.get_text() for label in left.get_yticklabels()][0] == "spike_and_slab"
    for ax, centre, half in ((left, "elpd", "se"), (right, "elpd_diff", "diff_se")):
        bars = [c for c in ax.collections if c.get_linewidth()[0] > 1][0].get_segments()
        expected = np.stack([table[centre] - table[half], table[centre] + table[half]], axis=1)
        np.testing.assert_allclose([segment[:, 0] for segment in bars], expected)
    shown = texts(figure)
    assert "0.81" in shown and "weight" in shown
    assert [text for text in shown if "worst k" in text] == (["▲ worst k = 0.83"] if n_model == 3 else [])
    assert "[nat]" in left.get_xlabel() and "[nat]" in right.get_xlabel()
    table.attrs |= {"folds": "7 blocks of up to 20 rows", "threshold": 0.35}
    figure = plot_comparison(table)
    assert "leaving out 7 blocks of up to 20 rows" in figure.axes[0].get_xlabel()
    # With few draws Pareto k must be smaller, and the first model's is not.
    assert "▲ worst k = 0.41" in texts(figure)


def test_figures_are_saved_whole_and_pyplot_keeps_none(tmp_path):
    before = plt.get_fignums()
    figures = {
        "coefficients": plot_coefficients(coefficient_table()),
        "models": plot_comparison(comparison_table()),
    }
    assert plt.get_fignums() == before
    paths = save_figures(figures, tmp_path / "new" / "figures")
    assert {name: path.name for name, path in paths.items()} == {
        "coefficients": "coefficients.png",
        "models": "models.png",
    }
    assert sorted(p.name for p in (tmp_path / "new" / "figures").iterdir()) == [
        "coefficients.png",
        "models.png",
    ]
    height, width = plt.imread(paths["models"]).shape[:2]
    np.testing.assert_allclose([width, height], figures["models"].get_size_inches() * 150, atol=1)


def test_a_failed_write_leaves_the_old_file_and_nothing_half_written(tmp_path, monkeypatch):
    figure = plot_comparison(comparison_table())
    (tmp_path / "models.png").write_bytes(b"old")

    def full_disk(path, **_):
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(figure, "savefig", full_disk)
    with pytest.raises(InputError, match="No space left on device"):
        save_figures({"models": figure}, tmp_path)
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("models.png", b"old")]


@pytest.mark.parametrize("name", ["", "../up", "a/b", ".hidden"])
def test_a_figure_name_that_is_no_file_name_is_refused(tmp_path, name):
    with pytest.raises(InputError, match="cannot name"):
        save_figures({name: Figure()}, tmp_path)


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="choose another folder"):
        save_figures({"a": Figure()}, tmp_path / "file" / "figures")
