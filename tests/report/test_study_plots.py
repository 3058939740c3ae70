from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.collections import LineCollection, QuadMesh
from matplotlib.colors import to_hex
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.report.plots import (
    Coefficient,
    plot_free_run,
    plot_gap_curve,
    plot_gap_map,
    plot_gap_over_time,
    plot_hypotheses,
    plot_posteriors,
    plot_rounds,
)
from bayes_greybox.report.plots.gap.before_after import seen_as
from bayes_greybox.report.plots.studies import gap_map, study_figures
from bayes_greybox.report.plots.style import BLUE, SKY
from bayes_greybox.report.words.formatting import percent_text, probability_text
from bayes_greybox.running.errors import InputError


def texts(figure: Figure) -> list[str]:
    """Everything a reader can read; drawing first makes warnings of the layout fail the test."""
    figure.canvas.draw()
    return [spaced(text) for text in (found.get_text() for found in figure.findobj(plt.Text)) if text]


def spaced(text: str) -> str:
    """With spaces that break in place of those that do not."""
    return text.replace("\u00a0", " ")


def grid_and_maps() -> tuple:
    x, y = np.linspace(-1, 1, 21), np.linspace(-2, 2, 21)
    gap = x[:, None] ** 3 * np.ones(21)
    return (x, y), {"before": (gap, (np.abs(gap) > 0.1).astype(float)), "after": (0.01 * gap, np.zeros((21, 21)))}


def test_maps_that_are_compared_share_their_scale_and_outline_only_what_is_sure():
    grid, maps = grid_and_maps()
    figure = plot_gap_map(
        grid, maps, variables=("y", "v"), units=("m", "m/s"), threshold=0.1, unit="m/s**2",
        samples=np.random.default_rng(0).uniform(-1, 1, (50, 2)),
    )  # fmt: skip
    shown = texts(figure)
    meshes = figure.findobj(QuadMesh)
    limits = {mesh.get_clim() for mesh in meshes if mesh.get_array().size == 441}
    assert limits == {(-1.0, 1.0)}
    assert any("around P(|gap| > 0.1 m/s²) > 0.9" in text for text in shown)
    assert "gap [m/s²]" in shown and "y [m]" in shown
    alone = plot_gap_map(grid, {"after": maps["after"]}, variables=("y", "v"), units=("", ""), threshold=0.1, limit=1.0)
    assert not any("P(" in text for text in texts(alone))


def test_before_and_after_look_the_same_in_every_figure_and_apart_in_grey(study):
    looks: dict[str, set] = {"before": set(), "after": set()}
    for figure in study_figures(study).values():
        for line in figure.findobj(Line2D):
            if line.get_label() in looks and line.axes is not None:
                looks[line.get_label()].add((line.get_color(), line.get_linestyle()))
    ((before, dashed),), ((after, solid),) = looks["before"], looks["after"]
    assert before != after and dashed != solid
    # Maps of the two have the same colours around them, and none of these inside.
    figure = gap_map(study, "ydot", ("before", "after"))
    framed = [ax for ax in figure.axes if ax.get_title(loc="left")]
    assert [to_hex(ax.spines["left"].get_edgecolor()).upper() for ax in framed] == [before, after]
    assert ["Before" in ax.get_title(loc="left") for ax in framed] == [True, False]
    assert len({mesh.get_cmap().name for mesh in figure.findobj(QuadMesh)}) == 1


def test_a_state_without_a_sensor_is_not_called_measured():
    t = np.linspace(0.0, 1.0, 30)
    samples = Trajectories.from_arrays(t, states={"y": np.sin(t)})
    whole = replace(samples, states={"y": np.sin(t), "v": np.cos(t)}, samples=samples)
    assert [seen_as(whole, name) for name in ("y", "v")] == ["measured", "path through the samples"]
    shown = plot_free_run(t, np.cos(t), None, np.stack([np.cos(t)] * 3), state="v", seen_as=seen_as(whole, "v"))
    assert "path through the samples" in texts(shown) and "measured" not in texts(shown)


