"""The discrepancy over one or two variables of the state space."""

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayes_greybox.criticism.discrepancy import DiscrepancyGrid
from bayes_greybox.report.plots import style
from bayes_greybox.report.words.formatting import level_text, number
from bayes_greybox.running.errors import InputError

MOST_DATA_POINTS = 2000

_PALE = LinearSegmentedColormap.from_list("uncertainty", ["#FCFBFD", "#BCBDDC", "#807DBA"])
"""White to middle purple: points stay visible on it, and it is ordered in grayscale."""


@mpl.rc_context(style.STYLE)
def plot_discrepancy_over_states(
    grid: DiscrepancyGrid,
    *,
    data: Float[np.ndarray, "n_obs n_var"] | None = None,
    noise: float | np.floating = 0.0,
    axes: Sequence[Axes] | np.ndarray | None = None,
) -> Figure:
    """Draw the posterior of f over one variable (curve with band) or two (maps of mean and sd).

    Where the grid lies outside the data's support, f is extrapolated: a curve is dashed and pale there, a map
    is hatched and pale, and the colour range ignores it.

    Args:
        grid: the posterior of f on the grid.
        data: positions of the data rows to mark, one column a variable; the grid's own points by default.
        noise: noise standard deviation, in the unit of f: colours of maps reach to it at least, so that what is small
            beside the noise is pale.
        axes: axes to draw into: one for one variable; mean and sd for two.

    Raises:
        InputError: the grid spans neither one variable nor two.
    """
    points = grid.points if data is None else data
    if len(grid.variables) not in (1, 2):
        raise InputError(f"A discrepancy is drawn over 1 or 2 variables, but the grid spans {len(grid.variables)}.")
    if len(grid.variables) == 1:
        panels = style.panels_of(axes, 1, "the curve", (6.6, 3.9))
        _draw_curve(panels[0], grid, points, axes is None)
    else:
        panels = style.panels_of(axes, 2, "mean and sd", (10.0, 4.5), nrows=1, ncols=2)
        _draw_maps(panels, grid, points, float(noise), axes is None)
    return style.figure_of(panels[0])


def _title(grid: DiscrepancyGrid, what: str) -> str:
    held = ", ".join(f"{style.plain(name)} = {number(value)}" for name, value in grid.fixed.items())
    title = f"{what} in the equation for {style.plain(grid.equation)}"
    return f"{title}\nheld: {held}" if held else title


def _draw_curve(ax: Axes, grid: DiscrepancyGrid, points: np.ndarray, ours: bool) -> None:
    x = grid.axes[0]
    ax.axhline(0.0, color=style.GREY, linewidth=0.8, zorder=0)
    # The faded copy runs underneath everywhere, so the two parts meet without a gap.
    ax.fill_between(x, grid.lower, grid.upper, color=style.BLUE, alpha=0.12, linewidth=0)
    ax.plot(x, grid.mean, color=style.BLUE, linewidth=1.2, linestyle=(0, (3, 2)), label="mean, extrapolated")
    look: dict[str, Any] = {"color": style.BLUE, "linewidth": 0, "label": f"{level_text(grid.level)} interval"}
    ax.fill_between(x, grid.lower, grid.upper, where=grid.inside.tolist(), alpha=0.28, **look)
    ax.plot(x, np.where(grid.inside, grid.mean, np.nan), color=style.BLUE, linewidth=2.0, label="mean")
    ax.margins(x=0.02)
    style.rug(ax, points[style.every_nth(len(points), MOST_DATA_POINTS), 0], "data")
    ax.set_xlabel(style.with_unit(grid.variables[0], grid.units[0]))
    ax.set_ylabel(style.with_unit("discrepancy f", grid.unit))
    ax.set_title(_title(grid, "Discrepancy"))
    wanted = ["mean", look["label"], "data"] + ([] if grid.inside.all() else ["mean, extrapolated"])
    artists = {artist.get_label(): artist for artist in ax.get_legend_handles_labels()[0]}
    style.place_legend(ax, ours, [artists[label] for label in wanted])


