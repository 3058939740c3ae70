"""The confounding study: bias and coverage of coefficients under each kernel."""

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayes_greybox.report.plots import style


@mpl.rc_context(style.STYLE)
def plot_confounding(terms: pd.DataFrame, *, axes: Sequence[Axes] | np.ndarray | None = None) -> Figure:
    """Draw errors of posterior means with mean posterior SDs, and coverage of the 90 % intervals.

    Args:
        terms: indexed by (situation, kernel, measure, term), with columns bias, sd, projection, coverage and
            coverage_projection.
        axes: axes to draw into: bias and coverage for each situation in turn.
    """
    situations = list(dict.fromkeys(terms.index.get_level_values("situation")))
    parts = [terms.xs(name, level="situation") for name in situations]
    panels = style.panels_of(
        axes, 2 * len(parts), "bias and coverage of each situation", (9.5, 1.4 + 0.24 * len(terms)),
        nrows=len(parts), ncols=2, width_ratios=[1.8, 1.0], height_ratios=[len(part) for part in parts],
    )  # fmt: skip
    for i, (name, part) in enumerate(zip(situations, parts, strict=True)):
        left, right = panels[2 * i : 2 * i + 2]
        rows = np.arange(len(part))
        labels = [
            f"{term}, {kernel}" + (f" ({measure})" if measure in ("empirical", "box") else "")
            for kernel, measure, term in part.index
        ]
        for ax in (left, right):
            ax.hlines(rows, 0, 1, transform=ax.get_yaxis_transform(), color=style.LIGHT, linewidth=0.6, zorder=0)
            ax.set_ylim(len(rows) - 0.5, -0.5)
            ax.tick_params(axis="y", length=0)
        bias, sd = part["bias"].to_numpy(float), part["sd"].to_numpy(float)
        left.axvline(0.0, color=style.GREY, linewidth=0.8, zorder=0)
        left.hlines(rows, bias - sd, bias + sd, color=style.BLUE, linewidth=2.0)
        left.plot(bias, rows, "o", color=style.BLUE, markersize=5, label="mean error ± posterior sd")
        projection = part["projection"].to_numpy(float)
        left.plot(
            projection,
            rows,
            "D",
            color=style.DARK,
            markersize=5,
            markerfacecolor="none",
            label="projection of what is missing",
        )
        left.set_yticks(rows, [style.plain(label) for label in labels])
        left.set_title(style.plain(name))
        right.axvline(0.9, color=style.DARK, linewidth=1.0, linestyle=(0, (4, 3)))
        right.plot(part["coverage"], rows, "o", color=style.ORANGE, markersize=5, label="covers the true coefficient")
        right.plot(
            part["coverage_projection"],
            rows,
            "D",
            color=style.DARK,
            markersize=5,
            markerfacecolor="none",
            label="covers it plus the projection",
        )
        right.set_yticks([])
        right.set_xlim(-0.04, 1.04)
    panels[-2].set_xlabel("coefficient less its true value")
    panels[-1].set_xlabel("share of 90 % intervals")
    handles = [*panels[0].get_legend_handles_labels()[0], *panels[1].get_legend_handles_labels()[0]]
    style.place_legend(panels[0], axes is None, handles, columns=2)
    return style.figure_of(panels[0])
