"""A comparison of models as a table for a terminal."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import pandas as pd
from rich.console import RenderableType
from rich.text import Text

from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.report.tables import records_of, table_of
from bayes_greybox.report.words.formatting import nats, number, pareto, weight_text

from .tables import drawn, verdict_text

_PRINTED = {"weight": weight_text, "worst_k": pareto, "refits": number}
"""How columns are printed that hold no log density."""


def comparison_tables(fits: Mapping[str, Posterior], table: pd.DataFrame) -> Iterator[RenderableType]:
    """Yield the verdict of each fit, the comparison, best first, and its notes."""
    for name, fit in fits.items():
        yield verdict_text(fit, f"{name}: ")
    left_out = f"leaving out {table.attrs['folds']}; " if "folds" in table.attrs else ""
    columns = {"model": lambda row: str(row["model"]), **{f"#{name}": _printed(str(name)) for name in table.columns}}
    title = f"Expected log predictive density (elpd, {left_out}nats; higher is better)"
    yield drawn(table_of(records_of(table.rename_axis("model")), columns, title))
    for note in table.attrs.get("notes", []):
        yield Text(f"Note: {note}")


def _printed(column: str) -> Callable[[Any], str]:
    return lambda row: _PRINTED.get(column, nats)(row[column])
