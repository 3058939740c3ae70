"""Delimited text: the separator of the values, the place of the names, and lines of remarks."""

import csv
import re
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import pandas as pd

from bayes_greybox.data.reading.cells import is_measured, may_have_lost, with_digits
from bayes_greybox.data.reading.table import Layout, Table, first_line, first_row_measured, require_distinct
from bayes_greybox.data.reading.units import is_number, split_header, unit_row
from bayes_greybox.running.errors import InputError

REMARKS = ("#", "%")  # signs at the start of lines that are remarks, as NumPy and MATLAB write them
BLANKS = r"\s+"  # separator of values by any number of blanks or tabs
LOOKED_AT = 400  # lines at the start of a file among which the names of the columns are looked for
_QUOTED_CELL = re.compile(r'(?<![^\s,;|])"[^"]*"(?![^\s,;|])')  # quoted text between separators


@dataclass(frozen=True)
class _Head:
    """Lines above the measurements."""

    skipped: tuple[int, ...]
    sep: str
    names: list[str] | None  # where a line with a mark of remarks has them
    units: dict[str, str]
    nameless: bool = False  # true if the first row holds numbers only


def read_text(path: Path, layout: Layout) -> Table:
    """Read a file of delimited text; its separator is found from the text if `layout` has none."""
    try:
        lines = _first_lines(path, layout)
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
    if head.names is None:
        _check_names(lines, head, path, layout, hint)
    try:
        with warnings.catch_warnings():
            # Rows with more values than names would lose the last ones.
            warnings.simplefilter("error", pd.errors.ParserWarning)
            frame = _frame(path, head, layout)
            long = [name for name in frame.columns if may_have_lost(frame[name])]
            if long:
                words = _frame(path, head, layout, dtype=dict.fromkeys(long, str))
                frame = frame.assign(**{name: with_digits(frame[name], words[name]) for name in long})
    except pd.errors.EmptyDataError:
        raise InputError(f'"{path}" has no table after its first {len(head.skipped)} lines; check skiprows.') from None
    except (pd.errors.ParserError, pd.errors.ParserWarning) as error:
        if not elsewhere:
            raise
        raise InputError(f'"{path}" is no table from its first line on ({first_line(error)}).{hint}') from error
    frame = frame.rename(columns=lambda name: str(name).strip())
    if head.sep == BLANKS and frame.iloc[:, -1].isna().any():
        _check_lengths(path, head, len(frame.columns), layout)
    if head.names is None and head.nameless:
        example = [f"c{i + 1}" for i in range(len(frame.columns))]
        hint = f" Its first row holds numbers: if it has no names, give them, such as columns={example}."
    named = head.names is not None and layout.columns is not None
    remarks = (first_row_measured(f'"{path}"'),) if named else ()
    return Table(frame, f'"{path}"', head.units, remarks=remarks, hint=hint, spaced=True)


def titles(path: Path, layout: Layout) -> int:
    """Count the lines of titles above the names, each with fewer cells than these; 0 if it is unclear."""
    try:
        lines = _first_lines(path, layout)
    except (OSError, UnicodeError, LookupError):
        return 0  # the reader of the file reports that
    header = _header(lines, layout.sep or "\t")
    if not header or all(not line.strip() or line.startswith(REMARKS) for line in lines[:header]):
        return 0  # remarks are no titles: they are passed over anyway
    mark = next(mark for mark in _marks(layout.sep or "\t") if _is_header(lines[header : header + 3], mark))
    filled = [sum(map(bool, _cells(line, mark))) for line in lines[: header + 1]]
    return header if all(count < filled[header] for count in filled[:header]) else 0


def _first_lines(path: Path, layout: Layout) -> list[str]:
    with path.open(encoding=layout.encoding) as file:
        return list(islice(file, LOOKED_AT))


def _frame(path: Path, head: _Head, layout: Layout, **options: Any) -> pd.DataFrame:
    # A delimiter at the end of each row would make the first column an index. A row that is empty still takes its time,
    # where there is no column of stamps. Marks of thousands are read with the cells: pandas would make a number of
    # 01.02.2024.
    return pd.read_csv(
        path, sep=head.sep, skipinitialspace=True, skiprows=list(head.skipped), names=head.names, index_col=False,
        header=None if head.names else "infer", skip_blank_lines=False, decimal=layout.decimal,
        encoding=layout.encoding, **options,
    )  # fmt: skip


