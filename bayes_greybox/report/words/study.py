"""What figures, pages and terminal call things: explanations and measures of the gap."""

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.discovery.decision.probabilities import STOPS
from bayes_greybox.discovery.decision.vetoes import MISFIT, NAMES_ALONE, worsened
from bayes_greybox.discovery.sensor_errors import bends
from bayes_greybox.discovery.sensor_errors.channels import (
    DELAY,
    DELAY_STEPS,
    GAIN,
    GAIN_SD,
    LAG,
    OFFSET,
    OFFSET_SD,
    STATES,
)
from bayes_greybox.discovery.sensor_errors.drift import DRIFT
from bayes_greybox.discovery.study import StudyResult
from bayes_greybox.physics.catalogue.loading import load_catalogue
from bayes_greybox.physics.catalogue.names import listing

from .formatting import (
    estimate,
    interval,
    listed,
    number,
    percent_text,
    probability_text,
    quantity,
    share_interval,
    share_text,
)

METRICS: dict[str, tuple[str, str]] = {
    "unexplained share": (
        "Unexplained part of {target}",
        "Share of the measured {rate} that neither the model nor the noise explains.",
    ),
    "free-run NRMSE": (
        "Error of a free run, {variable}",
        "Started from a measured state and left alone: RMS error over the standard deviation of the measurement.",
    ),
    "derivative NMSE": (
        "Error of the predicted rate {target}",
        "Mean square error over the variance of the measured rate.",
    ),
    "output NMSE": (
        "Error of the predicted {target}",
        "Mean square error over the variance of the measured {target}.",
    ),
    "sample NMSE": (
        "Error of the predicted samples, as forces on {target}",
        "Mean square error over the variance of the samples, whatever the path started from.",
    ),
    MISFIT: (
        "Error of the predicted samples over their noise, {target}",
        "One where the model explains all but the noise, and what its coefficients leave open.",
    ),
    NAMES_ALONE: (
        "Unexplained part of {target}, by names alone",
        "The same by what has a name, without the f of any shape that the amended model holds beside it.",
    ),
    "time to failure": ("Time until a free run fails", "How long the model can be run before it blows up."),
}
"""Title and explanation of each measure of the gap, the plainest first; see `metric_words`."""

NAMES = {
    "no gap": "no gap",
    "recalibrate": "recalibration of the simulation",
    "instrument": "the measurement",
    "unknown": "unknown",
}
"""Explanations that are not effects, as they are called in figures and tables."""

LIKELY = 0.5
"""A correction more probable than this is taken over into the amended simulation."""

GIVEN = ("position", "stored", "velocity", "level", "population", "state")
"""Roles whose column may well be in the data where none was recognised; another body's need not be there."""

ALL_STATES = "all states together"

LEAST_CLOSED = 1e-4
"""A gap that changes by less than this share of it is as it was."""

TWICE = 2.0
"""From this ratio on a rise is said as a multiple: hundreds of per cent are hard to read."""

MOST_CLOSED = 0.9999
"""Nobody is told that all of a gap is closed: what is left may only be less than the noise shows."""


def added(study: StudyResult) -> np.ndarray:
    """Row numbers of the effects that were added to the model."""
    return np.flatnonzero((study.effects["status"] == "added").to_numpy()) if len(study.effects) else np.zeros(0, int)


def name_of(study: StudyResult, slug: str) -> str:
    """Plain name of an explanation; that of the catalogue for an effect that the study's table does not have."""
    named = dict(zip(study.effects["slug"], study.effects["name"], strict=True))
    if slug in NAMES:
        return NAMES[slug]
    if slug.endswith(")") and "=" in slug:
        # The same effect on other columns, as "cube(r=u)".
        own, _, columns = slug.removesuffix(")").partition("(")
        return f"{name_of(study, own)} of {listed(sorted({part.split('=')[1] for part in columns.split(', ')}))}"
    return listing(named.get(part) or _catalogued(part) for part in slug.split(" + "))


