"""The page of a comparison: which model predicts best and how sure that is, then what each model says."""

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.criticism.convergence import SHORT_VERDICT, Verdict, convergence, convergence_table
from bayes_greybox.criticism.cross_validation.compare import TIE_NATS, tied, unreliable
from bayes_greybox.criticism.inclusion import inclusion
from bayes_greybox.inference.kept.netcdf import versions
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.physics.coefficient import Coefficient
from bayes_greybox.report.plots import plot_comparison
from bayes_greybox.report.words.formatting import (
    PROBABILITIES,
    count_text,
    estimate,
    exact_text,
    formula,
    interval,
    listed,
    nats,
    number,
    pareto,
    probability_column,
    weight_text,
)
from bayes_greybox.report.words.stated import term_probability

from .page import Badge, Code, Details, Items, Page, Pictures, Section, Table, Words, picture, write_page
from .tables import by_equation, fit_settings, footer, settings_rows, settings_table, summary_table

LIKELY = 0.5
"""Terms more probable than this under the best model are marked."""


def comparison_html(
    fits: Mapping[str, Posterior], table: pd.DataFrame, path: str | os.PathLike[str], config: str | None = None
) -> None:
    """Write the report of a comparison as one HTML file that needs no network.

    Args:
        fits: The fits by name.
        table: What `compare` returns for them, best first.
        path: Destination.
        config: Text of the configuration file that asked for it.

    Raises:
        InputError: The destination cannot be written.
    """
    write_page(comparison_page(fits, table, config), path)


def comparison_page(fits: Mapping[str, Posterior], table: pd.DataFrame, config: str | None = None) -> Page:
    """The report of a comparison.

    Args:
        fits: The fits by name.
        table: What `compare` returns for them, best first.
        config: Text of the configuration file that asked for it.
    """
    fits = {str(name): fits[str(name)] for name in table.index}
    made = table.attrs.get("versions") or versions()
    badges, alerts = _trust(fits, table)
    return Page(
        title=f"Comparison: {_verdict(table).text.lower()}",
        kind="bayes_greybox · comparison of models",
        headline=_headline(table),
        badges=badges,
        facts=_facts(fits, table),
        alerts=alerts,
        sections=[
            _ranking(table),
            _terms(fits),
            _coefficients(fits),
            _convergence(fits),
            _settings(fits, made, config),
        ],
        footer=footer(made["bayes-greybox"]),
    )


def _headline(table: pd.DataFrame) -> str:
    """Which model predicts best and how sure that is, in words for those who decide."""
    best, second = (str(name) for name in table.index[:2])
    level = tied(table)
    if level:
        behind = [str(name) for name in table.index[1:] if name not in level]
        rest = f"; {listed(behind)} {'predicts' if len(behind) == 1 else 'predict'} worse" if behind else ""
        return f"Too close to call: the data do not tell {listed([best, *level])} apart{rest}."
    gap, se = -float(table["elpd_diff"].iloc[1]), float(table["diff_se"].iloc[1])
    sure = f", {gap / se:.1f} times the standard error of that lead" if se > 0 else ""
    return f"{best} predicts data left out of the fit best: it is {nats(gap)} nats ahead of {second}{sure}."


def _verdict(table: pd.DataFrame) -> Badge:
    return Badge("Too close to call", "warn", "≈") if tied(table) else Badge("Clear lead", "good", "✓")


def _trust(fits: Mapping[str, Posterior], table: pd.DataFrame) -> tuple[list[Badge], list[str]]:
    """Badges and alerts: a lead that rests on bad chains or weights is not shown as good."""
    failed = [name for name, fit in fits.items() if not convergence(fit).mixed]
    doubtful = unreliable(table)
    badges, alerts = [], []
    if failed:
        badges.append(Badge("Not converged", "bad", "!"))
        alerts.append(f"The sampler did not converge for {listed(failed)}; do not rely on this comparison.")
    if doubtful:
        badges.append(Badge("Pareto k too large", "bad", "!"))
        alerts.append(
            f"Pareto k is above {number(table.attrs['threshold'], 2)} for {listed(doubtful)}, so the elpd there is not "
            "reliable: compare again with a larger max_refits."
        )
    verdict = _verdict(table)
    return [*badges, Badge(verdict.text, "quiet", verdict.symbol) if badges else verdict], alerts


def _facts(fits: Mapping[str, Posterior], table: pd.DataFrame) -> list[str]:
    data = next(iter(fits.values())).data
    runs = f" in {data.n_run} runs" if data.n_run > 1 else ""
    return [f"{len(fits)} models", f"data: {data.n_obs} rows{runs}", f"left out: {table.attrs['folds']}"]


