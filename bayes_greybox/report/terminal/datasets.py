"""The benchmark data sets as a table for a terminal."""

import pandas as pd
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text


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
