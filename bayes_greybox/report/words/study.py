"""Words for what a study holds: hypotheses, measures of the gap, sensor errors, and the unnamed discrepancy."""

import math
from collections.abc import Mapping
from functools import cache
from typing import Any

from bayes_greybox.discovery import summary
from bayes_greybox.discovery.answer.gap import NMSES, SHARE, within_noise
from bayes_greybox.discovery.decision.vetoes import MISFIT, NAMES_ALONE
from bayes_greybox.discovery.sensor_errors import bends, channels
from bayes_greybox.discovery.study import StudyResult
from bayes_greybox.physics.catalogue.loading import load_catalogue
from bayes_greybox.physics.catalogue.names import listing, slug_and_columns

from . import formatting as fmt

METRICS: dict[str, tuple[str, str]] = {
    "unexplained share": ("Unexplained part of {target}",
        "Share of the measured {rate} that neither the model nor the noise explains."),
    "free-run NRMSE": ("Error of a free run, {variable}",
        "Started from a measured state and left alone: RMS error over the standard deviation of the measurement."),
    "derivative NMSE": ("Error of the predicted rate {target}",
        "Mean square error over the variance of the measured rate."),
    "output NMSE": ("Error of the predicted {target}",
        "Mean square error over the variance of the measured {target}."),
    "sample NMSE": ("Error of the predicted samples, as forces on {target}",
        "Mean square error over the variance of the samples, wherever the path started."),
    MISFIT: ("Error of the predicted samples over their noise, {target}",
        "One if the model explains all but the noise and its coefficients' uncertainty."),
    NAMES_ALONE: ("Unexplained part of {target}, by names alone",
        "The same by named parts alone, without the f that the extended model has beside them."),
    "time to failure": ("Time until a free run fails", "How long the model can be run before it blows up."),
}  # fmt: skip
"""Title and explanation of each measure of the gap, the plainest first; see `metric_words`."""

NAMES = {
    "no gap": "no gap",
    "recalibrate": "recalibration of the simulation",
    "instrument": "the measurement",
    "unknown": "unknown",
}
"""Names of the hypotheses without effects, in figures and tables."""


def name_of(study: StudyResult, name: str) -> str:
    """Return the plain name of a hypothesis, of a set of effects, or of an effect on its columns.

    The package's catalogue names effects that the study's table does not have.
    """
    if name in NAMES:
        return NAMES[name]
    slug, columns = slug_and_columns(name)
    if columns:
        return f"{name_of(study, slug)} of {fmt.listed(columns)}"
    named = dict(zip(study.effects["slug"], study.effects["name"], strict=True))
    return listing(named.get(part) or _catalogued(part) for part in name.split(" + "))


def named_in(study: StudyResult, row: Mapping[str, Any]) -> str:
    """Return the plain name of an effect, with its columns if the table also has it on others."""
    table = study.effects
    alike = (table["equation"] == row["equation"]) & (table["slug"] == row["slug"])
    columns = row.get("quantity", "").split(", ")
    return f"{row['name']} of {fmt.listed(columns)}" if alike.sum() > 1 and any(columns) else row["name"]


@cache
def _catalogued(slug: str) -> str:
    """Return the name in the package's catalogue; for an effect from a user's file, its slug as words."""
    catalogue = {effect.slug: effect.name for effect in load_catalogue("all")}
    words = slug.replace("-", " ")
    return catalogue.get(slug, words[:1].upper() + words[1:])


def reversed_text(row: Mapping[str, Any]) -> str:
    """Return a note that an effect has the opposite of its usual sign, and its meaning; "" if it has not."""
    return f"sign reversed: “{words}”" if (words := row.get("reverse")) else ""


def remembered(study: StudyResult, equation: str) -> str:
    """Return what the discrepancy likely is, as in "is a law of y (probability 0.97)"; "" if it is not known."""
    of_channel = {"drift": "changes with time", "law": "follows another law"}
    of_none = {
        "law": "is a law of the states",
        "time": "is something in time, of the machine or of its sensor",
        "memory": "remembers",
    }
    laws, texts = [], []
    for each in summary.remainders(study, equation):
        p = fmt.probability_text(each.probability)
        if each.kind == summary.QUANTITY:
            laws.append(f"a law of {each.of.replace(', ', ' and ')} (probability {p})")
        elif each.of:
            texts.append(f"{of_channel.get(each.kind, 'remembers')} ({each.kind} of {each.of}, probability {p})")
        else:
            texts.append(f"{of_none[each.kind]} (probability {p})")
    return "; ".join([*([f"is {' and '.join(laws)}"] if laws else []), *texts])


def metric_words(study: StudyResult, metric: str, variable: str) -> tuple[str, str]:
    """Return title and explanation of a measure of the gap in an equation, or in the free run of a state."""
    data, (title, about) = study.train, METRICS[metric]
    words = {"target": data.target_label(variable), "rate": data.target_in_words(variable), "variable": variable}
    return title.format(**words), about.format(**words)


def metric_value(study: StudyResult, metric: str, value: float) -> str:
    """Return a value of a measure of the gap as text."""
    if metric == "time to failure":
        return fmt.quantity(value, study.train.unit("t")) if math.isfinite(value) else "never"
    return fmt.number(value, 3) if metric == MISFIT else fmt.share_text(value)


def metric_interval(study: StudyResult, metric: str, lower: float, upper: float) -> str:
    """Return the interval of a measure of the gap as text."""
    if metric == "time to failure":
        # A model that never fails has no time to failure; the upper end alone may be "never", too.
        ends = [metric_value(study, metric, value) for value in (lower, upper)]
        return " to ".join(dict.fromkeys(ends))
    if math.isnan(lower) or math.isnan(upper):
        return "–"
    return fmt.interval(lower, upper) if metric == MISFIT else fmt.share_interval(lower, upper)


