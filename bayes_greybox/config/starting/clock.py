"""Columns of time stamps, of the names of runs and of row numbers, by their names and their values."""

import re
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.data.reading.cells import AmbiguousDates, numbers, stamps
from bayes_greybox.data.reading.table import Layout, Table
from bayes_greybox.running.errors import InputError

TIME_WORDS = re.compile(r"(?i)^(t|time|zeit|timestamp|date|datetime|datum|x_value|elapsed)([ _].*)?$")
TIME_UNITS = {
    word: unit
    for unit, words in {
        "us": "us", "ms": "ms", "s": "s sec secs second seconds sekunde sekunden",
        "min": "min mins minute minutes minuten", "h": "h hr hrs hour hours stunde stunden",
        "day": "d day days tag tage", "week": "week weeks woche wochen", "month": "month months monat monate",
        "year": "yr year years jahr jahre",
    }.items()
    for word in words.split()
}  # fmt: skip
MAYBE_TIME = re.compile(rf"(?i)^({'|'.join(TIME_UNITS)})([ _.(].*)?$|(^|[ _.])(time|zeit|timestamp)([ _.(].*)?$")
"""Names of stamps if they go forward: s may be a position, h a height and min a minimum as well."""

RUNS = re.compile(
    r"(?i)^(run|trial|id|experiment|test|trajectory|segment|versuch|messung|rep|batch|subject|animal)([ _].*)?$"
)
COUNTERS = re.compile(r"(?i)^((index|no|nr|number|sample|row|row[ _.]?names?|obs|observation)\.?|#|unnamed: \d+)$")

ROWS_OUT_OF_ORDER = 3
"""Median number of rows of a run up to which rows are out of order."""


def time_column(table: Table, names: Sequence[str], layout: Layout) -> str | None:
    """Return the column of stamps: by its name, else the first that holds dates or only increases."""
    by_name = [name for name in names if TIME_WORDS.match(name)]
    # T may be a temperature.
    capital = [name for name in by_name if re.match(r"T(?![A-Za-z])", name)]
    maybe = [name for name in names if MAYBE_TIME.search(name) and name not in by_name]
    called = [*(name for name in by_name if name not in capital), *maybe, *capital]
    # A mere counter is no time; the index of a frame, or of its file, may hold dates.
    counters = [name for name in names if COUNTERS.match(name)]
    others = [name for name in names if name not in (*called, *counters)]
    labels = [name for name in names if tells_runs(table, name, layout)]
    moving: list[str] = []
    for name in (*called, *counters, *others):
        if moving and name not in called:
            # Nothing called a time goes forward: rows are out of order.
            break
        try:
            values, dated, *_ = stamps(table, name, layout)
        except AmbiguousDates:
            raise
        except InputError:
            continue
        codes = run_codes(table, next((label for label in labels if label != name), None))
        forward = _forward(values, codes) or (name in called and _begins_again(values))
        # The date of a day stays the same beside the time of that day.
        moves = bool(np.any(np.diff(values[np.isfinite(values)])))
        if moves and (dated or (forward and (name not in counters or np.any(values % 1)))):
            return name
        moving += [name] if moves and name in by_name else []
    return next(iter(moving), None)


def run_codes(table: Table, label: str | None) -> np.ndarray:
    """Return the number of each row's run by a column that tells runs apart; all are of one run without it."""
    return np.zeros(len(table.frame), int) if label is None else pd.factorize(table.frame[label])[0]


def _forward(values: np.ndarray, codes: np.ndarray) -> bool:
    """Return True if numbers only increase in each run."""
    runs = [values[(codes == code) & np.isfinite(values)] for code in np.unique(codes)]
    return all(bool(np.all(np.diff(run) > 0)) for run in runs)


def _begins_again(values: np.ndarray) -> bool:
    """Return True if numbers only increase, but for going back to where they began, as stamps of runs do."""
    values = values[np.isfinite(values)]
    runs = np.split(values, np.flatnonzero(np.diff(values) <= 0) + 1)
    return len(runs) * ROWS_OUT_OF_ORDER < len(values) and all(run[0] == values[0] for run in runs)


def tells_runs(table: Table, name: str, layout: Layout) -> bool:
    """Return True if a column labels runs: it has few values for its rows, and words or such a name."""
    column: Any = table.frame[name]
    count, total = column.nunique(), len(column)
    words = not pd.api.types.is_datetime64_any_dtype(column)
    if words:
        with suppress(InputError):
            numbers(table, name, layout)
            words = False
    # A label has four rows on average, or two where the name of the column says so.
    several = words and 1 < count <= total / 4
    named = RUNS.match(name) and count <= max(1, total / 2)
    return bool(column.notna().all() and (named or several))


def counts_runs(table: Table, name: str, layout: Layout, clock: np.ndarray) -> bool:
    """Return True if a column numbers the runs: it goes up by 1 wherever the time goes back, and nowhere else."""
    back = np.diff(clock) < 0
    with suppress(InputError):
        return bool(np.any(back)) and np.array_equal(np.diff(numbers(table, name, layout)), back)
    return False


def time_unit(name: str) -> str | None:
    """Return the unit that the name of a column of stamps says, such as that of "Day"; None if it says none."""
    words = [word.lower() for word in re.split(r"[\W_]+", name) if word]
    return next((TIME_UNITS[word] for word in (*words[-1:], *words[:1]) if word in TIME_UNITS), None)


def run_sizes(table: Table, run: str | None, parts: Sequence[np.ndarray]) -> dict[str, int]:
    """Return the number of rows by the name that the reader gives each run."""
    if run is None:
        return {str(i): len(part) for i, part in enumerate(parts)}
    labels = table.frame[run].astype(str).to_numpy()
    sizes: Counter[str] = Counter()
    for part in parts:
        if len(part):
            sizes[str(labels[part[0]]).strip()] += len(part)
    return sizes


def counts_rows(values: np.ndarray, codes: np.ndarray, named: bool) -> bool:
    """Return True for numbers of rows, of the whole table or of each run: from 0 or 1, or so named and whole."""
    if named:
        return bool(np.all(values[np.isfinite(values)] % 1 == 0)) and _forward(values, codes)
    runs = [values[codes == code] for code in np.unique(codes)]
    return any(all(run[0] in (0, 1) and np.all(np.diff(run) == 1) for run in each) for each in ([values], runs))
