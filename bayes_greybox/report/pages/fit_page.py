"""The page of one fit: verdict, coefficients, discrepancy, predictions, checks and settings."""

import json
import math
import os
from typing import Any

import pandas as pd

from bayes_greybox.criticism.checks.checks import checks
from bayes_greybox.criticism.convergence import SHORT_VERDICT, convergence
from bayes_greybox.criticism.discrepancy import discrepancy_table
from bayes_greybox.criticism.inclusion import inclusion
from bayes_greybox.criticism.prediction import predict
from bayes_greybox.equations.of_posterior import fitted_system
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.physics.coefficient import Coefficient
from bayes_greybox.physics.units import target_unit
from bayes_greybox.report import plots as figures
from bayes_greybox.report.folders.holding import CONFIGURATION_ATTRIBUTE
from bayes_greybox.report.pages.shared import trial_sections
from bayes_greybox.report.tables import records_of, table_of
from bayes_greybox.report.words import fit as words
from bayes_greybox.report.words import formatting as fmt

from .page import Badge, Card, Cards, Details, Items, Page, Pictures, Section, Words, picture, write_page
from .shared import equations_block, fit_settings, folded, footer, made_section, verdict_blocks

_CHECKS = {
    "LOO-PIT": "Leave-one-out predictions are as wide as they say",
    "whiteness": "Residuals are independent, as the noise model says",
    "linearity": "Samples are linear enough in what was learned",
    "prior sensitivity": "The data decide, not the prior",
}


def fit_html(fit: Posterior, path: str | os.PathLike[str], config: str | None = None) -> None:
    """Write the report of a fit, with the text of its configuration file, as one HTML file; see `write_page`."""
    write_page(fit_page(fit, config), path)


def fit_page(fit: Posterior, config: str | None = None) -> Page:
    """Return the report of a fit; see `fit_html`."""
    verdict, terms, shares = convergence(fit), inclusion(fit), discrepancy_table(fit)
    written = fit.idata.attrs.get(CONFIGURATION_ATTRIBUTE)
    sections = [
        *_study(fit),
        _coefficients(fit, terms),
        *([] if fit.model.discrepancy is None else [_discrepancy(fit, shares)]),
        _predicted(fit),
        *trial_sections(fit),
        _checks(fit),
        Section("convergence", "Can the sampler be trusted?", "", verdict_blocks(fit)),
        made_section("Model, sampler, seed and versions", fit_settings(fit), config or written),
    ]
    doubt = SHORT_VERDICT if verdict.short else "The sampler did not converge; do not rely on these numbers."
    badge = Badge("Converged", "good", "✓") if verdict.ok else Badge("Not converged", "bad", "!")
    return Page(
        title="Fit: converged" if verdict.mixed else "Fit: not converged",
        kind="bayes_greybox · fit",
        headline=_headline(fit, terms, shares),
        badges=[Badge("Converged, few draws", "warn", "✓") if verdict.short else badge],
        facts=_facts(fit),
        alerts=[] if verdict.ok else [" ".join([doubt, *verdict.reasons])],
        equations=equations_block(fitted_system(fit)),
        opening=[_shares(fit, shares)],
        sections=sections,
        footer=footer(str(fit.idata.attrs.get("inference_library_version", ""))),
    )


def _headline(fit: Posterior, table: pd.DataFrame, shares: pd.DataFrame) -> str:
    column = fmt.probability_column(table)
    sentences = []
    for name in fit.model.equations:
        rows = table.loc[name]
        terms = [fmt.formula(str(term)) for term in rows.index[rows[column] > words.LIKELY_TO_MATTER]]
        text = f"{fmt.listed(terms) if terms else 'no term'} {'matter' if len(terms) > 1 else 'matters'}"
        if fit.model.discrepancy:
            left = fmt.share_text(max(float(shares.loc[name, "discrepancy"]), 0.0))
            text += f"; {left} of the variance is left to the discrepancy"
        sentences.append(f"In {words.row_label(fit, name)}, {text}.")
    return " ".join(sentences)


def _facts(fit: Posterior) -> list[str]:
    data, sampling = fit.data, fit.sampling
    rows = words.rows_text(data) + (f", {data.dropped} dropped" if data.dropped else "")
    kernel = "none" if fit.model.discrepancy is None else fit.model.discrepancy.variant
    return [
        f"data: {rows if fit.whole is None else fit.rows_in_words}",
        f"rows: {fit.model.rows.in_words(data)}",
        f"prior: {fit.model.prior_text}",
        f"discrepancy: {kernel}",
        f"{sampling.chains} × {sampling.draws} draws",
    ]


