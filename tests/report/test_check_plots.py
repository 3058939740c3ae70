"""Figures of the checks: what they draw is what they were given."""

import numpy as np
import pandas as pd
import pytest

from bayes_greybox.report.plots import plot_autocorrelation, plot_loo_pit, plot_predictive, plot_sensitivity


def line(ax, label):
    return next(found for found in ax.get_lines() if found.get_label() == label)


def test_loo_pit_curve_starts_and_ends_at_zero_and_jumps_by_one_row():
    value = np.array([0.2, 0.9, 0.6])
    (ax,) = plot_loo_pit(value, equation="v", band=0.4, p=0.3).axes
    curve = line(ax, "LOO-PIT")
    u, difference = curve.get_xdata(), curve.get_ydata()
    assert difference[0] == 0 and difference[-1] == pytest.approx(0)
    np.testing.assert_allclose(u, [0, 0.2, 0.2, 0.6, 0.6, 0.9, 0.9, 1])
    np.testing.assert_allclose(difference[2::2] - difference[1:-1:2][: len(difference[2::2])], 1 / 3)


def test_lags_that_stand_out_are_marked():
    lag = np.arange(1, 6)
    values = np.array([0.5, 0.1, 0.0, -0.1, 0.2])
    (ax,) = plot_autocorrelation(lag, values, np.full(5, 0.3), equation="v", p=0.001, standing_out=(1,)).axes
    assert line(ax, "standing out").get_xdata().tolist() == [1]
    assert line(ax, "autocorrelation").get_xdata().tolist() == [2, 3, 4, 5]
    assert ax.get_xlabel() == "lag [rows]"


def test_sensitivities_stand_at_their_values():
    index = pd.MultiIndex.from_tuples([("v", "y"), ("v", "P(y)")], names=["equation", "quantity"])
    table = pd.DataFrame({"prior": [0.01, 0.3], "likelihood": [0.2, 0.0]}, index=index)
    figure = plot_sensitivity(table, threshold=0.05)
    figure.canvas.draw()
    (ax,) = figure.axes
    np.testing.assert_array_equal(line(ax, "to the prior").get_xdata(), table["prior"])
    assert [label.get_text() for label in ax.get_yticklabels()] == ["y", "P(y)"]


def test_predictive_draws_stand_beside_the_measured_rows():
    rng = np.random.default_rng(0)
    measured = rng.standard_normal(30)
    figure = plot_predictive(
        measured, rng.standard_normal((200, 30)), 50 * rng.standard_cauchy((200, 30)), equation="v"
    )
    figure.canvas.draw()
    left, right = figure.axes
    np.testing.assert_array_equal(line(right, "measured").get_xdata(), np.sort(measured))
    assert left.get_xlim()[0] <= measured.min() and left.get_xlim()[1] >= measured.max()
    assert len(right.get_lines()) == 61
    # One of many pale curves is not to be seen alone.
    predicted = figure.legends[0].legend_handles[0]
    assert predicted.get_label() == "predicted" and predicted.get_alpha() == 1.0