def test_a_gap_that_is_sure_everywhere_is_outlined_along_the_edge_of_the_data():
    (x, y), _ = grid_and_maps()
    inside = np.hypot(*np.meshgrid(x, y / 2, indexing="ij")) < 0.8
    sure = {"before": (np.ones((21, 21)), np.ones((21, 21)))}
    for seen in (inside, np.ones((21, 21), bool)):
        figure = plot_gap_map((x, y), sure, variables=("y", "v"), units=("", ""), threshold=0.1, inside=seen)
        assert any("around P(" in text for text in texts(figure))
        (lines,) = [found for found in figure.findobj(ContourSet) if not found.filled]
        (path,) = lines.get_paths()
        # Closed, and it goes round the data.
        np.testing.assert_array_equal(path.vertices[0], path.vertices[-1])
        rows = np.array(np.meshgrid(x, y, indexing="ij")).reshape(2, -1).T[seen.ravel()]
        assert path.contains_points(rows).all()


def test_what_lies_outside_the_data_does_not_set_the_scale():
    grid, maps = grid_and_maps()
    gap, probability = maps["before"]
    gap = gap.copy()
    gap[0] = 100.0
    inside = np.ones(gap.shape, bool)
    inside[0] = False
    figure = plot_gap_map(
        grid, {"before": (gap, probability)}, variables=("y", "v"), units=("", ""), threshold=0.1, inside=inside
    )
    assert "no data" in texts(figure)
    assert max(mesh.get_clim()[1] for mesh in figure.findobj(QuadMesh)) == 1.0


def test_a_gap_that_is_zero_everywhere_is_drawn():
    grid, _ = grid_and_maps()
    zero = np.zeros((21, 21))
    texts(plot_gap_map(grid, {"after": (zero, zero)}, variables=("y", "v"), units=("", ""), threshold=0.1))


def test_curves_are_thick_where_the_gap_is_sure():
    x = np.linspace(-1, 1, 50)
    sure = (np.abs(x) > 0.5).astype(float)
    figure = plot_gap_curve(
        x, x**3, 0.1 * x, sure, np.zeros(50), variable="y", variable_unit="m", title="Gap", threshold=0.1, samples=x
    )
    ax = figure.axes[0]
    thick = [found for found in ax.get_lines() if found.get_linewidth() > 3]
    assert [int(np.isfinite(found.get_ydata()).sum()) for found in thick] == [int(sure.sum()), 0]
    assert {"before", "after", "± threshold"} <= set(texts(figure))


def bands(values: np.ndarray, spread: float = 0.1) -> np.ndarray:
    return np.stack([values, values - spread, values + spread])


def test_the_gap_along_time_marks_the_stretches_that_are_sure():
    t = np.linspace(0, 10, 101)
    sure = ((t > 2) & (t < 4)) | (t > 9)
    figure = plot_gap_over_time(
        t, bands(np.sin(t)), bands(0 * t), equation="v", threshold=0.2, probability=sure.astype(float), time_unit="s"
    )
    (stretches,) = [c for c in figure.axes[0].collections if isinstance(c, LineCollection)]
    ends = np.array([segment[:, 0] for segment in stretches.get_segments()])
    np.testing.assert_allclose(ends, [[2.1, 3.9], [9.1, 10.0]])
    assert "time [s]" in texts(figure)


def test_stretches_that_nearly_touch_are_one():
    t = np.linspace(0, 10, 10001)
    figure = plot_gap_over_time(
        t, bands(np.sin(t)), bands(0 * t), equation="v", threshold=0.2, probability=(np.arange(10001) % 2).astype(float)
    )
    (stretches,) = [c for c in figure.axes[0].collections if isinstance(c, LineCollection)]
    assert len(stretches.get_segments()) == 1


