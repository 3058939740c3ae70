"""Before and after the missing effects were added, along time: the gap, and the free run of the model."""

from collections.abc import Sequence
from textwrap import fill
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.report.plots import style

from ..posterior.along_time import draw_band, draw_threshold, each_run, extreme_rows, label_axes, rows_of_runs
from .gap_map import SURE_GAP

UNSEEN_STATE = "path through the samples"
"""Name of the curve that runs of a state without a sensor are compared with."""

# Width in inches below which four labels of a legend do not fit in a row.
_NARROW_LEGEND = 6.0
# Rows of a run whose swings may be too many to be told apart in one panel, and of its end that is then shown again.
_LONG_RUN, _LAST_ROWS = 2000, 200


@mpl.rc_context(style.STYLE)
def plot_gap_over_time(
    time: Float[np.ndarray, " n_obs"],
    before: Float[np.ndarray, "3 n_obs"],
    after: Float[np.ndarray, "3 n_obs"],
    *,
    equation: str,
    threshold: float | np.floating,
    probability: Float[np.ndarray, " n_obs"] | None = None,
    run: Int[np.ndarray, " n_obs"] | None = None,
    run_names: Sequence[str] | None = None,
    time_unit: str | None = None,
    unit: str | None = None,
    width: float = 9.0,
    axes: Sequence[Axes] | np.ndarray | None = None,
) -> Figure:
    """Draw the gap along the record before and after, with the times at which it surely exceeds the threshold.

    Args:
        time: time of each row, in `time_unit`.
        before: mean, lower and upper end of the gap that the simulation leaves, in `unit`.
        after: the same of the extended model.
        equation: name of the state whose derivative the equation gives.
        threshold: size from which on a gap counts as one, in `unit`.
        probability: probability that `|gap|` exceeds the threshold, before.
        run: run of each row; all one run by default. At most six runs are drawn.
        run_names: name of each run.
        time_unit: unit of time.
        unit: unit of the gap.
        width: width of the figure in inches.
        axes: axes to draw into, one a drawn run.
    """
    rows, note = rows_of_runs(len(time), run)
    panels = _panels(rows, width, axes)
    # One line over the other would hide it, and the legend speak of what nobody sees.
    same = np.allclose(before, after, rtol=1e-6, atol=1e-6 * float(np.nanmax(np.abs(after))), equal_nan=True)
    for ax, chosen in each_run(panels, rows, run_names):
        ax.axhline(0.0, color=style.GREY, linewidth=0.8, zorder=0)
        draw_threshold(ax, threshold)
        if same:
            draw_band(ax, time[chosen], after[:, chosen], style.AFTER, "before and after")
        else:
            draw_band(ax, time[chosen], before[:, chosen], style.BEFORE, "before")
            draw_band(ax, time[chosen], after[:, chosen], style.AFTER, "after")
        if probability is not None:
            sure = probability[chosen] > SURE_GAP
            stretches = _stretches(time[chosen], sure)
            at, label = np.full(len(stretches), 0.02), f"P(beyond threshold) > {SURE_GAP:g}"
            ax.hlines(at, stretches[:, 0], stretches[:, 1], transform=ax.get_xaxis_transform(), color=style.DARK,
                      linewidth=5, label=label if len(stretches) else "")  # fmt: skip
        ax.margins(y=0.12)
    panels[0].set_title(f"Gap in the equation for {style.plain(equation)}{note}")
    _label(panels, style.with_unit("gap", unit), time_unit, axes is None)
    return style.figure_of(panels[0])


