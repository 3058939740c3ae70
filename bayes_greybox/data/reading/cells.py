"""Cells as numbers: decimal marks, dates as seconds, and messages on cells that are neither."""

import datetime
import re
import warnings
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

from bayes_greybox.data.plain_arrays import LARGEST_EXACT_INTEGER, first_lost, since_first
from bayes_greybox.running.errors import InputError

from .table import Layout, Table, capital
from .units import is_number

COMMA = r"[+-]?\d*,\d+([eE][+-]?\d+)?"  # pattern of a number with a comma for its decimal mark

_CLOCK = re.compile(r"^\d{1,3}:\d{2}:\d{2}([.,]\d+)?$")
_DATES = (datetime.date, datetime.time, datetime.timedelta, np.datetime64, np.timedelta64)
_DATE = re.compile(r"^(\d{1,4}[-/.]\w{1,9}[-/.]\d{1,4}(\b|T)|\d{8}T|\w*[A-Za-z]{3}\w*[ ,.]+\d)")
_GROUPED = re.compile(r"^[+-]?\d{1,3}(\.\d{3})+(,\d+)?$")
_NO_NUMBER = "?"
_PACKED = {8: "%Y%m%d", 12: "%Y%m%d%H%M", 14: "%Y%m%d%H%M%S"}
_SHORT_DATE = re.compile(r"^(\d{1,2})[-/.](\d{1,2})[-/.](\d{1,2})(?!\d)(.*)$")
_SECOND_FRACTION = re.compile(r"(?<=:\d{2})[.,](?=\d)")
_WHOLE = re.compile(r"(\d{1,2}:\d{2}:\d{2})(?![\d.,:])")  # a time of day with seconds and no fraction of them
# Pattern of a time of day with its zone.
_ZONE = re.compile(r"[T:]\d{2,6}(?:[.,]\d+)?\s*(?:Z|z|UTC|GMT|[+-]\d{2}(?::?\d{2})?)$")


class Stamps(NamedTuple):
    """A column of time."""

    # Numbers, NaN where a cell is missing; dates and clock times as seconds since the earliest one.
    time: Float[np.ndarray, " n_row"]
    dated: bool  # true for dates or clock times
    # Smallest of whole numbers that floats would not distinguish, which was subtracted; else None.
    first: int | None = None
    zoned: bool = False  # true for dates with their time zone


class AmbiguousDates(InputError):
    """Dates whose day, month and year cannot be distinguished."""


def numbers(table: Table, name: str, layout: Layout) -> Float[np.ndarray, " n_row"]:
    """Return a column as numbers, missing cells as NaN; dates and cells that are no numbers are refused."""
    column: Any = table.column(name)
    if column.dtype.kind in "mM":
        raise InputError(
            f'Column "{name}" of {table.where} holds dates, which only the time may; choose another column, or convert '
            "it to numbers."
        )
    values, bad = _as_numbers(column, layout)
    if len(bad):
        cell = column.iloc[bad[0]]
        raise InputError(
            f'Column "{name}" of {table.where} is not numeric: row {bad[0]} holds {cell!r}; {_remedy(cell, layout)}.'
        )
    present, whole = _whole(values)
    lost = first_lost(whole)
    if lost is not None:
        raise InputError(
            f'Column "{name}" of {table.where} holds whole numbers of more digits than a float does, such as '
            f"{whole[lost]} in row {np.flatnonzero(present)[lost]}: subtract a number from all of them first."
        )
    return values.to_numpy(dtype=float, na_value=np.nan)


def stamps(table: Table, name: str, layout: Layout) -> Stamps:
    """Return the column of time as numbers; no date at all, and dates whose day may be their month, are refused."""
    column: Any = table.column(name)
    if column.dtype.kind not in "mM":
        values, bad = _as_numbers(column, layout)
        if not len(bad):
            present, whole = _whole(values)
            time = values.to_numpy(dtype=float, na_value=np.nan)
            if first_lost(whole) is not None:
                time[present] = since_first(whole)
                return Stamps(time, False, int(whole.min()))
            packed = _packed_stamps(time)
            return Stamps(time, False) if packed is None else Stamps(packed, True)
        if _is_grouped(column.iloc[bad[0]], layout):
            raise _neither(column, table, name, layout, int(bad[0]))
        column = _dates(column, table, name, layout, int(bad[0]))
    if column.isna().all():
        raise InputError(f'Column "{name}" of {table.where} has no time in any row; choose another, or pass dt=.')
    start = column.min() if column.dtype.kind == "M" else pd.Timedelta(0)
    seconds = ((column - start) / pd.Timedelta(seconds=1)).to_numpy(dtype=float, na_value=np.nan)
    raw = table.column(name)
    words = raw.dtype.kind not in "mM"
    # Dates that were read from words are all in UTC by now.
    zoned = raw.astype(str).str.contains(_ZONE).any() if words else getattr(raw.dtype, "tz", None) is not None
    return Stamps(seconds, True, zoned=bool(zoned))


