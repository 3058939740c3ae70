"""Figures of a missing-effect study, and of a fleet of them: they draw the numbers of `discovery`."""

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery import summary
from bayes_greybox.discovery.answer.interval import INTERVAL_REACH
from bayes_greybox.discovery.answer.where import GapMap
from bayes_greybox.discovery.decision.probabilities import STOPS
from bayes_greybox.discovery.fleet.pooling import Pooled
from bayes_greybox.discovery.learned import shown_effects
from bayes_greybox.discovery.next_experiment.ranked import NextExperiment
from bayes_greybox.discovery.study import StudyResult
from bayes_greybox.discovery.ties import sorted_by_probability
from bayes_greybox.report.plots import style
from bayes_greybox.report.plots.gap.before_after import plot_free_run, plot_gap_over_time, seen_as
from bayes_greybox.report.plots.gap.gap_map import plot_gap_curve, plot_gap_map
from bayes_greybox.report.words.study import name_of
from bayes_greybox.running.errors import InputError

from ..words.formatting import formula, shorter
from .fits import band_rows, runs_of
from .gap.hypotheses import Coefficient, plot_hypotheses, plot_posteriors, plot_responses, plot_rounds


def study_figures(study: StudyResult) -> dict[str, Figure]:
    """Return every figure of a study by file name: gap, ranking, sets, coefficients, free runs."""
    figures: dict[str, Figure] = {}
    for equation in study.maps:
        suffix = f"_{equation}" if len(study.maps) > 1 else ""
        figures[f"gap_map{suffix}"] = gap_map(study, equation)
        if equation in study.traces:
            figures[f"gap_time{suffix}"] = gap_over_time(study, equation)
        if equation in study.hypotheses.index.unique(0):
            figures[f"ranking{suffix}"] = ranking(study, equation)
        if equation in study.rounds.index.unique(0):
            figures[f"rounds{suffix}"] = rounds(study, equation)
    if summary.added(study).size:
        figures["added_coefficients"] = added_coefficients(study)
    figures |= {f"free_run_{state}": free_run(study, state) for state in study.paths}
    return figures


def gap_parts(study: StudyResult, equation: str) -> tuple[str, ...]:
    """Return the parts of the gap map, "before" and "after"; the first alone where nothing was changed."""
    return ("before", "after") if summary.changed(study.maps[equation]) else ("before",)


def gap_limit(gap: GapMap) -> float:
    """Return the end of the colour range of a gap before and after: what is small beside the noise is pale."""
    inside = summary.support(gap)
    seen = inside if inside.any() else np.ones_like(inside)
    return max(float(gap.threshold), *(float(np.abs(values[seen]).max()) for values in (gap.before, gap.after)))


def gap_map(
    study: StudyResult,
    equation: str,
    parts: tuple[str, ...] | None = None,
    axes: Sequence[Axes] | np.ndarray | None = None,
) -> Figure:
    """Draw the gap over the state space before and after, on one scale; curves where it is over one variable.

    Colours go to the threshold at least: what is small beside the noise is pale. `parts` are "before", "after" or
    both, by default `gap_parts`, each on axes of its own; curves always show both.
    """
    gap = study.maps[equation]
    parts = parts or gap_parts(study, equation)
    inside = summary.support(gap)
    if len(gap.variables) == 1:
        values = (np.ravel(v) for v in (gap.before, gap.after, gap.probability, gap.after_probability))
        return plot_gap_curve(
            np.asarray(gap.axes[0]), *values,
            variable=gap.variables[0], variable_unit=gap.units[0], title=f"Gap in the equation for {equation}",
            threshold=gap.threshold, unit=gap.unit, inside=inside, samples=np.ravel(gap.samples), axes=axes,
        )  # fmt: skip
    title = f"{'Before: t' if len(gap_parts(study, equation)) > 1 else 'T'}he simulation as given"
    after = ("After: the extended model", gap.after, gap.after_probability)
    shown = {"before": (title, gap.before, gap.probability), "after": after}
    looks = {"before": style.BEFORE, "after": style.AFTER}
    return plot_gap_map(
        (np.asarray(gap.axes[0]), np.asarray(gap.axes[1])),
        {shown[part][0]: shown[part][1:] for part in parts},
        variables=gap.variables, units=gap.units, threshold=gap.threshold, unit=gap.unit,
        # One scale for both, also where they are drawn as two figures.
        limit=gap_limit(gap), inside=inside, samples=gap.samples,
        colours=[looks[part]["color"] for part in parts], axes=axes,
    )  # fmt: skip


def gap_over_time(study: StudyResult, equation: str, width: float = 9.0) -> Figure:
    """Draw the gap along the training data before and after, with its 90 % bands."""
    trace = study.traces[equation]
    return plot_gap_over_time(
        trace.time, *summary.trace_bands(trace),
        equation=equation, threshold=trace.threshold, probability=trace.probability, unit=trace.unit, width=width,
        **runs_of(study.train, trace.run),
    )  # fmt: skip


