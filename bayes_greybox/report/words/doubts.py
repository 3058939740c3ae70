"""Words for the findings about a study's verdict: the same for pages, terminal and record."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from bayes_greybox.discovery.contradictions import LARGEST_DELAY, Finding, findings, notable
from bayes_greybox.discovery.study import StudyResult
from bayes_greybox.discovery.summary import free_run_errors
from bayes_greybox.discovery.verdict import left_in_words, worse_in_words
from bayes_greybox.physics.catalogue.names import within

from .formatting import estimate, listed, number, numbers_in, p_text, probability_text, share_text
from .study import metric_value, name_of, remembered

PASSED = {
    "whiteness": "residuals are white ({})",
    "LOO-PIT": "the noise has the shape that the model gives it (LOO-PIT, {})",
    "motion": "the samples move as is said of their rate ({})",
    "linearity": "samples are linear enough in what was found, within its posterior ({})",
}
"""Words for a check that passed, by the first word of its name, with its p-value or k-hat."""

FINDING_TOPICS = {
    "residuals not tested": "Residuals", "other explanations": "Other explanations", "remains": "What remains",
    "runner-up": "Runner-up", "hardly late": "Measurement", "possible errors": "Measurement",
    "no further error": "Measurement", "rows": "Rows", "not weighed": "Not weighed", "tie": "Ties", "no tie": "Ties",
    "held-out samples": "Held-out samples", "free run": "Free run", "sampler": "Sampler",
}  # fmt: skip
"""Topics of findings by their codes."""


@dataclass(frozen=True)
class Doubt:
    """One thing that could speak against a verdict.

    Attributes:
        topic: Subject in a word or two.
        text: Finding in words, with its numbers.
        against: True if it speaks against the verdict; None if it could not be looked at.
    """

    topic: str
    text: str
    against: bool | None


def doubts(study: StudyResult) -> list[Doubt]:
    """Return the findings about a study's verdict in words, in the order of `findings`."""
    return [_in_words(study, each) for each in findings(study)]


def _in_words(study: StudyResult, finding: Finding) -> Doubt:
    text = FINDING_TEXTS[finding.code](study, finding)
    topic = _check_topic(finding) if finding.code == "check" else FINDING_TOPICS[finding.code]
    if finding.equation and len(study.maps) > 1:
        topic = f"{topic} of {study.train.target_label(finding.equation)}"
    return Doubt(topic, text[:1].upper() + text[1:], finding.against)


def _check_topic(finding: Finding) -> str:
    # Checks of the motion, in older files, are about one state each.
    kind, _, state = finding.values["name"].partition(" of ")
    topic = {"motion": "Motion", "linearity": "Linear rows"}.get(kind, "Residuals")
    return f"{topic} of {state}" if state else topic


def _check(study: StudyResult, finding: Finding) -> str:
    row, name = finding.values, finding.values["name"]
    value = p_text(row["p"]) if math.isnan(row["khat"]) else f"k-hat {number(float(row['khat']), 2)}"
    return PASSED[name.split(" of ")[0]].format(value) if row["ok"] else f"{row['text']} ({name}, {value})"


def _not_tested(study: StudyResult, finding: Finding) -> str:
    if not finding.values["enough"]:
        return "not tested: the rows that count are too few"
    rest = "there is a rest beside what has a name, of any shape or a process in time"
    return f"not tested: {rest}, which takes up what the tests would find"


def _other_explanations(study: StudyResult, finding: Finding) -> str:
    remembers = remembered(study, finding.equation)
    p = probability_text(finding.values["probability"])
    also = f"; what is missing {remembers}" if remembers else ""
    return f"what has a name, or needs none, has probability {p} in all{also}"


def _remains(study: StudyResult, finding: Finding) -> str:
    remembers, share = remembered(study, finding.equation), finding.values["share"]
    p = probability_text(finding.values["probability"])
    also = f"; if so, it {remembers}" if remembers else ""
    left = "" if math.isnan(share) else f"; beside the answer a rest carries {share_text(share)} of the gap"
    return f"the probability that something unknown is missing is {p}{also}{left}"


def _runner_up(study: StudyResult, finding: Finding) -> str:
    values = finding.values
    p, q = probability_text(values["answer"]), probability_text(values["probability"])
    text = f"{name_of(study, values['name'])} with probability {q}, the answer {p}"
    left = f"; but it leaves {share_text(values['share'])} of the gap to something else" if "share" in values else ""
    return f"{text}{left}"


def _hardly_late(study: StudyResult, finding: Finding) -> str:
    texts = "; ".join(numbers_in(row["text"]) for row in finding.values["rows"])
    return f"more than {LARGEST_DELAY:g} samples are hardly a delay: {texts}"