@pytest.mark.parametrize("width", [9.0, 4.6])
@pytest.mark.parametrize("left", [0.0, 1.0])
def test_labels_of_the_legend_stay_inside_the_figure(width, left):
    t = np.linspace(0, 10, 101)
    figure = plot_gap_over_time(
        t, bands(np.sin(t)), bands(left * np.sin(t)), equation="v", threshold=0.2, probability=np.ones(101), width=width
    )
    figure.canvas.draw()
    box = figure.legends[0].get_window_extent()
    assert box.x1 <= figure.bbox.x1


def test_the_end_of_a_long_free_run_is_shown_close_up():
    t = np.linspace(0, 300, 6001)
    figure = plot_free_run(t, np.sin(t), bands(np.cos(t)), bands(np.sin(t)), state="y")
    whole, end = figure.axes[:2]
    measured = {ax: next(line for line in ax.get_lines() if line.get_label() == "measured") for ax in (whole, end)}
    np.testing.assert_array_equal(measured[end].get_xdata(), t[-200:])
    np.testing.assert_array_equal(measured[end].get_ydata(), np.sin(t[-200:]))
    assert measured[whole].get_xdata()[0] < 1
    assert "last 200 samples" in end.texts[0].get_text()
    # In axes of the caller's own there is one a run.
    short = plot_free_run(t, np.sin(t), bands(np.cos(t)), bands(np.sin(t)), state="y", axes=[whole])
    assert short is figure


def test_a_free_run_that_fails_ends_with_a_cross_and_does_not_set_the_scale():
    t = np.linspace(0, 10, 101)
    before = np.where(t < 5, np.exp(t), np.nan)
    figure = plot_free_run(t, np.sin(t), bands(before), bands(np.sin(t)), state="y", unit="m")
    ax = figure.axes[0]
    (cross,) = [found for found in ax.get_lines() if found.get_marker() == "X"]
    assert cross.get_xdata()[0] == pytest.approx(4.9)
    assert "fails" in texts(figure)
    assert ax.get_ylim()[1] < 2
    assert not any(found.get_marker() == "X" for found in healthy_run().axes[0].get_lines())


def healthy_run() -> Figure:
    t = np.linspace(0, 10, 101)
    return plot_free_run(t, np.sin(t), bands(np.cos(t)), bands(np.sin(t)), state="y")


HOLDS = "90 % band: coefficients, nonlinear parameters, f, start"


@pytest.mark.parametrize("width", [9.0, 6.5, 4.5])
def test_the_legend_says_what_the_band_holds_and_fits_into_the_figure(width):
    t = np.linspace(0, 10, 101)
    figure = plot_free_run(t, np.sin(t), bands(np.cos(t)), bands(np.sin(t)), state="y", holds=HOLDS, width=width)
    (legend,) = figure.legends
    labels = [text.get_text().replace("\n", " ") for text in legend.get_texts()]
    assert labels == ["measured", "before", "after", HOLDS]
    figure.canvas.draw()
    assert legend.get_window_extent().x1 <= figure.bbox.x1


def test_a_band_that_holds_nothing_has_no_label():
    assert [text.get_text() for text in healthy_run().legends[0].get_texts()] == ["measured", "before", "after"]


def test_the_free_run_of_a_fit_is_one_model():
    t = np.linspace(0, 10, 101)
    figure = plot_free_run(t, np.sin(t), None, bands(np.sin(t)), state="y", holds="90 % band: coefficients, f")
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["measured", "model", "90 % band: coefficients, f"]


def test_a_run_that_never_started_leaves_the_other_curves():
    t = np.linspace(0, 10, 101)
    figure = plot_free_run(t, np.sin(t), bands(np.full(101, np.nan)), bands(np.sin(t)), state="y")
    shown = texts(figure)
    assert "after" in shown and "before" not in shown


def test_runs_get_a_panel_each_with_their_name():
    t = np.tile(np.linspace(0, 10, 50), 2)
    figure = plot_free_run(
        t, np.sin(t), bands(np.cos(t)), bands(np.sin(t)), state="y", run=np.repeat([0, 1], 50), run_names=["a", "b"]
    )
    assert len(figure.axes) == 2 and {"a", "b"} <= set(texts(figure))


