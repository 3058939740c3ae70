"""The page of a missing-effect study: the verdict first, then the ladder of evidence that leads to it."""

import os
from dataclasses import replace

import numpy as np

from bayes_greybox.criticism.convergence import convergence
from bayes_greybox.discovery.answer.gap import NO_SHARES
from bayes_greybox.discovery.learned import studied_system
from bayes_greybox.discovery.study import StudyResult
from bayes_greybox.discovery.summary import is_denied, shown_part
from bayes_greybox.report.words.doubts import doubts, doubts_title
from bayes_greybox.report.words.fit import data_remarks, rows_text
from bayes_greybox.report.words.formatting import share_text, unbroken
from bayes_greybox.report.words.sentence import statements
from bayes_greybox.report.words.study import METRICS, closed_text, in_noise, metric_value, metric_words

from . import study_sections as rungs
from .page import Badge, Card, Cards, Findings, Page, Section, Words, write_page
from .shared import equations_block, footer, made_section, verdict_blocks

BADGES = {
    "no gap": Badge("No gap", "good", "✓"),
    "instrument": Badge("The measurement", "warn", "∿"),
    "recalibrate": Badge("Recalibrate", "warn", "⟳"),
    "named": Badge("Named", "good", "✓"),
    "one of": Badge("One of several", "warn", "≈"),
    "partly named": Badge("Partly named", "warn", "◐"),
    "unknown": Badge("Unknown", "bad", "?"),
}


def study_html(study: StudyResult, path: str | os.PathLike[str], config: str | None = None) -> None:
    """Write the report of a study, with the text of its configuration file, as one HTML file; see `write_page`."""
    write_page(study_page(study, config), path)


def study_page(study: StudyResult, config: str | None = None) -> Page:
    """Return the report of a study; see `study_html`."""
    first, *others = statements(study)
    settings = study.settings
    opening = [rungs.to_do(study), rungs.free_runs(study), _numbers(study)]
    rest = (rungs.measurement, rungs.corrections, rungs.how_much, rungs.gap_numbers, _convergence)
    made = made_section("Settings, seed, versions and times", settings, config or study.config)
    ladder = (rungs.where, rungs.what, _checks, *rest)
    sections = [*(rung(study) for rung in ladder), made]
    about = ["bayes_greybox", "missing-effect study", *(str(settings[k]) for k in ("name", "date") if k in settings)]
    name = f"{settings['name']}: " if "name" in settings else ""
    # Of chains that agree the findings say what more draws would do.
    reasons = "" if study.fit is None else " ".join(convergence(study.fit).reasons)
    alerts = [f"The sampler did not converge; do not rely on these numbers. {reasons}"]
    return Page(
        title=f"{name}missing-effect study: {study.verdict}",
        kind=" · ".join(about),
        headline=unbroken(first),
        remarks=unbroken(" ".join(others)),
        badges=_badges(study),
        facts=_facts(study),
        alerts=alerts if study.fit is not None and not convergence(study.fit).mixed else [],
        equations=equations_block(studied_system(study)),
        opening=[section for section in opening if section is not None],
        sections=[section for section in sections if section is not None],
        footer=footer(settings.get("versions", {}).get("bayes-greybox")),
    )


def _badges(study: StudyResult) -> list[Badge]:
    badges = [BADGES.get(study.verdict, Badge(study.verdict.capitalize(), "quiet"))]
    if study.against:
        badges.append(Badge("its own checks speak against it", "bad", "!"))
    if study.fit is None:
        badges.append(Badge("no sampler was run", "quiet"))
    elif not convergence(study.fit).mixed:
        badges.append(Badge("sampler did not converge", "bad", "!"))
    return badges


def _checks(study: StudyResult) -> Section:
    found = [replace(each, text=unbroken(each.text)) for each in doubts(study)]
    return Section("against", doubts_title(found), "", [Findings(sorted(found, key=lambda each: not each.against))])


def _facts(study: StudyResult) -> list[str]:
    equations = ", ".join(map(study.train.target_label, study.maps))
    what = study.base.rows.in_words(study.train)
    facts = [f"equations: {equations}", f"training data: {rows_text(study.train)}", f"rows: {what}"]
    facts.append("held-out data: none" if study.test is None else f"held-out data: {rows_text(study.test)}")
    if "catalogue" in study.settings:
        facts.append(f"catalogue: {study.settings['catalogue']}")
    return [*facts, *data_remarks(study.train, study.test)]


def _numbers(study: StudyResult) -> Section | None:
    part = shown_part(study)
    table = study.gap.xs(part, level=0)
    denied = is_denied(study)
    cards = []
    for metric in METRICS:
        if metric not in table.index.get_level_values(0):
            continue
        block = table.xs(metric, level=0)
        for variable, row in zip(block.index, block.to_dict("records"), strict=True):
            before, after = float(row["before"]), float(row["after"])
            title, about = metric_words(study, metric, str(variable))
            left = after / before if metric not in NO_SHARES and before > 0 and np.isfinite(after) else None
            ends = {"before": metric_value(study, metric, before), "after": metric_value(study, metric, after)}
            noise = in_noise(study, part, {"metric": metric, "variable": variable})
            note = "within the noise before" if noise else closed_text(float(row["closed"]), denied)
            if ends["before"] == ends["after"]:
                # Two figures that read alike are shown once.
                ends, left, note = {"after": ends["after"]}, None, "within the noise" if noise else "before and after"
            elif after > before and ends["before"] == share_text(0.0):
                left, note = None, "next to nothing before"
            cards.append(Card(title, about, **ends, note=note, left=None if left is None else min(left, 1.0)))
    measured_on = "held-out data" if part == "test" else "the training data (none were held out)"
    title = f"The gap before and after, on {measured_on}"
    return Section("numbers", title, "", [Cards(cards[:6])]) if cards else None


def _convergence(study: StudyResult) -> Section:
    title = "Can the sampler be trusted?"
    if study.fit is None:
        text = "The extended model was not sampled: its numbers are those of the Laplace approximation."
        return Section("convergence", title, "", [Words(text)], folded=True)
    lead = "The extended model is sampled to check the numbers above, which are those of the closed form."
    # One estimate of a coefficient on a page: that of its tables, which the findings compare with the sampler's.
    blocks = verdict_blocks(study.fit, estimates=False)
    return Section("convergence", title, lead, blocks, folded=convergence(study.fit).mixed)
