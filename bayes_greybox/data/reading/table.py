"""Tables as they are read, and their layout."""

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.running.errors import InputError

from .units import checked_units, is_number, split_headers, unit_row


@dataclass(frozen=True)
class Layout:
    """Layout of a table, where the table does not show it; see `read` for each attribute."""

    sep: str | None = None
    decimal: str = "."
    thousands: str | None = None
    skiprows: int | tuple[int, ...] = 0
    encoding: str = "utf-8-sig"
    sheet: str | int | None = None
    columns: tuple[str, ...] | None = None
    dayfirst: bool | None = None


@dataclass(frozen=True, eq=False)
class Table:
    """Named columns of one source."""

    frame: pd.DataFrame
    where: str  # description of the source, within a sentence, such as '"run.csv"'
    # Units that the source states, by column, in its own spelling until `tidy` has checked them.
    units: Mapping[str, str] = field(default_factory=dict)
    # Column by the name that the source had for it with its unit, such as "pos [mm]".
    aliases: Mapping[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    hint: str = ""
    run: str | None = None  # column that tells runs apart, where the source has one by itself
    # Columns that belong together, by their name in the source, such as those of a matrix.
    groups: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    spaced: bool = False  # if true, rows without any value may only separate others, as in text and in sheets
    # Dimensions of a data set that has one row for each pair of their values, the shorter one first.
    dimensions: tuple[str, ...] = ()
    others: "tuple[Table, ...]" = ()  # tables of other lengths in the same source

    def holding(self, names: Iterable[str]) -> "Table":
        """Return the table of the source that has all columns of these names; this one if none has."""
        asked = list(names)
        return next((each for each in (self, *self.others) if all(map(each.has, asked))), self)

    def has(self, name: str) -> bool:
        """Return True if there is such a column, or a group of columns."""
        return self.aliases.get(name, name) in self.frame.columns or name in self.groups

    def column(self, name: str) -> Any:
        """Return one column; see `own_name`."""
        return self.frame[self.own_name(name)]

    def own_name(self, name: str) -> str:
        """Return this table's own name of a column, and refuse a name that it does not have, with the nearest ones."""
        # Columns of a frame may be numbers.
        name = self.aliases.get(str(name), str(name))
        if name in self.frame.columns:
            return name
        columns = [str(column) for column in self.frame.columns]
        lowered = {column.lower(): column for column in reversed(columns)}
        near = [lowered[match] for match in difflib.get_close_matches(str(name).lower(), lowered, n=3, cutoff=0.5)]
        guess = f" Did you mean {' or '.join(near)}?" if near else ""
        listing = f"Its columns are {', '.join(columns)}."
        raise InputError(f'{capital(self.where)} has no column "{name}".{guess} {listing}{self.hint}')

    def packed(self) -> "Table":
        """Return the table without rows that only separate others; with stamps they measure nothing."""
        return replace(self, frame=self.frame.dropna(how="all").reset_index(drop=True)) if self.spaced else self


def capital(text: str) -> str:
    """Return text as it stands at the start of a sentence."""
    return text[:1].upper() + text[1:]


def first_line(error: BaseException) -> str:
    """Return the first line of an error's message, or else its class."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0].rstrip(".")


def first_row_measured(where: str) -> str:
    """Return the remark on a first row that would have been taken for names without `columns=`."""
    return f"the first row of {where} was read as measurements, its columns being named by columns="


def tidy(table: Table, layout: Layout) -> Table:
    """Free names of units, check the units, and take a row of units from the measurements."""
    frame = table.frame
    names = [str(name).strip() for name in frame.columns]
    if layout.columns is not None:
        if len(layout.columns) != len(names):
            count = f"columns names {len(layout.columns)} columns, but {table.where} has {len(names)}"
            raise InputError(f"{count}: {', '.join(names)}; give one name each.")
        names = [str(name) for name in layout.columns]
    stated, aliases = dict(table.units), {}
    plain = split_headers(names)
    short = [name for name, _ in plain]
    for i, (name, unit) in enumerate(plain):
        # A name that others have too without its unit stays as it is.
        if unit is not None and short.count(name) == 1:
            aliases[names[i]], stated[name] = name, unit
            names[i] = name
    require_distinct(names, table.where)
    frame = frame.set_axis(names, axis=1)
    frame = _without_margins(frame) if table.spaced else frame
    units = _row_of_units(frame, layout.decimal)
    remarks = table.remarks
    if units is not None:
        frame = frame.iloc[1:].reset_index(drop=True)
        frame = _without_margins(frame) if table.spaced else frame
        stated |= {name: unit for name, unit in zip(names, units, strict=True) if unit}
    if not len(frame):
        raise InputError(f"{capital(table.where)} has no rows.")
    checked, unknown = checked_units(((name, unit) for name, unit in stated.items() if name in names), table.where)
    if units is not None:
        read = ", ".join(f"{name} in {unit}" for name, unit in checked.items())
        remarks = (*remarks, f"the first row of {table.where} was read as units: {read or 'none that is known'}")
    others = tuple(tidy(other, layout) for other in table.others) if layout.columns is None else ()
    return replace(table, frame=frame, units=checked, aliases=aliases, remarks=(*remarks, *unknown), others=others)


def require_distinct(names: Sequence[str], where: str) -> None:
    """Refuse two columns of one name; "" is no name."""
    twice = next((name for name in names if name and list(names).count(name) > 1), None)
    if twice is not None:
        raise InputError(
            f'{capital(where)} has the column "{twice}" more than once; rename one, or name all columns with '
            "columns=[...]."
        )


def _without_margins(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the rows from the first one with a value to the last."""
    filled = np.flatnonzero(frame.notna().any(axis=1).to_numpy())
    if len(filled) and len(filled) < len(frame):
        frame = frame.iloc[filled[0] : filled[-1] + 1].reset_index(drop=True).infer_objects()
    return frame if len(filled) else frame.iloc[:0]


def _row_of_units(frame: pd.DataFrame, decimal: str) -> list[str] | None:
    """Return the units in the first row, if it is one of units."""
    if len(frame) < 2:
        return None
    first, second = ([_text(value) for value in frame.iloc[row]] for row in (0, 1))
    # The decimal mark may not be known yet; dates begin with a digit.
    measured = [not cell or is_number(cell, decimal) or is_number(cell, ",") or cell[0].isdigit() for cell in second]
    return unit_row(first, measured)


def _text(value: Any) -> str:
    # A cell may hold a list, which is neither there nor missing.
    return "" if pd.api.types.is_scalar(value) and pd.isna(value) else str(value).strip()
