"""Missing-effect studies, one or those of a fleet, as a sentence and short tables for a terminal."""

from collections.abc import Iterator, Mapping
from typing import Any

import pandas as pd
from rich.console import Group, RenderableType
from rich.text import Text

from bayes_greybox.criticism.convergence import convergence
from bayes_greybox.discovery.answer.instrument import IN_MODEL
from bayes_greybox.discovery.contradictions import notable
from bayes_greybox.discovery.fleet.shared import Fleet
from bayes_greybox.discovery.learned import shown_effects, studied_system
from bayes_greybox.discovery.study import StudyResult
from bayes_greybox.discovery.summary import shown_part
from bayes_greybox.report.equations.text import equations_text
from bayes_greybox.report.tables import records_of, table_of
from bayes_greybox.report.terminal.tables import drawn
from bayes_greybox.report.words.asked import asked
from bayes_greybox.report.words.doubts import doubts, doubts_title
from bayes_greybox.report.words.fit import data_remarks
from bayes_greybox.report.words.fleet import fleet_sentence, lacks_text, not_pooled
from bayes_greybox.report.words.sentence import statements
from bayes_greybox.report.words.study import closed_cell, closed_heading, metric_value, reversed_text, suspect_size

from ..words.formatting import estimate, formula, known_share, numbers_in, probability_text, share_text

STYLES = {"no gap": "bold green", "named": "bold green", "unknown": "bold red"}

FINDING_MARKS = {True: ("✗", "bold red"), False: ("✓", "green"), None: ("–", "dim")}
"""Marks and styles of findings by whether they speak against the verdict; None where that was not looked at."""


def study_tables(study: StudyResult, file: str = "") -> Iterator[RenderableType]:
    """Yield verdict, what it asks, equations, findings, measurement, regions, effects, and the gap, to print.

    `file` is where the study is saved, for the commands that it asks for; "" for calls in Python.
    """
    first, *others = statements(study)
    yield Text.assemble((study.verdict.upper(), STYLES.get(study.verdict, "bold yellow")), f": {first}")
    if others:
        yield Text(" ".join(others))
    lines = [("\nWhat to do now", "bold")]
    for each in asked(study, file):
        lines += [(f"\n{each.text}", ""), *([(f"\n  {each.command}", "cyan")] if each.command else [])]
    yield Text.assemble(*lines, ("\n", ""))
    if study.fit is not None and not convergence(study.fit).ok:
        yield Text(str(convergence(study.fit)), style="yellow" if convergence(study.fit).mixed else "red")
    rows = f"{study.train.n_obs} rows: {study.base.rows.in_words(study.train)}"
    yield Text("\n".join([rows, *data_remarks(study.train, study.test)]), style="dim")
    if study.amendments:
        yield Text(f"\n{equations_text(studied_system(study))}")
    yield _findings(study)
    if IN_MODEL in set(study.instrument["status"]):
        yield _measurement(study)
    if len(study.where):
        columns = {
            "where": lambda row: numbers_in(row["description"]),
            "equation": lambda row: row["equation"],
            "#P": lambda row: probability_text(row["probability"]),
            "#of the gap": lambda row: share_text(row["gap_share"]),
            "#of the samples": lambda row: share_text(row["sample_share"]),
        }
        yield _table(study, study.where, columns, "Where the gap is")
    if len(study.effects):
        yield _effects(study)
    yield _gap(study)


def _findings(study: StudyResult) -> Group:
    rows = sorted(doubts(study), key=lambda each: each.against is not True)
    columns = {
        "": lambda each: FINDING_MARKS[each.against][0],
        "topic": lambda each: each.topic,
        "text": lambda each: each.text,
    }
    styles = [FINDING_MARKS[each.against][1] for each in rows]
    return drawn(table_of(rows, columns, doubts_title(rows)), styles=styles, header=False)


def _measurement(study: StudyResult) -> Group:
    rows = study.instrument
    shown: Any = rows[(rows["status"] == IN_MODEL) | (rows["probability"] >= notable(study))]
    columns = {
        "": lambda row: "+" if row["status"] == IN_MODEL else "",
        "what": lambda row: numbers_in(row["text"]),
        "equation": lambda row: row["equation"],
        "#P": lambda row: probability_text(row["probability"]),
        "#size": lambda row: suspect_size(row)[0],
        "#90 % interval": lambda row: suspect_size(row)[1],
    }
    return _table(study, shown, columns, "The measurement (+ in the model)")


def _effects(study: StudyResult) -> Group:
    columns = {
        "": lambda row: {"added": "+", "one of": "~", "": ""}[row["status"]],
        # The sentence says what a reversed sign means.
        "effect": lambda row: f"{row['name']}{', sign reversed' if reversed_text(row) else ''}",
        "equation": lambda row: row["equation"],
        "term": lambda row: formula(row["expression"]),
        "#P": lambda row: probability_text(row["probability"]),
        "#coefficient": lambda row: estimate(row["mean"], row["sd"], row["unit"]),
    }
    several = "; ~ could stand in its place" if "one of" in set(study.effects["status"]) else ""
    title = f"Effects, best first (+ added to the model{several})"
    # The report and the record have them all.
    return _table(study, shown_effects(study).head(5), columns, title)


def _gap(study: StudyResult) -> Group:
    part = shown_part(study)
    columns = {
        "measure": lambda row: row["metric"],
        "variable": lambda row: row["variable"],
        "#before": lambda row: metric_value(study, row["metric"], row["before"]),
        "#after": lambda row: metric_value(study, row["metric"], row["after"]),
        f"#{closed_heading(study)}": lambda row: closed_cell(study, part, row),
    }
    title = f"The gap before and after, on {'held-out' if part == 'test' else 'training'} data"
    return _table(study, study.gap.xs(part, level=0), columns, title)


def _table(study: StudyResult, rows: pd.DataFrame, columns: Mapping[str, Any], title: str) -> Group:
    return drawn(table_of(records_of(rows), columns, title, equations=list(study.maps)))


def fleet_tables(fleet: Fleet) -> tuple[Text | Group, ...]:
    """Return the sentence, the assets by their gap, and the effects that are not pooled."""
    columns = {
        "asset": lambda each: each.asset,
        "verdict": lambda each: each.verdict,
        "lacks": lambda each: each.sentence if each.failed else lacks_text(each),
        "#gap": lambda each: known_share(each.gap),
        "#left": lambda each: known_share(each.left),
    }
    table = drawn(table_of(fleet.assets, columns, "Assets by their gap"))
    return Text(fleet_sentence(fleet), style="bold"), table, *map(Text, not_pooled(fleet))
