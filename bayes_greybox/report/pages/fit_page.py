"""The page of one fit: verdict, coefficients, what the discrepancy holds, predictions, settings."""

import json
import math
import os
from typing import Any

import pandas as pd

from bayes_greybox.criticism.checks.checks import checks
from bayes_greybox.criticism.convergence import SHORT_VERDICT, Verdict, convergence
from bayes_greybox.criticism.discrepancy import discrepancy_table
from bayes_greybox.criticism.inclusion import inclusion
from bayes_greybox.criticism.prediction import predict
from bayes_greybox.equations.of_posterior import fitted_system
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.physics.units import target_unit
from bayes_greybox.report import plots as figures
from bayes_greybox.report.folders.copies import CONFIGURATION
from bayes_greybox.report.words.formatting import (
    PROBABILITIES,
    estimate,
    exact_text,
    formula,
    interval,
    listed,
    number,
    probability_column,
    probability_text,
    quantity,
    share_interval,
    share_text,
)
from bayes_greybox.report.words.stated import stated_text, term_probability

from .free_run_section import trial_sections
from .page import (
    Badge,
    Card,
    Code,
    Details,
    Items,
    Page,
    Pictures,
    Section,
    Words,
    picture,
    write_page,
)
from .tables import by_equation, equations_block, fit_settings, footer, settings_table, verdict_blocks

CLEAR = 0.5
"""Terms more probable than this are marked."""

_CHECKS = {
    "LOO-PIT": "Leave-one-out predictions are as wide as they say",
    "whiteness": "Residuals are independent, as the noise model says",
    "linearity": "Samples are linear enough in what was learned",
    "prior sensitivity": "The data decide, not the prior",
}

_TESTS = ("LOO-PIT", "whiteness")
"""Checks whose value is a p-value."""


def fit_html(fit: Posterior, path: str | os.PathLike[str], config: str | None = None) -> None:
    """Write the report of a fit as one HTML file that needs no network.

    Args:
        fit: The fit.
        path: Destination.
        config: Text of the configuration file that asked for it; what the fit knows of it by default.

    Raises:
        InputError: The destination cannot be written.
    """
    write_page(fit_page(fit, config), path)


def fit_page(fit: Posterior, config: str | None = None) -> Page:
    """The report of a fit.

    Args:
        fit: The fit.
        config: Text of the configuration file that asked for it; what the fit knows of it by default.
    """
    verdict, terms, shares = convergence(fit), inclusion(fit), discrepancy_table(fit)
    sections = [
        *_study(fit),
        _coefficients(fit, terms),
        *([] if fit.model.discrepancy is None else [_discrepancy(fit, shares)]),
        _predicted(fit),
        *trial_sections(fit),
        _checks(fit),
        Section("convergence", "Can the sampler be trusted?", "", verdict_blocks(fit)),
        _settings(fit, config or fit.idata.attrs.get(CONFIGURATION)),
    ]
    doubt = SHORT_VERDICT if verdict.short else "The sampler did not converge; do not rely on these numbers."
    return Page(
        title="Fit: converged" if verdict.mixed else "Fit: not converged",
        kind="bayes_greybox · fit",
        headline=_headline(fit, terms, shares),
        badges=[_badge(verdict)],
        facts=_facts(fit),
        alerts=[] if verdict.ok else [" ".join([doubt, *verdict.reasons])],
        equations=equations_block(fitted_system(fit)),
        cards=_cards(fit, shares),
        cards_title=f"Where the variance of the measured {fit.data.target_in_words(*fit.model.equations)} goes",
        sections=sections,
        footer=footer(str(fit.idata.attrs.get("inference_library_version", ""))),
    )


def _badge(verdict: Verdict) -> Badge:
    if verdict.short:
        return Badge("Converged, few draws", "warn", "✓")
    return Badge("Converged", "good", "✓") if verdict.ok else Badge("Not converged", "bad", "!")


def _headline(fit: Posterior, table: pd.DataFrame, shares: pd.DataFrame) -> str:
    column = probability_column(table)
    sentences = []
    for name in fit.model.equations:
        rows = table.loc[name]
        terms = [formula(str(term)) for term in rows.index[rows[column] > CLEAR]]
        found = f"{listed(terms)} matter" if len(terms) > 1 else f"{terms[0]} matters" if terms else "no term matters"
        discrepancy = ""
        if fit.model.discrepancy:
            left = share_text(max(float(shares.loc[name, "discrepancy"]), 0.0))
            discrepancy = f"; {left} of the variance is left to the discrepancy"
        sentences.append(f"In {_rate(fit, name)}, {found}{discrepancy}.")
    return " ".join(sentences)


