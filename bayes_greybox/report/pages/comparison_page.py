"""The page of a comparison: the model that predicts best and how sure that is, then what each model says."""

import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pandas as pd

from bayes_greybox.criticism.convergence import SHORT_VERDICT, convergence, convergence_table
from bayes_greybox.criticism.cross_validation.compare import TIE_NATS, tied, unreliable
from bayes_greybox.criticism.inclusion import inclusion
from bayes_greybox.inference.kept.netcdf import versions
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.report.plots import plot_comparison
from bayes_greybox.report.tables import Table, records_of, table_of

from ..words.fit import LIKELY_TO_MATTER, compared, ends_text, is_learned, rows_text, size_text, term_probability
from ..words.formatting import PROBABILITIES, count_text, formula, listed, nats, number, probability_column
from .page import Badge, Details, Items, Page, Pictures, Section, Words, picture, write_page
from .shared import fit_settings, folded, footer, settings_rows, settings_section, summary_table


def comparison_html(
    fits: Mapping[str, Posterior], table: pd.DataFrame, path: str | os.PathLike[str], config: str | None = None
) -> None:
    """Write the report of a comparison, whose table is that of `compare`, as one HTML file; see `write_page`."""
    write_page(comparison_page(fits, table, config), path)


def comparison_page(fits: Mapping[str, Posterior], table: pd.DataFrame, config: str | None = None) -> Page:
    """Return the report of a comparison; see `comparison_html`."""
    fits = {str(name): fits[str(name)] for name in table.index}
    made = table.attrs.get("versions") or versions()
    verdict = Badge("Too close to call", "warn", "≈") if tied(table) else Badge("Clear lead", "good", "✓")
    badges, alerts = _trust(fits, table, verdict)
    data = fits[str(table.index[0])].data
    estimates = _estimates(fits)
    return Page(
        title=f"Comparison: {verdict.text.lower()}",
        kind="bayes_greybox · comparison of models",
        headline=_headline(table),
        badges=badges,
        facts=[f"{len(fits)} models", f"data: {rows_text(data)}", f"left out: {table.attrs['folds']}"],
        alerts=alerts,
        sections=[
            _ranking(table),
            _terms(fits, estimates),
            _coefficients(fits, estimates),
            _convergence(fits),
            _settings(fits, made, config),
        ],
        footer=footer(made["bayes-greybox"]),
    )


def _headline(table: pd.DataFrame) -> str:
    """Return the model that predicts best and how sure that is, in words for those who decide."""
    best, second = (str(name) for name in table.index[:2])
    if level := tied(table):
        behind = [str(name) for name in table.index[1:] if name not in level]
        rest = f"; {listed(behind)} {'predicts' if len(behind) == 1 else 'predict'} worse" if behind else ""
        return f"Too close to call: the data do not tell {listed([best, *level])} apart{rest}."
    gap, se = -float(table["elpd_diff"].iloc[1]), float(table["diff_se"].iloc[1])
    sure = f", {gap / se:.1f} times the standard error of that lead" if se > 0 else ""
    return f"{best} predicts data left out of the fit best: it is {nats(gap)} nats ahead of {second}{sure}."


def _trust(fits: Mapping[str, Posterior], table: pd.DataFrame, verdict: Badge) -> tuple[list[Badge], list[str]]:
    """Return badges and alerts: a lead that rests on bad chains or weights is not shown as good."""
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
    return [*badges, Badge(verdict.text, "quiet", verdict.symbol) if badges else verdict], alerts


