"""Cells as numbers: decimal marks, dates as seconds, and what is said of a cell that is neither."""

import datetime
import re
import warnings
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

from bayes_greybox.data.digits import LARGEST_EXACT_INTEGER, first_lost, since_first
from bayes_greybox.running.errors import InputError

from .table import Layout, Table, capital
from .units import is_number

COMMA = r"[+-]?\d*,\d+([eE][+-]?\d+)?"
"""A number with a comma for its decimal mark."""

_CLOCK = re.compile(r"^\d{1,3}:\d{2}:\d{2}([.,]\d+)?$")
_DATES = (datetime.date, datetime.time, datetime.timedelta, np.datetime64, np.timedelta64)
_DATE = re.compile(r"^(\d{1,4}[-/.]\w{1,9}[-/.]\d{1,4}(\b|T)|\d{8}T|\w*[A-Za-z]{3}\w*[ ,.]+\d)")
_GROUPED = re.compile(r"^[+-]?\d{1,3}(\.\d{3})+(,\d+)?$")
_NO_NUMBER = "?"
_PACKED = {8: "%Y%m%d", 12: "%Y%m%d%H%M", 14: "%Y%m%d%H%M%S"}
_SHORT_DATE = re.compile(r"^(\d{1,2})[-/.](\d{1,2})[-/.](\d{1,2})(?!\d)(.*)$")
_SECOND_FRACTION = re.compile(r"(?<=:\d{2})[.,](?=\d)")
_WHOLE = re.compile(r"(\d{1,2}:\d{2}:\d{2})(?![\d.,:])")
"""A time of day with seconds and no fraction of them."""

_ZONE = re.compile(r"[T:]\d{2,6}(?:[.,]\d+)?\s*(?:Z|z|UTC|GMT|[+-]\d{2}(?::?\d{2})?)$")
"""A time of day with its zone."""


class Stamps(NamedTuple):
    """A column of time.

    Attributes:
        time: Numbers, NaN where a cell is missing; dates and clock times as seconds since the earliest one.
        dated: Whether they were dates or clock times.
        first: The smallest of whole numbers that floats would not tell apart, which was subtracted; else None.
        zoned: Whether they were dates with their time zone.
    """

    time: Float[np.ndarray, " n_row"]
    dated: bool
    first: int | None = None
    zoned: bool = False


class AmbiguousDates(InputError):
    """Dates of which nobody can tell what is day, month and year."""


def numbers(table: Table, name: str, layout: Layout) -> Float[np.ndarray, " n_row"]:
    """A column as numbers, missing cells as NaN.

    Raises:
        InputError: No such column; dates; a cell that is no number, with its row.
    """
    column: Any = table.column(name)
    if column.dtype.kind in "mM":
        raise InputError(
            f'Column "{name}" of {table.where} holds dates, which only the time may; choose another column, or convert '
            "it to numbers."
        )
    found, bad = _as_numbers(column, layout)
    if len(bad):
        cell = column.iloc[bad[0]]
        raise InputError(
            f'Column "{name}" of {table.where} is not numeric: row {bad[0]} holds {cell!r}; {_remedy(cell, layout)}.'
        )
    known, whole = _whole(found)
    lost = first_lost(whole)
    if lost is not None:
        raise InputError(
            f'Column "{name}" of {table.where} holds whole numbers of more digits than a float does, such as '
            f"{whole[lost]} in row {np.flatnonzero(known)[lost]}: subtract a number from all of them first."
        )
    return found.to_numpy(dtype=float, na_value=np.nan)


def stamps(table: Table, name: str, layout: Layout) -> Stamps:
    """The column of time as numbers.

    Raises:
        InputError: No such column; no date at all; cells that are neither; dates whose day may be their month.
    """
    column: Any = table.column(name)
    if column.dtype.kind not in "mM":
        found, bad = _as_numbers(column, layout)
        if not len(bad):
            return _numbered(found)
        if _is_grouped(column.iloc[bad[0]], layout):
            raise _neither(column, table, name, layout, int(bad[0]))
        column = _dates(column, table, name, layout, int(bad[0]))
    if column.isna().all():
        raise InputError(f'Column "{name}" of {table.where} has no time in any row; choose another, or pass dt=.')
    start = column.min() if column.dtype.kind == "M" else pd.Timedelta(0)
    seconds = ((column - start) / pd.Timedelta(seconds=1)).to_numpy(dtype=float, na_value=np.nan)
    given = table.column(name)
    words = given.dtype.kind not in "mM"
    # What was read from words has the zone of all of them, UTC.
    zoned = given.astype(str).str.contains(_ZONE).any() if words else getattr(given.dtype, "tz", None) is not None
    return Stamps(seconds, True, zoned=bool(zoned))


