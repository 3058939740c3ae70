"""The protocol that every benchmark keeps, and the one runner and writer of all of them.

A benchmark states its cases, how one of them is run, how the records are scored into tables, and the options that it
understands. The runner appends one line of JSON for each finished case to results.jsonl, so that a stopped run goes on,
and writes each table as a CSV file and all of them to summary.json.
"""

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from bayes_greybox.running.errors import InputError
from bayes_greybox.running.plain_values import plain_rows
from bayes_greybox.running.stages import stage, stages
from bayes_greybox.running.whole_files import write_text

RESULTS = "results.jsonl"
"""File of the finished cases."""

CASES_PER_WORKER = 60
"""A worker is replaced after so many cases: whatever it compiled stays in its memory."""

ONE_THREAD = {"XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false", "NPROC": "1"}
"""Environment of a worker, set before JAX starts there."""

Record = dict[str, Any]
"""Plain values of one finished case."""

Tables = dict[str, pd.DataFrame]
"""Tables by the name of their file, without its ending, or by their title on a terminal."""


@dataclass(frozen=True)
class Asked:
    """Options of a run, as `python -m benchmarks --help` explains them; each benchmark understands some of them."""

    folder: Path
    progress: bool = True
    seed: int = 0
    cases: int | None = None
    only: Sequence[str] | None = None
    replicates: int = 1
    workers: int = 1
    families: str | None = None
    displacement: float | None = None
    cap: float = 600.0
    size: Sequence[int] | None = None
    data: Path | None = None

    def names(self, known: Iterable[str], kind: str) -> list[str]:
        """Return the names of the kinds of cases to run, of all known ones; `kind` is a noun for one of them.

        Raises:
            InputError: A name is unknown.
        """
        known = list(known)
        unknown = [name for name in self.only or () if name not in known]
        if unknown:
            raise InputError(f"There is no {kind} {unknown[0]!r}; there are {', '.join(known)}.")
        return list(dict.fromkeys(self.only or known))[: self.cases]


@dataclass(frozen=True)
class Case:
    """One case of a benchmark.

    Attributes:
        key: Name that tells the case from all others of its benchmark, its seed included.
        arguments: Arguments of the benchmark's `run`; they can be pickled.
        about: First entries of its record.
    """

    key: str
    arguments: tuple[Any, ...]
    about: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Benchmark:
    """A benchmark.

    Attributes:
        name: Name on the command line.
        about: Sentence about its measurements that goes on after the name.
        options: Options that it understands, with its defaults; the others are refused.
        cases: Function from the options to the cases.
        run: Function from the arguments of a case to its record, at the top level of a module.
        score: Function from all records to tables by the name of their file; indices have names.
        show: Function from these tables to those for a terminal, by title.
        threads: BLAS threads with one worker, all cores by default; several workers have one each.
        refusals: If true, a case that the package refuses has a record with the sentence under "refused".
        rest: Function from a case and its record of an earlier run to the unfinished part of the case, or None.
        resumes: If false, nothing is taken over from an earlier run.
        in_summary: Function that says whether a table of that name belongs to summary.json.
        finish: Function of the folder and the tables that writes further files.
    """

    name: str
    about: str
    options: Mapping[str, Any]
    cases: Callable[[Asked], Sequence[Case]]
    run: Callable[..., Record]
    score: Callable[[list[Record]], Tables]
    show: Callable[[Tables], Tables]
    threads: int | None = None
    refusals: bool = False
    rest: Callable[[Case, Record], Case | None] = lambda case, record: None
    resumes: bool = True
    in_summary: Callable[[str], bool] = lambda name: True
    finish: Callable[[Path, Tables], object] = lambda folder, tables: None


def replicated(kind: str, names: Sequence[str], asked: Asked) -> list[Case]:
    """Return the replicates of named cases, whose `run` takes the name, the number of the replicate and the seed."""
    return [
        Case(f"{name}/{asked.seed}/{k}", (name, k, asked.seed), {kind: name, "replicate": k})
        for name in names
        for k in range(asked.replicates)
    ]


