"""Tables of texts, the same for HTML pages and the terminal, which only differ in how they draw them."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Table:
    """A table of texts.

    Attributes:
        columns: Headings; one that starts with "#" heads numbers, one with "`" formulas, one with "~" sentences.
        rows: Cells; the first of each heads its row.
        caption: Title of the table.
        marked: Numbers of the rows to stress.
        links: Targets of the head of each row, from the folder of the page; "" where it leads nowhere.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    marked: Sequence[int] = ()
    links: Sequence[str] = ()
    kind: str = "table"

    @property
    def heads(self) -> list[tuple[str, str]]:
        """Heading and class of each column."""
        kinds = {"#": "number", "`": "formula", "~": "sentence"}
        return [(title.lstrip("#`~"), kinds.get(title[:1], "text")) for title in self.columns]


def table_of(
    records: Iterable[Any],
    columns: Mapping[str, Callable[[Any], Any]],
    caption: str = "",
    marked: Callable[[Any], bool] | None = None,
    equations: Sequence[str] | None = None,
) -> Table:
    """Return the table of some records, such as `records_of` gives, a row each.

    `columns` are functions from a record to its cell, by headings as `Table` has them; rows of `marked` records
    are stressed. Where the report has one equation only, the column "equation" is left out.
    """
    records = list(records)
    if equations is not None and len(equations) < 2:
        columns = {title: cell for title, cell in columns.items() if title != "equation"}
    rows = [[str(cell(record)) for cell in columns.values()] for record in records]
    stressed = [k for k, record in enumerate(records) if marked is not None and marked(record)]
    return Table(list(columns), rows, caption, stressed)


def records_of(table: Any) -> list[dict[Any, Any]]:
    """Return the rows of a pandas table as records, which have the levels of its index too."""
    named = table.index.names != [None]
    return (table.reset_index() if named else table).to_dict("records")
