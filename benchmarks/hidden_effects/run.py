"""The benchmark from cases to tables: one line of JSON for each finished case, so that a stopped run goes on."""

import json
import os
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from threadpoolctl import threadpool_limits

from bayes_greybox.running.errors import InputError
from bayes_greybox.running.plain_values import plain_rows, plain_values
from benchmarks.files import opened, unwritable, write_tables
from benchmarks.resumed import RESULTS

from .assumptions.case import AssumptionCase
from .assumptions.cases import assumption_cases
from .assumptions.generate import AssumptionData
from .assumptions.generate import generate as generate_assumption
from .cases import Case, all_cases
from .generate import CaseData, generate
from .scoring.score import Scores, score
from .solvers.oracle import Oracle, nearest
from .solvers.oracle import ask as ask_oracle
from .solvers.peers import Rivals, available, require
from .solvers.peers import ask as ask_rivals
from .solvers.study import Solve, study_case

AnyCase = Case | AssumptionCase
"""A case of either kind."""

CASES_PER_WORKER = 60
"""A worker is replaced after so many cases: whatever it compiled stays in its memory."""

ONE_THREAD = {"XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false", "NPROC": "1"}
"""Environment of a worker, set before JAX starts there."""


class Ways(NamedTuple):
    """Who is asked about a case.

    Attributes:
        solve: The study, or a solver of one's own.
        oracle: How well anybody could do.
        rivals: Other methods; None where none is asked.
    """

    solve: Solve
    oracle: Oracle
    rivals: Rivals | None


def run(
    output: str | os.PathLike[str],
    cases: Sequence[AnyCase] | None = None,
    *,
    solve: Solve = study_case,
    oracle: Oracle = ask_oracle,
    rivals: Rivals = ask_rivals,
    workers: int = 2,
    peers: bool | None = None,
    progress: bool = True,
) -> Scores:
    """Run the benchmark, or what is left of it, and write its tables.

    Cases of one's own are `Case` objects with any host of `HOSTS` and any effects of its domain, or `AssumptionCase`
    objects of any family of `assumptions.families` with any of its breaches. A solver of one's own is a function of a
    `CaseData` that returns what `solvers.study.Solve` describes; for several workers it must be defined at the top
    level of a module.

    Args:
        output: Folder for results.jsonl, every table as a CSV file, and summary.json with all but the tables of cases.
            Cases that results.jsonl has are not run again, unless they failed or were run by another version.
        cases: The cases; those of `all_cases()` and `assumption_cases()` by default.
        solve: What solves a case; the study by default.
        oracle: What says how well anybody could do, as `solvers.oracle.ask` does.
        rivals: What PySINDy says, as `solvers.peers.ask` does.
        workers: Processes that work at once, one thread each; 1 works in this process.
        peers: Whether to run PySINDy on the same data; by default if it is installed. An earlier run without it is
            completed.
        progress: Whether to show a progress bar.

    Returns:
        The scores of the given cases.

    Raises:
        InputError: No cases or workers; a folder that cannot be written to; PySINDy is asked for and not installed.
    """
    chosen = (*all_cases(), *assumption_cases()) if cases is None else tuple(cases)
    if not chosen or workers < 1:
        raise InputError("The benchmark needs at least one case and one worker.")
    if peers:
        require()
    peers = available() if peers is None else peers
    folder = Path(output)
    try:
        rows = opened(folder / RESULTS)
    except OSError as error:
        raise unwritable(folder, error) from error
    ways = Ways(solve, oracle, rivals if peers else None)
    todo = [case for case in chosen if _lacking(rows.get(case.key, {}), ways)]
    with _bar(progress) as show, (folder / RESULTS).open("a", encoding="utf-8") as lines:
        show(len(chosen) - len(todo), len(chosen))
        for done, row in enumerate(_worked(todo, rows, ways, workers), 1):
            lines.write(json.dumps(row, allow_nan=False) + "\n")
            lines.flush()
            rows[row["key"]] = row
            show(len(chosen) - len(todo) + done, len(chosen))
    scores = score(rows[case.key] for case in chosen)
    write_scores(scores, folder)
    return scores


