"""Parts that the pages of studies, fits and comparisons share: settings, convergence, equations, folded tables."""

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from bayes_greybox.criticism.convergence import SHORT_VERDICT, convergence
from bayes_greybox.criticism.judged import quantity_name
from bayes_greybox.criticism.summary import summary
from bayes_greybox.equations.learned import LearnedSystem
from bayes_greybox.inference.kept.model_record import describe
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.report.equations.latex import equations_latex
from bayes_greybox.report.equations.mathml import equation_mathml
from bayes_greybox.report.equations.text import equation_text, inner_text, note
from bayes_greybox.report.tables import Table, records_of, table_of
from bayes_greybox.report.words.fit import row_label
from bayes_greybox.report.words.formatting import count_text, number, unit_text

from .page import Code, Details, Equation, Equations, Items, Section, Words


def settings_section(title: str, blocks: Sequence[Any], config: str | None) -> Section:
    """Return the last section of a page: settings, and the configuration file if there was one."""
    file = [Details("Configuration file", [Code(config)])] if config else []
    return Section("settings", title, "", [*blocks, *file])


def settings_table(settings: Mapping[str, Any], caption: str = "Settings by name") -> Table:
    """Return nested settings as rows of name and value."""
    return Table(("setting", "value"), settings_rows(settings), caption)


def settings_rows(settings: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return name and value of each setting, nested or not."""
    return [(" / ".join(path), value) for path, value in _flat(settings, ())]


def fit_settings(fit: Posterior) -> dict[str, Any]:
    """Return model, sampler, seed and versions of a fit."""
    model = describe(fit.model, fit.data)
    model["dictionary"] = {name: [term["expression"] for term in terms] for name, terms in model["dictionary"].items()}
    made = {
        key: fit.idata.attrs[key] for key in ("inference_library_version", "python_version") if key in fit.idata.attrs
    }
    return {"model": model, "sampling": dataclasses.asdict(fit.sampling), "versions": made}


class Folding(NamedTuple):
    """Words of a table and of the folded one below it.

    Attributes:
        shown: Caption of the table of what matters.
        hidden: Caption of the table of all else.
        opens: Line that opens it, with a place for the number of terms.
        nothing: Words in the place of the first table where nothing matters; "" for none.
    """

    shown: str
    hidden: str
    opens: str
    nothing: str = ""


def folded(
    records: tuple[Sequence[Any], Sequence[Any]], words: Folding, table: Callable[[Sequence[Any], str], Table]
) -> list[Any]:
    """Return a table of the records that matter, and one of all others that a reader opens."""
    shown, hidden = records
    blocks: list[Any] = [table(shown, words.shown)] if shown else [Words(words.nothing)] if words.nothing else []
    if hidden:
        few = f"{len(hidden)} terms" if len(hidden) > 1 else "1 term"
        blocks.append(Details(words.opens.format(few), [table(hidden, words.hidden)]))
    return blocks


def summary_table(fit: Posterior) -> Table:
    """Return every quantity of a fit with R̂ and effective sample sizes."""
    table = summary(fit)

    def rate(row: Any) -> str:
        return row_label(fit, row["equation"])

    def cell(column: Any) -> Callable[[Any], str]:
        return lambda row: _cell(column, row[column])

    heads = {column if column == "unit" else f"#{_HEADS.get(column, column)}": cell(column) for column in table.columns}
    columns = {"quantity": lambda row: quantity_name(str(row["quantity"])), "equation": rate, **heads}
    caption = "Posterior mean, standard deviation and 90\u00a0% interval, and how well each was sampled"
    return table_of(records_of(table), columns, caption, equations=list(table.index.unique(0)))


def verdict_blocks(fit: Posterior) -> list[Any]:
    """Return the result of the convergence checks of a fit, with the numbers behind it folded."""
    verdict = convergence(fit)
    details = Details("Every quantity with R̂ and effective sample sizes", [summary_table(fit)])
    if verdict.ok:
        return [Words("Every convergence check passed."), details]
    words = Words(SHORT_VERDICT) if verdict.mixed else Words("The sampler did not converge; what to try:", "alert")
    return [words, Items([("", reason) for reason in verdict.reasons]), details]


def equations_block(system: LearnedSystem) -> Equations | None:
    """Return learned equations for the top of a page; None where nothing was learned."""
    if not system.learned:
        return None
    shown = [Equation(equation_mathml(system, name), equation_text(system, name)) for name in system.shown]
    notes = [text for name in system.learned for text in inner_text(system, name)]
    return Equations(shown, notes, note(system), equations_latex(system))


def footer(version: str | None) -> str:
    """Return the last line of a page."""
    return f"Made by bayes_greybox{f' {version}' if version else ''}. This file holds everything it shows."


_HEADS = {"r_hat": "R̂", "ess_bulk": "bulk ESS", "ess_tail": "tail ESS"}


def _cell(column: str, value: Any) -> str:
    if column == "unit":
        return unit_text(value) or "–"
    if column == "r_hat" and math.isfinite(value):
        return f"{value:.3f}"
    return count_text(value) if column in ("ess_bulk", "ess_tail") else number(value, 4)


def _flat(value: Any, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], str]]:
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _flat(item, (*path, str(key)))
    elif isinstance(value, Sequence) and not isinstance(value, str):
        yield path, ", ".join(number(item, 6) for item in value) or "none"
    else:
        yield path, "none" if value is None else number(value, 6)