def _possible_errors(study: StudyResult, finding: Finding) -> str:
    texts = [
        f"{numbers_in(row['text'])} (probability {probability_text(row['probability'])})"
        for row in finding.values["rows"]
    ]
    return f"not taken for true, but possible: {'; '.join(texts)}"


def _no_further_error(study: StudyResult, finding: Finding) -> str:
    return f"no further suspect is as likely as {probability_text(notable(study))}"


def role_text(role: str, count: int) -> str:
    """Return that effects were not weighed because no column plays a role, and how to give it."""
    many = f"{count} effects were" if count > 1 else "1 effect was"
    how = f"give roles={{{role!r}: ...}}, in a file [study.roles] {role}"
    return f"{many} not weighed: no column plays the role {role!r}; {how}"


def _tie(study: StudyResult, finding: Finding) -> str:
    own, *others = (within(name_of(study, slug)) for slug in finding.values["slugs"])
    return f"these data do not tell {own} from {' or '.join(others)}"


def _held_out(study: StudyResult, finding: Finding) -> str:
    misfit = finding.values["misfit"]
    if finding.against:
        return left_in_words(misfit)
    return f"what is left of them is {number(misfit, 2)} times what their noise and the coefficients leave open"


RUN_TEXTS = {
    "no better": "the free run of {states} does not get better",
    "nothing added": "nothing was added, so it stays as it is",
    "by sensors": "no effect was added, and what was found of the sensors does this",
    # Where nothing has a name the model after holds f.
    "by f": "no name was added, and f of any shape does this",
    "better": "its error shrinks",
}
"""Words for the change of free runs, which their errors follow."""


def _free_run(study: StudyResult, finding: Finding) -> str:
    values = finding.values
    if values["change"] == "not integrated":
        return "not integrated, so it has no veto"
    where = "on held-out data" if values["part"] == "test" else "on the training data"
    if values["change"] != "worse":
        text = RUN_TEXTS[values["change"]].format(states=listed(values["states"]))
        return f"{text} {where}: {_errors(study, values['states'])}"
    states = "; ".join(f"the free run of {name} gets worse" for name in values["states"])
    texts = [f"{states} {where}: {_errors(study, values['states'])}"] if states else []
    return "; ".join([*texts, *([f"{_sooner(study, values['sooner'])} {where}"] if values["sooner"] else [])])


def _errors(study: StudyResult, states: Iterable[str]) -> str:
    errors = free_run_errors(study.gap)
    ends = {name: [share_text(errors.loc[name, column]) for column in ("before", "after")] for name in states}
    return ", ".join(f"{name} {before} → {after}" for name, (before, after) in ends.items())


def _sooner(study: StudyResult, key: tuple[str, str, str]) -> str:
    after, before = (float(study.gap.loc[[key], name].iloc[0]) for name in ("after", "before"))
    said = metric_value(study, key[1], before)
    earlier = f"after {said}" if math.isfinite(before) else said
    later = metric_value(study, key[1], after)
    return f"{worse_in_words(key)}: the amended model's after {later}, the simulation's {earlier},"


SAMPLER_TEXTS = {
    "not sampled": "not sampled: coefficients are those of the closed form",
    "converged": "every convergence check of the amended model's fit passed",
    "few draws": "the chains of the amended model's fit agree, though more draws are wanted: {}",
    "not converged": "the amended model's fit did not converge: {}",
}
"""Words for the state of the sampler, with reasons."""


def _sampler(study: StudyResult, finding: Finding) -> str:
    values = finding.values
    reasons = " ".join(values.get("reasons", ()))
    if values["state"] != "apart":
        return SAMPLER_TEXTS[values["state"]].format(reasons)
    texts = [_apart(*each) for each in values["apart"]]
    also = f", and it did not converge: {reasons}" if reasons else ""
    return f"the amended model's fit disagrees with the tables: {'; '.join(texts)}{also}"


def _apart(row: Mapping[str, Any], mean: float, sd: float) -> str:
    told = estimate(row["mean"], row["sd"], row["unit"])
    return f"its coefficient of {within(row['name'])} is {estimate(mean, sd, row['unit'])}, not {told}"


FINDING_TEXTS: dict[str, Callable[[StudyResult, Finding], str]] = {
    "check": _check,
    "residuals not tested": _not_tested,
    "other explanations": _other_explanations,
    "remains": _remains,
    "runner-up": _runner_up,
    "hardly late": _hardly_late,
    "possible errors": _possible_errors,
    "no further error": _no_further_error,
    "rows": lambda study, finding: finding.values["text"],
    "not weighed": lambda study, finding: role_text(**finding.values),
    "tie": _tie,
    "no tie": lambda study, finding: "no other effect of the catalogue could stand in the place of what was named",
    "held-out samples": _held_out,
    "free run": _free_run,
    "sampler": _sampler,
}
"""Words of findings by their codes."""
