"""Figures along time, one panel a run: the discrepancy, and predicted against measured; long records are thinned."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayes_greybox.report.plots import style
from bayes_greybox.report.words.formatting import level_text, shorter

MOST_PANELS = 6
# Bins of a long record: about one a pixel column of a notebook figure.
RECORD_BINS = 1200

POSTERIOR: dict[str, Any] = {"color": style.BLUE, "linewidth": 1.6}


@mpl.rc_context(style.STYLE)
def plot_discrepancy_over_time(
    time: Float[np.ndarray, " n_obs"],
    mean: Float[np.ndarray, " n_obs"],
    lower: Float[np.ndarray, " n_obs"],
    upper: Float[np.ndarray, " n_obs"],
    *,
    equation: str,
    run: Int[np.ndarray, " n_obs"] | None = None,
    run_names: Sequence[str] | None = None,
    sigma: float | np.floating | None = None,
    level: float | np.floating = 0.9,
    time_unit: str | None = None,
    unit: str | None = None,
    axes: Sequence[Axes] | np.ndarray | None = None,
) -> Figure:
    """Draw the posterior of the discrepancy f along time, against the noise standard deviation.

    A long record is thinned for drawing to the extremes of neighbouring rows, so peaks stay.

    Args:
        time: time of each row, in `time_unit`.
        mean: posterior mean of f at each row, in `unit`.
        lower: lower end of the credible interval.
        upper: upper end of the credible interval.
        equation: name of the state whose derivative the equation gives.
        run: run of each row, 0..n_run-1; all one run by default. At most six runs are drawn.
        run_names: name of each run.
        sigma: noise standard deviation, in `unit`: drawn as a pair of reference lines.
        level: probability that the credible interval holds.
        time_unit: unit of time.
        unit: unit of f.
        axes: axes to draw into, one a drawn run.
    """
    rows, note = rows_of_runs(len(time), run)
    values = np.stack([mean, lower, upper])
    height = 1.0 + (2.6 if len(rows) == 1 else 1.55 * len(rows))
    panels = style.panels_of(axes, len(rows), "one a run", (8.0, height), sharey=True)
    for ax, chosen in each_run(panels, rows, run_names):
        ax.axhline(0.0, color=style.GREY, linewidth=0.8, zorder=0)
        draw_band(ax, time[chosen], values[:, chosen], POSTERIOR, "mean", f"{level_text(level)} interval", 0.28)
        if sigma is not None:
            draw_threshold(ax, sigma, "± noise sd σ")
    panels[0].set_title(f"Discrepancy f in the equation for {style.plain(equation)}{note}")
    label_axes(panels, style.with_unit("discrepancy f", unit), time_unit, axes is None)
    style.place_legend(panels[0], axes is None)
    return style.figure_of(panels[0])


def rows_of_runs(n_obs: int, run: Int[np.ndarray, " n_obs"] | None) -> tuple[list[np.ndarray], str]:
    """Return the rows of each run that gets a panel, and a note for the title where some runs get none."""
    if run is None:
        return [np.arange(n_obs)], ""
    runs = np.unique(run)
    note = f" (first {MOST_PANELS} of {len(runs)} runs)" if len(runs) > MOST_PANELS else ""
    return [np.flatnonzero(run == number) for number in runs[:MOST_PANELS]], note


def draw_band(
    ax: Axes,
    time: Float[np.ndarray, " n_obs"],
    values: Float[np.ndarray, "3 n_obs"],
    look: Mapping[str, Any],
    label: str,
    band: str = "",
    alpha: float = 0.25,
) -> None:
    """Draw mean and band of a quantity along time as far as they are finite, thinned where the record is long."""
    alive = np.isfinite(values).all(axis=0)
    if not alive.any():
        return
    time, (mean, lower, upper) = time[alive], values[:, alive]
    band_time, low, high = _outer_band(time, lower, upper)
    ax.fill_between(band_time, low, high, color=look["color"], alpha=alpha, linewidth=0, label=band or None)
    kept = extreme_rows(mean)
    # Dashes of swings that are too many to be told apart are noise.
    thin = {} if len(kept) == len(mean) else {"linewidth": 0.9, "linestyle": "-"}
    ax.plot(time[kept], mean[kept], zorder=3, label=label, **{"linewidth": 1.4, **look, **thin})


def each_run(
    panels: Sequence[Axes], rows: Sequence[np.ndarray], run_names: Sequence[str] | None
) -> Iterator[tuple[Axes, np.ndarray]]:
    """Yield the panel and the rows of each run; where there are several, a run's name stands above its panel."""
    for index, (ax, chosen) in enumerate(zip(panels, rows, strict=True)):
        yield ax, chosen
        if len(rows) > 1:
            name = style.plain(shorter(f"run {index}" if run_names is None else str(run_names[index]), 24))
            ax.text(1.0, 1.0, name, transform=ax.transAxes, ha="right", va="bottom", fontsize=9, color=style.DARK)
        ax.margins(x=0.01)


