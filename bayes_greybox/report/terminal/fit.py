"""Fits, alone and compared, as short tables for a terminal."""

from collections.abc import Iterator, Mapping

import pandas as pd
from rich.console import Group, RenderableType
from rich.text import Text

from bayes_greybox.criticism.convergence import convergence
from bayes_greybox.criticism.discrepancy import discrepancy_table
from bayes_greybox.criticism.inclusion import inclusion
from bayes_greybox.equations.learned import INTERVAL_LEVEL
from bayes_greybox.equations.of_posterior import fitted_system
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.physics.coefficient import Coefficient
from bayes_greybox.report.equations.text import equations_text
from bayes_greybox.report.tables import records_of, table_of
from bayes_greybox.report.terminal.tables import drawn
from bayes_greybox.report.words import formatting as fmt
from bayes_greybox.report.words.fit import compared, data_remarks, ends_text, size_text, stated_text, term_probability


def fit_tables(fit: Posterior, held_out: pd.Series | None) -> Iterator[RenderableType]:
    """Yield verdict, learned equations, coefficients, discrepancy and NMSE on held-out data, by equation, to print."""
    yield _verdict(fit)
    yield Text("\n".join([fit.rows_in_words, *data_remarks(fit.data)]), style="dim")
    yield Text(f"\n{equations_text(fitted_system(fit))}")
    table = inclusion(fit, INTERVAL_LEVEL)
    for equation in fit.model.equations:
        priors = fit.model.stated(equation, fit.data).priors
        yield _coefficients(fit.data.target_label(equation), table.loc[equation], priors)
    yield _discrepancy(discrepancy_table(fit, INTERVAL_LEVEL))
    if held_out is not None:
        errors = ", ".join(f"{name} {fmt.share_text(value)}" for name, value in held_out.items())
        outputs = any(fit.data.is_output(name) for name in fit.model.equations)
        yield Text(f"\nError on held-out data (NMSE{'' if outputs else ' of the derivative'}): {errors}")


def _coefficients(label: str, table: pd.DataFrame, priors: Mapping[str, Coefficient]) -> RenderableType:
    column = fmt.probability_column(table)
    columns = {
        "term": lambda row: fmt.formula(row["term"]),
        f"#{fmt.PROBABILITIES[column]}": lambda row: term_probability(row, column),
        "#coefficient": lambda row: size_text(row, priors.get(row["term"]), unit=False),
        f"#{fmt.level_text(INTERVAL_LEVEL)} interval": lambda row: ends_text(row, priors.get(row["term"])),
        "unit": lambda row: fmt.unit_text(row["unit"]),
    }
    stated = [f"{fmt.formula(term)} {stated_text(priors[term])}" for term in map(str, table.index) if term in priors]
    below = f"Stated: {'; '.join(stated)}" if priors else ""
    return drawn(table_of(records_of(table), columns, f"Coefficients of {label}"), below)


def _discrepancy(table: pd.DataFrame) -> RenderableType:
    columns = {
        "equation": lambda row: row["equation"],
        "#simulation": lambda row: fmt.share_text(row["simulation"]),
        "#dictionary": lambda row: fmt.share_text(row["dictionary"]),
        "#noise": lambda row: fmt.share_text(row["noise"]),
        "#discrepancy": lambda row: fmt.share_text(row["discrepancy"]),
        "#lower": lambda row: fmt.share_text(row["discrepancy_lower"]),
        "#upper": lambda row: fmt.share_text(row["discrepancy_upper"]),
    }
    title = f"Shares of the variance, with the {fmt.level_text(INTERVAL_LEVEL)} interval of the discrepancy's"
    trades = ", ".join(
        f"{fmt.number(row['correlation'], 2)} ({fmt.formula(row['term'])})" for row in table.to_dict("index").values()
    )
    shown = drawn(table_of(records_of(table), columns, title))
    return Group(shown, Text(f"Largest correlation of a coefficient with the discrepancy: {trades}"))


def comparison_tables(fits: Mapping[str, Posterior], table: pd.DataFrame) -> Iterator[RenderableType]:
    """Yield the verdict of each fit, the comparison, best first, and its notes."""
    for name, fit in fits.items():
        yield _verdict(fit, f"{name}: ")
    left_out = f"leaving out {table.attrs['folds']}; " if "folds" in table.attrs else ""
    columns = {"model": compared("model"), **{f"#{name}": compared(str(name)) for name in table.columns}}
    title = f"Expected log predictive density (elpd, {left_out}nats; higher is better)"
    yield drawn(table_of(records_of(table.rename_axis("model")), columns, title))
    for note in table.attrs.get("notes", []):
        yield Text(f"Note: {note}")


def _verdict(fit: Posterior, label: str = "") -> Text:
    verdict = convergence(fit)
    first, *rest = str(verdict).splitlines()
    text = Text(f"{label}{first}", style="green" if verdict.ok else "bold yellow" if verdict.mixed else "bold red")
    for line in rest:
        text.append(f"\n{line}", style="not bold default")
    return text