def _shares(fit: Posterior, shares: pd.DataFrame) -> Section:
    cards = []
    for name, row in zip(shares.index, shares.to_dict("records"), strict=True):
        where = f" in {words.row_label(fit, str(name))}" if len(fit.equations) > 1 else ""
        share = "Share of the variance"
        parts = {"Simulation": (row["simulation"], ".")} if row["simulation"] != 0 else {}
        parts["Dictionary"] = row["dictionary"], "."
        if fit.model.discrepancy is not None:
            span = fmt.share_interval(row["discrepancy_lower"], row["discrepancy_upper"])
            parts["Discrepancy"] = max(row["discrepancy"], 0.0), f" that no term explains; 90\u00a0% interval {span}."
        parts["Noise"] = row["noise"], "."
        cards += [
            Card(f"{part}{where}", f"{share}{rest}", fmt.share_text(size)) for part, (size, rest) in parts.items()
        ]
    title = f"Where the variance of the measured {fit.data.target_in_words(*fit.model.equations)} goes"
    return Section("numbers", title, "", [Cards(cards)])


def _study(fit: Posterior) -> list[Section]:
    """Return the verdict of the missing-effect study that made this model, if one did."""
    text = fit.idata.attrs.get("missing_effects")
    if not text:
        return []
    found = json.loads(text)
    said = Words(f"{found['sentence']} (Verdict: {found['verdict']}.)")
    return [Section("study", "The study that made this model", "", [said])]


def _coefficients(fit: Posterior, table: pd.DataFrame) -> Section:
    column = fmt.probability_column(table)
    priors = {name: fit.model.stated(name, fit.data).priors for name in fit.model.equations}

    def prior(row: Any) -> Coefficient | None:
        return priors[row["equation"]].get(row["term"])

    columns = {
        "`term": lambda row: fmt.formula(str(row["term"])),
        "equation": lambda row: words.row_label(fit, str(row["equation"])),
        f"#{fmt.PROBABILITIES[column]}": lambda row: words.term_probability(row, column),
        "#coefficient": lambda row: words.size_text(row, prior(row)),
        "#90 % interval": lambda row: words.ends_text(row, prior(row)),
        "#shrinkage": lambda row: fmt.number(row["shrinkage"], 2) if words.is_learned(prior(row)) else "–",
    }
    if "stated" in table:
        columns["stated"] = lambda row: words.stated_text(prior(row))

    captions = (
        "Terms more likely to matter than not",
        "Terms that are likely absent, or too small to matter",
        "{} no more likely to matter than not",
    )
    nothing = "No term is more likely to matter than not."
    records, equations = records_of(table), fit.model.equations
    blocks = folded(records, lambda row: row[column] > words.LIKELY_TO_MATTER, columns, equations, captions, nothing)
    if any(table[column] > words.LIKELY_TO_MATTER):
        drawn = figures.coefficients(fit, least=words.LIKELY_TO_MATTER)
        alt = "Coefficients with intervals and probabilities"
        blocks.insert(0, Pictures([picture(drawn, alt, wide=True)]))
    lead = "Posterior mean, standard deviation and equal-tailed 90 % interval of each coefficient, in your units."
    return Section("coefficients", "Coefficients", lead, blocks)


