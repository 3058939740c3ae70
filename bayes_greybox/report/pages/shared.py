"""Parts that pages share: settings, convergence, equations, folded tables, free runs."""

import dataclasses
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

from matplotlib.figure import Figure

from bayes_greybox.criticism.bands import band_sources
from bayes_greybox.criticism.convergence import SHORT_VERDICT, convergence
from bayes_greybox.criticism.judged import quantity_name
from bayes_greybox.criticism.summary import summary
from bayes_greybox.criticism.trial import trial
from bayes_greybox.equations.learned import LearnedSystem
from bayes_greybox.inference.kept.model_record import describe
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.report import plots as figures
from bayes_greybox.report.equations.markup import equation_mathml, equations_latex
from bayes_greybox.report.equations.text import equation_text, inner_text, note, parameter_text
from bayes_greybox.report.tables import Table, records_of, table_of
from bayes_greybox.report.words.fit import row_label

from ..words.formatting import count_text, counted, listed, number, percent_text, share_text, unit_text
from .page import Code, Details, Equations, Items, Pictures, Section, Words, time_picture


def settings_section(title: str, blocks: Sequence[Any], config: str | None) -> Section:
    """Return the last section of a page: settings, and the configuration file if there was one."""
    file = [Details("Configuration file", [Code(config)])] if config else []
    return Section("settings", title, "", [*blocks, *file])


def made_section(opens: str, settings: Mapping[str, Any], config: str | None) -> Section:
    """Return the last section of the page of one result, whose settings the line `opens` opens."""
    table = Table(("setting", "value"), settings_rows(settings), "Settings by name")
    return settings_section("How this was made", [Details(opens, [table])], config)


def settings_rows(settings: Mapping[str, Any], path: str = "") -> list[tuple[str, str]]:
    """Return name and value of each setting, nested or not."""
    rows = []
    for key, value in settings.items():
        if isinstance(value, Mapping):
            rows += settings_rows(value, f"{path}{key} / ")
        elif isinstance(value, Sequence) and not isinstance(value, str):
            rows.append((f"{path}{key}", ", ".join(number(item, 6) for item in value) or "none"))
        else:
            rows.append((f"{path}{key}", "none" if value is None else number(value, 6)))
    return rows


def fit_settings(fit: Posterior) -> dict[str, Any]:
    """Return model, sampler, seed and versions of a fit."""
    model = describe(fit.model, fit.data)
    model["dictionary"] = {name: [term["expression"] for term in terms] for name, terms in model["dictionary"].items()}
    keys = [key for key in ("inference_library_version", "python_version") if key in fit.idata.attrs]
    made = {key: fit.idata.attrs[key] for key in keys}
    return {"model": model, "sampling": dataclasses.asdict(fit.sampling), "versions": made}


def folded(
    records: Collection[Any],
    matters: Callable[[Any], bool],
    columns: Mapping[str, Callable[[Any], Any]],
    equations: Sequence[str],
    captions: tuple[str, str, str],
    nothing: str = "",
    marked: Callable[[Any], bool] | None = None,
) -> list[Any]:
    """Return a table of the records that matter, and one of all others that a reader opens, see `table_of`.

    Captions are those of both tables, and the line that opens the second, with a place for the number of terms.
    `nothing` stands in the place of the first where nothing matters.
    """
    shown = table_of([each for each in records if matters(each)], columns, captions[0], marked, equations)
    hidden = table_of([each for each in records if not matters(each)], columns, captions[1], marked, equations)
    blocks: list[Any] = [shown] if shown.rows else [Words(nothing)] if nothing else []
    if hidden.rows:
        blocks.append(Details(captions[2].format(counted(len(hidden.rows), "term")), [hidden]))
    return blocks


def summary_table(fit: Posterior, estimates: bool = True) -> Table:
    """Return every quantity of a fit with R̂ and effective sample sizes, and with its estimate if that is wanted."""
    heads = {"r_hat": "R̂", "ess_bulk": "bulk ESS", "ess_tail": "tail ESS"}
    table = summary(fit) if estimates else summary(fit)[list(heads)]

    def text(column: str, value: Any) -> str:
        if column == "unit":
            return unit_text(value) or "–"
        if column == "r_hat" and math.isfinite(value):
            return f"{value:.3f}"
        return count_text(value) if column in ("ess_bulk", "ess_tail") else number(value, 4)

    def cell(column: Any) -> Callable[[Any], str]:
        return lambda row: text(column, row[column])

    columns = {
        "quantity": lambda row: quantity_name(str(row["quantity"])),
        "equation": lambda row: row_label(fit, row["equation"]),
        **{name if name == "unit" else f"#{heads.get(name, name)}": cell(name) for name in table.columns},
    }
    caption = "How well each quantity was sampled"
    if estimates:
        caption = "Posterior mean, standard deviation and 90\u00a0% interval, and how well each was sampled"
    return table_of(records_of(table), columns, caption, equations=list(table.index.unique(0)))


