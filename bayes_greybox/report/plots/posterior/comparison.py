"""Models side by side, and kernels."""

from collections.abc import Sequence
from textwrap import fill
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayes_greybox.report.plots import style
from bayes_greybox.report.words.formatting import pareto
from bayes_greybox.running.errors import InputError


@mpl.rc_context(style.STYLE)
def plot_comparison(table: pd.DataFrame, *, axes: Sequence[Axes] | np.ndarray | None = None) -> Figure:
    """Draw the expected log predictive density of each model, its difference to the best, and its weight.

    Models whose worst Pareto k is above the table's threshold are marked, because their elpd may be off.

    Args:
        table: indexed by model name, best first, with columns elpd, se, elpd_diff (≤ 0), diff_se, weight and
            worst_k; what `compare` puts into its `attrs` ("folds", "threshold") is shown.
        axes: axes to draw into: elpd, difference.

    Raises:
        InputError: a column is missing or the table is empty.
    """
    needed = ("elpd", "se", "elpd_diff", "diff_se", "weight", "worst_k")
    missing = [f"lacks the column {column!r}" for column in needed if column not in table.columns]
    if missing or table.empty:
        raise InputError(f"The comparison table {[*missing, 'has no rows'][0]}; pass the table that compare() returns.")
    longest = max(len(str(name)) for name in table.index)
    size = (8.4 + 0.06 * min(max(0, longest - 14), 40), 1.25 + 0.36 * len(table))
    left, right = style.panels_of(axes, 2, "elpd, difference", size, nrows=1, ncols=2, width_ratios=[1.25, 1.0])
    elpd, se, difference, diff_se, weight, worst_k = (table[name].to_numpy(dtype=float) for name in needed)
    # Above this Pareto shape the importance sampling behind an elpd is not to be trusted, however many draws there are
    # (Vehtari, Simpson, Gelman, Yao & Gabry 2024); with few draws the table names a smaller one.
    threshold = table.attrs.get("threshold", 0.7)
    suspect = worst_k > threshold
    rows = _draw_intervals(left, elpd, se, suspect, threshold)
    _draw_intervals(right, difference, diff_se, suspect, threshold)
    left.set_yticks(rows, [style.plain(str(name)) for name in table.index])
    # A longer line would run on below the other panel.
    left_out = f"\n{fill('leaving out ' + table.attrs['folds'], 40)}" if "folds" in table.attrs else ""
    left.set_xlabel(f"elpd ± se [nat]{left_out}\nhigher is better")
    right.set_yticks([])
    right.axvline(0.0, color=style.GREY, linewidth=0.8, zorder=0)
    right.set_xlabel("difference to the best ± se [nat]")
    beside = right.get_yaxis_transform()
    right.text(1.03, 1.0, "weight", transform=right.transAxes, va="bottom", fontsize=9, color=style.DARK)
    for row, (share, k, bad) in enumerate(zip(weight, worst_k, suspect, strict=True)):
        right.text(1.03, row, f"{share:.2f}", transform=beside, va="center", fontsize=9, color=style.DARK)
        if bad:
            warning = f"▲ worst k = {pareto(k)}"
            right.text(1.18, row, warning, transform=beside, va="center", fontsize=9, color=style.ORANGE)
    return style.figure_of(left)


def _draw_intervals(ax: Axes, value: np.ndarray, half: np.ndarray, suspect: np.ndarray, threshold: float) -> np.ndarray:
    rows = style.guide_rows(ax, len(value))
    ax.hlines(rows, value - half, value + half, color=style.BLUE, linewidth=2.0)
    ax.plot(value[~suspect], rows[~suspect], "o", color=style.BLUE, markersize=6, label="elpd")
    if suspect.any():
        label = f"worst k > {threshold:.2g}"
        ax.plot(value[suspect], rows[suspect], "^", color=style.ORANGE, markersize=8, label=label)
    ax.spines["left"].set_visible(False)
    ax.margins(x=0.1)
    ax.xaxis.set_major_locator(MaxNLocator(5))
    return rows


@mpl.rc_context(style.STYLE)
def plot_confounding(terms: pd.DataFrame, *, axes: Sequence[Axes] | np.ndarray | None = None) -> Figure:
    """Draw errors of posterior means with mean posterior SDs, and coverage of the 90 % intervals.

    Args:
        terms: indexed by (situation, kernel, measure, term), with columns bias, sd, projection, coverage and
            coverage_projection.
        axes: axes to draw into: bias and coverage for each situation in turn.
    """
    situations = terms.index.unique("situation")
    parts = [terms.xs(name, level="situation") for name in situations]
    panels = style.panels_of(
        axes, 2 * len(parts), "bias and coverage of each situation", (9.5, 1.4 + 0.24 * len(terms)),
        nrows=len(parts), ncols=2, width_ratios=[1.8, 1.0], height_ratios=[len(part) for part in parts],
    )  # fmt: skip
    diamond: dict[str, Any] = {"color": style.DARK, "markersize": 5, "markerfacecolor": "none"}
    for i, (name, part) in enumerate(zip(situations, parts, strict=True)):
        left, right = panels[2 * i : 2 * i + 2]
        labels = [
            f"{term}, {kernel}" + (f" ({measure})" if measure in ("empirical", "box") else "")
            for kernel, measure, term in part.index
        ]
        rows, _ = (style.guide_rows(ax, len(part)) for ax in (left, right))
        bias, sd = part["bias"].to_numpy(float), part["sd"].to_numpy(float)
        left.axvline(0.0, color=style.GREY, linewidth=0.8, zorder=0)
        left.hlines(rows, bias - sd, bias + sd, color=style.BLUE, linewidth=2.0)
        left.plot(bias, rows, "o", color=style.BLUE, markersize=5, label="mean error ± posterior sd")
        left.plot(part["projection"].to_numpy(float), rows, "D", label="projection of what is missing", **diamond)
        left.set_yticks(rows, [style.plain(label) for label in labels])
        left.set_title(style.plain(name))
        right.axvline(0.9, color=style.DARK, linewidth=1.0, linestyle=style.DASHED)
        right.plot(part["coverage"], rows, "o", color=style.ORANGE, markersize=5, label="covers the true coefficient")
        right.plot(part["coverage_projection"], rows, "D", label="covers it plus the projection", **diamond)
        right.set(yticks=[], xlim=(-0.04, 1.04))
    panels[-2].set_xlabel("coefficient less its true value")
    panels[-1].set_xlabel("share of 90 % intervals")
    handles = [*panels[0].get_legend_handles_labels()[0], *panels[1].get_legend_handles_labels()[0]]
    style.place_legend(panels[0], axes is None, handles, columns=2)
    return style.figure_of(panels[0])