def _head(lines: list[str], path: Path, layout: Layout) -> _Head:
    """Return the lines above the measurements of a file that begins with these lines."""
    skiprows = layout.skiprows
    skipped = set(range(skiprows) if isinstance(skiprows, int) else skiprows)
    marked: list[str] = []
    i, first = 0, ""
    for i, first in enumerate(lines):
        if i in skipped:
            continue
        if first.strip() and not first.startswith(REMARKS):
            break
        marked += [first.lstrip("#% ").strip()] if first.strip() else []
        skipped.add(i)
    below = next((line for k, line in enumerate(lines) if k > i and k not in skipped and line.strip()), first)
    sep = layout.sep or _separator(first, below, path.suffix.lower(), layout.decimal)
    cells = _cells(first, sep)
    every = tuple(sorted(skipped))
    nameless = all(is_number(cell, layout.decimal) for cell in cells)
    if layout.columns is not None and any(is_measured(cell, layout) for cell in cells):
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
        count = f"names {len(names)} columns, but its first row has {len(cells)} values"
        raise InputError(f'"{path}" {count}; correct the line of names.')
    return _Head(every, sep, names, dict(zip(names, units or (), strict=False)))


def _separator(line: str, below: str, suffix: str, decimal: str) -> str:
    """Return the separator of the values: a tab, semicolon or comma, or in other text than .csv blanks."""
    if suffix == ".tsv":
        return "\t"
    order = (",", ";", "\t", "|") if suffix == ".csv" else ("\t", ";", ",", "|")
    order = sorted(order, key=lambda mark: mark == decimal)
    # A mark within quotation marks is no separator.
    line, below = (_QUOTED_CELL.sub("x", text) for text in (line, below))
    # A comma may be part of a name, or the decimal mark: a separator divides the row below as well.
    both = [mark for mark in order if len(_cells(line, mark)) == len(_cells(below, mark)) > 1]
    # Commas that leave a semicolon or a tab in a cell are decimal marks, in a table without names: 0,1;27,3.
    clean = [mark for mark in both if mark != "," or not re.search(r"[;\t]", below)]
    return next(iter((*clean, *both)), None) or next(
        (mark for mark in order if mark in line), "," if suffix == ".csv" else BLANKS
    )


def _check_names(lines: list[str], head: _Head, path: Path, layout: Layout, hint: str) -> None:
    """Refuse two equal names, and more names than values: pandas would number the former and shift the latter."""
    rows = _rows((line for i, line in enumerate(lines) if i not in head.skipped), head.sep)
    names = next(rows, [])
    names = names[:-1] if names[-1:] == [""] else names
    if layout.columns is None and not head.nameless:
        require_distinct(names, f'"{path}"')
    values = next((row for row in rows if any(row)), None)
    if values is not None and len(names) > len(values):
        blanks = ", names with blanks being put in quotation marks" if head.sep == BLANKS else ""
        remedy = f"correct the line of names{blanks}, or skip it with skiprows= and name them with columns=[...]"
        raise InputError(
            f'"{path}" names {len(names)} columns, but its first row has {len(values)} values: {remedy}.{hint}'
        )


def _check_lengths(path: Path, head: _Head, count: int, layout: Layout) -> None:
    """Refuse a row with fewer values than names: between blanks, nobody sees which one is missing."""
    with path.open(encoding=layout.encoding) as file:
        for i, line in enumerate(file):
            n_cell = len(_cells(line, BLANKS)) if line.strip() and i not in head.skipped else count
            if n_cell < count:
                raise InputError(
                    f'"{path}" names {count} columns, but line {i + 1} has {n_cell} values; write nan where one is '
                    "missing."
                )


def _rows(lines: Iterable[str], sep: str) -> Iterator[list[str]]:
    """Yield the cells of lines; quoted text is one cell."""
    if sep == BLANKS:
        rows = csv.reader((" ".join(line.split()) for line in lines), delimiter=" ")
    else:
        plain = (line if sep == "\t" else f"{line.rstrip()}\n" for line in lines)
        rows = csv.reader(plain, delimiter=sep, skipinitialspace=True)
    for row in rows:
        yield [cell.strip().strip('"') for cell in row]


def _cells(line: str, sep: str) -> list[str]:
    cells = next(_rows([line.strip()], sep), [""])
    return cells[:-1] if cells and cells[-1] == "" else cells


def _header(lines: list[str], sep: str) -> int | None:
    """Return the line that looks like names: as many cells as the row of numbers below it, or below its units."""
    places = range(len(lines) - 2)
    return next((i for i in places if any(_is_header(lines[i : i + 3], mark) for mark in _marks(sep))), None)


def _marks(sep: str) -> list[str]:
    return list(dict.fromkeys((sep, "\t", ";", ",")))


def _is_header(lines: list[str], mark: str) -> bool:
    """Return True if the first of three lines has names, and the last one numbers under them."""
    cells, below, next_ = (_cells(line, mark) for line in lines)
    # An empty cell at the end of a row counts if the names have one there.
    below, next_ = ([*row, *[""] * (len(cells) - len(row) == 1)] for row in (below, next_))
    if len(cells) < 2 or len(cells) != len(next_) or len(cells) != len(below):
        return False
    names = not any(is_number(cell, ",") or not split_header(cell)[0] for cell in cells)
    numbers = [
        any(row) and all(not cell or is_number(cell, ",") or cell[:1].isdigit() for cell in row)
        for row in (below, next_)
    ]
    return names and numbers[1] and (numbers[0] or unit_row(below, [True] * len(below)) is not None)
