"""What the tables for a terminal have in common."""

import pandas as pd
from rich.table import Table
from rich.text import Text

from bayes_greybox.criticism.convergence import convergence
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.report.words.formatting import number


def plain_table(title: str) -> Table:
    """An empty table without lines."""
    return Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False, header_style="dim")


def frame_table(title: str, table: pd.DataFrame, *, wrap: bool = False) -> Table:
    """Any table with a plain index, which comes first, and on several lines where that may wrap."""
    rows = plain_table(title)
    rows.add_column(str(table.index.name or ""), no_wrap=not wrap)
    for column in table.columns:
        rows.add_column(str(column), justify="right")
    for key, entry in zip(table.index, table.to_numpy(dtype=object), strict=True):
        rows.add_row(Text(str(key)), *(Text(number(value)) for value in entry))
    return rows


def verdict_text(fit: Posterior, label: str = "") -> Text:
    """What the convergence checks say of a fit; `label` comes before it."""
    first, *rest = str(convergence(fit)).splitlines()
    style = "green" if convergence(fit).ok else "bold yellow" if convergence(fit).mixed else "bold red"
    text = Text(f"{label}{first}", style=style)
    for line in rest:
        text.append(f"\n{line}", style="not bold default")
    return text
