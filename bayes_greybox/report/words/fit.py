"""Words for the data, the terms and the rows of a fit."""

from collections.abc import Callable, Mapping
from typing import Any

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.physics.coefficient import Coefficient

from .formatting import estimate, exact, interval, nats, number, pareto, probability_text, unit_text

LIKELY_TO_MATTER = 0.5
"""Probability from which on a term is more likely to matter than not, and stands in the first table."""


def row_label(fit: Posterior, name: str, samples: str = "the samples") -> str:
    """Return the name of an equation's rows: a rate, an output, or samples that several equations share."""
    return fit.data.target_label(name) if name in fit.model.equations else samples


def rows_text(data: Trajectories) -> str:
    """Return the number of rows, and of runs where there are several."""
    return f"{data.n_obs} rows{f' in {data.n_run} runs' if data.n_run > 1 else ''}"


def is_learned(prior: Coefficient | None) -> bool:
    """Return whether a coefficient was estimated."""
    return prior is None or prior.learned


def term_probability(row: Mapping[Any, Any], column: str) -> str:
    """Return the probability of a term in a coefficient table; "given" where nothing was learned of it."""
    return "given" if row.get("given", False) else probability_text(row[column])


def size_text(row: Mapping[Any, Any], prior: Coefficient | None, unit: bool = True) -> str:
    """Return mean and standard deviation of a coefficient, or its value where it was fixed."""
    of = row["unit"] if unit else ""
    if is_learned(prior):
        return estimate(row["mean"], row["sd"], of)
    negative, size = exact(row["mean"])
    return f"{'−' if negative else ''}{size} {unit_text(of)}".rstrip()


def ends_text(row: Mapping[Any, Any], prior: Coefficient | None) -> str:
    """Return the interval of a coefficient; a dash where it was fixed."""
    return interval(row["lower"], row["upper"]) if is_learned(prior) else "–"


def stated_text(prior: Coefficient | None) -> str:
    """Return the statement about a coefficient: "N(−40, 10²), ≤ 0", "= −2"."""
    return "" if prior is None else str(prior).replace("-", "−")


def data_remarks(*parts: Trajectories | None) -> list[str]:
    """Return what was done to training and held-out data and what of them is missing, each remark once."""
    return list(dict.fromkeys(remark for part in parts if part is not None for remark in part.remarks))


def compared(column: str) -> Callable[[Mapping[Any, Any]], str]:
    """Return the function that writes the cell of a row of a comparison, a log density unless it is known otherwise."""
    others = {"model": str, "weight": "{:.2f}".format, "worst_k": pareto, "refits": number}
    return lambda row: others.get(column, nats)(row[column])
