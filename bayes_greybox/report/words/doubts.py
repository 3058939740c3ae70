"""What speaks against a study's verdict, and what was looked at and does not: for pages, terminal and record alike."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from bayes_greybox.criticism.convergence import convergence
from bayes_greybox.discovery.answer.instrument import IN_MODEL
from bayes_greybox.discovery.decision.criteria import Criteria
from bayes_greybox.discovery.decision.probabilities import STOPS
from bayes_greybox.discovery.decision.vetoes import left_in_words, left_over, misfits, worse_in_words, worsened
from bayes_greybox.discovery.sensor_errors.channels import DELAY_STEPS
from bayes_greybox.discovery.study import StudyResult
from bayes_greybox.discovery.ties import sorted_by_probability
from bayes_greybox.physics.catalogue.names import within

from .formatting import listed, number, numbers_in, p_text, probability_text, share_text
from .remainder import remembered
from .sampled import sampled_elsewhere
from .study import (
    added,
    answer,
    free_run_errors,
    free_run_part,
    metric_value,
    name_of,
    not_helped,
    not_weighed,
    rows_of,
    worse_runs,
)

NEGLIGIBLE = Criteria().remainder
"""Share of the gap from which on what remains beside an answer speaks against it."""

NOTABLE = 1 - Criteria().named
"""Another explanation speaks against the verdict from this probability on."""

FAR = 3.0
"""A delay of more than so many of its prior standard deviations is hardly one."""

FINE = {
    "whiteness": "residuals are white ({})",
    "LOO-PIT": "the noise has the shape that the model gives it (LOO-PIT, {})",
    "motion": "the samples move as is said of their rate ({})",
    "linearity": "samples are linear enough in what was found, within its posterior ({})",
}
"""What a check that is passed says, by the first word of its name, with its p-value or k-hat."""

TOPICS = {"motion": "Motion", "linearity": "Linear rows"}
"""What a check looks at, by the first word of its name, where that is not the residuals."""


@dataclass(frozen=True)
class Doubt:
    """One thing that could speak against a verdict.

    Attributes:
        topic: What was looked at, in a word or two.
        text: What was found, in words with its numbers.
        against: Whether it speaks against the verdict; None where it could not be looked at.
    """

    topic: str
    text: str
    against: bool | None


def doubts(study: StudyResult) -> list[Doubt]:
    """Checks, the free run, what remains, runner-up, ties, the measurement, what was not weighed, and the sampler.

    Args:
        study: The study.
    """
    found: list[Doubt] = []
    for equation in study.maps or study.hypotheses.index.unique(0):
        about = f" of {study.train.target_label(equation)}" if len(study.maps) > 1 else ""
        parts = (*_checks(study, equation), *_explanations(study, equation), *_measurement(study, equation))
        found += [replace(each, topic=f"{each.topic}{about}") for each in parts]
    rows = [Doubt("Rows", text, True) for text in study.warnings]
    rows += [Doubt("Not weighed", text, None) for text in not_weighed(study)]
    more = (*_ties(study), *_held_out(study), _free_run(study), _sampler(study))
    return [_said(each) for each in (*found, *rows, *more)]


def _said(doubt: Doubt) -> Doubt:
    return replace(doubt, text=doubt.text[:1].upper() + doubt.text[1:])


def _checks(study: StudyResult, equation: str) -> Iterator[Doubt]:
    table = rows_of(study.checks, equation)
    for name, row in zip(table.index, table.to_dict("records"), strict=True):
        p = p_text(row["p"]) if math.isnan(row["khat"]) else f"k-hat {number(float(row['khat']), 2)}"
        kind, _, state = name.partition(" of ")
        topic = f"{TOPICS[kind]}{f' of {state}' if state else ''}" if kind in TOPICS else "Residuals"
        yield Doubt(topic, FINE[kind].format(p) if row["ok"] else f"{row['text']} ({name}, {p})", not row["ok"])
    if not any(name in FINE and name not in TOPICS for name in table.index):
        why = "there is a rest beside what has a name, of any shape or a process in time, which takes up what the "
        why = f"{why}tests would find" if study.checkable(equation) else "the rows that count are too few"
        yield Doubt("Residuals", f"not tested: {why}", None)


def _explanations(study: StudyResult, equation: str) -> Iterator[Doubt]:
    """What remains beside the answer, and the likeliest other explanation."""
    table = sorted_by_probability(rows_of(study.hypotheses, equation))
    own, records = answer(study, equation), table.to_dict("index")
    if "unknown" in records:
        p, remembers = float(records["unknown"]["probability"]), remembered(study, equation)
        if own == "unknown":
            # Unknown is the answer, so that what speaks against it is all else.
            text = f"what has a name, or needs none, has probability {probability_text(1 - p)} in all"
            also = f"; what is missing {remembers}" if remembers else ""
            yield Doubt("Other explanations", f"{text}{also}", p < 0.5)
        else:
            text = f"the probability that something unknown is missing is {probability_text(p)}"
            text += f"; if so, it {remembers}" if remembers else ""
            share = float(records[own]["share_left"]) if own in records else math.nan
            left = "" if math.isnan(share) else f"; beside the answer a rest carries {share_text(share)} of the gap"
            yield Doubt("What remains", f"{text}{left}", p >= NOTABLE or share >= NEGLIGIBLE)
    name, row = next(((str(name), row) for name, row in records.items() if name != own), ("", {}))
    if name:
        p, q = (float(records[key]["probability"]) if key in records else math.nan for key in (own, name))
        text = f"{name_of(study, name)} with probability {probability_text(q)}, the answer {probability_text(p)}"
        if q > p and own in STOPS and name not in STOPS:
            text += f"; but it leaves {share_text(row['share_left'])} of the gap to something else"
        yield Doubt("Runner-up", text, q >= NOTABLE)


def _measurement(study: StudyResult, equation: str) -> Iterator[Doubt]:
    """Suspects that are not in the model, but likely; and delays that are too large for delays."""
    rows = [row for row in study.instrument.to_dict("records") if row["equation"] == equation]
    odd = [row for row in rows if row["status"] == IN_MODEL and abs(row["samples"]) > FAR * DELAY_STEPS]
    if odd:
        texts = "; ".join(numbers_in(row["text"]) for row in odd)
        yield Doubt("Measurement", f"more than {FAR * DELAY_STEPS:g} samples are hardly a delay: {texts}", True)
    likely = [row for row in rows if row["status"] != IN_MODEL and row["probability"] >= NOTABLE]
    if likely:
        texts = "; ".join(
            f"{numbers_in(row['text'])} (probability {probability_text(row['probability'])})" for row in likely
        )
        yield Doubt("Measurement", f"not taken for true, but possible: {texts}", True)
    elif not odd:
        yield Doubt("Measurement", f"no further suspect is as likely as {probability_text(NOTABLE)}", False)


def _ties(study: StudyResult) -> Iterator[Doubt]:
    for tie in study.ties:
        own, *others = (within(name_of(study, slug)) for slug in tie["slugs"])
        yield Doubt("Ties", f"these data do not tell {own} from {' or '.join(others)}", True)
    if not study.ties and added(study).size:
        yield Doubt("Ties", "no other effect of the catalogue could stand in the place of what was named", False)


def _held_out(study: StudyResult) -> Iterator[Doubt]:
    """What held-out samples say of the model after; nothing of rates."""
    left = left_over(study.gap)
    for name, misfit in misfits(study.gap, "test").items():
        if name in left:
            yield Doubt("Held-out samples", left_in_words(misfit), True)
        else:
            text = f"what is left of them is {number(misfit, 2)} times what their noise and the coefficients leave open"
            yield Doubt("Held-out samples", text, False)


def _free_run(study: StudyResult) -> Doubt:
    errors = free_run_errors(study.gap)
    where = "on held-out data" if free_run_part(study.gap) == "test" else "on the training data"
    if not len(errors):
        return Doubt("Free run", "not integrated, so it has no veto", None)

    def change(names: Any) -> str:
        parts = [
            f"{name} {share_text(errors.loc[name, 'before'])} → {share_text(errors.loc[name, 'after'])}"
            for name in names
        ]
        return f"{where}: {', '.join(parts)}"

    worse, failing = worse_runs(study.gap), _fails_sooner(study)
    if worse or failing:
        states = [f"the free run of {name} gets worse" for name in worse]
        texts = [f"{'; '.join(states)} {change(worse)}"] if worse else []
        return Doubt("Free run", "; ".join([*texts, *([f"{failing} {where}"] if failing else [])]), True)
    idle = not_helped(study.gap)
    if not added(study).size and study.verdict in ("no gap", "instrument", "unknown"):
        # What the integrator alone makes of it is no change.
        alike = all(share_text(row["before"]) == share_text(row["after"]) for row in errors.to_dict("records"))
        if alike or set(idle) == set(errors.index):
            return Doubt("Free run", f"nothing was added, so it stays as it is {change(errors.index)}", False)
        if study.verdict == "instrument":
            text = f"no effect was added, and what was found of the sensors does this {change(errors.index)}"
            return Doubt("Free run", text, False)
        # Where nothing has a name the model after holds f.
        return Doubt("Free run", f"no name was added, and f of any shape does this {change(errors.index)}", False)
    if idle:
        return Doubt("Free run", f"the free run of {listed(idle)} does not get better {change(idle)}", True)
    return Doubt("Free run", f"its error shrinks {change(errors.index)}", False)


def _fails_sooner(study: StudyResult) -> str:
    """What the free run's time to failure says; the veto decides, so that no page denies what the sentence says."""
    for key in worsened(study.gap):
        if key[1] == "time to failure":
            after, before = (float(study.gap.loc[[key], name].iloc[0]) for name in ("after", "before"))
            said = {name: metric_value(study, key[1], value) for name, value in (("after", after), ("before", before))}
            earlier = f"after {said['before']}" if math.isfinite(before) else said["before"]
            return f"{worse_in_words(key)}: the amended model's after {said['after']}, the simulation's {earlier},"
    return ""


def _sampler(study: StudyResult) -> Doubt:
    if study.fit is None:
        return Doubt("Sampler", "not sampled: coefficients are those of the closed form", None)
    verdict, elsewhere = convergence(study.fit), sampled_elsewhere(study)
    if elsewhere:
        also = "" if verdict.mixed else f", and it did not converge: {' '.join(verdict.reasons)}"
        return Doubt(
            "Sampler", f"the amended model's fit disagrees with the tables: {'; '.join(elsewhere)}{also}", True
        )
    if verdict.ok:
        return Doubt("Sampler", "every convergence check of the amended model's fit passed", False)
    if verdict.mixed:
        text = f"the chains of the amended model's fit agree, though more draws are wanted: {' '.join(verdict.reasons)}"
        return Doubt("Sampler", text, False)
    return Doubt("Sampler", f"the amended model's fit did not converge: {' '.join(verdict.reasons)}", True)
