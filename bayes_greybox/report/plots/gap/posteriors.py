"""The posterior of each coefficient that was added, in its own unit."""

from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayes_greybox.report.plots import style
from bayes_greybox.report.words.formatting import estimate, level_text
from bayes_greybox.running.errors import InputError

_HISTOGRAM_BINS = 40


@dataclass(frozen=True)
class Coefficient:
    """A coefficient to draw.

    Attributes:
        name: Heading of the panel.
        term: The term it multiplies.
        mean: Posterior mean, in `unit`.
        sd: Posterior standard deviation, in `unit`.
        lower: Lower end of the credible interval.
        upper: Upper end of it.
        unit: Unit.
        draws: Posterior draws; None where there are none, and only the interval is drawn.
    """

    name: str
    term: str
    mean: float
    sd: float
    lower: float
    upper: float
    unit: str = ""
    draws: Float[np.ndarray, " n_draw"] | None = None


@mpl.rc_context(style.STYLE)
def plot_posteriors(
    coefficients: Sequence[Coefficient], *, level: float = 0.9, axes: Sequence[Axes] | np.ndarray | None = None
) -> Figure:
    """Draw a histogram of the draws of each coefficient, with its mean and interval, one panel each.

    Args:
        coefficients: Coefficients to draw.
        level: Probability that the intervals hold.
        axes: Axes to draw into, one a coefficient.

    Raises:
        InputError: There are no coefficients.
    """
    if not coefficients:
        raise InputError("No effect was added, so there is no coefficient to draw.")
    n = len(coefficients)
    panels = style.panels_of(axes, n, "one a coefficient", (5.4, 0.5 + 1.75 * n))
    for ax, item in zip(panels, coefficients, strict=True):
        _draw(ax, item)
    below = panels[-1]
    below.set_xlabel(f"{below.get_xlabel()}\ndot and bar: mean and {level_text(level)} interval")
    return style.figure_of(panels[0])


def _draw(ax: Axes, item: Coefficient) -> None:
    if item.draws is not None and np.ptp(item.draws) > 0:
        ax.hist(item.draws, bins=_HISTOGRAM_BINS, color=style.BLUE, alpha=0.35)
    low, high = ax.get_xlim() if item.draws is not None else (item.lower, item.upper)
    pad = 0.15 * (item.upper - item.lower) or 0.1 * abs(item.mean) or 1.0
    low, high = min(low, item.lower - pad), max(high, item.upper + pad)
    # Zero is shown where it is near enough not to flatten the rest.
    if 0 < low < high - low:
        low = -0.03 * high
    elif 0 > high > low - high:
        high = -0.03 * low
    ax.set_xlim(low, high)
    if low <= 0 <= high:
        ax.axvline(0.0, color=style.GREY, linewidth=0.8, zorder=0)
    base = ax.get_xaxis_transform()
    ax.plot([item.lower, item.upper], [0.07, 0.07], color=style.BLUE, linewidth=3.0, transform=base)
    ax.plot([item.mean], [0.07], "o", color=style.BLUE, markersize=7, markeredgecolor="white", transform=base)
    ax.set_yticks([])
    ax.spines["left"].set_visible(False)
    ax.xaxis.set_major_locator(MaxNLocator(5))
    ax.set_xlabel(style.with_unit(f"coefficient of {item.term}", item.unit))
    ax.set_title(style.plain(item.name))
    text = estimate(item.mean, item.sd)
    ax.text(1.0, 1.0, text, transform=ax.transAxes, ha="right", va="bottom", fontsize=9, color=style.DARK)