def _ranking(table: pd.DataFrame) -> Section:
    rows = [
        (
            str(name),
            nats(row["elpd"]),
            nats(row["se"]),
            nats(row["elpd_diff"]),
            nats(row["diff_se"]),
            weight_text(row["weight"]),
            pareto(row["worst_k"]),
            number(row["refits"]),
            nats(row["p_eff"]),
        )
        for name, row in zip(table.index, table.to_dict("records"), strict=True)
    ]
    heads = (
        "model",
        "#elpd, nats",
        "#± SE, nats",
        "#difference, nats",
        "#± SE, nats",
        "#weight",
        "#worst k",
        "#refits",
        "#p_eff",
    )
    level = [i for i, name in enumerate(table.index) if i == 0 or name in tied(table)]
    caption = f"Left out: {table.attrs['folds']}. Marked: the best model, and those that the data do not tell from it"
    blocks: list[Any] = [
        Pictures(
            [
                picture(
                    plot_comparison(table), "Elpd of each model, its difference to the best and its weight", wide=True
                )
            ]
        ),
        Table(heads, rows, caption, level),
    ]
    notes = list(table.attrs.get("notes", []))
    if notes:
        blocks += [Words("What to beware of:"), Items([("", note) for note in notes])]
    meaning = [
        ("elpd", "Expected log predictive density: log probability of the data left out, summed; higher is better."),
        ("Difference", f"To the best model. It counts above {TIE_NATS:g} nats and twice its standard error (SE)."),
        ("Weight", "Share of each model in the mixture of models that predicts best (stacking)."),
        (
            "Worst k",
            f"Largest Pareto k among parts left out that were not fitted again; up to "
            f"{number(table.attrs['threshold'], 2)} is safe. A dash: all were.",
        ),
        ("Refits", "Parts that the model was fitted again without, because k was too large."),
        ("p_eff", "Effective number of sampled parameters."),
    ]
    blocks.append(Details("What the columns mean", [Items(meaning)]))
    return Section("ranking", "Which model predicts best?", _LEAD, blocks)


_LEAD = "Every model is judged on data that its prediction did not use: how probable did it hold what was measured?"


def _terms(fits: Mapping[str, Posterior]) -> Section:
    """How probable each term is, one column for each model."""
    tables: dict[str, Any] = {name: inclusion(fit) for name, fit in fits.items()}
    columns = {name: probability_column(table) for name, table in tables.items()}
    first, rows, absent, marked = next(iter(fits)), [], [], []
    for key in _keys(tables):
        found = {name: float(table.loc[key, columns[name]]) for name, table in tables.items() if key in table.index}
        cells = [
            term_probability(tables[name].loc[key].to_dict(), columns[name], _prior(fits[name], key))
            if name in found
            else "–"
            for name in fits
        ]
        row = (formula(key[1]), _rate(fits, key[0]), *cells)
        if max(found.values()) > LIKELY:
            if found.get(first, 0.0) > LIKELY:
                marked.append(len(rows))
            rows.append(row)
        else:
            absent.append(row)
    heads = ("`term", "equation", *(f"#{name}: {PROBABILITIES[columns[name]]}" for name in fits))
    blocks: list[Any] = [Words("Under no model is a term more likely to matter than not.")]
    if rows:
        caption = "Terms more likely to matter than not under some model; those of the best one are marked"
        blocks = [by_equation(heads, rows, _equations(fits), caption, marked)]
    if absent:
        table = by_equation(heads, absent, _equations(fits), "Terms that are likely absent under every model")
        few = f"{len(absent)} terms" if len(absent) > 1 else "1 term"
        blocks.append(Details(f"{few} likely absent under every model", [table]))
    moved = next(iter(fits.values())).data.target_in_words(*_equations(fits), article="the ")
    lead = (
        "Probability that a term matters. Only a spike-and-slab prior can leave a term out, and has P(included); for "
        f"the others it is the probability of moving {moved} by more than 1 % (RMS) of what the simulation leaves. A "
        "dash: not in the model."
    )
    return Section("terms", "Which terms matter under each model?", lead, blocks)


def _coefficients(fits: Mapping[str, Posterior]) -> Section:
    """Estimates of each term under each model that has it, one below the other."""
    tables: dict[str, Any] = {name: inclusion(fit) for name, fit in fits.items()}
    columns = {name: probability_column(table) for name, table in tables.items()}
    rows, absent = [], []
    for key in _keys(tables):
        models = {name: table.loc[key] for name, table in tables.items() if key in table.index}
        likely = max(float(row[columns[name]]) for name, row in models.items()) > LIKELY
        for name, row in models.items():
            prior = _prior(fits[name], key)
            learned = prior is None or prior.learned
            size = estimate(row["mean"], row["sd"], row["unit"]) if learned else exact_text(row["mean"], row["unit"])
            ends = interval(row["lower"], row["upper"]) if learned else "–"
            cells = (size if learned else f"{size} (given)", ends)
            (rows if likely else absent).append((formula(key[1]), _rate(fits, key[0]), name, *cells))
    heads = ("`term", "equation", "model", "#coefficient", "#90 % interval")
    blocks: list[Any] = []
    if rows:
        caption = "Coefficients of the terms more likely to matter than not under some model"
        blocks.append(by_equation(heads, rows, _equations(fits), caption))
    if absent:
        table = by_equation(heads, absent, _equations(fits), "Coefficients of the other terms")
        blocks.append(Details("Coefficients of terms likely absent under every model", [table]))
    lead = "Posterior mean, standard deviation and equal-tailed 90 % interval of each coefficient, in your units."
    return Section("coefficients", "Coefficients", lead, blocks)


