"""Bars with their labels above them: the ranking of hypotheses, and the likeliest sets of each size."""

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayes_greybox.report.plots import style
from bayes_greybox.report.words.formatting import probability_text, share_text

# Points between the columns of text, and the width of a character in them.
_COLUMN_SPACE, _CHARACTER = 8.0, 6.0


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
    return _bars(labels, probability, colours, columns, title, "probability", axes)


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
        at += _COLUMN_SPACE + _CHARACTER * max(len(text) for text in (heading, *texts))
        beside: dict[str, Any] = {"xytext": (at, 0), "textcoords": "offset points", "ha": "right"}
        ax.annotate(heading, (1, 1), xycoords="axes fraction", va="bottom", fontsize=9, color=style.GREY, **beside)
        for row, text in enumerate(texts):
            ax.annotate(text, (1, row), xycoords=right, va="center", fontsize=9.5, **beside)
    ax.set_xlim(0, 1)
    ax.set_ylim(len(labels) - 0.6, -0.72)
    ax.set_xticks([0, 0.25, 0.5, 0.75, 1], ["0", "0.25", "0.5", "0.75", "1"])
    ax.set_yticks([])
    ax.set_xlabel(quantity)
    ax.set_title(title)
    ax.spines["left"].set_visible(False)
    return style.figure_of(ax)