def _whole(column: Any) -> tuple[Bool[np.ndarray, " n_row"], np.ndarray]:
    """Mark the cells with a value, and return these as integers; none if the column has other numbers."""
    present, kind = column.notna().to_numpy(), column.dtype.kind
    return present, column[present].to_numpy(dtype=f"{kind}8") if kind in "iu" else np.array([])


def is_packed_dates(values: np.ndarray) -> bool:
    """Return True for dates such as 20240305: in no other column would every number be the date of a day."""
    return _packed_stamps(values) is not None


def _packed_stamps(values: np.ndarray) -> np.ndarray | None:
    """Return seconds since the earliest of stamps such as 20240305 or 20240305081500; None for other numbers."""
    present = np.isfinite(values)
    if not present.any() or np.any(values[present] % 1 != 0):
        return None
    text = pd.Series([f"{value:.0f}" for value in values[present]])
    digits = len(text[0])
    if digits not in _PACKED or not text.str.fullmatch(rf"(19|20)\d{{{digits - 2}}}").all():
        return None
    dates: Any = pd.to_datetime(text, format=_PACKED[digits], errors="coerce")
    if dates.isna().any():
        return None
    seconds = np.full(len(values), np.nan)
    seconds[present] = ((dates - dates.min()) / pd.Timedelta(seconds=1)).to_numpy(dtype=float)
    return seconds


def is_measured(cell: str, layout: Layout) -> bool:
    """Return True if a cell of text is a number, a date or a clock time, and hence no name."""
    plain = cell.replace(layout.thousands, "") if layout.thousands else cell
    return is_number(plain, layout.decimal) or bool(_CLOCK.match(cell) or (cell[:1].isdigit() and _DATE.match(cell)))


def may_have_lost(column: Any) -> bool:
    """Return True if digits may have been lost: pandas makes floats of whole numbers beside a missing cell."""
    if column.dtype.kind != "f" or not column.isna().any():
        return False
    present = column.dropna().to_numpy(dtype=float)
    with np.errstate(invalid="ignore"):
        return bool(len(present) and np.max(np.abs(present)) > LARGEST_EXACT_INTEGER and np.all(present % 1 == 0))


def with_digits(floats: Any, words: Any) -> Any:
    """Read numbers in words again with all their digits, missing where the floats are; floats if they are not whole."""
    whole: Any = pd.to_numeric(words.where(floats.notna()), errors="coerce", dtype_backend="numpy_nullable")
    return whole if whole.dtype.kind in "iu" and whole.isna().equals(floats.isna()) else floats


def _as_numbers(column: Any, layout: Layout) -> tuple[Any, np.ndarray]:
    """Return a column of numbers, and the rows whose cells are no numbers."""
    if column.dtype.kind == "c":
        return column, np.array([0])
    if pd.api.types.is_numeric_dtype(column):
        return column, np.array([], dtype=int)
    text = column.map(lambda cell: _plain(cell, layout))
    values: Any = pd.to_numeric(text, errors="coerce")
    values = with_digits(values, text) if may_have_lost(values) else values
    # Grouped digits are sought in the original cells: in `text` a decimal comma is a point already.
    bad = np.flatnonzero(column.map(lambda cell: _is_grouped(cell, layout)).to_numpy(dtype=bool))
    if not len(bad):
        missing = text.isna() | text.map(lambda cell: isinstance(cell, str) and not cell)
        bad = np.flatnonzero(values.isna().to_numpy() & ~missing.to_numpy())
    if not len(bad) and (not pd.api.types.is_numeric_dtype(values) or values.dtype.kind == "c"):
        bad = np.array([0])
    return values, bad


def _plain(cell: Any, layout: Layout) -> Any:
    """Return a number in words as Python writes it; a date in words, which pandas would count in ticks."""
    if isinstance(cell, _DATES):
        missing: Any = pd.isna(cell)
        return cell if missing else str(cell)
    if not isinstance(cell, str):
        return cell
    cell = cell.strip()
    if layout.thousands and layout.thousands in cell:
        mark, point = re.escape(layout.thousands), re.escape(layout.decimal)
        if not re.fullmatch(rf"[+-]?\d{{1,3}}({mark}\d{{2,3}})*{mark}\d{{3}}({point}\d*)?([eE][+-]?\d+)?", cell):
            return _NO_NUMBER
        cell = cell.replace(layout.thousands, "")
    return cell.replace(layout.decimal, ".") if layout.decimal != "." else cell


def _is_grouped(cell: Any, layout: Layout) -> bool:
    """Return True if points of a cell probably group its digits, as the comma is the decimal mark."""
    alone = layout.decimal == "," and layout.thousands is None and isinstance(cell, str)
    return alone and bool(re.fullmatch(r"[+-]?[1-9]\d{0,2}(\.\d{3})+", cell.strip()))


def _remedy(cell: Any, layout: Layout) -> str:
    """Advise on a cell that is no number."""
    text, comma = str(cell).strip(), 'if the comma is its decimal mark, pass decimal=","'
    if re.fullmatch(COMMA, text) and layout.decimal == ".":
        return comma
    if _GROUPED.match(text):
        grouped = 'if the point groups its digits, pass thousands="."'
        return grouped if layout.decimal == "," else f'{comma} and thousands="."'
    if re.fullmatch(r"[+-]?\d{1,3}(,\d{3})+(\.\d+)?", text):
        return 'if the comma groups its digits, pass thousands=","'
    return "correct the cell or choose another column"