def verdict_blocks(fit: Posterior, estimates: bool = True) -> list[Any]:
    """Return the result of the convergence checks of a fit, with the numbers behind it folded."""
    verdict = convergence(fit)
    details = Details("Every quantity with R̂ and effective sample sizes", [summary_table(fit, estimates)])
    if verdict.ok:
        return [Words("Every convergence check passed."), details]
    words = Words(SHORT_VERDICT) if verdict.mixed else Words("The sampler did not converge; what to try:", "alert")
    return [words, Items([("", reason) for reason in verdict.reasons]), details]


def equations_block(system: LearnedSystem) -> Equations | None:
    """Return learned equations for the top of a page; None where nothing was learned."""
    if not system.learned:
        return None
    shown = [(equation_mathml(system, name), equation_text(system, name)) for name in system.shown]
    notes = [*(text for name in system.learned for text in inner_text(system, name)), *parameter_text(system)]
    return Equations(shown, notes, note(system), equations_latex(system))


def footer(version: str | None) -> str:
    """Return the last line of a page."""
    return f"Made by bayes_greybox{f' {version}' if version else ''}. This file holds everything it shows."


def free_run_section(
    title: str,
    lead: str,
    drawn: Mapping[str, Callable[[float], Figure]],
    holds: Iterable[str],
    further: Sequence[Any] = (),
    shown: str = "against the measurements",
) -> Section:
    """Return free runs as a section, with the figure of each state, which a function draws at a width in inches.

    Sentences on the bands, with what varies in them by `holds`, follow the lead. Further blocks stand above.
    """
    pictures = [time_picture(draw, f"Free run of {state} {shown}") for state, draw in drawn.items()]
    if not pictures:
        return Section("free-run", title, lead, further)
    varied = {band_sources(each) for each in holds} - {""}
    of = f" of {listed(varied.pop().split(', '))}" if varied else ""
    bands = f"Bands hold 90 % of the posterior draws{of}; where none is seen it is narrower than the line."
    return Section(
        "free-run", title, f"{lead} {bands} A cross marks where a run failed.", [*further, Pictures(pictures)]
    )


def trial_sections(fit: Posterior) -> list[Section]:
    """Return the section of a fit's errors and free run on held-out data, or else on the training data.

    There is none for outputs alone, of which none were held out.
    """
    tried = trial(fit)
    run = tried.run
    rows = [
        (f"mean square error of the predicted {row_label(fit, name, 'samples')}, over its variance", share_text(error))
        for name, error in tried.nmse.items()
    ]
    for name, error in run.nrmse().items() if run else ():
        rows.append((f"RMS error of the free run of {name}, over its standard deviation", percent_text(float(error))))
    if run is None and not (rows or tried.why):
        return []
    blocks: list[Any] = [Table(("measure", "#value"), rows)] if rows else []
    if tried.why and run is None:
        blocks.append(Words(f"There is no free run. {tried.why}"))
    size = f"{number(tried.n_obs)} rows{f' in {tried.n_run} runs' if tried.n_run > 1 else ''}"
    if tried.held_out:
        title, lead = "How does it do on held-out data?", f"{size} that the model did not learn from."
    else:
        title = "Does it follow the measurements by itself?"
        lead = f"On the training data, {size}, as none were held out."
    if run is None:
        return [free_run_section(title, lead, {}, [], blocks)]
    lead += " The model is started where the measurements start and then left alone."
    drawn = {state: partial(figures.simulated, run, state) for state in run.states}
    data, unit = run.data, run.data.unit("t") or ""
    failed = [
        f"{percent_text(float(share))} of the draws{f' in run {name}' if data.n_run > 1 else ''} after "
        f"{number(float(at) - float(data.time[data.run == k][0]))} {unit}".strip()
        for k, (name, share, at) in enumerate(zip(data.run_names, run.failed, run.failed_at, strict=True))
        if share > 0
    ]
    blocks += [Words(f"The free run blows up: {listed(failed)}.")] if failed else []
    return [free_run_section(title, lead, drawn, [run.holds], blocks)]
