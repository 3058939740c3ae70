"""Hypotheses, in bars and in what each expects of an experiment, and the coefficients that were added."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayes_greybox.report.plots import style
from bayes_greybox.report.words.formatting import estimate, level_text, probability_text, share_text
from bayes_greybox.running.errors import InputError


@mpl.rc_context(style.STYLE)
def plot_hypotheses(
    names: Sequence[str],
    probability: Float[np.ndarray, " n_hypothesis"],
    share_left: Float[np.ndarray, " n_hypothesis"],
    *,
    chosen: Sequence[str] = (),
    tied: Sequence[str] = (),
    title: str = "What could close the gap",
    axes: Sequence[Axes] | np.ndarray | None = None,
) -> Figure:
    """Draw the probability of each hypothesis, and the share of the gap that it leaves open.

    Args:
        names: the hypotheses, best first.
        probability: probability of each; they sum to one over all hypotheses.
        share_left: share of the gap that f has to carry under each.
        chosen: names that the study settled on: drawn dark.
        tied: names that these data do not tell from a chosen one: drawn pale and marked.
        title: title of the bars.
        axes: one axes to draw into.
    """
    colours = [style.BLUE if name in chosen else style.SKY if name in tied else style.LIGHT for name in names]
    labels = [f"{name}  (tied)" if name in tied else name for name in names]
    columns = {
        "P": [probability_text(value) for value in probability],
        "gap left": [share_text(value) for value in share_left],
    }
    return _bars(labels, probability, colours, columns, title, "probability of each by itself", axes)


@mpl.rc_context(style.STYLE)
def plot_rounds(
    labels: Sequence[str],
    share_left: Float[np.ndarray, " n_round"],
    *,
    title: str = "Likeliest sets of each size",
    axes: Sequence[Axes] | np.ndarray | None = None,
) -> Figure:
    """Draw the share of the gap that the likeliest set with no effect, with one, with two leaves.

    Args:
        labels: names of the sets, in order.
        share_left: share of the gap that it leaves.
        title: title of the bars.
        axes: one axes to draw into.
    """
    columns = {"left by columns": [share_text(value) for value in share_left]}
    return _bars(labels, share_left, [style.BLUE] * len(labels), columns, title, "share of the gap left", axes)


def _bars(
    labels: Sequence[str],
    length: np.ndarray,
    colours: Sequence[str],
    columns: dict[str, list[str]],
    title: str,
    quantity: str,
    axes: Sequence[Axes] | np.ndarray | None,
) -> Figure:
    """Draw bars from 0 to 1, each below its label, with columns of text at the right."""
    (ax,) = style.panels_of(axes, 1, "the bars", (5.4, 0.95 + 0.44 * len(labels)))
    rows = np.arange(len(labels))
    shown = np.clip(np.nan_to_num(length), 0.0, 1.0)
    ax.barh(rows, 1.0, height=0.3, color="#F3F3F3")
    ax.barh(rows, shown, height=0.3, color=colours, edgecolor=style.GREY, linewidth=[0.6 * (s > 0) for s in shown])
    for row, label in enumerate(labels):
        ax.text(0.0, row - 0.24, style.plain(label), va="bottom", fontsize=9.5, color=style.DARK)
    right, at = ax.get_yaxis_transform(), 0.0
    for heading, texts in columns.items():
        # Points between the columns, and the width of a character in them.
        at += 8.0 + 6.0 * max(len(text) for text in (heading, *texts))
        beside: dict[str, Any] = {"xytext": (at, 0), "textcoords": "offset points", "ha": "right"}
        ax.annotate(heading, (1, 1), xycoords="axes fraction", va="bottom", fontsize=9, color=style.GREY, **beside)
        for row, text in enumerate(texts):
            ax.annotate(text, (1, row), xycoords=right, va="center", fontsize=9.5, **beside)
    ax.set(xlim=(0, 1), ylim=(len(labels) - 0.6, -0.72), yticks=[], xlabel=quantity, title=title)
    ax.set_xticks([0, 0.25, 0.5, 0.75, 1], ["0", "0.25", "0.5", "0.75", "1"])
    ax.spines["left"].set_visible(False)
    return style.figure_of(ax)


LOOKS = ((style.BLUE, "-"), (style.ORANGE, (0, (5, 2))), (style.SKY, (0, (1, 1))), (style.DARK, (0, (5, 1.5, 1, 1.5))))
"""Colour and line of each explanation, likeliest first; more of them are not drawn."""


@mpl.rc_context(style.STYLE)
def plot_responses(
    time: Float[np.ndarray, " n_row"],
    bands: Float[np.ndarray, "n_explanation 3 n_row"],
    *,
    names: Sequence[str],
    probability: Float[np.ndarray, " n_explanation"],
    noise: float,
    channel: str,
    unit: str | None = None,
    time_unit: str | None = None,
    width: float = 9.0,
    axes: Sequence[Axes] | np.ndarray | None = None,
) -> Figure:
    """Draw bands of one sensor under each explanation, and their difference from the likeliest one's median.

    Args:
        time: times of the rows, in `time_unit`.
        bands: lower end, median and upper end for each explanation, without noise, in `unit`.
        names: explanations, likeliest first; the first four are drawn.
        probability: probability of each.
        noise: standard deviation of the sensor.
        channel: measured quantity.
        unit: unit of the channel.
        time_unit: unit of time.
        width: width of the figure in inches.
        axes: two axes to draw into: the response, and the difference.
    """
    order = "the response, then the difference"
    above, below = style.panels_of(axes, 2, order, (width, 5.4), sharex=True, height_ratios=[1.2, 1.0])
    centre = bands[0, 1]
    below.axhspan(-1, 1, color=style.LIGHT, linewidth=0, label="noise, ±1 SD")
    for (colour, line), name, p, band in zip(LOOKS, names, probability, bands, strict=False):
        label = f"{style.plain(name)} ({p:.2f})"
        for ax, (low, middle, high) in ((above, band), (below, (band - centre) / noise)):
            ax.fill_between(time, low, high, color=colour, alpha=0.22, linewidth=0)
            ax.plot(time, middle, color=colour, linestyle=line, linewidth=1.4, label=label if ax is above else None)
    if len(names) > len(LOOKS):
        above.plot([], [], " ", label=f"{len(names) - len(LOOKS)} less likely ones are not drawn")
    above.set(title=f"{style.plain(channel)} under each explanation", ylabel=style.with_unit(channel, unit))
    below.set(title="Difference from the likeliest, over the noise", ylabel="difference [SD]")
    below.set_xlabel(style.with_unit("time", time_unit))
    below.axhline(0.0, color=style.GREY, linewidth=0.8, zorder=0.5)
    for ax in (above, below):
        ax.margins(x=0.01)
    handles = [*above.get_legend_handles_labels()[0], *below.get_legend_handles_labels()[0]]
    # Names of several effects are long: in a narrow figure they stand one below the other.
    style.place_legend(above, axes is None, handles, columns=max(1, min(len(handles), int(width // 3))))
    return style.figure_of(above)


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
        ax.hist(item.draws, bins=40, color=style.BLUE, alpha=0.35)
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
    ax.set(xlabel=style.with_unit(f"coefficient of {item.term}", item.unit), title=style.plain(item.name))
    text = estimate(item.mean, item.sd)
    ax.text(1.0, 1.0, text, transform=ax.transAxes, ha="right", va="bottom", fontsize=9, color=style.DARK)