def _dates(column: Any, table: Table, name: str, layout: Layout, bad: int) -> Any:
    """Return a column of dates or clock times in words as dates or durations."""
    text = column.map(lambda cell: cell if pd.isna(cell) else str(cell).strip())
    filled = text.dropna()
    if filled.str.match(_CLOCK).all():
        return pd.to_timedelta(text.str.replace(",", "."))
    # pandas would read many a number with marks in it as a date.
    dates = text.isna() | (text.str.match(_DATE, na=False) & ~text.str.match(_GROUPED, na=False))
    if not dates.all():
        # A cell of no kind is reported before one of another kind than the others.
        number: Any = pd.to_numeric(text, errors="coerce")
        some = dates | text.str.match(_CLOCK, na=False) | number.notna()
        odd = np.flatnonzero(~(dates if some.all() else some).to_numpy(dtype=bool))
        raise _neither(column, table, name, layout, int(odd[0]))
    zoned = text.str.contains(_ZONE, na=False)
    bare = np.flatnonzero((text.notna() & ~zoned).to_numpy(dtype=bool))
    if zoned.any() and len(bare):
        raise InputError(
            f'Column "{name}" of {table.where} has stamps with a time zone and without one, as '
            f"{column.iloc[bare[0]]!r} in row {bare[0]}: write all of them with their zone, or none."
        )
    # Writers leave out the fraction of a second where it is zero.
    mixed = filled.str.contains(_SECOND_FRACTION).any()
    text = text.str.replace(_SECOND_FRACTION, ".", regex=True)
    if mixed:
        text = text.str.replace(_WHOLE, r"\1.0", n=1, regex=True)
    short = bool(filled.str.match(_SHORT_DATE).all())
    read = [dates for dates in _readings(text, short, layout) if dates is not None]
    if not read:
        # The reading in which most are dates shows which one is none.
        tried = [dates.isna() for dates in _readings(text, short, layout, errors="coerce") if dates is not None]
        odd = min((np.flatnonzero((lost & text.notna()).to_numpy(dtype=bool)) for lost in tried), key=len, default=[])
        raise _neither(column, table, name, layout, int(odd[0]) if len(odd) else bad)
    if any(not (read[0] - read[0].min()).equals(other - other.min()) for other in read[1:]):
        such = f'{capital(table.where)} has dates such as {filled.iloc[0]!r} in column "{name}", in which the '
        asked = "pass dayfirst=True or dayfirst=False"
        raise AmbiguousDates(
            f"{such}year may be first or last: write it with four digits, or {asked} where it is last."
            if short
            else f"{such}day may be the month: {asked}."
        )
    return read[0]


def _readings(text: Any, short: bool, layout: Layout, **options: Any) -> list[Any]:
    """Parse dates in words in every order they may have; None for an order that does not fit."""
    if short:
        return _short_dates(text, layout, **options)
    # Years first need no guess.
    first = _parsed(text, format="ISO8601", **options)
    if first is not None and not options:
        return [first]
    orders = (False, True) if layout.dayfirst is None else (layout.dayfirst,)
    others = [_parsed(text, dayfirst=dayfirst, **options) for dayfirst in orders]
    return [first, *others] if options else others


def _short_dates(text: Any, layout: Layout, **options: Any) -> list[Any]:
    """Parse dates with years of two digits in each order of day, month and year that they may have."""
    orders = {None: ("dmy", "mdy", "ymd"), True: ("dmy",), False: ("mdy",)}[layout.dayfirst]

    def long(cell: Any, order: str) -> Any:
        if pd.isna(cell):
            return cell
        *parts, rest = _SHORT_DATE.fullmatch(cell).groups()  # pyright: ignore[reportOptionalMemberAccess]
        part = dict(zip(order, parts, strict=True))
        # As POSIX reads them.
        year = int(part["y"]) + (2000 if int(part["y"]) < 69 else 1900)
        return f"{year}-{part['m']:0>2}-{part['d']:0>2}{rest}"

    texts = [text.map(lambda cell, order=order: long(cell, order)) for order in orders]
    return [_parsed(each, dayfirst=False, **options) for each in texts]


def _neither(column: Any, table: Table, name: str, layout: Layout, row: int) -> InputError:
    cell = column.iloc[row]
    return InputError(
        f'Column "{name}" of {table.where} holds neither numbers nor dates: row {row} holds {cell!r}; '
        f"{_remedy(cell, layout)}."
    )


def _parsed(text: Any, **options: Any) -> Any:
    """Parse dates, without their time zone; None if they are of another form."""
    with warnings.catch_warnings():
        # pandas warns if only one of the numbers can be the day; then both orders agree.
        warnings.simplefilter("ignore", UserWarning)
        try:
            return pd.to_datetime(text, utc=True, **options)
        except (ValueError, OverflowError, TypeError):
            return None
