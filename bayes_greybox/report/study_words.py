"""What figures, pages and terminal call things: explanations, measures of the gap, the amended simulation."""

import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from bayes_greybox.discovery.study import StudyResult
from bayes_greybox.physics.simulation import FUNCTION, simulation_record

from .formatting import nmse_text, number, percent_text

METRICS: dict[str, tuple[str, str]] = {
    "unexplained share": (
        "Unexplained part of d({variable})/dt",
        "Share of the measured rate that neither the model's physics nor the noise explains.",
    ),
    "free-run NRMSE": (
        "Error of a free run, {variable}",
        "Started from a measured state and left alone: RMS error over the standard deviation of the measurement.",
    ),
    "derivative NMSE": (
        "Error of the predicted rate d({variable})/dt",
        "Mean square error over the variance of the measured rate.",
    ),
    "time to failure": ("Time until a free run fails", "How long the model can be run before it blows up."),
}
"""Title and explanation of each measure of the gap, the plainest first."""

NAMES = {
    "no gap": "no gap",
    "recalibrate": "recalibration of the simulation",
    "instrument": "the measurement",
    "unknown": "unknown",
}
"""Explanations that are not effects, as they are called in figures and tables."""

LIKELY = 0.5
"""A correction more probable than this is taken over into the amended simulation."""

MOST_CLOSED = 0.9999
"""Nobody is told that all of a gap is closed: what is left may only be less than the noise shows."""


def added(study: StudyResult) -> np.ndarray:
    """Row numbers of the effects that were added to the model."""
    return np.flatnonzero((study.effects["status"] == "added").to_numpy()) if len(study.effects) else np.zeros(0, int)


def name_of(study: StudyResult, slug: str) -> str:
    """Plain name of an explanation; the slug itself for an effect that the study's table does not have."""
    named = dict(zip(study.effects["slug"], study.effects["name"], strict=True))
    if slug in NAMES:
        return NAMES[slug]
    return " + ".join(named.get(part, part) for part in slug.split(" + "))


def marked(study: StudyResult, equation: str) -> tuple[list[str], list[str]]:
    """Slugs that were added to an equation, and those tied with them."""
    chosen = study.effects.iloc[added(study)]
    chosen = chosen[chosen["equation"] == equation]
    tied = [slug for slugs in chosen["tied_with"] for slug in slugs]
    return list(chosen["slug"]), tied


def shown_part(study: StudyResult) -> str:
    """Which part of the data the gap is summed up on: held-out data where there are any."""
    return "test" if "test" in study.gap.index.get_level_values(0) else "train"


def metric_value(study: StudyResult, metric: str, value: float) -> str:
    """A value of a measure of the gap as it is read."""
    if metric == "time to failure":
        unit = study.train.unit("t") or ""
        return "never" if not math.isfinite(value) else f"{number(value)} {unit}".strip()
    return nmse_text(value) if metric == "derivative NMSE" else percent_text(value)


def closed_text(closed: float) -> str:
    """What became of the gap, in words."""
    if not math.isfinite(closed):
        return ""
    if closed < -0.005:
        return f"the gap grew by {percent_text(-closed)}"
    return "unchanged" if closed < 0.005 else f"{percent_text(min(closed, MOST_CLOSED))} of the gap closed"


def metric_interval(study: StudyResult, metric: str, lower: float, upper: float) -> str:
    """The interval of a measure of the gap as it is read."""
    if metric == "time to failure":
        # A model that never fails has no time to failure; beyond its earliest failure it may never fail.
        ends = [metric_value(study, metric, value) for value in (lower, upper)]
        return " to ".join(dict.fromkeys(ends))
    if math.isnan(lower) or math.isnan(upper):
        return "–"
    return f"{metric_value(study, metric, lower)} to {metric_value(study, metric, upper)}"


def concentration(row: Mapping[str, Any]) -> str:
    """Share of the gap over share of the samples: 1 where the gap is spread evenly."""
    gap, samples = row["gap_share"], row["sample_share"]
    return f"{gap / samples:.1f}×" if samples > 0 and math.isfinite(gap) else "–"


def amended_simulation(study: StudyResult) -> str:
    """The simulation's expressions with the added effects and likely corrections, one line each; "" for a callable.

    Digits are those that the posterior standard deviation justifies.
    """
    given = simulation_record(study.base.simulation)
    if given == FUNCTION:
        return ""
    additions: dict[str, list[str]] = {}
    for row in study.effects.to_dict("records"):
        if row["status"] == "added":
            additions.setdefault(row["equation"], []).append(_product(row["mean"], row["sd"], row["expression"]))
    for (equation, term), row in zip(study.corrections.index, study.corrections.to_dict("records"), strict=True):
        if row["probability"] > LIKELY:
            additions.setdefault(str(equation), []).append(_product(row["mean"], row["sd"], str(term)))
    lines = []
    for equation, parts in additions.items():
        start = str((given or {}).get(equation, ""))
        text = f"{start} {' '.join(parts)}".strip().removeprefix("+ ")
        lines.append(f'{equation} = "{text}"')
    return "\n".join(lines)


def _product(mean: float, sd: float, expression: str) -> str:
    size = max(abs(mean), 1e-300)
    digits = 4 if not sd > 0 else min(8, max(2, math.ceil(math.log10(size / sd)) + 2))
    factor = f"({expression})" if re.search(r"[-+]", re.sub(r"\([^()]*\)", "", expression)) else expression
    return f"{'-' if mean < 0 else '+'} {abs(mean):.{digits}g}*{factor}"
