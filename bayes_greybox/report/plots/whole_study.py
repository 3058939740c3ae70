"""A whole study in one figure: where simulation and measurements disagree, what is missing, does adding it help."""

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from bayes_greybox.discovery.study import StudyResult
from bayes_greybox.discovery.summary import changed, support, trace_bands
from bayes_greybox.report.plots import style
from bayes_greybox.running.errors import InputError

from .fits import band_rows
from .gap.before_after import UNSEEN_STATE, plot_free_run, plot_gap_over_time, seen_as
from .posterior.over_states import fade_outside, finish_map
from .studies import gap_limit, gap_map, ranking, run_data

QUESTIONS = ("Where do simulation and measurements disagree?", "What is missing?", "Does adding it help?")
"""Titles of the panels."""


@mpl.rc_context({**style.STYLE, "font.size": 9.5, "axes.titlesize": 9.5})
def overview(study: StudyResult, equation: str | None = None, wide: bool = True) -> Figure:
    """Draw a study in three panels: the gap over the states, the ranking of hypotheses, and a free run.

    The gap is that before and after, on one scale; of the hypotheses the four likeliest are drawn; the free run is of
    the state whose run was off most before, on held-out data if there are any, and of several runs the first. Where
    nothing was added, or without a free run, the gap along time is drawn.

    By default the equation is the first one whose gap was closed. Panels stand side by side, for a screen or a page, or
    else, if not `wide`, below each other, for a phone.

    Raises:
        InputError: The study has no such equation.
    """
    if equation is None:
        closed = [name for name, gap in study.maps.items() if changed(gap)]
        equation = next(iter([*closed, *study.maps]), "")
    if equation not in study.maps:
        raise InputError(f"The study has no equation {equation!r}; it has {', '.join(study.maps) or 'none'}.")
    figure = style.new_figure(13.2, 3.5) if wide else style.new_figure(5.0, 7.6)
    if wide:
        panels = figure.subfigures(1, 3, width_ratios=(4.8, 3.9, 4.5), wspace=0.02)
    else:
        panels = figure.subfigures(3, 1, height_ratios=(2.7, 2.4, 2.5), hspace=0.03)
    where, what, helps = panels
    _where(where, study, equation)
    if equation in study.hypotheses.index.unique(0):
        ranking(study, equation, most=4, letters=44, axes=[what.subplots()])
    off: dict[str, float] = {}
    for name, path in study.paths.items() if changed(study.maps[equation]) else ():
        error = np.abs(path.before.mean - path.measured)
        # Where a run failed it is off beyond all bounds.
        off[name] = float(np.mean(np.nan_to_num(error, nan=np.inf))) / (float(np.std(path.measured)) or 1.0)
    state = max(off, key=lambda name: off[name]) if off else None
    if state is None:
        _along_time(helps, study, equation)
    else:
        _free_run(helps, study, state)
    asked = [*QUESTIONS[:2], "And along time?" if state is None else QUESTIONS[2]]
    for number, (panel, question) in enumerate(zip(panels, asked, strict=True), start=1):
        panel.suptitle(f"{number}  {question}", x=0.02, ha="left", fontsize=10.5, fontweight="bold")
    return figure


def _where(panel: SubFigure, study: StudyResult, equation: str) -> None:
    gap = study.maps[equation]
    if len(gap.variables) == 1:
        gap_map(study, equation, axes=[panel.subplots()])
        return
    shown = {"the simulation as given": gap.before, **({"the extended model": gap.after} if changed(gap) else {})}
    axes = np.ravel(panel.subplots(1, len(shown), sharey=True))
    inside, limit = support(gap), gap_limit(gap)
    grid = (np.asarray(gap.axes[0]), np.asarray(gap.axes[1]))
    look: dict[str, Any] = {"cmap": style.SIGNED, "vmin": -limit, "vmax": limit, "shading": "nearest"}
    meshes = []
    for ax, (title, values) in zip(axes, shown.items(), strict=True):
        meshes.append(ax.pcolormesh(*grid, values.T, rasterized=True, **look))
        fade_outside(ax, grid, inside)
        finish_map(ax, grid, gap.variables, gap.units, gap.samples)
        ax.set_title(title)
        ax.label_outer()
    panel.colorbar(meshes[-1], ax=list(axes), label=style.with_unit("gap", gap.unit))


def _free_run(panel: SubFigure, study: StudyResult, state: str) -> None:
    path, data, ax = study.paths[state], run_data(study), panel.subplots()
    rows = _first_run(path.run, early=not np.isfinite(path.before.mean[-1]))
    before, after = (band_rows(band)[:, rows] for band in (path.before, path.after))
    about = {"seen_as": seen_as(data, state), "unit": data.unit(state), "time_unit": data.unit("t")}
    plot_free_run(
        path.time[rows], path.measured[rows], before, after, state=state, holds=path.holds, **about, axes=[ax]
    )
    _finish(ax, "from the first state and the inputs alone")


def _along_time(panel: SubFigure, study: StudyResult, equation: str) -> None:
    if equation not in study.traces:
        return
    trace, ax = study.traces[equation], panel.subplots()
    rows = _first_run(trace.run)
    before, after = (band[:, rows] for band in trace_bands(trace))
    about = {"threshold": trace.threshold, "unit": trace.unit, "time_unit": study.train.unit("t")}
    plot_gap_over_time(trace.time[rows], before, after, equation=equation, **about, axes=[ax])
    _finish(ax, "the gap along the training data")


def _first_run(run: np.ndarray, early: bool = False) -> np.ndarray:
    """Return the rows of the first run, of a long one those of its end, or its beginning: panels are small."""
    rows = np.flatnonzero(np.asarray(run) == run[0])
    return rows[:800] if early else rows[-800:]


def _finish(ax: Axes, title: str) -> None:
    """Set the title, and a legend of curves alone: what bands hold is long."""
    handles, labels = ax.get_legend_handles_labels()
    named = ("measured", UNSEEN_STATE, "before", "after", "before and after")
    curves = {label: handle for handle, label in zip(handles, labels, strict=True) if label in named}
    ax.legend(list(curves.values()), list(curves), loc="lower left", ncols=3, columnspacing=1.2)
    ax.set_title(title)