def _numbered(found: Any) -> Stamps:
    """Stamps that are numbers."""
    values = found.to_numpy(dtype=float, na_value=np.nan)
    known, whole = _whole(found)
    if first_lost(whole) is not None:
        values[known] = since_first(whole)
        return Stamps(values, False, int(whole.min()))
    packed = _packed_stamps(values)
    return Stamps(values, False) if packed is None else Stamps(packed, True)


def _whole(found: Any) -> tuple[Bool[np.ndarray, " n_row"], np.ndarray]:
    """Which cells of a column of numbers are there, and these as integers; no numbers where it has others."""
    known = found.notna().to_numpy()
    kind = found.dtype.kind
    return known, found[known].to_numpy(dtype=f"{kind}8") if kind in "iu" else np.array([])


def is_packed_dates(values: np.ndarray) -> bool:
    """Whether numbers are dates such as 20240305: in no other column would every value be the date of a day."""
    return _packed_stamps(values) is not None


def _packed_stamps(values: np.ndarray) -> np.ndarray | None:
    """Seconds since the earliest of stamps such as 20240305 or 20240305081500; None if the numbers are no such."""
    known = np.isfinite(values)
    if not known.any() or np.any(values[known] % 1 != 0):
        return None
    first = f"{values[known][0]:.0f}"
    form = _PACKED.get(len(first))
    if form is None or not first.startswith(("19", "20")):
        return None
    text = pd.Series([f"{value:.0f}" for value in values[known]])
    if not text.str.fullmatch(rf"(19|20)\d{{{len(first) - 2}}}").all():
        return None
    dates: Any = pd.to_datetime(text, format=form, errors="coerce")
    if dates.isna().any():
        return None
    seconds = np.full(len(values), np.nan)
    seconds[known] = ((dates - dates.min()) / pd.Timedelta(seconds=1)).to_numpy(dtype=float)
    return seconds


def is_measured(cell: str, layout: Layout) -> bool:
    """Whether a cell of text is a number, a date or a clock time, and hence no name."""
    plain = cell.replace(layout.thousands, "") if layout.thousands else cell
    return is_number(plain, layout.decimal) or bool(_CLOCK.match(cell) or (cell[:1].isdigit() and _DATE.match(cell)))


def may_have_lost(column: Any) -> bool:
    """Whether digits may have been lost to a missing cell, for which pandas makes floats of whole numbers."""
    if column.dtype.kind != "f" or not column.isna().any():
        return False
    known = column.dropna().to_numpy(dtype=float)
    with np.errstate(invalid="ignore"):
        return bool(len(known) and np.max(np.abs(known)) > LARGEST_EXACT_INTEGER and np.all(known % 1 == 0))


def with_digits(found: Any, words: Any) -> Any:
    """Numbers with missing cells among them with all their digits.

    Args:
        found: The numbers as floats.
        words: What they were read from.

    Returns:
        Whole numbers, missing where those are; floats where they were not written as whole numbers.
    """
    whole: Any = pd.to_numeric(words.where(found.notna()), errors="coerce", dtype_backend="numpy_nullable")
    return whole if whole.dtype.kind in "iu" and whole.isna().equals(found.isna()) else found