def _rate(fit: Posterior, name: str) -> str:
    """What rows are of: the rate of a state, an output, or the samples that several equations share."""
    return fit.data.target_label(name) if name in fit.model.equations else "the samples"


def _with_unit(value: float, fit: Posterior, name: str) -> str:
    return quantity(value, target_unit(name, fit.data))


def _facts(fit: Posterior) -> list[str]:
    data, sampling = fit.data, fit.sampling
    runs = f" in {data.n_run} runs" if data.n_run > 1 else ""
    dropped = f", {data.dropped} dropped" if data.dropped else ""
    kernel = "none" if fit.model.discrepancy is None else fit.model.discrepancy.variant
    return [
        f"data: {data.n_obs} rows{runs}{dropped}" if fit.whole is None else f"data: {fit.rows_in_words}",
        f"rows: {fit.model.rows.in_words(data)}",
        f"prior: {fit.model.prior_text}",
        f"discrepancy: {kernel}",
        f"{sampling.chains} × {sampling.draws} draws",
    ]


def _cards(fit: Posterior, shares: pd.DataFrame) -> list[Card]:
    cards = []
    several = len(fit.equations) > 1
    for name, row in zip(shares.index, shares.to_dict("records"), strict=True):
        where = f" in {_rate(fit, str(name))}" if several else ""
        if row["simulation"] != 0:
            cards.append(Card(f"Simulation{where}", "Share of the variance.", share_text(row["simulation"])))
        cards.append(Card(f"Dictionary{where}", "Share of the variance.", share_text(row["dictionary"])))
        if fit.model.discrepancy is not None:
            span = share_interval(row["discrepancy_lower"], row["discrepancy_upper"])
            about = f"Share of the variance that no term explains; 90\u00a0% interval {span}."
            cards.append(Card(f"Discrepancy{where}", about, share_text(max(row["discrepancy"], 0.0))))
        cards.append(Card(f"Noise{where}", "Share of the variance.", share_text(row["noise"])))
    return cards


def _study(fit: Posterior) -> list[Section]:
    """What the missing-effect study said that made this model, if one did."""
    text = fit.idata.attrs.get("missing_effects")
    if not text:
        return []
    found = json.loads(text)
    words = Words(f"{found['sentence']} (Verdict: {found['verdict']}.)")
    return [Section("study", "The study that made this model", "", [words])]


def _coefficients(fit: Posterior, table: pd.DataFrame) -> Section:
    column = probability_column(table)
    records = table.to_dict("records")
    priors = {name: fit.model.stated(name, fit.data).priors for name in fit.model.equations}
    rows = []
    for (name, term), row in zip(table.index, records, strict=True):
        prior = priors[name].get(term)
        learned = prior is None or prior.learned
        cells = (
            formula(str(term)),
            _rate(fit, str(name)),
            term_probability(row, column, prior),
            estimate(row["mean"], row["sd"], row["unit"]) if learned else exact_text(row["mean"], row["unit"]),
            interval(row["lower"], row["upper"]) if learned else "–",
            number(row["shrinkage"], 2) if learned else "–",
        )
        rows.append((*cells, stated_text(prior)) if "stated" in table else cells)
    clear = [bool(row[column] > CLEAR) for row in records]
    heads = ("`term", "equation", f"#{PROBABILITIES[column]}", "#coefficient", "#90 % interval", "#shrinkage")
    heads = (*heads, "stated") if "stated" in table else heads
    shown, absent = (
        [row for row, is_clear in zip(rows, clear, strict=True) if is_clear is kept] for kept in (True, False)
    )
    blocks: list[Any] = [Words("No term is more likely to matter than not.")]
    if shown:
        drawn = figures.coefficients(fit, least=CLEAR)
        blocks = [
            Pictures([picture(drawn, "Coefficients with intervals and probabilities", wide=True)]),
            by_equation(heads, shown, fit.model.equations, "Terms more likely to matter than not"),
        ]
    if absent:
        few = f"{len(absent)} terms" if len(absent) > 1 else "1 term"
        folded = by_equation(heads, absent, fit.model.equations, "Terms that are likely absent, or too small to matter")
        blocks.append(Details(f"{few} no more likely to matter than not", [folded]))
    lead = "Posterior mean, standard deviation and equal-tailed 90 % interval of each coefficient, in your units."
    return Section("coefficients", "Coefficients", lead, blocks)


