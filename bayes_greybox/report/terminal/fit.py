"""A fit as short tables for a terminal."""

from collections.abc import Iterator, Mapping

import pandas as pd
from rich.console import Group, RenderableType
from rich.text import Text

from bayes_greybox.criticism.discrepancy import discrepancy_table
from bayes_greybox.criticism.inclusion import inclusion
from bayes_greybox.equations.of_posterior import fitted_system
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.physics.coefficient import Coefficient
from bayes_greybox.report.equations.text import equations_text
from bayes_greybox.report.words.formatting import (
    PROBABILITIES,
    estimate,
    exact_text,
    formula,
    interval,
    level_text,
    number,
    probability_column,
    share_text,
    unit_text,
)
from bayes_greybox.report.words.remarks import data_remarks
from bayes_greybox.report.words.stated import stated_text, term_probability

from .tables import plain_table, verdict_text

_LEVEL = 0.9


def fit_tables(fit: Posterior, held_out: pd.Series | None) -> Iterator[RenderableType]:
    """Verdict in words, then the learned equations, coefficients, discrepancy and error on held-out data.

    Args:
        fit: The fit.
        held_out: Normalised mean squared error by equation, or None.

    Yields:
        What to print, in order.
    """
    yield verdict_text(fit)
    yield Text("\n".join([fit.rows_in_words, *data_remarks(fit.data)]), style="dim")
    yield Text(f"\n{equations_text(fitted_system(fit))}")
    table = inclusion(fit, _LEVEL)
    for equation in fit.model.equations:
        priors = fit.model.stated(equation, fit.data).priors
        yield _coefficients(fit.data.target_label(equation), table.loc[equation], priors)
    yield _discrepancy(discrepancy_table(fit, _LEVEL))
    if held_out is not None:
        errors = ", ".join(f"{name} {share_text(value)}" for name, value in held_out.items())
        outputs = any(fit.data.is_output(name) for name in fit.model.equations)
        yield Text(f"\nError on held-out data (NMSE{'' if outputs else ' of the derivative'}): {errors}")


def _coefficients(label: str, table: pd.DataFrame, priors: Mapping[str, Coefficient]) -> RenderableType:
    rows = plain_table(f"Coefficients of {label}")
    probability = probability_column(table)
    rows.add_column("term", overflow="fold")
    for title in (PROBABILITIES[probability], "coefficient", f"{level_text(_LEVEL)} interval"):
        rows.add_column(title, justify="right", no_wrap=True)
    rows.add_column("unit", overflow="fold")
    if priors:
        # Below the table: beside it there is no room on a narrow terminal.
        told = [f"{formula(str(term))} {stated_text(priors[str(term)])}" for term in table.index if str(term) in priors]
        rows.caption, rows.caption_justify, rows.caption_style = Text(f"Stated: {'; '.join(told)}"), "left", "dim"
    for term, entry in table.to_dict("index").items():
        prior = priors.get(str(term))
        numbers = [estimate(entry["mean"], entry["sd"]), interval(entry["lower"], entry["upper"])]
        if prior is not None and not prior.learned:
            numbers = [exact_text(entry["mean"]), "–"]
        cells = [formula(str(term)), term_probability(entry, probability, prior), *numbers, unit_text(entry["unit"])]
        rows.add_row(*map(Text, cells))
    return Group("", rows)


def _discrepancy(table: pd.DataFrame) -> RenderableType:
    rows = plain_table(f"Shares of the variance, with the {level_text(_LEVEL)} interval of the discrepancy's")
    rows.add_column("equation", overflow="fold")
    parts = ("simulation", "dictionary", "noise", "discrepancy", "discrepancy_lower", "discrepancy_upper")
    for title in (*parts[:4], "lower", "upper"):
        rows.add_column(title, justify="right", no_wrap=True)
    entries = table.to_dict("index")
    for equation, entry in entries.items():
        rows.add_row(Text(str(equation)), *(Text(share_text(entry[part])) for part in parts))
    trades = ", ".join(f"{number(entry['correlation'], 2)} ({formula(entry['term'])})" for entry in entries.values())
    return Group("", rows, Text(f"Largest correlation of a coefficient with the discrepancy: {trades}"))
