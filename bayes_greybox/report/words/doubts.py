"""Words for the findings about a study's verdict: the same for pages, terminal and record."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bayes_greybox.discovery.contradictions import MOST_DELAYED_SAMPLES, Finding, findings, notable
from bayes_greybox.discovery.decision.probabilities import STOPS
from bayes_greybox.discovery.decision.vetoes import left_in_words, worse_in_words
from bayes_greybox.discovery.study import StudyResult
from bayes_greybox.discovery.summary import free_run_errors
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

RUN_TEXTS = {
    "not integrated": "not integrated, so it has no veto",
    "no better": "the free run of {states} does not get better",
    "nothing added": "nothing was added, so it stays as it is",
    "by sensors": "no effect was added, and what was found of the sensors does this",
    # Where nothing has a name the model after holds f.
    "by f": "no name was added, and f of any shape does this",
    "better": "its error shrinks",
}
"""Words for the change of free runs, which their errors follow."""

SAMPLER_TEXTS = {
    "not sampled": "not sampled: coefficients are those of the closed form",
    "converged": "every convergence check of the extended model's fit passed",
    "few draws": "the chains of the extended model's fit agree, though more draws are wanted: {}",
    "not converged": "the extended model's fit did not converge: {}",
}
"""Words for the state of the sampler, with reasons."""


@dataclass(frozen=True)
class Doubt:
    """One thing that could speak against a verdict; `against` is None if it could not be looked at."""

    topic: str
    text: str
    against: bool | None


def doubts(study: StudyResult) -> list[Doubt]:
    """Return the findings about a study's verdict in words, in the order of `findings`."""
    return [_in_words(study, each) for each in findings(study)]


def doubts_title(found: Sequence[Doubt]) -> str:
    """Return the title of a list of findings."""
    return "What speaks against it" if any(each.against for each in found) else "What was checked"


def role_text(role: str, count: int) -> str:
    """Return that effects were not weighed because no column plays a role, and how to give it."""
    many = f"{count} effects were" if count > 1 else "1 effect was"
    how = f'give roles={{{role!r}: "COLUMN"}}, in a file {role} = "COLUMN" under [study.roles]'
    return f"{many} not weighed: no column plays the role {role!r}; {how}"


def _in_words(study: StudyResult, finding: Finding) -> Doubt:
    if finding.code == "check":
        topic, text = _check(finding.values)
    else:
        topic, text = FINDING_TOPICS[finding.code], _text(study, finding)
    if finding.equation and len(study.maps) > 1:
        topic = f"{topic} of {study.train.target_label(finding.equation)}"
    return Doubt(topic, text[:1].upper() + text[1:], finding.against)


def _check(row: Mapping[str, Any]) -> tuple[str, str]:
    """Return topic and text of a check; those of the motion, in older files, are about one state each."""
    kind, _, state = row["name"].partition(" of ")
    topic = {"motion": "Motion", "linearity": "Linear rows"}.get(kind, "Residuals")
    value = p_text(row["p"]) if math.isnan(row["khat"]) else f"k-hat {number(float(row['khat']), 2)}"
    text = PASSED[kind].format(value) if row["ok"] else f"{row['text']} ({row['name']}, {value})"
    return f"{topic} of {state}" if state else topic, text