def perform(benchmark: Benchmark, cases: Sequence[Case], asked: Asked) -> Tables:
    """Run the cases, or what is left of them, and write the results.

    Cases that results.jsonl has are not run again, unless another version of the package ran them.

    Returns:
        The tables of these cases.

    Raises:
        InputError: There is no case or no worker; the folder cannot be written to.
    """
    if not cases or asked.workers < 1:
        raise InputError(f"{benchmark.name} needs at least one case and one worker.")
    folder = Path(asked.folder)
    with _writable(folder):
        folder.mkdir(parents=True, exist_ok=True)
        records = _finished(folder / RESULTS) if benchmark.resumes else {}
        lines = (folder / RESULTS).open("a" if benchmark.resumes else "w", encoding="utf-8")
    left = [benchmark.rest(case, records[case.key]) if case.key in records else case for case in cases]
    todo = [case for case in left if case is not None]
    label = benchmark.name.replace("-", " ").capitalize()
    with lines, stages(asked.progress), stage(label, len(cases)) as bar:
        bar.advance(len(cases) - len(todo))
        for record in _records(benchmark, todo, asked.workers):
            with _writable(folder):
                lines.write(json.dumps(record) + "\n")
                lines.flush()
            records[record["key"]] = record
            bar.advance()
    tables = benchmark.score([records[case.key] for case in cases])
    with _writable(folder):
        for name, table in tables.items():
            write_text(folder / f"{name}.csv", table.reset_index().to_csv(index=False))
        about = {"version": version("bayes-greybox"), **{name: getattr(asked, name) for name in benchmark.options}}
        rows = {name: plain_rows(table) for name, table in tables.items() if benchmark.in_summary(name)}
        write_text(
            folder / "summary.json", json.dumps({**about, "cases": len(cases), **rows}, indent=2, default=str) + "\n"
        )
        benchmark.finish(folder, tables)
    return tables


def mean(values: Sequence[float] | np.ndarray) -> float:
    """Return the mean; NaN of nothing."""
    return float(np.mean(values)) if len(values) else float("nan")


def median(values: Sequence[float] | np.ndarray) -> float:
    """Return the median; NaN of nothing."""
    return float(np.median(values)) if len(values) else float("nan")


def by_group(
    records: Iterable[Record], names: Mapping[str, str], scores: Callable[[list[Record]], Record]
) -> pd.DataFrame:
    """Return one row for each group of records, in the order of their first.

    Args:
        records: Records.
        names: Entries that the records of a group share, and what the table's index calls them.
        scores: Function from the records of a group to its row.
    """
    groups: dict[tuple[Any, ...], list[Record]] = {}
    for record in records:
        groups.setdefault(tuple(record[name] for name in names), []).append(record)
    rows = {key[0] if len(names) == 1 else key: scores(group) for key, group in groups.items()}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis(list(names.values()))


def _records(benchmark: Benchmark, cases: Sequence[Case], workers: int) -> Iterator[Record]:
    """Yield records as they are finished."""
    if workers == 1 or len(cases) < 2:
        with threadpool_limits(benchmark.threads):
            for case in cases:
                yield _record(benchmark.run, benchmark.refusals, case)
        return
    # New processes every so often, since what a worker compiled stays in its memory. Not by max_tasks_per_child: a pool
    # that replaces its workers can wait for ever (https://github.com/python/cpython/issues/115634).
    size = workers * CASES_PER_WORKER
    for start in range(0, len(cases), size):
        # JAX has threads, which a forked process would wait for without end.
        pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_start_worker)
        try:
            together = cases[start : start + size]
            for future in as_completed(
                [pool.submit(_record, benchmark.run, benchmark.refusals, case) for case in together]
            ):
                yield future.result()
        finally:
            pool.shutdown(cancel_futures=True)


def _record(run: Callable[..., Record], refusals: bool, case: Case) -> Record:
    try:
        found = run(*case.arguments)
    except InputError as error:
        if not refusals:
            raise
        found = {"refused": str(error)}
    return {"key": case.key, "version": version("bayes-greybox"), **case.about, **found}


def _start_worker() -> None:
    os.environ.update(ONE_THREAD)
    # Holds for the life of the process: nothing gives the threads back.
    threadpool_limits(1)


def _finished(file: Path) -> dict[str, Record]:
    """Read records by their key; of several lines with one key the last counts.

    The file is left with whole lines only: without those that were cut off, and those of another version of the
    package.
    """
    records = {}
    for line in file.read_text(encoding="utf-8").splitlines() if file.exists() else ():
        try:
            record = json.loads(line)
        except json.JSONDecodeError:
            continue
        if record.get("version") == version("bayes-greybox"):
            records[record["key"]] = record
    write_text(file, "".join(json.dumps(record) + "\n" for record in records.values()))
    return records


@contextmanager
def _writable(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f'Cannot write to the folder "{folder}" ({reason}); choose another one.') from error
