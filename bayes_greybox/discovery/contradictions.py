"""Coded findings about a study's verdict: what contradicts it, and what was looked at and does not."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bayes_greybox.criticism.convergence import convergence

from . import summary
from .answer.checks import LOO_PIT, WHITENESS
from .answer.instrument import IN_MODEL
from .decision.probabilities import STOPS, UNKNOWN_KIND
from .decision.vetoes import FAILURE, left_over, misfits, worsened
from .sensor_errors.channels import DELAY_STEPS
from .study import StudyResult
from .ties import sorted_by_probability

MOST_DELAYED_SAMPLES = 3.0 * DELAY_STEPS
"""Samples from which on a channel is hardly late, but something else: three prior standard deviations of a delay."""


@dataclass(frozen=True)
class Finding:
    """One thing that could contradict a verdict, of an equation or ("") the whole study; None: not looked at."""

    code: str
    against: bool | None
    equation: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)


def notable(study: StudyResult) -> float:
    """Return the probability from which on another explanation contradicts the verdict."""
    return 1 - study.criteria.named


def findings(study: StudyResult) -> Iterator[Finding]:
    """Yield checks, what remains, runner-up, measurement, rows, ties, held-out samples, free run and sampler."""
    for name in study.maps or study.hypotheses.index.unique(0):
        yield from _checks(study, name)
        yield from _explanations(study, name)
        yield from _measurement(study, name)
    for text in study.warnings:
        yield Finding("rows", True, values={"text": text})
    for role, count in summary.not_weighed(study).items():
        yield Finding("not weighed", None, values={"role": role, "count": count})
    for tie in study.ties:
        yield Finding("tie", True, values={"slugs": tie["slugs"]})
    if not study.ties and summary.added(study).size and study.verdict != "one of":
        yield Finding("no tie", False)
    left = left_over(study.gap, study.criteria)
    for name, misfit in misfits(study.gap, "test").items():
        yield Finding("held-out samples", name in left, values={"misfit": misfit})
    yield _free_run(study)
    yield _sampler(study)


def _checks(study: StudyResult, equation: str) -> Iterator[Finding]:
    table = summary.rows_of(study.checks, equation)
    for name, row in zip(table.index, table.to_dict("records"), strict=True):
        yield Finding("check", not row["ok"], equation, {"name": name, **row})
    if not {WHITENESS, LOO_PIT} & set(table.index):
        yield Finding("residuals not tested", None, equation, {"enough": study.checkable(equation)})


def _explanations(study: StudyResult, equation: str) -> Iterator[Finding]:
    """Yield what remains beside the answer, and the likeliest other explanation."""
    table = sorted_by_probability(summary.rows_of(study.hypotheses, equation))
    own, records, least = summary.answer(study, equation), table.to_dict("index"), notable(study)
    if UNKNOWN_KIND in records:
        p = float(records[UNKNOWN_KIND]["probability"])
        share = float(records[own]["share_left"]) if own in records else math.nan
        if own == UNKNOWN_KIND:
            # Unknown is the answer, so that all else contradicts it.
            yield Finding("other explanations", p < study.criteria.missing, equation, {"probability": 1 - p})
        else:
            against = p >= least or share >= study.criteria.remainder
            yield Finding("remains", against, equation, {"probability": p, "share": share})
    # Beside effects the unknown is what remains, and no rival of one set among many.
    others = [str(name) for name in records if name != own and (own in STOPS or name != UNKNOWN_KIND)]
    if others:
        against, values = _runner_up(study, own, others[0], records)
        yield Finding("runner-up", against, equation, values)


def _runner_up(
    study: StudyResult, own: str, other: str, records: Mapping[Any, Mapping[Any, Any]]
) -> tuple[bool, dict[str, Any]]:
    """Return whether the likeliest other explanation contradicts an answer, and the two probabilities."""
    p, q = (float(records[key]["probability"]) if key in records else math.nan for key in (own, other))
    values: dict[str, Any] = {"name": other, "probability": q, "answer": p, "of": "set"}
    if own in STOPS:
        values["of"] = "answer"
        if own != UNKNOWN_KIND and other not in STOPS:
            nothing = [each for each in STOPS if each != UNKNOWN_KIND and each in records]
            values |= {"of": "nothing", "answer": sum(float(records[each]["probability"]) for each in nothing)}
        elif q > p and other not in STOPS:
            values["share"] = records[other]["share_left"]
    return q >= notable(study), values


def _measurement(study: StudyResult, equation: str) -> Iterator[Finding]:
    """Yield sensor errors that are likely, though not in the model, and delays that are too large for delays."""
    rows = [row for row in study.instrument.to_dict("records") if row["equation"] == equation]
    late = [row for row in rows if row["status"] == IN_MODEL and abs(row["samples"]) > MOST_DELAYED_SAMPLES]
    if late:
        yield Finding("hardly late", True, equation, {"rows": late})
    likely = [row for row in rows if row["status"] != IN_MODEL and row["probability"] >= notable(study)]
    if likely:
        yield Finding("possible errors", True, equation, {"rows": likely})
    elif not late:
        yield Finding("no further error", False, equation)


def _free_run(study: StudyResult) -> Finding:
    gap = study.gap
    errors, part = summary.free_run_errors(gap), summary.free_run_part(gap)
    if not len(errors):
        return Finding("free run", None, values={"change": "not integrated"})
    worse, idle = summary.worse_runs(gap, study.criteria), summary.not_helped(gap, study.criteria)
    sooner = next((key for key in worsened(gap, study.criteria) if key[1] == FAILURE), None)
    if worse or sooner:
        return Finding("free run", True, values={"change": "worse", "part": part, "states": worse, "sooner": sooner})
    every = {"part": part, "states": tuple(errors.index)}
    if not summary.added(study).size and study.verdict in STOPS and study.verdict != "recalibrate":
        # Where nothing was added, only the sensors, or f of any shape, changed the model.
        change = "by sensors" if study.verdict == "instrument" else "by f"
        # A free run may change by so much where nothing but the integrator differs.
        least = np.maximum(1e-3 * errors["before"], study.criteria.integrator)
        moved = np.abs(errors["after"] - errors["before"]) > least
        change = "nothing added" if set(idle) == set(errors.index) or not np.any(moved) else change
        return Finding("free run", False, values={"change": change, **every})
    if idle:
        return Finding("free run", True, values={"change": "no better", "part": part, "states": idle})
    return Finding("free run", False, values={"change": "better", **every})


def _sampler(study: StudyResult) -> Finding:
    if study.fit is None:
        return Finding("sampler", None, values={"state": "not sampled"})
    verdict, apart = convergence(study.fit), summary.sampler_contradictions(study)
    if apart:
        reasons = () if verdict.mixed else verdict.reasons
        return Finding("sampler", True, values={"state": "apart", "apart": apart, "reasons": reasons})
    state = "converged" if verdict.ok else "few draws" if verdict.mixed else "not converged"
    return Finding("sampler", not verdict.mixed, values={"state": state, "reasons": verdict.reasons})
