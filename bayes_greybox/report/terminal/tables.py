"""Tables for a terminal, and that of the benchmark data sets."""

from collections.abc import Sequence

import pandas as pd
from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.table import Table as RichTable
from rich.text import Text

from bayes_greybox.report.tables import Table
from bayes_greybox.report.words.formatting import number


def plain_table(title: str) -> RichTable:
    """Return an empty table without lines."""
    return RichTable(
        title=title, title_justify="left", title_style="bold", box=None, pad_edge=False, header_style="dim"
    )


def drawn(table: Table, below: str = "", styles: Sequence[str] = (), header: bool = True) -> Group:
    """Return a table for a terminal, its caption above and an empty line above that.

    `below` stands under it, as beside it there is no room on a narrow terminal. `styles` are those of the first cell of
    each row.
    """
    rows = plain_table(table.caption)
    rows.show_header = header
    for title, kind in table.heads:
        side = "right" if kind == "number" else "left"
        rows.add_column(title, justify=side, no_wrap=kind == "number", overflow="fold")
    for k, (first, *rest) in enumerate(table.rows):
        rows.add_row(Text(first, style=styles[k] if styles else ""), *map(Text, rest))
    if below:
        rows.caption, rows.caption_justify, rows.caption_style = Text(below), "left", "dim"
    return Group("", rows)


def frame_table(title: str, table: pd.DataFrame, *, wrap: bool = False) -> RichTable:
    """Return any table with a plain index, which comes first, and on several lines where that may wrap."""
    rows = plain_table(title)
    rows.add_column(str(table.index.name or ""), no_wrap=not wrap)
    for column in table.columns:
        rows.add_column(str(column), justify="right")
    for key, entry in zip(table.index, table.to_numpy(dtype=object), strict=True):
        rows.add_row(Text(str(key)), *(Text(number(value)) for value in entry))
    return rows


def datasets_table(table: pd.DataFrame) -> RenderableType:
    """Return the benchmark data sets one below the other, each with its files: too long for columns."""
    parts: list[RenderableType] = []
    for name, entry in table.to_dict("index").items():
        state = "ready" if entry["verified"] else ("altered" if entry["found"] else "not found")
        parts.append(Text.assemble((str(name), "bold"), f": {entry['hidden effect']}; {state}"))
        rows = RichTable.grid("what", "said", padding=(0, 2))
        rows.columns[1].overflow = "fold"
        for what in ("files", "found", "source", "terms"):
            if entry[what]:
                rows.add_row(what, Text(str(entry[what])))
        parts.append(Padding(rows, (0, 0, 0, 2)))
    return Group(*parts)