def _text(study: StudyResult, finding: Finding) -> str:
    values = finding.values
    p = probability_text(values.get("probability", math.nan))
    match finding.code:
        case "residuals not tested":
            rest = "there is a rest beside what has a name, of any shape or a process in time"
            why = f"{rest}, which takes up what the tests would find"
            return f"not tested: {why if values['enough'] else 'the rows that count are too few'}"
        case "other explanations":
            remembers = remembered(study, finding.equation)
            also = f"; what is missing {remembers}" if remembers else ""
            return f"what has a name, or needs none, has probability {p} in all{also}"
        case "remains":
            remembers, share = remembered(study, finding.equation), values["share"]
            also = f"; if so, it {remembers}" if remembers else ""
            left = "" if math.isnan(share) else f"; beside the answer a rest carries {share_text(share)} of the gap"
            return f"the probability that something unknown is missing is {p}{also}{left}"
        case "runner-up":
            return _runner_up(name_of(study, values["name"]), p, values)
        case "hardly late":
            texts = "; ".join(numbers_in(row["text"]) for row in values["rows"])
            return f"more than {MOST_DELAYED_SAMPLES:g} samples are hardly a delay: {texts}"
        case "possible errors":
            rows = [(numbers_in(row["text"]), probability_text(row["probability"])) for row in values["rows"]]
            return f"not taken for true, but possible: {'; '.join(f'{text} (probability {p})' for text, p in rows)}"
        case "no further error":
            return f"no further suspect is as likely as {probability_text(notable(study))}"
        case "rows":
            return values["text"]
        case "not weighed":
            return role_text(**values)
        case "tie":
            own, *others = (within(name_of(study, slug)) for slug in values["slugs"])
            return f"these data do not tell {own} from {' or '.join(others)}"
        case "no tie":
            return "no other effect of the catalogue could stand in the place of what was named"
        case "held-out samples":
            left = f"{number(values['misfit'], 2)} times what their noise and the coefficients leave open"
            return left_in_words(values["misfit"]) if finding.against else f"what is left of them is {left}"
        case "free run":
            return _free_run(study, **values)
    return _sampler(**values)


def _runner_up(name: str, p: str, values: Mapping[str, Any]) -> str:
    answer = probability_text(values["answer"])
    if values["of"] == "nothing":
        return f"{name} with probability {p}; that no effect is missing has {answer}"
    if values["of"] == "answer":
        share = (
            f"; but it leaves {share_text(values['share'])} of the gap to something else" if "share" in values else ""
        )
        return f"{name} with probability {p}, the answer {answer}{share}"
    rival = f"{name}, {p}" if values["name"] in STOPS else f"{name} by itself, {p}"
    likelier = "; effect by effect the answer is likelier" if values["probability"] > values["answer"] else ""
    return f"{rival}; the answer's set by itself, {answer}{likelier}"


def _free_run(study: StudyResult, change: str, part: str = "", states: Iterable[str] = (), sooner: Any = None) -> str:
    if change == "not integrated":
        return RUN_TEXTS[change]
    where = "on held-out data" if part == "test" else "on the training data"
    table, names = free_run_errors(study.gap), list(states)
    ends = [[share_text(table.loc[name, column]) for column in ("before", "after")] for name in names]
    errors = ", ".join(f"{name} {before} → {after}" for name, (before, after) in zip(names, ends, strict=True))
    if change != "worse":
        return f"{RUN_TEXTS[change].format(states=listed(names))} {where}: {errors}"
    worse = "; ".join(f"the free run of {name} gets worse" for name in names)
    texts = [f"{worse} {where}: {errors}"] if names else []
    if sooner:
        before, after = (float(study.gap.loc[[sooner], name].iloc[0]) for name in ("before", "after"))
        earlier, later = (metric_value(study, sooner[1], value) for value in (before, after))
        earlier = f"after {earlier}" if math.isfinite(before) else earlier
        texts.append(
            f"{worse_in_words(sooner)}: the extended model's after {later}, the simulation's {earlier}, {where}"
        )
    return "; ".join(texts)


def _sampler(state: str, reasons: Iterable[str] = (), apart: Iterable[tuple[Any, float, float]] = ()) -> str:
    why = " ".join(reasons)
    if state != "apart":
        return SAMPLER_TEXTS[state].format(why)
    texts = []
    for row, mean, sd in apart:
        sampled, tabled = estimate(mean, sd, row["unit"]), estimate(row["mean"], row["sd"], row["unit"])
        texts.append(f"its coefficient of {within(row['name'])} is {sampled}, not {tabled}")
    also = f", and it did not converge: {why}" if why else ""
    return f"the extended model's fit disagrees with the tables: {'; '.join(texts)}{also}"