def closed_share(closed: float) -> str:
    """Return the closed share of the gap, never 100 %; by how much it grew stand before and after beside it."""
    if abs(closed) < summary.LEAST_CLOSED:
        return "unchanged"
    # What is left of it may only be hidden by the noise.
    return "grew" if closed < 0 else fmt.percent_text(min(closed, 0.9999))


def closed_heading(study: StudyResult) -> str:
    """Return the heading of the shares by which errors shrank: nothing is called closed that is denied."""
    return "lower by" if summary.is_denied(study) else "closed"


def closed_cell(study: StudyResult, part: str, row: Mapping[str, Any]) -> str:
    """Return what became of an error, by its row of the gap table; within the noise there was no gap to close."""
    return "within the noise" if in_noise(study, part, row) else closed_share(row["closed"])


def in_noise(study: StudyResult, part: str, row: Mapping[str, Any]) -> bool:
    """Return whether a row of the gap table is of a misfit that was within the noise before."""
    n_row = summary.rows_by_part(study).get(part)
    of_gap = row["metric"] in (SHARE, NAMES_ALONE, MISFIT, *NMSES)
    return of_gap and within_noise(study.gap, part, row["variable"], n_row)


def risen(ratio: float) -> str:
    """Return by how much something rose: in per cent below a doubling, from there on as a multiple of two digits."""
    if ratio < 2:
        return f"by {fmt.percent_text(ratio - 1)}"
    return f"to {fmt.number(float(f'{ratio:.2g}'), 2)}\u00a0times what it was"


def closed_text(closed: float, denied: bool = False) -> str:
    """Return in words what became of the gap.

    Args:
        closed: Share that is closed.
        denied: True if the free run contradicts it, or nothing has a name: then nothing is called closed.
    """
    if not math.isfinite(closed):
        return ""
    if closed < -0.005:
        return f"the gap grew {risen(1 - closed)}"
    if closed < 0.005:
        return "unchanged"
    size = closed_share(closed)
    return f"lower by {size}" if denied else f"{size} of the gap closed"


def suspect_size(row: Mapping[str, Any]) -> tuple[str, str, str]:
    """Return the size of a sensor error, its 90 % interval in the same unit, and both in samples for a delay."""
    if row["suspect"] == channels.GAIN:
        span = f"{fmt.percent_text(row['lower'])} to {fmt.percent_text(row['upper'])}"
        return f"{fmt.percent_text(row['mean'])} ± {fmt.percent_text(row['sd'])}", span, "–"
    if math.isnan(row["sd"]):
        return (fmt.quantity(row["mean"], row["unit"], 2) if row["unit"] else "–"), "–", "–"
    span, samples = fmt.interval(row["lower"], row["upper"]), "–"
    if math.isfinite(row["samples"]):
        samples = f"{fmt.number(row['samples'], 2)} ({fmt.interval(row['lower_samples'], row['upper_samples'])})"
    return fmt.estimate(row["mean"], row["sd"], row["unit"]), span, samples


def suspects_weighed(study: StudyResult) -> list[tuple[str, str]]:
    """Return every weighed sensor error and kind of noise, with its prior probability and size."""
    weighed = summary.channels_weighed(study)
    if not weighed:
        return []
    odds, labels = study.settings["prior odds"], [study.train.target_label(name) for name in study.maps]
    each, noise = (fmt.probability_text(odds[key]) for key in ("suspect", "noise"))
    of_rms = f"±\u00a0{fmt.percent_text(channels.OFFSET_SD, 0)} of the channel's RMS"
    sizes = {
        channels.DELAY: f"±\u00a0{channels.DELAY_STEPS:g}\u00a0samples",
        channels.GAIN: f"±\u00a0{fmt.percent_text(channels.GAIN_SD, 0)}",
        **dict.fromkeys((channels.OFFSET, channels.DRIFT), of_rms),
        channels.NOISE: "what smoothing takes off",
        channels.DEPARTURE: "what the other state of its pair lacks",
        **dict.fromkeys(bends.BEND_ERRORS, f"±\u00a0{fmt.percent_text(bends.BEND_SD, 0)} at the end of the range"),
    }
    rows = []
    for kind, names in weighed.items():
        named = ", ".join("all states together" if name == channels.STATES else name for name in names)
        rows.append((f"{kind.capitalize()} of {named}", f"{each} each; size {sizes[kind]}"))
    for equation, rate in zip(study.maps, labels, strict=True):
        where = f" in {rate}" if len(labels) > 1 else ""
        rows += [
            (f"{key.capitalize()}{where}", f"as {other['what']}, which does the same")
            for key, other in summary.same_as(study, equation).items()
        ]
    return [*rows, ("Noise that is correlated, that depends on the state, that has outliers", f"{noise} each")]


def concentration(row: Mapping[str, Any]) -> str:
    """Return the share of the gap over the share of the samples: 1 where the gap is spread evenly."""
    gap, samples = row["gap_share"], row["sample_share"]
    return f"{gap / samples:.1f}×" if samples > 0 and math.isfinite(gap) else "–"


def whole_term(row: Mapping[str, Any]) -> str:
    """Return an effect's formula with the rates of its hidden states, if any."""
    rates = [f"d({name})/dt = {rate}" for name, rate in (row.get("hidden") or {}).items()]
    return ", ".join([row["expression"], *rates])
