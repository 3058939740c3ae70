"""One coefficient in every asset that has it, beside their mean."""

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from bayes_greybox.discovery.answer.interval import INTERVAL_REACH
from bayes_greybox.discovery.fleet.pooling import Pooled
from bayes_greybox.report.plots import style

MOST_ASSETS = 60
"""Largest number of assets in one figure; of more, as many from the smallest to the largest."""

LONGEST_ASSET_NAME = 28
"""Letters of a name in a figure."""


@mpl.rc_context(style.STYLE)
def plot_pooled(
    names: Sequence[str], mean: Sequence[float], sd: Sequence[float], whole: Pooled, label: str, width: float = 6.4
) -> Figure:
    """Draw a forest of one coefficient: each asset's own estimate, its pooled one, and their mean.

    Args:
        names: Names of the assets.
        mean: Posterior mean in each.
        sd: Its standard deviation.
        whole: Their pooling.
        label: Label of the axis, with the unit.
        width: Width in inches.
    """
    order = np.argsort(mean)
    order = order[np.unique(np.linspace(0, len(order) - 1, min(MOST_ASSETS, len(order))).round().astype(int))]
    shown = [
        name if len(name) <= LONGEST_ASSET_NAME else f"{name[: LONGEST_ASSET_NAME - 1]}…" for name in map(str, names)
    ]
    figure = style.new_figure(width, 1.3 + 0.24 * len(order))
    ax = figure.add_subplot()
    place = np.arange(len(order))
    ax.axvspan(whole.lower, whole.upper, color=style.LIGHT, alpha=0.6, lw=0, label="mean, 90 %")
    means, sds = (np.asarray(each)[order] for each in (mean, sd))
    pooled, pooled_sds = (np.asarray(each)[order] for each in (whole.each, whole.each_sd))
    own_bars, pooled_bars = INTERVAL_REACH * sds, INTERVAL_REACH * pooled_sds
    ax.errorbar(means, place + 0.13, xerr=own_bars, fmt="o", ms=3.5, color=style.BLUE, label="its own data")
    ax.errorbar(pooled, place - 0.13, xerr=pooled_bars, fmt="s", ms=3, color=style.DARK, label="pooled")
    ax.set_yticks(place, [style.plain(shown[int(i)]) for i in order])
    ax.set_ylim(-0.7, len(order) - 0.3)
    ax.set_xlabel(style.plain(label))
    figure.legend(loc="outside lower left", ncols=3)
    return figure