def _prior(fit: Posterior, key: tuple[str, str]) -> Coefficient | None:
    """What was stated of the coefficient of a term."""
    return fit.model.stated(key[0], fit.data).priors.get(key[1])


def _convergence(fits: Mapping[str, Posterior]) -> Section:
    rows, reasons = [], []
    for name, fit in fits.items():
        judged = convergence_table(fit)
        divergences = int(fit.idata["sample_stats"].dataset["diverging"].sum())
        rows.append(
            (
                name,
                _result(convergence(fit)),
                number(_worst(judged["r_hat"], np.max), 4),
                count_text(_worst(judged["ess_bulk"], np.min)),
                count_text(_worst(judged["ess_tail"], np.min)),
                number(divergences),
            )
        )
        reasons += [(name, reason) for reason in convergence(fit).reasons]
    heads = ("model", "result", "#largest R̂", "#least bulk ESS", "#least tail ESS", "#divergences")
    failed = [i for i, fit in enumerate(fits.values()) if not convergence(fit).mixed]
    caption = f"How well each model was sampled{'; marked: not converged' if failed else ''}"
    blocks: list[Any] = [Table(heads, rows, caption, failed)]
    if reasons:
        said = Words("The sampler did not converge; what to try:", "alert") if failed else Words(SHORT_VERDICT)
        blocks += [said, Items(reasons)]
    blocks += [
        Details(f"{name}: every quantity with R̂ and effective sample sizes", [summary_table(fit)])
        for name, fit in fits.items()
    ]
    return Section("convergence", "Can the sampler be trusted?", "", blocks)


def _result(verdict: Verdict) -> str:
    return "converged" if verdict.ok else "converged, few draws" if verdict.short else "not converged"


def _settings(fits: Mapping[str, Posterior], made: Mapping[str, str], config: str | None) -> Section:
    """What the models differ in beside each other, and what they share once."""
    settings = {name: dict(settings_rows(_described(fit))) for name, fit in fits.items()}
    keys = list(dict.fromkeys(key for one in settings.values() for key in one))
    values = {key: [one[key] for one in settings.values() if key in one] for key in keys}
    partly = [(key, *(one.get(key, "–") for one in settings.values())) for key in keys if len(values[key]) < len(fits)]
    everywhere = {key: row for key, row in values.items() if len(row) == len(fits)}
    differ = [(key, *row) for key, row in everywhere.items() if len(set(row)) > 1]
    shared = [(key, row[0]) for key, row in everywhere.items() if len(set(row)) == 1]
    heads = ("setting", *fits)
    same = Words("Prior, kernel, data and sampler are the same for all models.")
    blocks: list[Any] = [Table(heads, differ, "Settings that differ")] if differ else [] if partly else [same]
    if partly:
        blocks.append(
            Details("Settings that only some of the models have", [Table(heads, partly, "Settings of some models")])
        )
    blocks += [
        Details("Settings that all models share", [Table(("setting", "value"), shared, "Settings of all models")]),
        Details("Versions that made the comparison", [settings_table(made, "Versions by package")]),
    ]
    if config:
        blocks.append(Details("Configuration file", [Code(config)]))
    return Section("settings", "What do the models differ in?", "", blocks)


def _described(fit: Posterior) -> dict[str, Any]:
    """Settings of a fit, with a place for the kernel also where there is none."""
    settings = fit_settings(fit)
    if settings["model"]["discrepancy"] is None:
        settings["model"]["discrepancy"] = {"variant": None}
    return settings


def _keys(tables: Mapping[str, pd.DataFrame]) -> list[tuple[str, str]]:
    """Every (equation, term) of any model, those of an equation together."""
    keys = list(dict.fromkeys((str(name), str(term)) for table in tables.values() for name, term in table.index))
    order = list(dict.fromkeys(name for name, _ in keys))
    return sorted(keys, key=lambda key: order.index(key[0]))


def _equations(fits: Mapping[str, Posterior]) -> tuple[str, ...]:
    return next(iter(fits.values())).model.equations


def _rate(fits: Mapping[str, Posterior], name: str) -> str:
    return next(iter(fits.values())).data.target_label(name)


def _worst(column: Any, pick: Any) -> float:
    known = column.to_numpy(float)
    known = known[~np.isnan(known)]
    return float(pick(known)) if len(known) else float("nan")
