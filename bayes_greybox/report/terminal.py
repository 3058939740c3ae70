"""Results as tables for a terminal; every number arrives computed."""

from collections.abc import Iterator, Mapping
from typing import Any

import pandas as pd
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from bayes_greybox.criticism.convergence import convergence
from bayes_greybox.criticism.discrepancy import discrepancy_table
from bayes_greybox.criticism.inclusion import inclusion
from bayes_greybox.data.columns import derivative_label
from bayes_greybox.inference.posterior import Posterior

from .text import PROBABILITIES, nats, number, pareto, probability_column

_LEVEL = 0.9


def fit_tables(fit: Posterior, held_out: pd.Series | None) -> Iterator[RenderableType]:
    """Verdict in words, then coefficients, discrepancy and error on held-out data.

    Args:
        fit: The fit.
        held_out: Normalised mean squared error by equation, or None.

    Yields:
        What to print, in order.
    """
    yield _verdict("", fit)
    table = inclusion(fit, _LEVEL)
    for equation in fit.model.equations:
        yield _coefficients(derivative_label(equation, fit.data.time_name), table.loc[equation])
    yield _discrepancy(discrepancy_table(fit, _LEVEL))
    if held_out is not None:
        errors = ", ".join(f"{name} {value:.2g}" for name, value in held_out.items())
        yield Text(f"\nError on held-out data (NMSE of the derivative): {errors}")


def comparison_tables(fits: Mapping[str, Posterior], table: pd.DataFrame) -> Iterator[RenderableType]:
    """Verdict of each fit, then the comparison, best first, with what to beware of."""
    for name, fit in fits.items():
        yield _verdict(f"{name}: ", fit)
    left_out = f"leaving out {table.attrs['folds']}; " if "folds" in table.attrs else ""
    rows = plain_table(f"Expected log predictive density (elpd, {left_out}nats; higher is better)")
    rows.add_column("model", overflow="fold")
    for column in table.columns:
        rows.add_column(str(column), justify="right")
    for name, entry in table.iterrows():
        rows.add_row(Text(str(name)), *(Text(_compared(*cell)) for cell in entry.items()))
    yield Group("", rows)
    for note in table.attrs.get("notes", []):
        yield Text(f"Note: {note}")


def datasets_table(table: pd.DataFrame) -> RenderableType:
    """The benchmark data sets, one to a row."""
    rows = Table(box=None, pad_edge=False, header_style="bold")
    for title in ("data set", "hidden effect", "state", "source", "terms"):
        rows.add_column(title, overflow="fold")
    for name, entry in table.to_dict("index").items():
        state = "ready" if entry["verified"] else ("altered" if entry["found"] else "not found")
        cells = (name, entry["hidden effect"], state, entry["source"], entry["terms"])
        rows.add_row(*(Text(str(cell)) for cell in cells))
    return rows


def frame_table(title: str, table: pd.DataFrame) -> Table:
    """Any table with a plain index, which comes first."""
    rows = plain_table(title)
    rows.add_column(str(table.index.name or ""), no_wrap=True)
    for column in table.columns:
        rows.add_column(str(column), justify="right")
    for key, entry in zip(table.index, table.to_numpy(dtype=object), strict=True):
        rows.add_row(Text(str(key)), *(Text(number(value)) for value in entry))
    return rows


def plain_table(title: str) -> Table:
    """An empty table without lines."""
    return Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False, header_style="dim")


def _verdict(label: str, fit: Posterior) -> Text:
    first, *rest = str(convergence(fit)).splitlines()
    text = Text(f"{label}{first}", style="green" if convergence(fit).ok else "bold red")
    for line in rest:
        text.append(f"\n{line}", style="not bold default")
    return text


def _coefficients(label: str, table: pd.DataFrame) -> RenderableType:
    rows = plain_table(f"Coefficients of {label}, with {_LEVEL:.0%} intervals")
    probability = probability_column(table)
    rows.add_column("term", overflow="fold")
    for title in ("mean", "sd", "lower", "upper"):
        rows.add_column(title, justify="right", no_wrap=True)
    rows.add_column("unit", overflow="fold")
    rows.add_column(PROBABILITIES[probability], justify="right", no_wrap=True)
    for term, entry in table.iterrows():
        numbers = [_number(entry[column]) for column in ("mean", "sd", "lower", "upper")]
        cells = [term, *numbers, entry["unit"], f"{entry[probability]:.3f}"]
        rows.add_row(*(Text(str(cell)) for cell in cells))
    return Group("", rows)


def _discrepancy(table: pd.DataFrame) -> RenderableType:
    rows = plain_table(f"Shares of the variance, with the {_LEVEL:.0%} interval of the discrepancy's")
    rows.add_column("equation", overflow="fold")
    parts = ("simulation", "dictionary", "noise", "discrepancy", "discrepancy_lower", "discrepancy_upper")
    for title in (*parts[:4], "lower", "upper"):
        rows.add_column(title, justify="right", no_wrap=True)
    entries = table.to_dict("index")
    for equation, entry in entries.items():
        rows.add_row(Text(str(equation)), *(Text(_percent(entry[part])) for part in parts))
    trades = ", ".join(f"{entry['correlation']:.2f} ({entry['term']})" for entry in entries.values())
    return Group("", rows, Text(f"Largest correlation of a coefficient with the discrepancy: {trades}"))


def _compared(column: Any, value: Any) -> str:
    if column == "weight":
        return f"{value:.2f}"
    return {"worst_k": pareto, "refits": number}.get(column, nats)(value)


def _number(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _percent(share: float) -> str:
    # Rounded first, so that a tiny negative share does not show as -0.00 %.
    return f"{round(100 * share, 2) + 0.0:.2f} %"