def _as_numbers(column: Any, layout: Layout) -> tuple[Any, np.ndarray]:
    """A column of numbers, and the rows whose cells are none, where there are such."""
    if column.dtype.kind == "c":
        return column, np.array([0])
    if pd.api.types.is_numeric_dtype(column):
        return column, np.array([], dtype=int)
    text = column.map(lambda cell: _plain(cell, layout))
    found: Any = pd.to_numeric(text, errors="coerce")
    found = with_digits(found, text) if may_have_lost(found) else found
    missing = text.isna() | text.map(lambda cell: isinstance(cell, str) and not cell)
    bad = np.flatnonzero(found.isna().to_numpy() & ~missing.to_numpy())
    # As they are written: a decimal comma is a point by now.
    grouped = np.flatnonzero(column.map(lambda cell: _is_grouped(cell, layout)).to_numpy(dtype=bool))
    bad = grouped if len(grouped) else bad
    if not len(bad) and (not pd.api.types.is_numeric_dtype(found) or found.dtype.kind == "c"):
        bad = np.array([0])
    return found, bad


def _plain(cell: Any, layout: Layout) -> Any:
    """A number in words as Python writes it; a date in words, which pandas would count in ticks."""
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
    """Whether points of a cell probably group its digits, the comma being the decimal mark."""
    alone = layout.decimal == "," and layout.thousands is None and isinstance(cell, str)
    return alone and bool(re.fullmatch(r"[+-]?[1-9]\d{0,2}(\.\d{3})+", cell.strip()))


def _remedy(cell: Any, layout: Layout) -> str:
    """What to do about a cell that is no number."""
    text = str(cell).strip()
    if re.fullmatch(COMMA, text) and layout.decimal == ".":
        return 'if the comma is its decimal mark, pass decimal=","'
    if re.fullmatch(r"[+-]?\d{1,3}(\.\d{3})+(,\d+)?", text):
        return (
            'if the point groups its digits, pass thousands="."'
            if layout.decimal == ","
            else 'if the comma is its decimal mark, pass decimal="," and thousands="."'
        )
    if re.fullmatch(r"[+-]?\d{1,3}(,\d{3})+(\.\d+)?", text):
        return 'if the comma groups its digits, pass thousands=","'
    return "correct the cell or choose another column"


def _dates(column: Any, table: Table, name: str, layout: Layout, bad: int) -> Any:
    """A column of dates or clock times in words, as dates or durations."""
    text = column.map(lambda cell: cell if pd.isna(cell) else str(cell).strip())
    given = text.dropna()
    if given.str.match(_CLOCK).all():
        return pd.to_timedelta(text.str.replace(",", "."))
    # pandas would read many a number with marks in it as a date.
    dates = text.isna() | (text.str.match(_DATE, na=False) & ~text.str.match(_GROUPED, na=False))
    if not dates.all():
        # The cell that is of no kind, before one that is only of another kind than the rest.
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
    mixed = given.str.contains(_SECOND_FRACTION).any()
    text = text.str.replace(_SECOND_FRACTION, ".", regex=True)
    if mixed:
        text = text.str.replace(_WHOLE, r"\1.0", n=1, regex=True)
    short = bool(given.str.match(_SHORT_DATE).all())
    read = [dates for dates in _readings(text, short, layout) if dates is not None]
    if not read:
        # The reading in which most are dates shows which one is none.
        tried = [dates.isna() for dates in _readings(text, short, layout, errors="coerce") if dates is not None]
        odd = min((np.flatnonzero((lost & text.notna()).to_numpy(dtype=bool)) for lost in tried), key=len, default=[])
        raise _neither(column, table, name, layout, int(odd[0]) if len(odd) else bad)
    if any(not (read[0] - read[0].min()).equals(other - other.min()) for other in read[1:]):
        such = f'{capital(table.where)} has dates such as {given.iloc[0]!r} in column "{name}", in which the '
        asked = "pass dayfirst=True or dayfirst=False"
        raise AmbiguousDates(
            f"{such}year may be first or last: write it with four digits, or {asked} where it is last."
            if short
            else f"{such}day may be the month: {asked}."
        )
    return read[0]


def _readings(text: Any, short: bool, layout: Layout, **options: Any) -> list[Any]:
    """What dates in words may be; None for a reading that they do not have."""
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
    """Dates with years of two digits, in each order of day, month and year that they may have."""
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
    """Dates, without their time zone; None if they are of another form."""
    with warnings.catch_warnings():
        # It warns where the day can only be the other number; then both readings agree.
        warnings.simplefilter("ignore", UserWarning)
        try:
            return pd.to_datetime(text, utc=True, **options)
        except (ValueError, OverflowError, TypeError):
            return None