def run_case(case: AnyCase, before: Mapping[str, Any], ways: Ways) -> dict[str, Any]:
    """Everything about one case that is not known yet; an error is a result.

    Args:
        case: The case.
        before: What an earlier run found, or nothing.
        ways: What is asked.
    """
    row = {"version": version("bayes-greybox"), "key": case.key, "domain": case.system.domain, **asdict(case)}
    row |= {"truth": [], "off": None, "closable": None, **before}
    row.pop("error", None)
    parts = _lacking(before, ways)
    try:
        data = make_data(case)
        row |= {"truth": [asdict(item) for item in data.effects], "off": data.off}
        if isinstance(data, AssumptionData):
            row |= {"accepted": data.accepted, "excused": data.excused, "silent": data.silent}
            row["suspects"] = [asdict(suspect) for suspect in data.suspects]
            # Neither knows of anything but white noise on the rate.
            row["oracle"] = row["visible"] = row["closable"] = None
        else:
            row["closable"] = data.closable
        if "oracle" in parts and not isinstance(data, AssumptionData):
            row |= {"visible": None, **ways.oracle(data)}
            row["nearest"] = nearest(data) if case.family == "off-catalogue" else None
        if "study" in parts:
            row["study"] = ways.solve(data)
        if "stlsq" in parts and ways.rivals is not None:
            row |= ways.rivals(data)
    except Exception:
        row["error"] = traceback.format_exc()
    return plain_values(row)


def make_data(case: AnyCase) -> CaseData:
    """The data of a case of either kind."""
    return generate_assumption(case) if isinstance(case, AssumptionCase) else generate(case)


def write_scores(scores: Scores, folder: Path) -> None:
    """Write every table as CSV, and all but the tables of cases to summary.json.

    Raises:
        InputError: The folder cannot be written to.
    """
    tables, long = scores.tables(), ("cases", "assumption_cases")
    about = {"cases": len(scores.cases) + len(scores.assumption_cases)}
    about |= {name: plain_rows(table) for name, table in tables.items() if name not in long}
    try:
        write_tables(folder, tables, about)
    except OSError as error:
        raise unwritable(folder, error) from error


def _lacking(row: Mapping[str, Any], ways: Ways) -> tuple[str, ...]:
    """Parts of a case that are still to be found; an oracle that says nothing of what is visible is an older one."""
    wanted = ("oracle", "study", *(("stlsq",) if ways.rivals is not None else ()))
    return tuple(p for p in wanted if p not in row or (p == "oracle" and "visible" not in row))


def _worked(
    todo: Sequence[AnyCase], rows: Mapping[str, Mapping[str, Any]], ways: Ways, workers: int
) -> Iterator[dict[str, Any]]:
    """Rows as they are finished."""
    tasks = [(case, dict(rows.get(case.key, {})), ways) for case in todo]
    if workers == 1 or len(todo) < 2:
        with threadpool_limits(1):
            for task in tasks:
                yield run_case(*task)
        return
    # New processes every so often, since what a worker compiled stays in its memory. Not by max_tasks_per_child: a pool
    # that replaces its workers can wait for ever (https://github.com/python/cpython/issues/115634).
    size = workers * CASES_PER_WORKER
    for start in range(0, len(tasks), size):
        # JAX has threads, which a forked process would wait for without end.
        pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_start_worker)
        try:
            for future in as_completed([pool.submit(run_case, *task) for task in tasks[start : start + size]]):
                yield future.result()
        finally:
            pool.shutdown(cancel_futures=True)


def _start_worker() -> None:
    os.environ.update(ONE_THREAD)
    # Holds for the life of the process: nothing gives the threads back.
    threadpool_limits(1)


@contextmanager
def _bar(visible: bool) -> Iterator[Callable[[int, int], None]]:
    columns = (TextColumn("Hidden effects"), BarColumn(), MofNCompleteColumn())
    with Progress(
        *columns, TimeElapsedColumn(), TimeRemainingColumn(), console=Console(stderr=True), disable=not visible
    ) as progress:
        task = progress.add_task("cases", total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)
