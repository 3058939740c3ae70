"""Simulation-based calibration: differences of ECDFs from uniform with their band, and reliability of inclusion."""

from collections.abc import Mapping

import matplotlib as mpl
import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayes_greybox.report.plots import style
from bayes_greybox.report.words.formatting import number
from bayes_greybox.running.errors import InputError

_ACROSS = 4
"""Panels in a row."""


@mpl.rc_context(style.STYLE)
def plot_calibration(
    differences: pd.DataFrame,
    lower: Float[np.ndarray, " n_point"],
    upper: Float[np.ndarray, " n_point"],
    tests: pd.DataFrame,
    reliability: Mapping[str, pd.DataFrame] | None = None,
) -> Figure:
    """Draw a panel for each ranked quantity, then one for the inclusion probabilities of each equation.

    A curve that leaves the band, drawn in orange where its test failed, says that the posterior is wrong: an arch above
    zero that the draws are too large, one below that they are too small, an S that they are too wide or too narrow.

    Args:
        differences: ECDF of the ranks less that of uniform values, one column a quantity, indexed by where.
        lower: Least difference inside the simultaneous band.
        upper: Largest.
        tests: By quantity: adjusted p and passed.
        reliability: By equation: low, high, count, predicted and observed share of included terms, lower and upper.

    Raises:
        InputError: Nothing to draw, or a column is missing.
    """
    reliability = reliability or {}
    if differences.empty:
        raise InputError("There are no ranks to draw; pass what calibrate() returns.")
    for table in reliability.values():
        missing = {"predicted", "observed", "lower", "upper", "count"} - set(table.columns)
        if missing:
            raise InputError(f"The reliability table lacks the column {min(missing)!r}; pass that of calibrate().")
    n_panel = differences.shape[1] + len(reliability)
    down = -(-n_panel // _ACROSS)
    figure = style.new_figure(10.5, 0.4 + 2.0 * down)
    panels = figure.subplots(down, _ACROSS, squeeze=False).ravel()
    at = differences.index.to_numpy(float)
    reach = 1.15 * max(float(np.abs(differences.to_numpy()).max()), float(-lower.min()), float(upper.max()))
    for ax, name in zip(panels, differences, strict=False):
        passed, adjusted = bool(tests.loc[name, "passed"]), float(np.asarray(tests.loc[name, "adjusted"]))
        ax.fill_between(at, lower, upper, color=style.LIGHT, linewidth=0, label="band")
        ax.axhline(0.0, color=style.GREY, linewidth=0.6)
        ax.plot(
            at,
            differences[name].to_numpy(float),
            color=style.BLUE if passed else style.ORANGE,
            linewidth=1.3,
            label="ECDF",
        )
        ax.set_ylim(-reach, reach)
        _finish(ax, str(name), f"adjusted p = {number(adjusted, 2)}")
    for ax, (name, table) in zip(panels[differences.shape[1] :], reliability.items(), strict=False):
        _draw_reliability(ax, table)
        _finish(ax, f"{name}: P(included)", "")
    for ax in panels[n_panel:]:
        ax.set_visible(False)
    figure.supxlabel("rank of the truth / number of draws", fontsize=10)
    figure.supylabel("ECDF − uniform", fontsize=10)
    return figure


def _draw_reliability(ax: Axes, table: pd.DataFrame) -> None:
    shown = table.loc[table["count"].to_numpy() > 0]
    predicted, observed = shown["predicted"].to_numpy(float), shown["observed"].to_numpy(float)
    ax.plot([0, 1], [0, 1], color=style.GREY, linewidth=0.6)
    ax.vlines(predicted, shown["lower"].to_numpy(float), shown["upper"].to_numpy(float), color=style.LIGHT, linewidth=5)
    ax.plot(predicted, observed, "o", color=style.BLUE, markersize=4, label="observed share")
    ax.set_ylim(-0.05, 1.05)
    ax.set_xlabel("predicted", fontsize=9)
    ax.set_ylabel("observed", fontsize=9)


def _finish(ax: Axes, title: str, note: str) -> None:
    ax.set_title(style.plain(title), fontsize=9)
    ax.set_xlim(0, 1)
    ax.set_xticks([0, 0.5, 1], ["0", "½", "1"])
    ax.yaxis.set_major_locator(MaxNLocator(4))
    ax.text(0.98, 0.04, note, transform=ax.transAxes, ha="right", va="bottom", fontsize=8, color=style.DARK)
