"""The loop of a benchmark: a line of JSON for each finished case, so that a stopped run goes on."""

import json
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

from bayes_greybox.data.errors import InputError

from .files import opened
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
