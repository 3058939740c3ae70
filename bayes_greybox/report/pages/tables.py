"""What the pages of studies, fits and comparisons have in common: settings, convergence, the last line."""

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from bayes_greybox.criticism.convergence import SHORT_VERDICT, convergence
from bayes_greybox.criticism.judged import quantity_name
from bayes_greybox.criticism.summary import summary
from bayes_greybox.equations.learned import LearnedSystem
from bayes_greybox.inference.kept.model_record import describe
from bayes_greybox.report.equations.latex import equations_latex
from bayes_greybox.report.equations.mathml import equation_mathml
from bayes_greybox.report.equations.text import equation_text, inner_text, note
from bayes_greybox.report.words.formatting import count_text, number, unit_text

from .page import Details, Equation, Equations, Items, Table, Words


def by_equation(
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    equations: Sequence[str],
    caption: str = "",
    marked: Sequence[int] = (),
) -> Table:
    """A table whose column "equation" is left out where there is one equation only.

    Args:
        columns: Headings, as for `Table`.
        rows: Cells.
        equations: Equations of the report.
        caption: What the table shows.
        marked: Numbers of the rows to stress.
    """
    kept = [i for i, column in enumerate(columns) if column != "equation" or len(equations) > 1]
    return Table([columns[i] for i in kept], [[row[i] for i in kept] for row in rows], caption, marked)


def settings_table(settings: Mapping[str, Any], caption: str = "Settings by name") -> Table:
    """Nested settings as rows of name and value."""
    return Table(("setting", "value"), settings_rows(settings), caption)


def settings_rows(settings: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Name and value of each setting, nested or not."""
    return [(" / ".join(path), value) for path, value in _flat(settings, ())]


def fit_settings(fit: Any) -> dict[str, Any]:
    """Model, sampler, seed and versions of a fit."""
    model = describe(fit.model, fit.data)
    model["dictionary"] = {name: [term["expression"] for term in terms] for name, terms in model["dictionary"].items()}
    made = {
        key: fit.idata.attrs[key] for key in ("inference_library_version", "python_version") if key in fit.idata.attrs
    }
    return {"model": model, "sampling": dataclasses.asdict(fit.sampling), "versions": made}


def summary_table(fit: Any) -> Table:
    """Every quantity of a fit with R̂ and effective sample sizes."""
    table = summary(fit)
    rows = []
    for (equation, quantity), row in zip(table.index, table.to_dict("records"), strict=True):
        cells = [_cell(column, value) for column, value in row.items()]
        rate = fit.data.target_label(equation) if equation in fit.model.equations else "the samples"
        rows.append((quantity_name(str(quantity)), rate, *cells))
    heads = [column if column == "unit" else f"#{_HEADS.get(column, column)}" for column in table.columns]
    equations = list(dict.fromkeys(table.index.get_level_values(0)))
    caption = "Posterior mean, standard deviation and 90\u00a0% interval, and how well each was sampled"
    return by_equation(("quantity", "equation", *heads), rows, equations, caption)


def verdict_blocks(fit: Any) -> list[Any]:
    """What the convergence checks say of a fit, with the numbers behind it folded."""
    details = Details("Every quantity with R̂ and effective sample sizes", [summary_table(fit)])
    if convergence(fit).ok:
        return [Words("Every convergence check passed."), details]
    reasons = Items([("", reason) for reason in convergence(fit).reasons])
    if convergence(fit).mixed:
        return [Words(SHORT_VERDICT), reasons, details]
    return [Words("The sampler did not converge; what to try:", "alert"), reasons, details]


def equations_block(system: LearnedSystem) -> Equations | None:
    """Learned equations for the top of a page; None where nothing was learned.

    Args:
        system: The equations.
    """
    if not system.learned:
        return None
    shown = [Equation(equation_mathml(system, name), equation_text(system, name)) for name in system.shown]
    notes = [text for name in system.learned for text in inner_text(system, name)]
    return Equations(shown, notes, note(system), equations_latex(system))


def footer(version: str | None) -> str:
    """The line that says what made the page."""
    return f"Made by bayes_greybox{f' {version}' if version else ''}. This file holds everything it shows."


_HEADS = {"r_hat": "R̂", "ess_bulk": "bulk ESS", "ess_tail": "tail ESS"}


def _cell(column: str, value: Any) -> str:
    if column == "unit":
        return unit_text(value) or "–"
    if column == "r_hat" and math.isfinite(value):
        return f"{value:.3f}"
    return count_text(value) if column.startswith("ess") else number(value, 4)


def _flat(value: Any, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], str]]:
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _flat(item, (*path, str(key)))
    elif isinstance(value, Sequence) and not isinstance(value, str):
        yield path, ", ".join(number(item, 6) for item in value) or "none"
    else:
        yield path, "none" if value is None else number(value, 6)
