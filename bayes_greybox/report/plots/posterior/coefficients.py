"""Forest plot of the coefficients, with the probability that each one matters."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator

from bayes_greybox.report.plots import style
from bayes_greybox.report.words.formatting import PROBABILITIES, estimate, formula, number, probability_text, unit_text
from bayes_greybox.running.errors import InputError


@mpl.rc_context(style.STYLE)
def plot_coefficients(
    table: pd.DataFrame,
    *,
    equation: str | None = None,
    truth: Mapping[Any, Any] | None = None,
    units: Mapping[Any, Any] | None = None,
    scale: Literal["auto", "linear", "symlog"] = "auto",
    axes: Sequence[Axes] | np.ndarray | None = None,
) -> Figure:
    """Draw mean and interval of each coefficient, its value in figures, and the probability that it matters.

    One row of panels for each unit of an equation, as numbers of different units have no common axis. The bars show
    `inclusion` where the table has it, and otherwise `outside_rope` under its own name; without either column there
    are no bars.

    Args:
        table: indexed (equation, term) with columns mean, sd, lower, upper and, where known, inclusion or
            outside_rope (probabilities), given (true where the coefficient was given), unit (text) and latex (text).
        equation: draw this equation only.
        truth: true coefficients, `{(equation, term): value}` or `{equation: {term: value}}`; terms without
            one get no marker.
        units: units of the coefficients, keyed as `truth`; they go before the table's own column.
        scale: axis of the coefficients; `auto` is linear unless the clear ones span orders of magnitude.
        axes: axes to draw into, in reading order: per equation the coefficients, whatever their units, and, where
            there are probabilities, the bars.

    Raises:
        InputError: a column is missing, the table is empty, or it does not hold the equation.
    """
    names = _equations(table, equation)
    blocks: list[Any] = [table.xs(name, level=0) for name in names]
    units_of = {
        name: _texts(block, "unit") | _for_equation(units, name) for name, block in zip(names, blocks, strict=True)
    }
    if axes is None:
        parts = [part for pair in zip(names, blocks, strict=True) for part in _by_unit(*pair, units_of[pair[0]])]
        names, blocks = [name for name, _ in parts], [block for _, block in parts]
    sources = [next((c for c in PROBABILITIES if c in block and not block[c].isna().any()), None) for block in blocks]
    with_bars = any(source is not None for source in sources)
    if axes is None:
        pairs = _own_axes(blocks, with_bars)
    elif with_bars:
        flat = style.given_axes(axes, 2 * len(names), "coefficients and bars of each equation")
        pairs = list(zip(flat[::2], flat[1::2], strict=True))
    else:
        pairs = [(ax, None) for ax in style.given_axes(axes, len(names), "one an equation")]
    for k, (name, block, source, (forest, bars)) in enumerate(zip(names, blocks, sources, pairs, strict=True)):
        _draw_forest(forest, block, _for_equation(truth, name), units_of[name], scale)
        if k == 0 or names[k - 1] != name:
            forest.set_title(f"Coefficients in the equation for {style.plain(name)}")
        if bars is not None:
            _draw_bars(bars, block, source)
            if k + 1 < len(names) and names[k + 1] == name:
                # The axis below says it for all units of the equation.
                bars.set_xlabel("")
                bars.set_xticklabels([])
    marks = [mark for forest, _ in pairs for mark in forest.get_lines() if mark.get_label() == "true value"]
    if marks:
        style.place_legend(pairs[0][0], axes is None, marks[:1])
    return style.figure_of(pairs[0][0])


def _equations(table: pd.DataFrame, equation: str | None) -> list[str]:
    missing = [column for column in ("mean", "sd", "lower", "upper") if column not in table.columns]
    if missing:
        raise InputError(f"The coefficient table lacks the column {missing[0]!r}; pass inclusion(fit).")
    names = list(table.index.unique(0))
    if equation is not None and equation not in names:
        raise InputError(f"The coefficient table has no equation {equation!r}; it has {', '.join(names)}.")
    if not names:
        raise InputError("The coefficient table has no rows, so there is nothing to draw.")
    return names if equation is None else [equation]


def _by_unit(name: str, block: pd.DataFrame, units: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Return an equation's terms by the unit of their coefficients, in the order in which the units come."""
    of = [unit_text(units.get(str(term))) for term in block.index]
    return [(name, block[[other == unit for other in of]]) for unit in dict.fromkeys(of)]


def _own_axes(blocks: list[pd.DataFrame], with_bars: bool) -> list[tuple[Axes, Axes | None]]:
    heights = [0.29 * len(block) + 0.8 for block in blocks]
    longest = max(len(str(term)) for block in blocks for term in block.index)
    width = min(8.0 + 0.05 * max(0, longest - 12), 11.0) + (0.0 if with_bars else -1.6)
    figure = style.new_figure(width, sum(heights) + 0.35)
    columns, ratios = (2, [3.0, 1.1]) if with_bars else (1, [1.0])
    grid = figure.subplots(len(blocks), columns, squeeze=False, height_ratios=heights, width_ratios=ratios)
    return [(row[0], row[1] if with_bars else None) for row in grid]


def _for_equation(values: Mapping[Any, Any] | None, equation: str) -> dict[str, Any]:
    values = values or {}
    if isinstance(values.get(equation), Mapping):
        return dict(values[equation])
    return {key[1]: value for key, value in values.items() if isinstance(key, tuple) and key[0] == equation}


