"""The posterior of one coefficient beside the part of the discrepancy that imitates its term."""

from collections.abc import Sequence
from typing import Literal

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from scipy.ndimage import convolve1d

from bayes_greybox.report.plots import style
from bayes_greybox.report.words.formatting import number


@mpl.rc_context(style.STYLE)
def plot_tradeoff(
    theta: Float[np.ndarray, " n_draw"],
    projection: Float[np.ndarray, " n_draw"],
    *,
    term: str,
    equation: str,
    correlation: float | np.floating | None = None,
    unit: str | None = None,
    axes: Sequence[Axes] | np.ndarray | None = None,
) -> Figure:
    """Draw posterior pairs of a coefficient θ and of the amount of its term that the discrepancy f imitates.

    Both axes have the same unit and the same width. A discrepancy that steals from the term shows as a cloud
    along the line θ + f = constant; one that is orthogonal to it as a flat line at zero.

    Args:
        theta: draws of the coefficient, in `unit`.
        projection: the same draws of the coefficient f amounts to along the term, in `unit`.
        term: name of the term.
        equation: name of the state whose derivative the equation gives.
        correlation: posterior correlation of the two, to print; NaN where one of them does not vary.
        unit: unit of the coefficient.
        axes: axes to draw into: the pairs, the distribution of θ (above), that of f (right).
    """
    if axes is None:
        figure = style.new_figure(5.8, 5.8)
        layout = figure.add_gridspec(2, 2, width_ratios=[4, 1], height_ratios=[1, 4])
        pairs = figure.add_subplot(layout[1, 0])
        above = figure.add_subplot(layout[0, 0])
        right = figure.add_subplot(layout[1, 1])
    else:
        pairs, above, right = style.given_axes(axes, 3, "pairs, θ above, f at the right")
    width = float(1.12 * max(np.ptp(theta), np.ptp(projection)) or 2.0 * max(np.max(np.abs(theta)), 1.0))
    # Rounding noise around an exact zero is drawn at zero, not magnified by its own range.
    x_view, y_view = _view(theta, width), _view(projection, width)
    zero = theta == 0.0
    _draw_pairs(pairs, theta, projection, zero, width)
    pairs.set(xlim=x_view, ylim=y_view)
    # Five digits a label, where θ is known that well, leave room for no more.
    pairs.xaxis.set_major_locator(MaxNLocator(4))
    pairs.set_xlabel(style.with_unit(f"θ: coefficient of {term}", unit))
    pairs.set_ylabel(style.with_unit(f"amount of {term} that f imitates", unit))
    _draw_marginal(above, theta, zero, x_view, "vertical")
    _draw_marginal(right, projection, zero, y_view, "horizontal")
    title = f"θ–f trade-off in the equation for {style.plain(equation)}"
    if correlation is not None:
        undefined = "not defined: one of the two does not vary"
        title += f"\ncorrelation {number(correlation, 2) if np.isfinite(correlation) else undefined}"
    above.set_title(title)
    return style.figure_of(pairs)


def _view(draws: np.ndarray, width: float) -> tuple[float, float]:
    centre = 0.5 * (float(draws.min()) + float(draws.max()))
    return centre - 0.5 * width, centre + 0.5 * width


def _draw_pairs(ax: Axes, theta: np.ndarray, projection: np.ndarray, zero: np.ndarray, width: float) -> None:
    ax.axhline(0.0, color=style.GREY, linewidth=0.8, zorder=0)
    on_line = (0.0, float(np.median(theta + projection)))
    ax.axline(on_line, slope=-1.0, color=style.DARK, linewidth=1.0, linestyle=style.DASHED, label="θ + f = constant")
    kept = style.every_nth(len(theta), 4000)
    for chosen, colour, label in ((~zero, style.BLUE, "draws"), (zero, style.ORANGE, "draws with θ exactly 0")):
        if chosen.any():
            x, y = theta[kept][chosen[kept]], projection[kept][chosen[kept]]
            ax.plot(x, y, "o", color=colour, markersize=3, alpha=0.25, markeredgewidth=0, label=label)
    _draw_contours(ax, theta[~zero], projection[~zero], width)
    # θ + f = constant falls to the right, and leaves this corner.
    legend = ax.legend(loc="lower left", handletextpad=0.4)
    for handle in filter(None, legend.legend_handles):
        handle.set_alpha(1.0)


def _draw_contours(ax: Axes, x: np.ndarray, y: np.ndarray, width: float) -> None:
    """Draw outlines of the densest cells that hold half and nine tenths of the draws."""
    if len(x) < 200 or min(np.ptp(x), np.ptp(y)) < 0.01 * width:
        return
    # Counted along the principal axes of the cloud: cells along x and y would blur a narrow ridge.
    draws = np.stack([x, y], axis=1)
    variance, direction = np.linalg.eigh(np.cov(draws.T))
    if variance[0] <= 1e-10 * variance[1]:
        return
    to_draws = direction * np.sqrt(variance)
    whitened = (draws - draws.mean(axis=0)) @ direction / np.sqrt(variance)
    reach = 1.1 * float(np.abs(whitened).max())
    count, edge, _ = np.histogram2d(*whitened.T, bins=30, range=[(-reach, reach)] * 2)
    for axis in (0, 1, 0, 1, 0, 1):
        count = convolve1d(count, [0.25, 0.5, 0.25], axis, mode="constant")
    ordered = np.sort(count.ravel())[::-1]
    share = np.cumsum(ordered) / ordered.sum()
    levels = [float(ordered[np.searchsorted(share, held)]) for held in (0.9, 0.5)]
    if levels[0] < levels[1]:
        centre = 0.5 * (edge[1:] + edge[:-1])
        cells = np.stack(np.meshgrid(centre, centre, indexing="ij"), axis=-1) @ to_draws.T + draws.mean(axis=0)
        ax.contour(cells[..., 0], cells[..., 1], count, levels=levels, colors=[style.DARK], linewidths=[0.9, 1.5])


def _draw_marginal(
    ax: Axes, draws: np.ndarray, zero: np.ndarray, view: tuple[float, float], side: Literal["vertical", "horizontal"]
) -> None:
    parts, bins = [draws[~zero], draws[zero]], np.linspace(*view, 42).tolist()
    ax.hist(parts, bins=bins, color=[style.BLUE, style.ORANGE], stacked=True, orientation=side)
    ax.set(**{"xlim" if side == "vertical" else "ylim": view}, xticks=[], yticks=[])
    ax.spines[:].set_visible(False)