def named_in(study: StudyResult, row: Mapping[str, Any]) -> str:
    """Plain name of an effect of the table, with its columns where another row is the same on others.

    Args:
        study: The study.
        row: Of its table of effects.
    """
    table = study.effects
    alike = (table["equation"] == row["equation"]) & (table["slug"] == row["slug"])
    of = row.get("quantity", "").split(", ")
    return f"{row['name']} of {listed(of)}" if alike.sum() > 1 and any(of) else row["name"]


@cache
def _catalogued(slug: str) -> str:
    """Name in the package's catalogue; of an effect of a user's own file its slug as words."""
    known = {effect.slug: effect.name for effect in load_catalogue("all")}
    words = slug.replace("-", " ")
    return known.get(slug, words[:1].upper() + words[1:])


def reversed_text(row: Mapping[str, Any]) -> str:
    """That an effect of the table has the other sign than usual, and what it then does; "" where it has not.

    Args:
        row: Of the table of effects; files of before say nothing of signs.
    """
    return f"sign reversed: “{words}”" if (words := row.get("reverse")) else ""


def answer(study: StudyResult, equation: str) -> str:
    """Which row of the hypotheses of an equation the study settled on: a set of effects, or what needs none."""
    chosen, _ = marked(study, equation)
    if chosen:
        return together(chosen)
    if len(study.maps) <= 1 and study.verdict in STOPS:
        return study.verdict
    # Of several equations the verdict is that of one; an equation without an effect has its likeliest row without one.
    rows = rows_of(study.hypotheses, equation)
    alone = {name: p for name, p in zip(rows.index, rows["probability"], strict=True) if name in STOPS}
    return max(alone, key=lambda name: alone[name], default=study.verdict)


def rows_of(table: pd.DataFrame, key: str, level: int | str = 0) -> pd.DataFrame:
    """Rows of a table whose index has a value at a level, without that level; none where it has none."""
    return table.xs(key, level=level) if key in table.index.get_level_values(level) else table.iloc[:0].droplevel(level)


def together(slugs: Iterable[str]) -> str:
    """The name of a set of effects in the tables of a study."""
    return " + ".join(sorted(slugs))


def set_label(study: StudyResult, name: str) -> str:
    """A set of effects with its size; what needs none says so."""
    return f"no effect: {name_of(study, name)}" if name in STOPS else name_of(study, name)


def tied_sets(study: StudyResult, equation: str) -> list[str]:
    """Sets that these data do not tell from an equation's answer: another effect in the place of one of it."""
    chosen = study.effects.iloc[added(study)]
    chosen = chosen[chosen["equation"] == equation]
    slugs = list(chosen["slug"])
    return [
        together([*(slug for slug in slugs if slug != own), other])
        for own, others in zip(chosen["slug"], chosen["tied_with"], strict=True)
        for other in others
    ]


def free_run_errors(gap: pd.DataFrame) -> pd.DataFrame:
    """Errors of the free runs by state, on held-out data where there are any; empty where none were integrated."""
    return rows_of(_free_runs(gap), free_run_part(gap), "data")


def free_run_part(gap: pd.DataFrame) -> str:
    """Which part of the data the free runs are judged on: held-out data, unless there are none or they are at rest."""
    return "test" if "test" in _free_runs(gap).index.get_level_values("data") else "train"


def _free_runs(gap: pd.DataFrame) -> pd.DataFrame:
    rows = rows_of(gap, "free-run NRMSE", "metric")
    # A state at rest has no error to speak of.
    return rows.dropna(subset=["before"])


def not_helped(gap: pd.DataFrame) -> tuple[str, ...]:
    """States whose free run, on the mean, is no better after than before, though not surely worse."""
    errors = free_run_errors(gap)
    better = dict(zip(errors.index, errors["after"] < errors["before"], strict=True))
    return tuple(str(name) for name, good in better.items() if not good and name not in worse_runs(gap))


def worse_runs(gap: pd.DataFrame) -> tuple[str, ...]:
    """States whose free run gets worse."""
    return tuple(name for _, metric, name in worsened(gap) if metric == "free-run NRMSE")


