"""The page of a comparison: the model that predicts best and how sure that is, then what each model says."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import pandas as pd

from bayes_greybox.criticism.convergence import SHORT, Verdict, convergence, convergence_table
from bayes_greybox.criticism.cross_validation.compare import TIE_NATS, tied, unreliable
from bayes_greybox.criticism.inclusion import inclusion
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.kept.netcdf import versions
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.physics.coefficient import Coefficient
from bayes_greybox.report.plots import plot_comparison
from bayes_greybox.report.tables import Table, records_of, table_of
from bayes_greybox.report.words.formatting import (
    PROBABILITIES,
    count_text,
    formula,
    interval,
    listed,
    nats,
    number,
    pareto,
    probability_column,
    weight_text,
)
from bayes_greybox.report.words.stated import MATTERS, is_learned, size_text, term_probability

from .page import Badge, Details, Items, Page, Pictures, Section, Words, picture, write_page
from .shared import fit_settings, folded, footer, settings_rows, settings_section, settings_table, summary_table


def comparison_html(
    fits: Mapping[str, Posterior], table: pd.DataFrame, path: str | os.PathLike[str], config: str | None = None
) -> None:
    """Write the report of a comparison as one HTML file that needs no network.

    Args:
        fits: The fits by name.
        table: Result of `compare` for them, best first.
        path: Destination.
        config: Text of the configuration file that asked for it.

    Raises:
        InputError: The destination cannot be written.
    """
    write_page(comparison_page(fits, table, config), path)


def comparison_page(fits: Mapping[str, Posterior], table: pd.DataFrame, config: str | None = None) -> Page:
    """Return the report of a comparison.

    Args:
        fits: The fits by name.
        table: Result of `compare` for them, best first.
        config: Text of the configuration file that asked for it.
    """
    fits = {str(name): fits[str(name)] for name in table.index}
    made = table.attrs.get("versions") or versions()
    badges, alerts = _trust(fits, table)
    terms = _Terms.of(fits)
    return Page(
        title=f"Comparison: {_verdict(table).text.lower()}",
        kind="bayes_greybox · comparison of models",
        headline=_headline(table),
        badges=badges,
        facts=_facts(fits, table),
        alerts=alerts,
        sections=[
            _ranking(table),
            _terms(terms),
            _coefficients(terms),
            _convergence(fits),
            _settings(fits, made, config),
        ],
        footer=footer(made["bayes-greybox"]),
    )


def _headline(table: pd.DataFrame) -> str:
    """Return the model that predicts best and how sure that is, in words for those who decide."""
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
    verdict = _verdict(table)
    return [*badges, Badge(verdict.text, "quiet", verdict.symbol) if badges else verdict], alerts


def _facts(fits: Mapping[str, Posterior], table: pd.DataFrame) -> list[str]:
    data = next(iter(fits.values())).data
    runs = f" in {data.n_run} runs" if data.n_run > 1 else ""
    return [f"{len(fits)} models", f"data: {data.n_obs} rows{runs}", f"left out: {table.attrs['folds']}"]


RANKING: dict[str, Callable[[Any], str]] = {
    "model": lambda row: str(row["model"]),
    "#elpd, nats": lambda row: nats(row["elpd"]),
    "#± SE, nats": lambda row: nats(row["se"]),
    "#difference, nats": lambda row: nats(row["elpd_diff"]),
    "#± SE of the difference, nats": lambda row: nats(row["diff_se"]),
    "#weight": lambda row: weight_text(row["weight"]),
    "#worst k": lambda row: pareto(row["worst_k"]),
    "#refits": lambda row: number(row["refits"]),
    "#p_eff": lambda row: nats(row["p_eff"]),
}
"""Columns of the ranking."""


def _ranking(table: pd.DataFrame) -> Section:
    best = {str(table.index[0]), *tied(table)}
    drawn = plot_comparison(table)
    caption = f"Left out: {table.attrs['folds']}. Marked: the best model, and those that the data do not tell from it"
    blocks: list[Any] = [
        Pictures([picture(drawn, "Elpd of each model, its difference to the best and its weight", wide=True)]),
        table_of(records_of(table.rename_axis("model")), RANKING, caption, lambda row: row["model"] in best),
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
    lead = "Every model is judged on data that its prediction did not use: how probable did it hold what was measured?"
    return Section("ranking", "Which model predicts best?", lead, blocks)


@dataclass(frozen=True)
class _Terms:
    """Terms of several models.

    Attributes:
        fits: The fits by name.
        tables: Their tables of coefficients.
        columns: Names of their probabilities.
    """

    fits: Mapping[str, Posterior]
    tables: Mapping[str, Any]
    columns: Mapping[str, str]

    @classmethod
    def of(cls, fits: Mapping[str, Posterior]) -> "_Terms":
        """Return the terms of fits."""
        tables = {name: inclusion(fit) for name, fit in fits.items()}
        return cls(fits, tables, {name: probability_column(table) for name, table in tables.items()})

    @property
    def data(self) -> Trajectories:
        """Data of all models."""
        return next(iter(self.fits.values())).data

    @property
    def equations(self) -> tuple[str, ...]:
        """Equations of all models."""
        return next(iter(self.fits.values())).model.equations

    def keys(self) -> list[tuple[str, str]]:
        """Return every (equation, term) of any model, those of an equation together."""
        keys = list(dict.fromkeys((str(a), str(b)) for table in self.tables.values() for a, b in table.index))
        order = list(dict.fromkeys(name for name, _ in keys))
        return sorted(keys, key=lambda key: order.index(key[0]))

    def models(self, key: tuple[str, str]) -> list[str]:
        """Return the models that have a term."""
        return [name for name, table in self.tables.items() if key in table.index]

    def probability(self, name: str, key: tuple[str, str]) -> float:
        """Return the probability of a term under a model; 0 where the model does not have it."""
        table = self.tables[name]
        return float(table.loc[key, self.columns[name]]) if key in table.index else 0.0

    def matters(self, key: tuple[str, str]) -> bool:
        """Return whether a term is more likely to matter than not under some model."""
        return max(self.probability(name, key) for name in self.models(key)) > MATTERS

    def prior(self, name: str, key: tuple[str, str]) -> Coefficient | None:
        """Return the statement about the coefficient of a term under a model."""
        fit = self.fits[name]
        return fit.model.stated(key[0], fit.data).priors.get(key[1])

    def row(self, name: str, key: tuple[str, str]) -> dict[Any, Any]:
        """Return the row of a term in the table of a model."""
        return self.tables[name].loc[key].to_dict()

    def folded(self, records: Mapping[bool, Sequence[Any]], names: "_Folded", table: Callable) -> list[Any]:
        """Return the table of records that matter, and the folded one of the others."""
        return folded((records[True], names.shown), (records[False], names.hidden, names.opens), table, names.nothing)


class _Folded(NamedTuple):
    """Captions of a table, of the folded table below it, its opening line, and words where there is no first table."""

    shown: str
    hidden: str
    opens: str
    nothing: str = ""


def _terms(terms: _Terms) -> Section:
    """Return the section of the probability of each term, one column for each model."""
    first = next(iter(terms.fits))

    def cell(name: str) -> Callable[[tuple[str, str]], str]:
        return lambda key: (
            term_probability(terms.row(name, key), terms.columns[name], terms.prior(name, key))
            if name in terms.models(key)
            else "–"
        )

    columns = {
        "`term": lambda key: formula(key[1]),
        "equation": lambda key: terms.data.target_label(key[0]),
        **{f"#{name}: {PROBABILITIES[terms.columns[name]]}": cell(name) for name in terms.fits},
    }

    def drawn(keys: Sequence[Any], caption: str) -> Table:
        return table_of(keys, columns, caption, lambda key: terms.probability(first, key) > MATTERS, terms.equations)

    names = _Folded(
        "Terms more likely to matter than not under some model; those of the best one are marked",
        "Terms that are likely absent under every model",
        "{} likely absent under every model",
        "Under no model is a term more likely to matter than not.",
    )
    records = {likely: [key for key in terms.keys() if terms.matters(key) is likely] for likely in (True, False)}
    moved = terms.data.target_in_words(*terms.equations, article="the ")
    lead = (
        "Probability that a term matters. Only a spike-and-slab prior can leave a term out, and has P(included); for "
        f"the others it is the probability of moving {moved} by more than 1 % (RMS) of what the simulation leaves. A "
        "dash: not in the model."
    )
    return Section("terms", "Which terms matter under each model?", lead, terms.folded(records, names, drawn))


def _coefficients(terms: _Terms) -> Section:
    """Return the section of the estimates of each term under each model that has it, one below the other."""

    def size(record: tuple[tuple[str, str], str]) -> str:
        key, name = record
        prior = terms.prior(name, key)
        return f"{size_text(terms.row(name, key), prior)}{'' if is_learned(prior) else ' (given)'}"

    def ends(record: tuple[tuple[str, str], str]) -> str:
        key, name = record
        row = terms.row(name, key)
        return interval(row["lower"], row["upper"]) if is_learned(terms.prior(name, key)) else "–"

    columns = {
        "`term": lambda record: formula(record[0][1]),
        "equation": lambda record: terms.data.target_label(record[0][0]),
        "model": lambda record: record[1],
        "#coefficient": size,
        "#90 % interval": ends,
    }

    def drawn(records: Sequence[Any], caption: str) -> Table:
        return table_of(records, columns, caption, equations=terms.equations)

    names = _Folded(
        "Coefficients of the terms more likely to matter than not under some model",
        "Coefficients of the other terms",
        "Coefficients of terms likely absent under every model",
    )
    records = {
        likely: [(key, name) for key in terms.keys() if terms.matters(key) is likely for name in terms.models(key)]
        for likely in (True, False)
    }
    lead = "Posterior mean, standard deviation and equal-tailed 90 % interval of each coefficient, in your units."
    return Section("coefficients", "Coefficients", lead, terms.folded(records, names, drawn))


def _convergence(fits: Mapping[str, Posterior]) -> Section:
    verdicts = {name: convergence(fit) for name, fit in fits.items()}
    tables = {name: convergence_table(fit) for name, fit in fits.items()}
    columns = {
        "model": lambda name: name,
        "result": lambda name: _result(verdicts[name]),
        "#largest R̂": lambda name: number(tables[name]["r_hat"].max(), 4),
        "#least bulk ESS": lambda name: count_text(tables[name]["ess_bulk"].min()),
        "#least tail ESS": lambda name: count_text(tables[name]["ess_tail"].min()),
        "#divergences": lambda name: number(int(fits[name].idata["sample_stats"].dataset["diverging"].sum())),
    }
    failed = [name for name, verdict in verdicts.items() if not verdict.mixed]
    caption = f"How well each model was sampled{'; marked: not converged' if failed else ''}"
    blocks: list[Any] = [table_of(fits, columns, caption, lambda name: name in failed)]
    if reasons := [(name, reason) for name, verdict in verdicts.items() for reason in verdict.reasons]:
        words = Words("The sampler did not converge; what to try:", "alert") if failed else Words(SHORT)
        blocks += [words, Items(reasons)]
    blocks += [
        Details(f"{name}: every quantity with R̂ and effective sample sizes", [summary_table(fit)])
        for name, fit in fits.items()
    ]
    return Section("convergence", "Can the sampler be trusted?", "", blocks)


def _result(verdict: Verdict) -> str:
    return "converged" if verdict.ok else "converged, few draws" if verdict.short else "not converged"


def _settings(fits: Mapping[str, Posterior], made: Mapping[str, str], config: str | None) -> Section:
    """Return the section of the settings in which models differ, side by side, and of those that they share."""
    settings = {name: dict(settings_rows(_described(fit))) for name, fit in fits.items()}
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
    blocks += [
        Details("Settings that all models share", [drawn(shared, "Settings of all models", ("value",))]),
        Details("Versions that made the comparison", [settings_table(made, "Versions by package")]),
    ]
    return settings_section("What do the models differ in?", blocks, config)


def _described(fit: Posterior) -> dict[str, Any]:
    """Return the settings of a fit, with a place for the kernel also where there is none."""
    settings = fit_settings(fit)
    if settings["model"]["discrepancy"] is None:
        settings["model"]["discrepancy"] = {"variant": None}
    return settings