def _discrepancy(fit: Posterior, shares: pd.DataFrame) -> Section:
    blocks: list[Any] = []
    for name in fit.model.equations:
        rate = _rate(fit, name)
        shown = [
            picture(figures.discrepancy_over_states(fit, name), f"Discrepancy in {rate} over the states", wide=True),
            picture(figures.discrepancy_over_time(fit, name), f"Discrepancy in {rate} along time", wide=True),
        ]
        blocks.append(Pictures(shown))
    rows = [
        (
            _rate(fit, str(name)),
            share_text(row["discrepancy"]),
            share_interval(row["discrepancy_lower"], row["discrepancy_upper"]),
            _with_unit(row["rms"], fit, str(name)),
            _with_unit(row["sigma"], fit, str(name)),
            f"{number(row['correlation'], 2)} ({formula(row['term'])})",
            number(row["correlation_none"], 2),
        )
        for name, row in zip(shares.index, shares.to_dict("records"), strict=True)
    ]
    heads = (
        "equation",
        "#share",
        "#90 % interval",
        "#RMS of f",
        "#noise SD",
        "#trade-off with θ",
        "#without orthogonality",
    )
    blocks.append(by_equation(heads, rows, fit.model.equations, "The discrepancy beside the noise and the terms"))
    trades = [
        picture(figures.trade_off(fit, name), f"Posterior trade-off of f with a coefficient of {_rate(fit, name)}")
        for name in fit.model.equations
    ]
    blocks.append(Details("Trade-off between coefficients and discrepancy", [Pictures(trades)]))
    lead = (
        "What neither the simulation nor any term explains: the posterior of f over the states and along the record. "
        "Colours reach to the standard deviation of the noise at least: what is pale is small beside it."
    )
    return Section("discrepancy", "What no term explains", lead, blocks)


def _predicted(fit: Posterior) -> Section:
    shown = [
        picture(figures.predicted(fit, name), f"Predicted and measured {_rate(fit, name)}", wide=True)
        for name in fit.model.equations
    ]
    errors = predict(fit, fit.data).nmse()
    text = ", ".join(f"{_rate(fit, str(name))} {share_text(value)}" for name, value in errors.items())
    words = Words(f"Mean square error over the variance of the measurements, training data: {text}.")
    return Section("predicted", "Predicted and measured", "", [Pictures(shown), words])


def _checks(fit: Posterior) -> Section:
    found = checks(fit)
    rows = [
        (
            _CHECKS[str(check)],
            _rate(fit, str(name)),
            "not known" if math.isnan(row["value"]) else "passed" if row["ok"] else "look at this",
            "" if math.isnan(row["value"]) else (probability_text if check in _TESTS else _two)(row["value"]),
            "" if math.isnan(row["limit"]) else number(row["limit"], 2),
        )
        for (name, check), row in zip(found.table.index, found.table.to_dict("records"), strict=True)
    ]
    marked = [i for i, ok in enumerate(found.table["ok"]) if not ok]
    heads = ("check", "equation", "result", "#value", "#limit")
    blocks: list[Any] = []
    if found.reasons:
        blocks += [Words("What the checks say, and what to try:"), Items([("", reason) for reason in found.reasons])]
    blocks.append(by_equation(heads, rows, fit.model.equations, "Checks that did not pass are marked", marked))
    for name in fit.equations:
        rate = _rate(fit, name)
        shown = [
            picture(figures.loo_pit(fit, name), f"Leave-one-out predictions of {rate} against a uniform distribution"),
            picture(figures.autocorrelation(fit, name), f"Autocorrelation of the whitened residuals of {rate}"),
        ]
        if "prior_predictive" in fit.idata:
            words = f"Distribution of {rate}: measured, drawn from the prior and drawn from the posterior"
            shown.append(picture(figures.predictive(fit, name), words, wide=True))
        blocks.append(Pictures(shown))
    table = [
        (
            formula(str(quantity)),
            _rate(fit, str(name)),
            number(row["prior"], 2),
            number(row["likelihood"], 2),
            row["diagnosis"],
        )
        for (name, quantity), row in zip(found.sensitivity.index, found.sensitivity.to_dict("records"), strict=True)
    ]
    heads = ("`quantity", "equation", "#to the prior", "#to the likelihood", "diagnosis")
    shown = [picture(figures.sensitivity(fit), "Sensitivity of each quantity to prior and likelihood", wide=True)]
    scaled = by_equation(heads, table, fit.model.equations, "Change for each doubling of the weight")
    blocks.append(Details("Sensitivity to prior and likelihood", [Pictures(shown), scaled]))
    lead = (
        "Two tests, each wrong about at most one in a hundred correct models (p-value below its limit), and how much "
        "the answers would change if the prior counted more or less."
    )
    return Section("checks", "Do the data support the model?", lead, blocks)


def _two(value: float) -> str:
    return number(value, 2)


def _settings(fit: Posterior, config: str | None) -> Section:
    blocks = [Details("Model, sampler, seed and versions", [settings_table(fit_settings(fit))])]
    if config:
        blocks.append(Details("Configuration file", [Code(config)]))
    return Section("settings", "How this was made", "", blocks)