def marked(study: StudyResult, equation: str) -> tuple[list[str], list[str]]:
    """Slugs that were added to an equation, and those tied with them."""
    chosen = study.effects.iloc[added(study)]
    chosen = chosen[chosen["equation"] == equation]
    tied = [slug for slugs in chosen["tied_with"] for slug in slugs]
    return list(chosen["slug"]), tied


def shown_part(study: StudyResult) -> str:
    """Which part of the data the gap is summed up on: held-out data where there are any."""
    return "test" if "test" in study.gap.index.get_level_values(0) else "train"


def not_weighed(study: StudyResult) -> list[str]:
    """How many effects were not weighed for want of a role that can be given, by role; whole sentences but the dot."""
    found = []
    for role in GIVEN:
        start = f"no column plays the role {role!r}"
        slugs = {slug for (_, slug), why in study.left_out.items() if why.startswith(start)}
        if slugs:
            many = f"{len(slugs)} effects were" if len(slugs) > 1 else "1 effect was"
            found.append(f"{many} not weighed: {start}; give roles={{{role!r}: ...}}, in a file [study.roles] {role}")
    return found


def metric_words(study: StudyResult, metric: str, variable: str) -> tuple[str, str]:
    """Title and explanation of a measure of the gap in an equation, or in the free run of a state."""
    data, (title, about) = study.train, METRICS[metric]
    words = {"target": data.target_label(variable), "rate": data.target_in_words(variable), "variable": variable}
    return title.format(**words), about.format(**words)


def metric_value(study: StudyResult, metric: str, value: float) -> str:
    """A value of a measure of the gap as it is read."""
    if metric == "time to failure":
        return quantity(value, study.train.unit("t")) if math.isfinite(value) else "never"
    return number(value, 3) if metric == MISFIT else share_text(value)


def closed_share(closed: float) -> str:
    """The share of the gap that is closed, never all of it; what grew is below nothing, or a multiple."""
    if abs(closed) < LEAST_CLOSED:
        return "unchanged"
    if math.isfinite(closed) and 1 - closed >= TWICE:
        return f"grew to {_times(1 - closed)}"
    return percent_text(min(closed, MOST_CLOSED))


def risen(ratio: float) -> str:
    """By how much something rose: in per cent below twice what it was, from there on as a multiple.

    Args:
        ratio: After over before, above one.
    """
    return f"by {percent_text(ratio - 1)}" if ratio < TWICE else f"to {_times(ratio)} what it was"


def _times(ratio: float) -> str:
    """A multiple to two digits, such as 23000 times, in one piece."""
    return f"{number(float(f'{ratio:.2g}'), 2)}\u00a0times"


def closed_text(closed: float, denied: bool = False) -> str:
    """What became of the gap, in words.

    Args:
        closed: Share that is closed.
        denied: Whether the free run does not see it closed, or nothing has a name: then nothing is called so.
    """
    if not math.isfinite(closed):
        return ""
    if closed < -0.005:
        return f"the gap grew {risen(1 - closed)}"
    if closed < 0.005:
        return "unchanged"
    size = closed_share(closed)
    return f"lower by {size}" if denied else f"{size} of the gap closed"


def metric_interval(study: StudyResult, metric: str, lower: float, upper: float) -> str:
    """The interval of a measure of the gap as it is read."""
    if metric == "time to failure":
        # A model that never fails has no time to failure; beyond its earliest failure it may never fail.
        ends = [metric_value(study, metric, value) for value in (lower, upper)]
        return " to ".join(dict.fromkeys(ends))
    if math.isnan(lower) or math.isnan(upper):
        return "–"
    return interval(lower, upper) if metric == MISFIT else share_interval(lower, upper)


def suspect_size(row: Mapping[str, Any]) -> tuple[str, str, str]:
    """Size of a suspect about the measurement, its 90 % interval in the same unit, and both in samples for a delay."""
    if row["suspect"] == GAIN:
        span = f"{percent_text(row['lower'])} to {percent_text(row['upper'])}"
        return f"{percent_text(row['mean'])} ± {percent_text(row['sd'])}", span, "–"
    if math.isnan(row["sd"]):
        return (quantity(row["mean"], row["unit"], 2) if row["unit"] else "–"), "–", "–"
    span, samples = interval(row["lower"], row["upper"]), "–"
    if math.isfinite(row["samples"]):
        samples = f"{number(row['samples'], 2)} ({interval(row['lower_samples'], row['upper_samples'])})"
    return estimate(row["mean"], row["sd"], row["unit"]), span, samples