def _ranking(table: pd.DataFrame) -> Section:
    best = {str(table.index[0]), *tied(table)}
    headings = {
        "model": "model", "#elpd, nats": "elpd", "#± SE, nats": "se", "#difference, nats": "elpd_diff",
        "#± SE of the difference, nats": "diff_se", "#weight": "weight", "#worst k": "worst_k", "#refits": "refits",
        "#p_eff": "p_eff",
    }  # fmt: skip
    columns = {heading: compared(name) for heading, name in headings.items()}
    drawn = plot_comparison(table)
    caption = f"Left out: {table.attrs['folds']}. Marked: the best model, and those that the data do not tell from it"
    blocks: list[Any] = [
        Pictures([picture(drawn, "Elpd of each model, its difference to the best and its weight", wide=True)]),
        table_of(records_of(table.rename_axis("model")), columns, caption, lambda row: row["model"] in best),
    ]
    if notes := list(table.attrs.get("notes", [])):
        blocks += [Words("What to beware of:"), Items([("", note) for note in notes])]
    safe = number(table.attrs["threshold"], 2)
    meaning = [
        ("elpd", "Expected log predictive density: log probability of the data left out, summed; higher is better."),
        ("Difference", f"To the best model. It counts above {TIE_NATS:g} nats and twice its standard error (SE)."),
        ("Weight", "Share of each model in the mixture of models that predicts best (stacking)."),
        ("Worst k", f"Largest Pareto k among parts left out that were not fitted again; up to {safe} is safe. A dash: "
         "all were."),
        ("Refits", "Parts that the model was fitted again without, because k was too large."),
        ("p_eff", "Effective number of sampled parameters."),
    ]  # fmt: skip
    blocks.append(Details("What the columns mean", [Items(meaning)]))
    lead = "Every model is judged on data that its prediction did not use: how probable did it hold what was measured?"
    return Section("ranking", "Which model predicts best?", lead, blocks)


def _estimates(fits: Mapping[str, Posterior]) -> list[dict[str, Any]]:
    """Return the coefficients of every term, those of an equation together, under each model that has it, in words."""
    tables: dict[str, Any] = {name: inclusion(fit) for name, fit in fits.items()}
    keys = list(dict.fromkeys((str(name), str(term)) for table in tables.values() for name, term in table.index))
    order = list(dict.fromkeys(equation for equation, _ in keys))
    estimates = []
    for key in sorted(keys, key=lambda key: order.index(key[0])):
        for name, fit in fits.items():
            if key not in tables[name].index:
                continue
            row, column = tables[name].loc[key].to_dict(), probability_column(tables[name])
            prior = fit.model.stated(key[0], fit.data).priors.get(key[1])
            size = f"{size_text(row, prior)}{'' if is_learned(prior) else ' (given)'}"
            texts = {"size": size, "ends": ends_text(row, prior), "probability": term_probability(row, column)}
            estimates.append({"key": key, "model": name, "likely": row[column] > LIKELY_TO_MATTER, **texts})
    return estimates


def _terms(fits: Mapping[str, Posterior], estimates: Sequence[Mapping[str, Any]]) -> Section:
    first, *_ = fits
    data, equations = fits[first].data, fits[first].model.equations
    by_key: dict[tuple[str, str], dict[str, Any]] = {}
    for each in estimates:
        by_key.setdefault(each["key"], {})[each["model"]] = each
    titles = {name: PROBABILITIES[probability_column(inclusion(fit))] for name, fit in fits.items()}

    def cell(name: str) -> Callable[[Any], str]:
        return lambda key: by_key[key][name]["probability"] if name in by_key[key] else "–"

    columns = {
        "`term": lambda key: formula(key[1]),
        "equation": lambda key: data.target_label(key[0]),
        **{f"#{name}: {title}": cell(name) for name, title in titles.items()},
    }
    captions = (
        "Terms more likely to matter than not under some model; those of the best one are marked",
        "Terms that are likely absent under every model",
        "{} likely absent under every model",
    )
    nothing, likely = "Under no model is a term more likely to matter than not.", _likely(estimates)
    best = _likely([each for each in estimates if each["model"] == first])
    blocks = folded(by_key, likely.__contains__, columns, equations, captions, nothing, best.__contains__)
    moved = data.target_in_words(*equations, article="the ")
    lead = (
        "Probability that a term matters. Only a spike-and-slab prior can leave a term out, and has P(included); for "
        f"the others it is the probability of moving {moved} by more than 1 % (RMS) of what the simulation leaves. A "
        "dash: not in the model."
    )
    return Section("terms", "Which terms matter under each model?", lead, blocks)


