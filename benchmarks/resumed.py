"""The loop of a benchmark: a line of JSON for each finished case, so that a stopped run goes on, then a table."""

import json
import os
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import pandas as pd
from threadpoolctl import threadpool_limits

from bayes_greybox.running.errors import InputError

from .files import opened, unwritable, write_tables
from .progress import shown

RESULTS = "results.jsonl"
"""File of the finished cases."""

Case = TypeVar("Case")


def picked(known: Mapping[str, Case], names: Sequence[str] | None, what: str) -> list[Case]:
    """Cases by their names; all where none are named.

    Args:
        known: All cases by name.
        names: Of those that are wanted.
        what: What one is called.

    Raises:
        InputError: An unknown one.
    """
    unknown = [name for name in names or () if name not in known]
    if unknown:
        raise InputError(f"There is no {what} {unknown[0]!r}; there are {', '.join(known)}.")
    return [known[name] for name in names or known]


def tabled(
    output: str | os.PathLike[str],
    cases: Sequence[Case],
    *,
    key: Callable[[Case], str],
    measure: Callable[[Case], dict[str, Any]],
    what: str,
    progress: bool,
    score: Callable[[list[dict[str, Any]]], pd.DataFrame],
    name: str,
    about: Mapping[str, Any],
    beside: Callable[[pd.DataFrame], Mapping[str, Any]] = lambda table: {},
    threads: int | None = None,
) -> pd.DataFrame:
    """Measure all cases, or those that are left, and write their table.

    Args:
        output: Folder for `RESULTS`, the table as CSV, and summary.json.
        cases: The cases.
        key: What tells a case from the others.
        measure: What came of a case.
        what: What the progress bar calls them.
        progress: Whether to show the bar.
        score: From the rows of all cases to the table.
        name: Of the table's file, without its ending.
        about: Size, seed and whatever else summary.json says.
        beside: What it says of the table.
        threads: Of BLAS while cases are measured; as many as there are by default.

    Raises:
        InputError: A folder that cannot be written to.
    """
    folder = Path(output)
    try:
        with threadpool_limits(threads):
            rows = resumed(folder, cases, key=key, measure=measure, what=what, progress=progress)
        table = score(rows)
        write_tables(folder, {name: table}, {**about, **beside(table)})
    except OSError as error:
        raise unwritable(folder, error) from error
    return table


def resumed(
    folder: Path,
    cases: Sequence[Case],
    *,
    key: Callable[[Case], str],
    measure: Callable[[Case], dict[str, Any]],
    what: str,
    progress: bool,
) -> list[dict[str, Any]]:
    """Rows of all cases, measured where the file has none of this version of the package.

    Args:
        folder: Where `RESULTS` is.
        cases: The cases.
        key: What tells a case from the others.
        measure: What came of a case.
        what: What the progress bar calls them.
        progress: Whether to show the bar.

    Raises:
        OSError: A folder that cannot be written to.
    """
    rows = opened(folder / RESULTS)
    todo = [case for case in cases if key(case) not in rows]
    with (folder / RESULTS).open("a", encoding="utf-8") as lines:
        for case in shown(todo, what, progress):
            rows[key(case)] = row = {"key": key(case), "version": version("bayes-greybox"), **measure(case)}
            lines.write(json.dumps(row) + "\n")
            lines.flush()
    return [rows[key(case)] for case in cases]