def ranking(
    study: StudyResult,
    equation: str,
    most: int = 10,
    letters: int = 400,
    axes: Sequence[Axes] | np.ndarray | None = None,
) -> Figure:
    """Draw the `most` probable hypotheses about one equation, likeliest first, by names of so many `letters`."""

    def label(slug: str) -> str:
        return shorter(name_of(study, slug), letters)

    table: Any = sorted_by_probability(study.hypotheses.xs(equation, level=0))
    # Three at least, of others those that are not next to impossible.
    table = table.head(min(most, max(int((table["probability"] >= 0.001).sum()), 3)))
    tied = summary.tied_sets(study, equation)
    return plot_hypotheses(
        [label(slug) for slug in table.index],
        table["probability"].to_numpy(float), table["share_left"].to_numpy(float),
        chosen=[label(summary.answer(study, equation))], tied=[label(slug) for slug in tied],
        title=f"Hypotheses about {study.train.target_label(equation)}", axes=axes,
    )  # fmt: skip


def rounds(study: StudyResult, equation: str) -> Figure:
    """Draw the likeliest set with no effect, with one, with two, and the share of the gap that each leaves."""
    table = study.rounds.xs(equation, level=0)
    labels, left = ["the simulation as given"], [1.0]
    for row in table.to_dict("records"):
        if row["verdict"] != "no gap":
            name = name_of(study, row["verdict"])
            labels.append(f"no effect: {name}" if row["verdict"] in STOPS else name)
            left.append(float(row["share_left"]))
    title = f"Likeliest sets of each size, {study.train.target_label(equation)}"
    return plot_rounds(labels, np.array(left, float), title=title)


def added_coefficients(study: StudyResult) -> Figure:
    """Draw the posterior of the coefficient of each effect that was added."""
    chosen = shown_effects(study).loc[summary.added(study)]
    coefficients = []
    for place, row in enumerate(chosen.to_dict("records")):
        numbers: dict[str, Any] = {name: float(row[name]) for name in ("mean", "sd", "lower", "upper")}
        about = {"name": row["name"], "term": formula(row["expression"]), "unit": row["unit"]}
        coefficients.append(Coefficient(**about, **numbers, draws=summary.added_draws(study, place)))
    return plot_posteriors(coefficients)


def free_run(study: StudyResult, state: str, width: float = 9.0) -> Figure:
    """Draw a state as measured and as the models run it from its start alone."""
    path = study.paths[state]
    data = run_data(study)
    return plot_free_run(
        path.time, path.measured, band_rows(path.before), band_rows(path.after),
        state=state, holds=path.holds, seen_as=seen_as(data, state), unit=data.unit(state), width=width,
        **runs_of(data, path.run),
    )  # fmt: skip


def next_experiment(found: NextExperiment, place: int = 0, width: float = 9.0) -> dict[str, Figure]:
    """Draw the responses of each sensor of an experiment under each explanation; figures by file name.

    Bands hold 90 % of the simulated outcomes, without noise; below, their difference from the likeliest explanation's
    median. `place` is the number of the experiment among those that are to be done together.

    Raises:
        InputError: Nothing was predicted, or fewer experiments were.
    """
    if not 0 <= place < len(found.responses):
        raise InputError(f"The answer has predictions of {len(found.responses)} experiments; there is none at {place}.")
    shown = found.responses[place]
    return {
        f"next_{channel}": plot_responses(
            shown.candidate.times, bands, names=shown.names, probability=shown.probability,
            noise=shown.candidate.sensors[channel], channel=shown.labels[channel], unit=shown.units[channel],
            time_unit=shown.units["t"], width=width,
        )
        for channel, bands in shown.bands.items()
    }  # fmt: skip


@mpl.rc_context(style.STYLE)
def plot_pooled(
    names: Sequence[str], mean: Sequence[float], sd: Sequence[float], whole: Pooled, label: str, width: float = 6.4
) -> Figure:
    """Draw a forest of one coefficient: its mean and standard deviation in each asset, the pooled ones, their mean."""
    order = np.argsort(mean)
    # Of more than 60, as many from the smallest to the largest.
    order = order[np.unique(np.linspace(0, len(order) - 1, min(60, len(order))).round().astype(int))]
    figure = style.new_figure(width, 1.3 + 0.24 * len(order))
    ax = figure.add_subplot()
    place = np.arange(len(order))
    ax.axvspan(whole.lower, whole.upper, color=style.LIGHT, alpha=0.6, lw=0, label="mean, 90 %")
    means, sds = (np.asarray(each)[order] for each in (mean, sd))
    pooled, pooled_sds = (np.asarray(each)[order] for each in (whole.each, whole.each_sd))
    own_bars, pooled_bars = INTERVAL_REACH * sds, INTERVAL_REACH * pooled_sds
    ax.errorbar(means, place + 0.13, xerr=own_bars, fmt="o", ms=3.5, color=style.BLUE, label="its own data")
    ax.errorbar(pooled, place - 0.13, xerr=pooled_bars, fmt="s", ms=3, color=style.DARK, label="pooled")
    ax.set_yticks(place, [style.plain(shorter(str(names[int(i)]), 28)) for i in order])
    ax.set(ylim=(-0.7, len(order) - 0.3), xlabel=style.plain(label))
    figure.legend(loc="outside lower left", ncols=3)
    return figure


def run_data(study: StudyResult) -> Trajectories:
    """Return the data that free runs are compared with."""
    return study.train if study.test is None or summary.shown_part(study) == "train" else study.test
