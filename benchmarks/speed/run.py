"""All contenders on all problems, and the table of their costs; then the package beside the machine's own routines."""

import math
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import pandas as pd

from benchmarks.runner import Asked, Benchmark, Case, Record, Tables

from .contenders.listed import CONTENDERS
from .contest import contest
from .drawn import CAP, Settings
from .figures import apart, figures
from .floor import FLOORS, floor
from .problems import Problem, measured, problems

SHOWN = {
    "theta_rate": "θ/s",
    "eta_rate": "η/s",
    "ratio": "times",
    "ratio_cpu": "CPU",
    "gradients": "grad.",
    "first": "first",
    "seconds": "s",
    "memory": "MB",
    "r_hat": "R̂",
    "off": "off",
    "end": "",
}
"""Columns on a terminal, and their titles."""


def cases(asked: Asked) -> list[Case]:
    """Return every contender on the first problems, then the comparisons with the machine's own routines."""
    chosen, settings = problems()[: asked.cases], Settings(seed=asked.seed, cap=asked.cap)
    return [
        *contests(asked.folder, chosen, CONTENDERS, settings),
        *(Case(f"floor/{name}", (floor, name), {"what": name}) for name in FLOORS),
    ]


def contests(
    folder: Path, chosen: Sequence[Problem], contenders: Sequence[str] | Mapping[str, Any], settings: Settings
) -> list[Case]:
    """Return each contender on each problem that it is asked about."""
    return [
        Case(
            f"{problem.name}/{name}/{settings.seed}/{settings.tune}+{settings.draws}",
            (measure, folder, name, problem, settings),
            {"problem": problem.name, "contender": name, "cap": settings.cap},
        )
        for problem in chosen
        for name in contenders
        if CONTENDERS[name].runs(problem)
    ]


def measure(folder: Path, contender: str, problem: Problem, settings: Settings) -> dict[str, Any]:
    """Return the costs and figures of one contender on one problem; the folder is for its files, which go."""
    with tempfile.TemporaryDirectory(dir=folder, prefix="contest-") as own:
        drawn, costs = contest(Path(own), contender, _data(problem), settings)
        shutil.rmtree(Path(own) / "compiled", ignore_errors=True)
    return {**costs, **({} if drawn is None else figures(drawn))}


# Of one problem only, which has its contenders one after the other: at most there are gigabytes. The seed of the data
# is not the user's, which is the samplers'.
_data = lru_cache(1)(lambda problem: measured(problem, 1))


def score(records: list[Record]) -> Tables:
    """Return one row for each contender on each problem, and one for each comparison with the machine.

    Contenders have, by problem and contender: `theta_rate` and `eta_rate`, smallest bulk effective sample sizes over θ
    and η a second of the whole process, from its start, compiling included; `ratio`, how many times the first the
    contender of this package that has the same posterior gives; `ratio_cpu`, the same by CPU seconds; `ratio_drawing`,
    the same without the seconds of imports and compilers; `gradients` for an effective draw; `first` (seconds to a
    converged answer); `seconds`, `cpu`, `starting`, `memory` (MB); `divergences`; `r_hat_theta`, `r_hat`; `off` and
    `off_mcse` (posterior means of θ, see `apart`); `end`, where it is not the usual one.

    Comparisons have `here` and `machine`, seconds, and `times`, the one over the other.
    """
    known = {(record["problem"], record["contender"]): record for record in records if "contender" in record}
    plain = ("gradients", "first", "seconds", "cpu", "starting", "memory", "divergences", "r_hat_theta", "r_hat")
    table = {}
    for (problem, name), row in known.items():
        other = known.get((problem, CONTENDERS[name].of), {})
        off, off_mcse = apart(row, other)
        table[problem, name] = {
            "theta_rate": _rate(row, "theta"),
            "eta_rate": _rate(row, "eta"),
            "ratio": _over(_rate(other, "theta"), _rate(row, "theta")),
            "ratio_cpu": _over(_rate(other, "theta", "cpu"), _rate(row, "theta", "cpu")),
            "ratio_drawing": _over(_drawing(other), _drawing(row)),
            **{key: row.get(key, math.nan) for key in plain},
            "off": off,
            "off_mcse": off_mcse,
            "end": _end(row),
        }
    tables = {"speed": pd.DataFrame.from_dict(table, orient="index").rename_axis(["problem", "contender"])}
    floors = [record for record in records if "what" in record]
    if floors:
        tables["floor"] = pd.DataFrame(floors, columns=["what", "here", "machine", "times"]).set_index("what")
    return tables


def show(tables: Tables) -> dict[str, pd.DataFrame]:
    """Return the contenders of each problem, then the comparisons with the machine."""
    shown = {
        f"{problem}: effective draws a second of θ and η, cold": rows.droplevel("problem")
        .loc[:, list(SHOWN)]
        .rename(columns=SHOWN)
        for problem, rows in tables["speed"].groupby(level="problem", sort=False)
    }
    if "floor" in tables:
        shown["Seconds of the processor, beside those of the machine's own routines"] = tables["floor"]
    return shown


def _rate(row: Mapping[str, Any], of: str, seconds: str = "seconds") -> float:
    return row.get(f"ess_{of}", math.nan) / row.get(seconds, math.nan)


def _drawing(row: Mapping[str, Any]) -> float:
    if "ess_theta" not in row:
        return math.nan
    return row["ess_theta"] / max(row["seconds"] - row["starting"], 1e-9)


def _over(first: float, second: float) -> float:
    return first / second if second else math.nan


def _end(row: Mapping[str, Any]) -> str:
    if row["failed"]:
        return row["failed"]
    if not row["capped"]:
        return ""
    drawn = row.get("draws", 0)
    return f"{row['cap']:.0f} s: {f'{drawn} draws' if drawn else 'still in warm-up'}"


def called(function: Any, *arguments: Any) -> dict[str, Any]:
    """Call the function of a case."""
    return function(*arguments)


SPEED = Benchmark(
    "speed",
    "has NumPyro, PyMC with nutpie and PySINDy (extra [peers]) draw from the posteriors that this package draws from, "
    "each in a process of its own, and compares a gradient with LAPACK's share of it, the pass over the rows with a "
    "matrix product.",
    {"cases": None, "cap": CAP, "seed": 0},
    cases,
    called,
    score,
    show,
    threads=1,
)
