"""The benchmark from cases to tables: one line of JSON for each finished case, so that a stopped run goes on."""

import json
import os
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from threadpoolctl import threadpool_limits

from bayes_greybox.data.errors import InputError

from .cases import Case, all_cases
from .generate import CaseData, generate
from .oracle import nearest, posterior
from .peers import available, sindy
from .score import Scores, score
from .solve import Solve, study_case

RESULTS = "results.jsonl"
"""File of the finished cases."""

CASES_PER_WORKER = 60
"""A worker is replaced after so many cases; every compiled shape would stay in its memory."""

_ONE_THREAD = {"XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false", "NPROC": "1"}


def run(
    output: str | os.PathLike[str],
    cases: Sequence[Case] | None = None,
    *,
    solve: Solve = study_case,
    workers: int = 2,
    peers: bool | None = None,
    progress: bool = True,
) -> Scores:
    """Run the benchmark, or what is left of it, and write its tables.

    Cases of one's own: build `Case` objects (any host of `HOSTS`, any effects of its domain) and pass them as `cases`.
    Solvers of one's own: any function of a `CaseData` that returns what `solve.Solve` describes; with more than one
    worker it must be defined at the top of a module.

    Args:
        output: Folder for results.jsonl, one table a CSV file, and summary.json with all tables. Cases that it already
            has are not run again, unless they failed.
        cases: The cases; those of `all_cases()` by default.
        solve: What solves a case; the study by default.
        workers: Processes that work at once, one core each; 1 works in this process.
        peers: Whether to run PySINDy on the same data; by default if it is installed.
        progress: Whether to show a progress bar.

    Returns:
        The scores of the given cases.

    Raises:
        InputError: No cases, workers or folder; PySINDy is asked for and not installed.
    """
    chosen = tuple(all_cases() if cases is None else cases)
    if not chosen or workers < 1:
        raise InputError("The benchmark needs at least one case and one worker.")
    if peers and not available():
        sindy_is_missing()
    file = _results_file(output)
    rows = finished(file)
    todo = [case for case in chosen if case.key not in rows]
    work = partial(solve_case, solve=solve, peers=available() if peers is None else peers)
    with _bar(progress) as advance, file.open("a", encoding="utf-8") as lines:
        advance(len(chosen) - len(todo), len(chosen))
        for row in _worked(work, todo, workers):
            lines.write(json.dumps(row, allow_nan=False) + "\n")
            lines.flush()
            rows[row["key"]] = row
            advance(1, len(chosen))
    scores = score(rows[case.key] for case in chosen)
    write_tables(scores, Path(output))
    return scores