def test_bars_show_probability_share_left_and_who_was_chosen_or_tied():
    names = ["cubic spring", "sine", "unknown"]
    figure = plot_hypotheses(
        names, np.array([0.9, 0.1, 1e-9]), np.array([0.01, np.nan, 1.0]), chosen=names[:1], tied=names[1:2]
    )
    shown = texts(figure)
    assert {"cubic spring", "sine  (tied)", "unknown", "0.900", "< 0.001", "1.0 %", "–", "100 %"} <= set(shown)
    bars = figure.axes[0].patches[3:]
    np.testing.assert_allclose([bar.get_width() for bar in bars], [0.9, 0.1, 1e-9])
    assert [plt.matplotlib.colors.to_hex(bar.get_facecolor()).upper() for bar in bars[:2]] == [BLUE, SKY]


def test_texts_beside_the_bars_do_not_overlap():
    figure = plot_hypotheses(["a"] * 3, np.array([1.0, 1e-9, 0.5]), np.array([0.00001, 1.0, 0.5]))
    figure.canvas.draw()
    for row in range(3):
        beside = [t for t in figure.axes[0].texts if getattr(t, "xy", None) == (1, row)]
        texts_of_row = [t for t in beside if t.get_text() not in ("P", "gap left")]
        assert len(texts_of_row) == 2
        boxes = sorted((t.get_window_extent() for t in texts_of_row), key=lambda box: box.x0)
        assert all(left.x1 < right.x0 for left, right in zip(boxes, boxes[1:], strict=False))


def test_rounds_are_rungs_from_top_to_bottom():
    figure = plot_rounds(["as given", "1. add a"], np.array([1.0, 0.2]))
    assert figure.axes[0].yaxis_inverted()
    assert {"as given", "1. add a", "100 %", "20.0 %"} <= set(texts(figure))


def test_a_coefficient_is_drawn_with_its_draws_or_with_its_interval_alone():
    draws = np.random.default_rng(0).normal(-0.8, 0.01, 500)
    about = {"term": "y³", "mean": -0.8, "sd": 0.01, "lower": -0.82, "upper": -0.78, "unit": "1/m**2"}
    figure = plot_posteriors([Coefficient("spring", draws=draws, **about), Coefficient("alone", **about)])
    first, second = figure.axes
    assert len(first.patches) > 10 and not second.patches
    shown = texts(figure)
    assert "−0.800 ± 0.010" in shown and "coefficient of y³ [1/m²]" in shown
    still = plot_posteriors([Coefficient("still", draws=np.zeros(10), **{**about, "lower": 0.0, "upper": 0.0})])
    texts(still)
    with pytest.raises(InputError, match="No effect was added"):
        plot_posteriors([])


def test_probabilities_are_never_rounded_to_certainty():
    assert [spaced(probability_text(p)) for p in (1.0, 0.9995, 0.5, 1e-4, 0.0, np.nan)] == [
        "> 0.999", "> 0.999", "0.500", "< 0.001", "< 0.001", "–",
    ]  # fmt: skip
    shares = (1.0, 0.9997, 0.4567, 0.0123, 0.00456, 1e-6, 0.0, -0.5, np.nan)
    assert [spaced(percent_text(s)) for s in shares] == [
        "100 %", "> 99.9 %", "45.7 %", "1.2 %", "0.46 %", "< 0.01 %", "0 %", "−50.0 %", "–",
    ]  # fmt: skip


def test_a_gap_that_stayed_as_it_was_is_drawn_once():
    t = np.linspace(0, 10, 101)
    figure = plot_gap_over_time(
        t, bands(np.sin(t)), bands(np.sin(t)), equation="v", threshold=2.0, probability=np.zeros(101)
    )
    labels = {text.get_text() for text in figure.legends[0].get_texts()}
    # Nothing is in the legend that is not in the figure.
    assert labels == {"before and after", "± threshold"}