def label_axes(panels: Sequence[Axes], quantity: str, time_unit: str | None, ours: bool) -> None:
    """Label time, and the quantity once for all panels of a figure of our own."""
    panels[-1].set_xlabel(style.with_unit("time", time_unit))
    if ours and len(panels) > 1:
        style.figure_of(panels[0]).supylabel(quantity, fontsize=10)
    else:
        panels[0].set_ylabel(quantity)


def draw_threshold(ax: Axes, size: float | np.floating, label: str = "± threshold") -> None:
    """Draw the pair of lines that a curve has to leave to count."""
    for sign, name in ((1.0, label), (-1.0, "_")):
        ax.axhline(sign * float(size), color=style.DARK, linewidth=1.0, linestyle=style.DASHED, label=name)


@mpl.rc_context(style.STYLE)
def plot_predicted(
    time: Float[np.ndarray, " n_obs"],
    measured: Float[np.ndarray, " n_obs"],
    mean: Float[np.ndarray, " n_obs"],
    lower: Float[np.ndarray, " n_obs"],
    upper: Float[np.ndarray, " n_obs"],
    *,
    equation: str,
    label: str | None = None,
    level: float | np.floating = 0.9,
    run: Int[np.ndarray, " n_obs"] | None = None,
    run_names: Sequence[str] | None = None,
    time_unit: str | None = None,
    unit: str | None = None,
    axes: Sequence[Axes] | np.ndarray | None = None,
) -> Figure:
    """Draw predicted and measured derivative along time, and beside it predicted against measured.

    The scatter holds every row; along time at most six runs are drawn, thinned to the extremes of
    neighbouring rows where they are long.

    Args:
        time: time of each row, in `time_unit`.
        measured: measured derivative, in `unit`.
        mean: posterior predictive mean, in `unit`.
        lower: lower end of the predictive interval.
        upper: upper end of the predictive interval.
        equation: name of the state whose derivative is predicted.
        label: name of another predicted quantity, such as an output.
        level: probability that the interval holds.
        run: run of each row, 0..n_run-1; all one run by default.
        run_names: name of each run.
        time_unit: unit of time.
        unit: unit of the derivative.
        axes: axes to draw into: one a drawn run, then the scatter.
    """
    rows, note = rows_of_runs(len(time), run)
    values = np.stack([mean, lower, upper])
    if axes is None:
        figure = style.new_figure(10.5, max(4.0, 0.9 + 1.5 * len(rows)))
        layout = figure.add_gridspec(len(rows), 2, width_ratios=[1.75, 1.0])
        panels = [figure.add_subplot(layout[0, 0])]
        panels += [figure.add_subplot(layout[i, 0], sharey=panels[0]) for i in range(1, len(rows))]
        across = figure.add_subplot(layout[:, 1])
    else:
        *panels, across = style.given_axes(axes, len(rows) + 1, "one a run, then the scatter")
    quantity = label or f"d({equation})/dt"
    for ax, chosen in each_run(panels, rows, run_names):
        _draw_measured(ax, time[chosen], measured[chosen])
        band = f"{level_text(level)} interval"
        draw_band(ax, time[chosen], values[:, chosen], POSTERIOR, "predicted mean", band, 0.28)
    panels[len(panels) // 2].set_ylabel(style.with_unit(quantity, unit))
    panels[0].set_title(f"Predicted and measured {style.plain(quantity)}{note}")
    panels[-1].set_xlabel(style.with_unit("time", time_unit))
    style.place_legend(panels[0], axes is None)
    _draw_across(across, measured, mean, quantity, unit)
    return style.figure_of(across)


def _draw_measured(ax: Axes, time: np.ndarray, measured: np.ndarray) -> None:
    if len(time) <= 2000:
        size = _marker_size(len(time))
        ax.plot(time, measured, "o", color=style.DARK, markersize=size, markeredgewidth=0, zorder=2.5, label="measured")
        return
    # Points would merge into a blot.
    kept = extreme_rows(measured)
    ax.plot(time[kept], measured[kept], color=style.GREY, linewidth=0.8, label="measured")


def _draw_across(ax: Axes, measured: np.ndarray, mean: np.ndarray, quantity: str, unit: str | None) -> None:
    low, high = float(min(measured.min(), mean.min())), float(max(measured.max(), mean.max()))
    pad = 0.05 * (high - low) or 1.0
    view = (low - pad, high + pad)
    if len(measured) <= 3000:
        size = _marker_size(len(measured)) + 0.7
        ax.plot(measured, mean, "o", color=style.BLUE, markersize=size, alpha=0.5, markeredgewidth=0, label="rows")
    else:
        cells = ax.hexbin(
            measured, mean, gridsize=60, bins="log", mincnt=1, cmap="cividis_r", extent=view + view, linewidths=0.2
        )
        style.figure_of(ax).colorbar(cells, ax=ax, label="rows in the cell", shrink=0.8)
    ax.axline((low, low), slope=1.0, color=style.DARK, linewidth=1.0, linestyle=style.DASHED, label="1:1")
    ax.set_aspect("equal", anchor="N")
    ax.xaxis.set_major_locator(MaxNLocator(5))
    ax.yaxis.set_major_locator(MaxNLocator(5))
    ax.set(xlim=view, ylim=view, xlabel=style.with_unit(f"measured {quantity}", unit))
    ax.set_ylabel(style.with_unit(f"predicted {quantity}", unit))
    ax.legend(loc="upper left", handletextpad=0.5)


def _marker_size(n_obs: int) -> float:
    return 4.5 if n_obs <= 100 else 2.8 if n_obs <= 400 else 1.8


def extreme_rows(values: Float[np.ndarray, " n_obs"]) -> Int[np.ndarray, " n_kept"]:
    """Return the numbers of the rows to draw of a long record: the smallest and the largest of each bin, in order.

    Bins are of neighbouring rows. A record of no more than `2 RECORD_BINS` rows keeps all.
    """
    n_obs = len(values)
    if n_obs <= 2 * RECORD_BINS:
        return np.arange(n_obs)
    kept = [0, n_obs - 1]
    for start, end in pairwise(_edges(n_obs)):
        kept += [start + int(np.argmin(values[start:end])), start + int(np.argmax(values[start:end]))]
    return np.unique(np.asarray(kept))


def _outer_band(time: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a band to draw, by time, lower and upper edge, that covers the whole band of a long record."""
    n_obs = len(time)
    if n_obs <= 2 * RECORD_BINS:
        return time, lower, upper
    # Each bin has its lowest lower and its highest upper edge, at its first and its last row.
    starts, ends = (edges := _edges(n_obs))[:-1], edges[1:] - 1
    return (
        np.stack([time[starts], time[ends]], axis=1).ravel(),
        np.repeat(np.minimum.reduceat(lower, starts), 2),
        np.repeat(np.maximum.reduceat(upper, starts), 2),
    )


def _edges(n_obs: int) -> np.ndarray:
    return np.linspace(0, n_obs, RECORD_BINS + 1).astype(np.int64)
