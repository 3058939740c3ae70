"""Results as tables for a terminal; every number arrives computed."""

from collections.abc import Iterator, Mapping
from typing import Any

import pandas as pd
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

import bayes_greybox as bg

_PROBABILITIES = {"inclusion": "P(included)", "outside_rope": "P(|θ| > ROPE)"}


def fit_tables(fit: "bg.Fit", held_out: pd.Series | None) -> Iterator[RenderableType]:
    """Verdict in words, then coefficients, discrepancy and error on held-out data.

    Args:
        fit: The fit.
        held_out: Normalised mean squared error by equation, or None.

    Yields:
        What to print, in order.
    """
    yield _verdict("", fit)
    yield _coefficients(fit.inclusion())
    yield _frame("Discrepancy", fit.discrepancy())
    if held_out is not None:
        yield _frame("Held-out data", held_out.rename("NMSE of the derivative").rename_axis("equation").to_frame())


def comparison_tables(fits: Mapping[str, "bg.Fit"], table: pd.DataFrame) -> Iterator[RenderableType]:
    """Verdict of each fit, then the comparison, best first."""
    for name, fit in fits.items():
        yield _verdict(f"{name}: ", fit)
    yield _frame("Comparison (elpd in nats, higher is better)", table.rename_axis("model"))


def datasets_table(table: pd.DataFrame) -> RenderableType:
    """The benchmark data sets, one to a row."""
    rows = Table(box=None, pad_edge=False, header_style="bold")
    for title in ("data set", "hidden effect", "state", "source", "terms"):
        rows.add_column(title, overflow="fold")
    for name, entry in table.to_dict("index").items():
        state = "ready" if entry["verified"] else ("altered" if entry["found"] else "not found")
        rows.add_row(
            *(Text(str(x)) for x in (name, entry["hidden effect"], state, entry["source"], entry["terms"]))
        )
    return rows


def _verdict(label: str, fit: "bg.Fit") -> Text:
    if fit.verdict.ok:
        head = Text(f"{label}The sampler converged.", style="green")
    else:
        head = Text(f"{label}The sampler did not converge; do not use these numbers.", style="bold red")
    for reason in fit.verdict.reasons:
        head.append(f"\n  {reason}", style="not bold default")
    return head


def _coefficients(table: pd.DataFrame) -> RenderableType:
    rows = _table("Coefficients (mean, standard deviation, credible interval)")
    probability = next((column for column in _PROBABILITIES if column in table), None)
    titles = ["equation", "term", "mean", "sd", "lower", "upper", *(["unit"] if "unit" in table else [])]
    for title in titles:
        rows.add_column(
            title, justify="left" if title in ("equation", "term", "unit") else "right", overflow="fold"
        )
    if probability is not None:
        rows.add_column(_PROBABILITIES[probability], justify="right")
    for key, entry in table.iterrows():
        equation, term = key if isinstance(key, tuple) else ("", key)
        cells = [equation, term, *(_number(entry[column]) for column in titles[2:])]
        if probability is not None:
            cells.append(f"{entry[probability]:.3f}")
        rows.add_row(*(Text(str(cell)) for cell in cells))
    return Group("", rows)


def _frame(title: str, table: pd.DataFrame) -> RenderableType:
    rows = _table(title)
    flat = table.reset_index()
    for column in flat.columns:
        numeric = pd.api.types.is_numeric_dtype(flat[column])
        rows.add_column(str(column), justify="right" if numeric else "left", overflow="fold")
    for entry in flat.itertuples(index=False):
        rows.add_row(*(Text(_number(value)) for value in entry))
    return Group("", rows)


def _table(title: str) -> Table:
    return Table(
        title=title, title_justify="left", title_style="bold", box=None, pad_edge=False, header_style="dim"
    )


def _number(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