def _coefficients(fits: Mapping[str, Posterior], estimates: Sequence[Mapping[str, Any]]) -> Section:
    fit, likely = next(iter(fits.values())), _likely(estimates)
    columns = {
        "`term": lambda each: formula(each["key"][1]),
        "equation": lambda each: fit.data.target_label(each["key"][0]),
        "model": lambda each: each["model"],
        "#coefficient": lambda each: each["size"],
        "#90 % interval": lambda each: each["ends"],
    }
    captions = (
        "Coefficients of the terms more likely to matter than not under some model",
        "Coefficients of the other terms",
        "Coefficients of terms likely absent under every model",
    )
    blocks = folded(estimates, lambda each: each["key"] in likely, columns, fit.model.equations, captions)
    lead = "Posterior mean, standard deviation and equal-tailed 90 % interval of each coefficient, in your units."
    return Section("coefficients", "Coefficients", lead, blocks)


def _likely(estimates: Sequence[Mapping[str, Any]]) -> set[tuple[str, str]]:
    return {each["key"] for each in estimates if each["likely"]}


def _convergence(fits: Mapping[str, Posterior]) -> Section:
    verdicts = {name: convergence(fit) for name, fit in fits.items()}
    failings = {name: "converged, few draws" if each.short else "not converged" for name, each in verdicts.items()}
    tables: dict[str, Any] = {name: convergence_table(fit) for name, fit in fits.items()}
    columns = {
        "model": lambda name: name,
        "result": lambda name: "converged" if verdicts[name].ok else failings[name],
        "#largest R̂": lambda name: number(tables[name]["r_hat"].max(), 4),
        "#least bulk ESS": lambda name: count_text(tables[name]["ess_bulk"].min()),
        "#least tail ESS": lambda name: count_text(tables[name]["ess_tail"].min()),
        "#divergences": lambda name: number(int(fits[name].idata["sample_stats"].dataset["diverging"].sum())),
    }
    failed = [name for name, verdict in verdicts.items() if not verdict.mixed]
    caption = f"How well each model was sampled{'; marked: not converged' if failed else ''}"
    blocks: list[Any] = [table_of(fits, columns, caption, lambda name: name in failed)]
    if reasons := [(name, reason) for name, verdict in verdicts.items() for reason in verdict.reasons]:
        words = Words("The sampler did not converge; what to try:", "alert") if failed else Words(SHORT_VERDICT)
        blocks += [words, Items(reasons)]
    blocks += [
        Details(f"{name}: every quantity with R̂ and effective sample sizes", [summary_table(fit)])
        for name, fit in fits.items()
    ]
    return Section("convergence", "Can the sampler be trusted?", "", blocks)


def _settings(fits: Mapping[str, Posterior], made: Mapping[str, str], config: str | None) -> Section:
    """Return the section of the settings in which models differ, side by side, and of those that they share."""
    settings = {}
    for name, fit in fits.items():
        described = fit_settings(fit)
        # A place for the kernel also where there is none.
        described["model"]["discrepancy"] = described["model"]["discrepancy"] or {"variant": None}
        settings[name] = dict(settings_rows(described))
    keys = dict.fromkeys(key for one in settings.values() for key in one)
    rows = {key: [one.get(key) for one in settings.values()] for key in keys}
    partly = {key: [value or "–" for value in row] for key, row in rows.items() if None in row}
    differ = {key: row for key, row in rows.items() if key not in partly and len(set(row)) > 1}
    shared = {key: row[:1] for key, row in rows.items() if key not in partly and len(set(row)) == 1}

    def drawn(some: Mapping[str, Sequence[Any]], caption: str, heads: Sequence[str] = tuple(fits)) -> Table:
        return Table(("setting", *heads), [(key, *row) for key, row in some.items()], caption)

    blocks: list[Any] = [drawn(differ, "Settings that differ")] if differ else []
    if not differ and not partly:
        blocks = [Words("Prior, kernel, data and sampler are the same for all models.")]
    if partly:
        blocks.append(Details("Settings that only some of the models have", [drawn(partly, "Settings of some models")]))
    by_package = "Versions by package"
    blocks += [
        Details("Settings that all models share", [drawn(shared, "Settings of all models", ("value",))]),
        Details("Versions that made the comparison", [Table(("setting", "value"), settings_rows(made), by_package)]),
    ]
    return settings_section("What do the models differ in?", blocks, config)
