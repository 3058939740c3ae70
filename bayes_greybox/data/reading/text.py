"""Delimited text: what separates the values, where the names stand, and which lines are remarks."""

import re
import warnings
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import pandas as pd

from bayes_greybox.data.errors import InputError

from .table import Layout, Table
from .units import is_number, split_header, unit_row

REMARKS = ("#", "%")
"""Signs at the start of lines that are remarks, as NumPy and MATLAB write them."""

LOOKED_AT = 400
"""Lines at the start of a file among which the names of the columns are looked for."""


@dataclass(frozen=True)
class _Head:
    """What stands above the measurements: lines before the names, the names where they are marked, their separator.

    `nameless` where its first row holds numbers only.
    """

    skipped: tuple[int, ...]
    sep: str
    names: list[str] | None
    units: dict[str, str]
    nameless: bool = False


def read_text(path: Path, layout: Layout) -> Table:
    """Read a file of delimited text.

    Args:
        path: The file; lines marked # or % above the rows are remarks, but for names above rows of numbers.
        layout: What separates the values is found from the text where it is not given.

    Raises:
        InputError: Names that do not fit the rows; text that is no table.
    """
    try:
        with path.open(encoding=layout.encoding) as file:
            lines = list(islice(file, LOOKED_AT))
    except UnicodeError:
        raise InputError(
            f'"{path}" is not text in {layout.encoding.removesuffix("-sig")}; give its encoding, such as '
            'encoding="latin-1" or encoding="utf-16".'
        ) from None
    head = _head(lines, path, layout)
    header = _header(lines, head.sep)
    usual = header in (None, 0, len(head.skipped)) or head.names is not None
    elsewhere = not usual and not layout.skiprows
    hint = f" If the names stand in line {(header or 0) + 1} of the file, pass skiprows={header}." if elsewhere else ""
    try:
        with warnings.catch_warnings():
            # Rows with more values than names would lose the last ones.
            warnings.simplefilter("error", pd.errors.ParserWarning)
            frame = pd.read_csv(
                path,
                sep=head.sep,
                skipinitialspace=True,
                skiprows=list(head.skipped),
                header=None if head.names else "infer",
                names=head.names,
                # A delimiter at the end of each row would make the first column an index.
                index_col=False,
                decimal=layout.decimal,
                thousands=layout.thousands,
                encoding=layout.encoding,
            )
    except pd.errors.EmptyDataError:
        raise InputError(f'"{path}" has no table after its first {len(head.skipped)} lines; check skiprows.') from None
    except (pd.errors.ParserError, pd.errors.ParserWarning) as error:
        if not elsewhere:
            raise
        raise InputError(f'"{path}" is no table from its first line on ({_first_line(error)}).{hint}') from error
    frame = frame.rename(columns=lambda name: str(name).strip())
    remarks = ()
    if head.names is None and head.nameless:
        example = [f"c{i + 1}" for i in range(len(frame.columns))]
        hint = f" Its first row holds numbers: if it has no names, give them, such as columns={example}."
    elif head.names is not None and layout.columns is not None:
        remarks = (f'the first row of "{path}" was read as measurements, its columns being named by columns=',)
    return Table(frame, f'"{path}"', head.units, remarks=remarks, hint=hint)


def _head(lines: list[str], path: Path, layout: Layout) -> _Head:
    """What stands above the measurements of a file that begins with these lines."""
    given = layout.skiprows
    skipped = set(range(given) if isinstance(given, int) else given)
    marked: list[str] = []
    i, first = 0, ""
    for i, first in enumerate(lines):
        if i in skipped:
            continue
        if first.strip() and not first.startswith(REMARKS):
            break
        marked += [first.lstrip("#% ").strip()] if first.strip() else []
        skipped.add(i)
    below = next((line for line in lines[i + 1 :] if line.strip()), first) if lines else first
    sep = layout.sep or _separator(first, below, path.suffix.lower())
    cells = _cells(first, sep)
    every = tuple(sorted(skipped))
    nameless = all(is_number(cell, layout.decimal) for cell in cells)
    if layout.columns is not None and nameless:
        return _Head(every, sep, list(layout.columns), {})
    if not marked or not nameless:
        return _Head(every, sep, None, {}, nameless)
    # Names behind a mark above rows of numbers, as numpy.savetxt writes them; other such lines are remarks.
    names = _cells(marked[-1], sep)
    units = unit_row(names, [True] * len(names)) if all(name[:1] in ("[", "(") for name in names) else None
    if units is not None and len(marked) > 1:
        # A line of units in brackets below that of names.
        names = _cells(marked[-2], sep)
    if len(names) != len(cells):
        raise InputError(
            f'"{path}" names {len(names)} columns, but its first row has {len(cells)} values; correct the line of '
            "names."
        )
    return _Head(every, sep, names, dict(zip(names, units or (), strict=False)))


def _separator(line: str, below: str, suffix: str) -> str:
    """What separates the values: tabs, semicolons, commas, or in other text than .csv blanks."""
    if suffix == ".tsv":
        return "\t"
    order = (",", ";", "\t", "|") if suffix == ".csv" else ("\t", ";", ",", "|")
    # A comma may be part of a name, or the decimal mark: what separates does so in the row below as well.
    found = next((mark for mark in order if len(_cells(line, mark)) == len(_cells(below, mark)) > 1), None)
    return found or next((mark for mark in order if mark in line), "," if suffix == ".csv" else r"\s+")


def _cells(line: str, sep: str) -> list[str]:
    cells = [cell.strip().strip('"') for cell in re.split(sep if len(sep) > 1 else re.escape(sep), line.strip())]
    return cells[:-1] if cells[-1] == "" else cells


def _header(lines: list[str], sep: str) -> int | None:
    """Line that looks like the names of columns: as many cells as the row of numbers below it, or below its units."""
    separators = dict.fromkeys((sep, "\t", ";", ","))
    for i in range(len(lines) - 2):
        for mark in separators:
            cells, below, next_ = (_cells(line, mark) for line in lines[i : i + 3])
            if len(cells) < 2 or len(cells) != len(next_) or len(cells) != len(below):
                continue
            names = not any(is_number(cell, ",") or not split_header(cell)[0] for cell in cells)
            numbers = [all(is_number(cell, ",") or cell[:1].isdigit() for cell in row) for row in (below, next_)]
            if names and numbers[1] and (numbers[0] or unit_row(below, [True] * len(below))):
                return i
    return None


def _first_line(error: BaseException) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0].rstrip(".")
