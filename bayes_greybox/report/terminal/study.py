"""A missing-effect study as a sentence and short tables for a terminal."""

from collections.abc import Iterator, Sequence
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from bayes_greybox.criticism.convergence import convergence
from bayes_greybox.discovery.answer.instrument import IN_MODEL
from bayes_greybox.discovery.learned import studied_system
from bayes_greybox.discovery.study import StudyResult
from bayes_greybox.physics.catalogue.names import within
from bayes_greybox.report.equations.text import equations_text
from bayes_greybox.report.words.doubts import NOTABLE, doubts
from bayes_greybox.report.words.formatting import estimate, formula, numbers_in, probability_text, share_text
from bayes_greybox.report.words.remarks import data_remarks
from bayes_greybox.report.words.sentence import sentence
from bayes_greybox.report.words.study import (
    closed_share,
    metric_value,
    name_of,
    reversed_text,
    shown_part,
    suspect_size,
)

from .tables import plain_table

MOST_EFFECTS = 5
"""Effects shown; the report and the record have them all."""

STYLES = {"no gap": "bold green", "named": "bold green", "unknown": "bold red"}

SHORT = {"added": "+", "one of": "~", "": ""}
"""Marks of effects by their status."""

SIGNS = {True: ("✗", "bold red"), False: ("✓", "green"), None: ("–", "dim")}
"""Marks of what speaks against a verdict, of what does not, and of what was not looked at."""


def study_tables(study: StudyResult) -> Iterator[RenderableType]:
    """Verdict and equations, what speaks against it, the measurement, where, what, and the gap before and after.

    Args:
        study: The study.

    Yields:
        What to print, in order.
    """
    yield Text.assemble((study.verdict.upper(), STYLES.get(study.verdict, "bold yellow")), f": {sentence(study)}")
    if study.fit is not None and not convergence(study.fit).ok:
        yield Text(str(convergence(study.fit)), style="yellow" if convergence(study.fit).mixed else "red")
    rows = f"{study.train.n_obs} rows: {study.base.rows.in_words(study.train)}"
    yield Text("\n".join([rows, *data_remarks(study.train, study.test)]), style="dim")
    if study.amendments:
        yield Text(f"\n{equations_text(studied_system(study))}")
    yield Group("", _against(study))
    if IN_MODEL in set(study.instrument["status"]):
        yield Group("", _measurement(study))
    if len(study.where):
        yield Group("", _where(study))
    if len(study.effects):
        yield Group("", _effects(study))
    yield Group("", _gap(study))
    for tie in study.ties:
        names = " or ".join(within(name_of(study, slug)) for slug in tie["slugs"])
        yield Text(f"\nNot told apart by these data: {names}. {tie['advice']}")


def _against(study: StudyResult) -> Table:
    table = plain_table("What speaks against it")
    table.show_header = False
    for _ in range(3):
        table.add_column(overflow="fold")
    for each in sorted(doubts(study), key=lambda each: each.against is not True):
        sign, style = SIGNS[each.against]
        table.add_row(Text(sign, style=style), Text(each.topic), Text(each.text))
    return table


def _measurement(study: StudyResult) -> Table:
    rows = [
        (
            "+" if row["status"] == IN_MODEL else "",
            numbers_in(row["text"]),
            row["equation"],
            probability_text(row["probability"]),
            *suspect_size(row)[:2],
        )
        for row in study.instrument.to_dict("records")
        if row["status"] == IN_MODEL or row["probability"] >= NOTABLE
    ]
    title = "The measurement (+ in the model)"
    return _table(study, title, ("", "what", "equation", "#P", "#size", "#90 % interval"), rows)


def _where(study: StudyResult) -> Table:
    rows = [
        (
            numbers_in(row["description"]),
            row["equation"],
            probability_text(row["probability"]),
            share_text(row["gap_share"]),
            share_text(row["sample_share"]),
        )
        for row in study.where.to_dict("records")
    ]
    return _table(study, "Where the gap is", ("where", "equation", "#P", "#of the gap", "#of the samples"), rows)


def _effects(study: StudyResult) -> Table:
    rows = [
        (
            SHORT[row["status"]],
            # The sentence says what that means.
            f"{row['name']}, sign reversed" if reversed_text(row) else row["name"],
            row["equation"],
            formula(row["expression"]),
            probability_text(row["probability"]),
            estimate(row["mean"], row["sd"], row["unit"]),
        )
        for row in study.effects.head(MOST_EFFECTS).to_dict("records")
    ]
    several = "; ~ could stand in its place" if "one of" in set(study.effects["status"]) else ""
    title = f"Effects, best first (+ added to the model{several})"
    return _table(study, title, ("", "effect", "equation", "term", "#P", "#coefficient"), rows)


def _gap(study: StudyResult) -> Table:
    part = shown_part(study)
    table = study.gap.xs(part, level=0)
    rows = [
        (
            metric,
            variable,
            metric_value(study, metric, row["before"]),
            metric_value(study, metric, row["after"]),
            closed_share(row["closed"]),
        )
        for (metric, variable), row in zip(table.index, table.to_dict("records"), strict=True)
    ]
    title = f"The gap before and after, on {'held-out' if part == 'test' else 'training'} data"
    return _table(study, title, ("measure", "variable", "#before", "#after", "#closed"), rows)


def _table(study: StudyResult, title: str, columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> Table:
    """A table; the column that says which equation is left out where there is one equation only."""
    table = plain_table(title)
    kept = [i for i, column in enumerate(columns) if column != "equation" or len(study.maps) > 1]
    for i in kept:
        number = columns[i].startswith("#")
        side = "right" if number else "left"
        table.add_column(columns[i].lstrip("#"), justify=side, no_wrap=number, overflow="fold")
    for row in rows:
        table.add_row(*(Text(str(row[i])) for i in kept))
    return table