def same_as(study: StudyResult, equation: str) -> dict[str, dict[str, Any]]:
    """Suspects about the measurement that do what another does, or a coefficient that is off; see `study.settings`.

    Args:
        study: The study; one of before kept none.
        equation: The equation in which they do.
    """
    return dict(study.settings.get("same as", {}).get(equation, {}))


def suspects_weighed(study: StudyResult) -> list[tuple[str, str]]:
    """Every suspect about the measurement, and how likely and how large it was taken to be beforehand."""
    odds = study.settings.get("prior odds")
    if not odds:
        return []
    states, inputs = study.train.state_names, study.train.input_names
    same = [same_as(study, name) for name in study.maps]

    def weighed(kind: str, channels: Sequence[str]) -> str:
        # What is the same column as another suspect's, or as a coefficient's, in every equation is told as that.
        own = [name for name in channels if not all(f"{kind} of {name}" in twins for twins in same)]
        return f"{kind.capitalize()} of {', '.join(ALL_STATES if name == STATES else name for name in own)}"

    labels = [study.train.target_label(name) for name in study.maps]
    # A rate that a filter computed, and a state that is one, have no sensor of their own.
    if (computed := study.train.filter) is not None:
        rates = [study.train.target_label(name) for name in study.maps if not computed.one_sensor(name)]
        states = tuple(name for name in states if computed.source(name) == name)
    else:
        rates = labels
    delays = [*rates, *([STATES] if inputs else []), *(states if len(states) > 1 else ()), *inputs]
    channels = [*rates, *states, *inputs]
    each, noise = (probability_text(odds[key]) for key in ("suspect", "noise"))
    lagging = dict.fromkeys(row["channel"] for row in study.instrument.to_dict("records") if row["suspect"] == LAG)
    share = f"{probability_text(odds.get('slow_sensor', 0.5))}: it, or that of an input, which does the same"
    lags = [(f"Lag of {name}", share) for name in lagging]
    # Rows of samples have sensors whose readings are no straight line.
    sampled = computed is None and not set(study.maps) & set(study.train.derivatives)
    bending = (study.train.samples or study.train).state_names if sampled else ()
    at_ends = f"±\u00a0{percent_text(bends.BEND_SD, 0)} at the end of the range"
    of_rms = f"size ±\u00a0{percent_text(OFFSET_SD, 0)} of the channel's RMS"
    return [
        (weighed(DELAY, delays), f"{each} each; size ±\u00a0{DELAY_STEPS:g}\u00a0samples"),
        (weighed(GAIN, channels), f"{each} each; size ±\u00a0{percent_text(GAIN_SD, 0)}"),
        (weighed(OFFSET, channels), f"{each} each; {of_rms}"),
        *([(weighed(DRIFT, rates), f"{each} each; {of_rms}")] if rates else []),
        *[(weighed(kind, bending), f"{each} each; size {at_ends}") for kind in bends.BEND_ERRORS if bending],
        *lags,
        *(
            (
                f"{key.capitalize()}{f' in {rate}' if len(labels) > 1 else ''}",
                f"as {other['what']}, which does the same",
            )
            for rate, twins in zip(labels, same, strict=True)
            for key, other in twins.items()
        ),
        ("Noise that is correlated, that depends on the state, that has outliers", f"{noise} each"),
    ]


def concentration(row: Mapping[str, Any]) -> str:
    """Share of the gap over share of the samples: 1 where the gap is spread evenly."""
    gap, samples = row["gap_share"], row["sample_share"]
    return f"{gap / samples:.1f}×" if samples > 0 and math.isfinite(gap) else "–"


def whole_term(row: Mapping[str, Any]) -> str:
    """An effect's formula with the rates of its hidden states, if it remembers."""
    rates = [f"d({name})/dt = {rate}" for name, rate in (row.get("hidden") or {}).items()]
    return ", ".join([row["expression"], *rates])
