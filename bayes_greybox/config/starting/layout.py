"""Layout of a table, found from the table where it leaves no doubt."""

import codecs
import re
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from bayes_greybox.data.reading.cells import COMMA, is_measured
from bayes_greybox.data.reading.formats.text import titles
from bayes_greybox.data.reading.sources import TABLE_READERS, read_source
from bayes_greybox.data.reading.table import Layout, Table

GROUPS = r"[+-]?(\d+|[1-9]\d{0,2}(\.\d{3})+)(,\d+)?"
"""A number with a comma for its decimal mark, whose digits may be grouped by points."""

NUMBER = rf"{COMMA}|{GROUPS}|[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?(\.\d+)?"
"""A number where the name of a column would stand; the second of two equal ones has another point behind it."""


def read_as_found(data: Path, layout: Layout) -> tuple[Table, Layout]:
    """Read a table with the encoding, titles and marks that it has; known parts of the layout take precedence."""
    if data.is_file() and TABLE_READERS.get(data.suffix.lower()) is TABLE_READERS[".csv"]:
        layout = _encoded(data, layout)
        if layout.skiprows == 0 and layout.columns is None:
            layout = replace(layout, skiprows=titles(data, layout))
    table = read_source(data, layout)
    if layout.decimal == "." and _numbers_have(",", table):
        layout = replace(layout, decimal=",")
        table = read_source(data, layout)
    # Digits grouped by points.
    if layout.decimal == "," and layout.thousands is None and _numbers_have(".", table):
        layout = replace(layout, thousands=".")
        table = read_source(data, layout)
    if layout.columns is None and _nameless(table, layout):
        layout = replace(layout, columns=tuple(f"c{i + 1}" for i in range(len(table.frame.columns))))
        table = read_source(data, layout)
    return table, layout


def _nameless(table: Table, layout: Layout) -> bool:
    """Return True if the first row of a table, which was read as names, holds measurements."""
    names = [str(name) for name in table.frame.columns]
    if not all(re.fullmatch(NUMBER, name) or is_measured(name, layout) for name in names):
        return False
    if names != [str(i) for i in range(len(names))]:
        return True
    # Columns without names are often called 0, 1, 2: they are names unless the first column goes on from 0.
    column = table.frame.iloc[:2, 0]
    return pd.api.types.is_numeric_dtype(column) and 2.0 * column.iloc[0] == column.iloc[-1] != 0.0


def _encoded(data: Path, layout: Layout) -> Layout:
    """Return the layout with the encoding of Western European Windows, or UTF-16, where text is no UTF-8."""
    if layout.encoding != Layout().encoding:
        return layout
    content = data.read_bytes()
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return replace(layout, encoding="utf-16")
    # Text has no such bytes; what has is refused as it is.
    for encoding in [layout.encoding, "cp1252", "latin-1"] if b"\0" not in content else []:
        with suppress(UnicodeDecodeError):
            content.decode(encoding)
            return replace(layout, encoding=encoding)
    return layout


def _numbers_have(mark: str, table: Table) -> bool:
    """Return True if a column that was read as words has numbers with this mark."""
    words = table.frame.select_dtypes(exclude="number")
    columns: list[Any] = [words[name].dropna().astype(str).str.strip() for name in words]
    numbers = [each for each in columns if len(each) and each.str.fullmatch(f"{COMMA}|{GROUPS}").all()]
    return any(each.str.contains(mark, regex=False).any() for each in numbers)
