"""A comparison of models as a table for a terminal."""

from collections.abc import Iterator, Mapping
from typing import Any

import pandas as pd
from rich.console import Group, RenderableType
from rich.text import Text

from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.report.words.formatting import nats, number, pareto, weight_text

from .tables import plain_table, verdict_text

_PRINTED = {"weight": weight_text, "worst_k": pareto, "refits": number}
"""How columns are printed that hold no log density."""


def comparison_tables(fits: Mapping[str, Posterior], table: pd.DataFrame) -> Iterator[RenderableType]:
    """Verdict of each fit, then the comparison, best first, with what to beware of."""
    for name, fit in fits.items():
        yield verdict_text(fit, f"{name}: ")
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


def _compared(column: Any, value: Any) -> str:
    return _PRINTED.get(column, nats)(value)