@mpl.rc_context(style.STYLE)
def plot_free_run(
    time: Float[np.ndarray, " n_obs"],
    measured: Float[np.ndarray, " n_obs"],
    before: Float[np.ndarray, "3 n_obs"] | None,
    after: Float[np.ndarray, "3 n_obs"],
    *,
    state: str,
    holds: str = "",
    seen_as: str = "measured",
    run: Int[np.ndarray, " n_obs"] | None = None,
    run_names: Sequence[str] | None = None,
    time_unit: str | None = None,
    unit: str | None = None,
    width: float = 9.0,
    axes: Sequence[Axes] | np.ndarray | None = None,
) -> Figure:
    """Draw a state as measured and as the model runs it from its start alone, before and after.

    A run that failed ends with a cross where it did. The scale is that of the measurements and of the extended model:
    a run that leaves it was far off. The end of a single long run, where errors have had most time to grow, is shown
    again close up.

    Args:
        time: time of each row, in `time_unit`.
        measured: the measured state, in `unit`.
        before: mean, lower and upper end of the free run before; NaN from where it failed. None: there is one model.
        after: the same of the extended model.
        state: name of the state.
        holds: sources of uncertainty in the band after, for the legend.
        seen_as: name of the curve that the runs are compared with, for the legend.
        run: run of each row; all one run by default. At most six runs are drawn.
        run_names: name of each run.
        time_unit: unit of time.
        unit: unit of the state.
        width: width of the figure in inches.
        axes: axes to draw into, one a drawn run.
    """
    rows, note = rows_of_runs(len(time), run)
    closer = axes is None and len(rows) == 1 and len(rows[0]) > _LONG_RUN
    if closer:
        rows, run_names = [rows[0], rows[0][-_LAST_ROWS:]], ["whole run", f"its last {_LAST_ROWS} samples"]
    panels = _panels(rows, width, axes)
    low, high = float(measured.min()), float(measured.max())
    margin = 0.35 * (high - low) or 1.0
    if style.figure_of(panels[0]).get_figwidth() < _NARROW_LEGEND:
        holds = fill(holds, 34)
    shown = [(after, style.AFTER, "model" if before is None else "after", holds)]
    if before is not None:
        # Draws of its start alone: where a run fails they are anywhere.
        line = np.broadcast_to(before[:1], before.shape)
        shown.insert(0, (line, style.BEFORE, "before", ""))
    for ax, chosen in each_run(panels, rows, run_names):
        t, seen = time[chosen], measured[chosen]
        for values, model_look, label, band in shown:
            draw_band(ax, t, values[:, chosen], model_look, label, band)
        look: dict[str, Any] = {"color": style.DARK, "zorder": 4, "label": seen_as}
        if len(t) <= 400:
            ax.plot(t, seen, "o", markersize=2.2, markeredgewidth=0, **look)
        else:
            kept = extreme_rows(seen)
            ax.plot(t[kept], seen[kept], linewidth=0.9, linestyle=(0, (2, 1.5)), **look)
        ax.set_ylim(low - margin, high + margin)
        for values, model_look, *_ in shown:
            _mark_failure(ax, t, values[0, chosen], model_look["color"])
    panels[0].set_title(f"Free run of {style.plain(state)}{note}")
    _label(panels, style.with_unit(state, unit), time_unit, axes is None)
    return style.figure_of(panels[0])


def seen_as(data: Trajectories, state: str) -> str:
    """Return the name of the curve that free runs of a state are compared with: a measurement if it has a sensor."""
    return "measured" if state in (data.samples or data).states else UNSEEN_STATE


def _panels(rows: list[np.ndarray], width: float, axes: Sequence[Axes] | np.ndarray | None) -> list[Axes]:
    height = 1.05 + (2.5 if len(rows) == 1 else 1.6 * len(rows))
    return style.panels_of(axes, len(rows), "one a run", (width, height), sharey=True)


def _mark_failure(ax: Axes, time: np.ndarray, path: np.ndarray, colour: str) -> None:
    alive = np.flatnonzero(np.isfinite(path))
    if len(alive) in (0, len(path)):
        return
    end, at = float(time[alive[-1]]), float(np.clip(path[alive[-1]], *ax.get_ylim()))
    ax.plot([end], [at], "X", color=colour, markersize=9, markeredgecolor="white", zorder=5, clip_on=False)
    beside: dict[str, Any] = {"xytext": (7, 0), "textcoords": "offset points", "va": "center"}
    ax.annotate("fails", (end, at), fontsize=9, color=colour, **beside)


def _stretches(time: Float[np.ndarray, " n_obs"], on: Bool[np.ndarray, " n_obs"]) -> Float[np.ndarray, "n_stretch 2"]:
    """Return start and end of the stretches of rows that are on, near ones joined."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]]).astype(int)))
    pairs = np.stack([time[edges[::2]], time[edges[1::2] - 1]], axis=1)
    joined: list[np.ndarray] = []
    for pair in pairs:
        if joined and pair[0] - joined[-1][1] < (time[-1] - time[0]) / 400:
            joined[-1][1] = pair[1]
        else:
            joined.append(pair)
    return np.reshape(np.array(joined), (-1, 2))


def _label(panels: list[Axes], quantity: str, time_unit: str | None, ours: bool) -> None:
    label_axes(panels, quantity, time_unit, ours)
    handles = {str(h.get_label()): h for ax in reversed(panels) for h in ax.get_legend_handles_labels()[0]}
    first = ("measured", UNSEEN_STATE, "before", "after", "before and after", "model", "± threshold")
    order = [label for label in first if label in handles]
    order += [label for label in handles if label not in order]
    # What a band holds is a long label.
    widest = _NARROW_LEGEND + 0.06 * max(0, sum(map(len, order)) - 50)
    narrow = style.figure_of(panels[0]).get_figwidth() < widest
    columns = 2 if narrow and (len(order) > 3 or sum(map(len, order)) > 45) else None
    style.place_legend(panels[0], ours, [handles[label] for label in order], columns)
