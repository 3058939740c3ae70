"""The benchmark data sets for a terminal."""

import pandas as pd
from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text


def datasets_table(table: pd.DataFrame) -> RenderableType:
    """Return the benchmark data sets one below the other, each with its files: too long for columns."""
    parts: list[RenderableType] = []
    for name, entry in table.to_dict("index").items():
        state = "ready" if entry["verified"] else ("altered" if entry["found"] else "not found")
        parts.append(Text.assemble((str(name), "bold"), f": {entry['hidden effect']}; {state}"))
        rows = Table.grid("what", "said", padding=(0, 2))
        rows.columns[1].overflow = "fold"
        for what in ("files", "found", "source", "terms"):
            if entry[what]:
                rows.add_row(what, Text(str(entry[what])))
        parts.append(Padding(rows, (0, 0, 0, 2)))
    return Group(*parts)
