"""The gap between simulation and measurement over one or two variables, before and after effects were added."""

from collections.abc import Mapping, Sequence

import matplotlib as mpl
import numpy as np
from jaxtyping import Bool, Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayes_greybox.report.plots import style
from bayes_greybox.report.plots.posterior.along_time import draw_threshold
from bayes_greybox.report.words.formatting import quantity

from ..posterior.over_states import MOST_DATA_POINTS, draw_map, fade_outside, finish_map, legend_mark, outline

SURE_GAP = 0.9
"""Probability from which a gap counts as there, in every figure."""


@mpl.rc_context(style.STYLE)
def plot_gap_map(
    grid: tuple[Float[np.ndarray, " n_0"], Float[np.ndarray, " n_1"]],
    maps: Mapping[str, tuple[Float[np.ndarray, "n_0 n_1"], Float[np.ndarray, "n_0 n_1"]]],
    *,
    variables: Sequence[str],
    units: Sequence[str],
    threshold: float | np.floating,
    unit: str = "",
    limit: float | np.floating | None = None,
    inside: Bool[np.ndarray, "n_0 n_1"] | None = None,
    samples: Float[np.ndarray, "n_obs 2"] | None = None,
    colours: Sequence[str] | None = None,
    axes: Sequence[Axes] | np.ndarray | None = None,
) -> Figure:
    """Draw the posterior mean of the gap over two variables, outlined where it surely exceeds the threshold.

    Args:
        grid: positions along the first and the second variable.
        maps: by title, such as "before" and "after": posterior mean of the gap, in `unit`, and the probability that
            `|gap|` exceeds the threshold.
        variables: names of the two variables.
        units: their units.
        threshold: size from which on a gap counts as one, in `unit`.
        unit: unit of the gap.
        limit: end of the colour range; the largest `|gap|` of all maps by default.
        inside: where there are data; elsewhere a map is hatched and pale.
        samples: positions of the data rows, to mark.
        colours: colours of titles and frames, one a map, as curves of the same models have them elsewhere.
        axes: axes to draw into, one a map.
    """
    panels = style.panels_of(axes, len(maps), "one a map", (5.4 * len(maps), 4.5), nrows=1, ncols=len(maps))
    seen = _seen(inside, (len(grid[0]), len(grid[1])))
    end = float(limit) if limit else max(float(np.abs(gap[seen]).max()) for gap, _ in maps.values()) or 1.0
    bold = False
    framed = colours if colours is not None else [None] * len(maps)
    for ax, colour, (title, (gap, probability)) in zip(panels, framed, maps.items(), strict=True):
        draw_map(ax, grid, gap, style.SIGNED, (-end, end), style.with_unit("gap", unit))
        fade_outside(ax, grid, seen)
        bold = outline(ax, grid, probability, SURE_GAP, seen) or bold
        finish_map(ax, grid, variables, units, samples)
        ax.set_title(title)
        if colour is not None:
            ax.set_title(title, color=colour, fontweight="bold")
            ax.spines[:].set(visible=True, edgecolor=colour, linewidth=2.0)
    event = style.plain(f"around P(|gap| > {quantity(threshold, unit)}) > {SURE_GAP:g}")
    handles = [legend_mark("outline", event)] if bold else []
    if samples is not None:
        handles.append(legend_mark("data", "data"))
    if not seen.all():
        handles.append(legend_mark("outside", "no data"))
    if handles:
        style.place_legend(panels[0], axes is None, handles)
    return style.figure_of(panels[0])


@mpl.rc_context(style.STYLE)
def plot_gap_curve(
    grid: Float[np.ndarray, " n_0"],
    before: Float[np.ndarray, " n_0"],
    after: Float[np.ndarray, " n_0"],
    probability: Float[np.ndarray, " n_0"],
    after_probability: Float[np.ndarray, " n_0"],
    *,
    variable: str,
    variable_unit: str,
    title: str,
    threshold: float | np.floating,
    unit: str = "",
    inside: Bool[np.ndarray, " n_0"] | None = None,
    samples: Float[np.ndarray, " n_obs"] | None = None,
    axes: Sequence[Axes] | np.ndarray | None = None,
) -> Figure:
    """Draw the posterior mean of the gap over one variable, before and after; thick where it is surely there.

    Args:
        grid: positions along the variable.
        before: posterior mean of the gap that the simulation leaves, in `unit`.
        after: the same of the extended model.
        probability: probability that `|gap|` exceeds the threshold, before.
        after_probability: the same after.
        variable: name of the variable.
        variable_unit: its unit.
        title: title of the curves.
        threshold: size from which on a gap counts as one, in `unit`: drawn as a pair of reference lines.
        unit: unit of the gap.
        inside: where there are data; elsewhere the curves are dotted.
        samples: positions of the data rows, to mark.
        axes: one axes to draw into.
    """
    (ax,) = style.panels_of(axes, 1, "the curves", (6.6, 3.9))
    ax.axhline(0.0, color=style.GREY, linewidth=0.8, zorder=0)
    draw_threshold(ax, threshold)
    seen = _seen(inside, grid.shape)
    for values, sure, look, label in (
        (before, probability > SURE_GAP, style.BEFORE, "before"),
        (after, after_probability > SURE_GAP, style.AFTER, "after"),
    ):
        if not seen.all():
            ax.plot(grid, values, color=look["color"], linewidth=1.0, linestyle=(0, (1, 2)))
        ax.plot(grid, np.where(seen, values, np.nan), linewidth=1.3, label=label, **look)
        bold = np.where(seen & sure, values, np.nan)
        ax.plot(grid, bold, linewidth=3.4, solid_capstyle="butt", dash_capstyle="butt", **look)
    if samples is not None:
        style.rug(ax, samples[style.every_nth(len(samples), MOST_DATA_POINTS)])
    ax.margins(x=0.02)
    ax.set(xlabel=style.with_unit(variable, variable_unit), ylabel=style.with_unit("gap", unit), title=title)
    handles: list[Artist] = [*ax.get_legend_handles_labels()[0]]
    handles.append(Line2D([], [], color=style.GREY, linewidth=3.4, label=f"P(beyond threshold) > {SURE_GAP:g}"))
    style.place_legend(ax, axes is None, handles)
    return style.figure_of(ax)


def _seen(inside: np.ndarray | None, shape: tuple[int, ...]) -> np.ndarray:
    return np.ones(shape, bool) if inside is None or not inside.any() else inside