def _discrepancy(fit: Posterior, shares: pd.DataFrame) -> Section:
    blocks: list[Any] = []
    draws = {"over the states": figures.discrepancy_over_states, "along time": figures.discrepancy_over_time}
    learned = fitted_system(fit).learned
    for name in fit.model.equations:
        label, f = words.row_label(fit, name), learned[name].discrepancy
        alt = f"Discrepancy in {label}"
        shown = Pictures([picture(draw(fit, name), f"{alt} {how}", wide=True) for how, draw in draws.items()])
        if f is not None and f.left:
            blocks.append(shown)
        else:
            # A map of nothing shows patterns all the same.
            blocks += [Words(f"The data do not tell f of {label} from zero."), Details(f"f of {label} anyway", [shown])]
    columns = {
        "equation": lambda row: words.row_label(fit, row["equation"]),
        "#share": lambda row: fmt.share_text(row["discrepancy"]),
        "#90 % interval": lambda row: fmt.share_interval(row["discrepancy_lower"], row["discrepancy_upper"]),
        "#RMS of f": lambda row: fmt.quantity(row["rms"], target_unit(row["equation"], fit.data)),
        "#noise SD": lambda row: fmt.quantity(row["sigma"], target_unit(row["equation"], fit.data)),
        "#trade-off with θ": lambda row: f"{fmt.number(row['correlation'], 2)} ({fmt.formula(row['term'])})",
        "#without orthogonality": lambda row: fmt.number(row["correlation_none"], 2),
    }
    caption = "The discrepancy beside the noise and the terms"
    blocks.append(table_of(records_of(shares), columns, caption, equations=fit.model.equations))
    alt = "Posterior trade-off of f with a coefficient of {}"
    trades = [
        picture(figures.trade_off(fit, name), alt.format(words.row_label(fit, name))) for name in fit.model.equations
    ]
    blocks.append(Details("Trade-off between coefficients and discrepancy", [Pictures(trades)]))
    lead = (
        "What neither the simulation nor any term explains: the posterior of f over the states and along the record. "
        "Colours reach to the standard deviation of the noise at least: what is pale is small beside it."
    )
    return Section("discrepancy", "What no term explains", lead, blocks)


def _predicted(fit: Posterior) -> Section:
    shown = [
        picture(figures.predicted(fit, name), f"Predicted and measured {words.row_label(fit, name)}", wide=True)
        for name in fit.model.equations
    ]
    errors = predict(fit, fit.data).nmse()
    text = ", ".join(f"{words.row_label(fit, str(name))} {fmt.share_text(value)}" for name, value in errors.items())
    said = Words(f"Mean square error over the variance of the measurements, training data: {text}.")
    return Section("predicted", "Predicted and measured", "", [Pictures(shown), said])


def _checks(fit: Posterior) -> Section:
    results = checks(fit)

    def value(row: Any) -> str:
        if math.isnan(row["value"]):
            return ""
        p_value = row["check"] in ("LOO-PIT", "whiteness")
        return fmt.probability_text(row["value"]) if p_value else fmt.number(row["value"], 2)

    columns = {
        "check": lambda row: _CHECKS[row["check"]],
        "equation": lambda row: words.row_label(fit, row["equation"]),
        "result": lambda row: "not known" if math.isnan(row["value"]) else "passed" if row["ok"] else "look at this",
        "#value": value,
        "#limit": lambda row: "" if math.isnan(row["limit"]) else fmt.number(row["limit"], 2),
    }
    blocks: list[Any] = []
    if results.reasons:
        blocks += [Words("What the checks say, and what to try:"), Items([("", reason) for reason in results.reasons])]
    caption, equations = "Checks that did not pass are marked", fit.model.equations
    blocks.append(table_of(records_of(results.table), columns, caption, lambda row: not row["ok"], equations))
    for name in fit.equations:
        rate = words.row_label(fit, name)
        shown = [
            picture(figures.loo_pit(fit, name), f"Leave-one-out predictions of {rate} against a uniform distribution"),
            picture(figures.autocorrelation(fit, name), f"Autocorrelation of the whitened residuals of {rate}"),
        ]
        if "prior_predictive" in fit.idata:
            alt = f"Distribution of {rate}: measured, drawn from the prior and drawn from the posterior"
            shown.append(picture(figures.predictive(fit, name), alt, wide=True))
        blocks.append(Pictures(shown))
    columns = {
        "`quantity": lambda row: fmt.formula(str(row["quantity"])),
        "equation": lambda row: words.row_label(fit, row["equation"]),
        "#to the prior": lambda row: fmt.number(row["prior"], 2),
        "#to the likelihood": lambda row: fmt.number(row["likelihood"], 2),
        "diagnosis": lambda row: row["diagnosis"],
    }
    shown = [picture(figures.sensitivity(fit), "Sensitivity of each quantity to prior and likelihood", wide=True)]
    caption = "Change for each doubling of the weight"
    scaled = table_of(records_of(results.sensitivity), columns, caption, equations=equations)
    blocks.append(Details("Sensitivity to prior and likelihood", [Pictures(shown), scaled]))
    lead = (
        "Two tests, each wrong about at most one in a hundred correct models (p-value below its limit), and how much "
        "the answers would change if the prior counted more or less."
    )
    return Section("checks", "Do the data support the model?", lead, blocks)