def _draw_maps(panels: list[Axes], grid: DiscrepancyGrid, points: np.ndarray, noise: float, ours: bool) -> None:
    seen = grid.inside if grid.inside.any() else np.ones_like(grid.inside)
    limit = max(noise, _first_positive(np.abs(grid.mean[seen]), np.abs(grid.sd[seen])))
    draw_map(panels[0], grid.axes, grid.mean, style.SIGNED, (-limit, limit), style.with_unit("mean of f", grid.unit))
    fade_outside(panels[0], grid.axes, grid.inside)
    largest = max(noise, _first_positive(grid.sd[seen]))
    draw_map(panels[1], grid.axes, grid.sd, _PALE, (0.0, largest), style.with_unit("sd of f", grid.unit))
    fade_outside(panels[1], grid.axes, grid.inside)
    mean = np.ma.array(grid.mean, mask=~seen)
    levels = np.linspace(-limit, limit, 9)
    inner = levels[(levels > mean.min()) & (levels < mean.max())]
    if inner.size:
        # Negative levels are dashed, so that the sign survives in grayscale.
        panels[0].contour(*grid.axes, mean.T, levels=inner, colors=[style.DARK], linewidths=0.6)
    # Positive where the interval lies on one side of zero.
    beyond = np.maximum(grid.lower, -grid.upper)
    bold = outline(panels[0], grid.axes, beyond, 0.0, seen)
    for ax in panels:
        finish_map(ax, grid.axes, grid.variables, grid.units, points, "data")
    panels[0].set_title(_title(grid, "Discrepancy f"))
    panels[1].set_title("Its uncertainty" + ("\n" if grid.fixed else ""))
    handles = [legend_mark("data", "data")]
    if bold:
        handles.append(legend_mark("outline", f"edge of where the {level_text(grid.level)} interval excludes 0"))
    if not grid.inside.all():
        handles.append(legend_mark("outside", "no data: extrapolated"))
    style.place_legend(panels[0], ours, handles)


def _first_positive(*candidates: np.ndarray) -> float:
    """Return the largest value of the first array that is not all zero; 1 where they all are."""
    return next((float(values.max()) for values in candidates if values.max() > 0), 1.0)


def draw_map(
    ax: Axes,
    grid: Sequence[np.ndarray],
    values: Float[np.ndarray, "n_0 n_1"],
    colours: str | Colormap,
    limits: tuple[float, float],
    label: str,
) -> None:
    """Draw values over two variables by colour, with a colour bar whose ends show what lies beyond the limits."""
    low, high = limits
    mesh = ax.pcolormesh(*grid, values.T, cmap=colours, vmin=low, vmax=high, shading="nearest", rasterized=True)
    above, below = values.max() > high, values.min() < low
    extend = "both" if above and below else "max" if above else "min" if below else "neither"
    style.figure_of(ax).colorbar(mesh, ax=ax, label=label, extend=extend)


def finish_map(
    ax: Axes,
    grid: Sequence[np.ndarray],
    variables: Sequence[str],
    units: Sequence[str],
    points: Float[np.ndarray, "n_obs 2"] | None,
    label: str | None = None,
) -> None:
    """Mark the data rows on a map of two variables, name these, and end it where the grid does."""
    if points is not None:
        shown = points[style.every_nth(len(points), MOST_DATA_POINTS)]
        look: dict[str, Any] = {"color": style.DARK, "markersize": 1.6, "alpha": 0.35, "markeredgewidth": 0}
        ax.plot(shown[:, 0], shown[:, 1], "o", label=label, **look)
    (x, y), (x_label, y_label) = grid, map(style.with_unit, variables, units)
    ax.set(xlim=(x[0], x[-1]), ylim=(y[0], y[-1]), xlabel=x_label, ylabel=y_label)


def legend_mark(kind: str, label: str) -> Artist:
    """Return a legend's entry for the outline of a map, its marked data rows, or where there are none ("outside")."""
    if kind == "outside":
        return Patch(facecolor="white", edgecolor=style.GREY, hatch="////", label=label)
    dot = {"marker": "o", "linestyle": "none", "markersize": 2.5}
    look: dict[str, Any] = dot if kind == "data" else {"linewidth": 2.0}
    return Line2D([], [], color=style.DARK, label=label, **look)


def outline(ax: Axes, grid: Sequence[np.ndarray], values: np.ndarray, level: float, seen: np.ndarray) -> bool:
    """Draw a bold closed line around values above a level where there are data, and return whether there are any."""
    top = float(values[seen].max())
    if not top > level:
        return False
    # Below the level outside, so that the line closes at the edge of the data and of the map.
    below = 2 * level - top
    framed = np.pad(np.where(seen, values, below), 1, constant_values=below)
    edges = [(a[0] - 1e-3 * (a[1] - a[0]), a[-1] + 1e-3 * (a[1] - a[0])) for a in grid]
    along, across = (np.concatenate([[first], a, [last]]) for a, (first, last) in zip(grid, edges, strict=True))
    ax.contour(along, across, framed.T, levels=[level], colors=[style.DARK], linewidths=2.0)
    return True


def fade_outside(ax: Axes, grid: Sequence[np.ndarray], inside: np.ndarray) -> None:
    """Hatch a map and make it pale where there are no data."""
    if not inside.all():
        outside = (~inside).T.astype(float)
        ax.contourf(*grid, outside, levels=[0.5, 1.5], colors=["white"], alpha=0.55)
        ax.contourf(*grid, outside, levels=[0.5, 1.5], colors="none", hatches=["////"])