def _texts(block: pd.DataFrame, name: str) -> dict[str, Any]:
    column: Any = block.get(name, {})
    return {str(term): value for term, value in column.items() if isinstance(value, str)}


def _draw_forest(ax: Axes, block: pd.DataFrame, truth: dict[str, Any], units: dict[str, Any], scale: str) -> None:
    terms = [str(term) for term in block.index]
    latex = _texts(block, "latex")
    lower, upper, mean = (block[name].to_numpy(dtype=float) for name in ("lower", "upper", "mean"))
    true = np.asarray([float(truth.get(term, np.nan)) for term in terms])
    threshold = _linear_range(mean, lower, upper, true) if scale != "linear" else None
    if threshold is None and scale == "symlog":
        threshold = _power_of_ten(0.01 * float(np.max(np.abs([mean, lower, upper]))) or 1.0)
    values = np.concatenate([mean, lower, upper, true[np.isfinite(true)], [0.0]])
    shown = {unit_text(units.get(term)) for term in terms}
    about = style.with_unit("coefficient", shown.pop()) if len(shown) == 1 else "coefficient, each in its own unit"
    label = _set_scale(ax, float(values.min()), float(values.max()), threshold, about)
    several = "each in its own" in about
    ax.axvline(0.0, color=style.GREY, linewidth=0.8, zorder=0)
    rows = style.guide_rows(ax, len(terms))
    ax.hlines(rows, lower, upper, color=style.BLUE, linewidth=2.2, zorder=2)
    ax.plot(mean, rows, "o", color=style.BLUE, markersize=5.5, zorder=3, label="mean")
    if np.isfinite(true).any():
        hollow: dict[str, Any] = {"markersize": 9, "markerfacecolor": "none", "markeredgecolor": style.ORANGE}
        ax.plot(true, rows, "D", zorder=4, label="true value", **hollow)
    for row, (term, value, sd) in enumerate(zip(terms, mean, block["sd"], strict=True)):
        text = style.plain(estimate(value, sd, units.get(term) if several else ""))
        ax.text(1.02, row, text, transform=ax.get_yaxis_transform(), va="center", fontsize=9, color=style.DARK)
    ax.set_yticks(rows, [style.formula_or_name(formula(term), latex.get(term)) for term in terms])
    ax.set_ylim(len(terms) - 0.4, -0.6)
    ax.spines["left"].set_visible(False)
    ax.set_xlabel(label)


def _set_scale(ax: Axes, low: float, high: float, threshold: float | None, label: str) -> str:
    """Set scale, limits and ticks of an axis that spans low ≤ 0 ≤ high, and return its whole label."""
    if threshold is None:
        pad = 0.08 * (high - low) or 1.0
        ax.set_xlim(low - pad, high + pad)
        ax.xaxis.set_major_locator(MaxNLocator(6, min_n_ticks=3))
        return label
    ax.set_xscale("symlog", linthresh=threshold, linscale=1.0)
    ax.set_xlim(min(2.0 * low, -threshold), max(2.0 * high, threshold))
    first = round(np.log10(threshold))
    below, above = (max(int(np.ceil(np.log10(max(end, threshold)))) - first, 0) for end in (-low, high))
    # Labels collide when neighbours are closer than a fifth of the axis; the label of zero is a narrow one.
    decades = below + above + 2
    step = -(-decades // 5)
    nearest = 0 if decades <= 8 else 1
    ticks = [-(10.0 ** (first + i)) for i in range(nearest, below + 1, step)]
    ticks += [0.0] + [10.0 ** (first + i) for i in range(nearest, above + 1, step)]
    ax.xaxis.set_major_locator(FixedLocator(sorted(ticks)))
    return f"{label}\n(linear between ± {number(10.0**first)}, logarithmic beyond)"


def _power_of_ten(value: float) -> float:
    return float(10.0 ** np.floor(np.log10(value)))


def _linear_range(mean: np.ndarray, lower: np.ndarray, upper: np.ndarray, true: np.ndarray) -> float | None:
    """Return the half width of the linear part of a symmetric-log axis; None where a linear axis will do."""
    clear = np.abs(mean[(lower * upper > 0) & (mean != 0)])
    largest = np.nanmax(np.abs(np.stack([mean, lower, upper, true])))
    # Beyond this ratio of the largest to the smallest clear coefficient a linear axis hides the small ones.
    if clear.size == 0 or largest <= 30 * clear.min():
        return None
    return _power_of_ten(max(clear.min(), 1e-5 * largest))


def _draw_bars(ax: Axes, block: pd.DataFrame, source: str | None) -> None:
    if source is None:
        ax.set_axis_off()
        return
    rows = np.arange(len(block))
    probability = block[source].to_numpy(dtype=float)
    given = block["given"].to_numpy(bool) if "given" in block else np.zeros(len(block), bool)
    ax.barh(rows[~given], probability[~given], height=0.55, color=style.BLUE)
    for row, value in enumerate(probability):
        text = "given" if given[row] else probability_text(value)
        ax.text(1.04, row, text, transform=ax.get_yaxis_transform(), va="center", fontsize=9)
    ax.set(xlim=(0, 1), ylim=(len(block) - 0.4, -0.6), yticks=[], xlabel=PROBABILITIES[source])
    ax.set_xticks([0, 0.5, 1], ["0", "0.5", "1"])
