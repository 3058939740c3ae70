"""All contenders on all problems, and the table of what they cost."""

import math
import os
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import pandas as pd

from benchmarks.resumed import tabled

from .contenders.listed import CONTENDERS
from .contest import contest
from .drawn import Settings
from .figures import apart, figures
from .problems import Data, Problem, measured, problems

DATA_SEED = 1
"""Of the data; the sampler's is the user's."""


def run(
    output: str | os.PathLike[str],
    chosen: Sequence[Problem] | None = None,
    *,
    contenders: Sequence[str] = tuple(CONTENDERS),
    settings: Settings | None = None,
    progress: bool = True,
) -> pd.DataFrame:
    """Have every contender draw from every posterior, or those that are left, and write the table.

    Args:
        output: Folder for results.jsonl, and for speed.csv and summary.json.
        chosen: Problems; all by default.
        contenders: By name.
        settings: Of the samplers.
        progress: Whether to show a progress bar.

    Returns:
        The table of `score`.

    Raises:
        InputError: A folder that cannot be written to.
    """
    settings = settings or Settings()
    cases = [
        (problem, name)
        for problem in (problems() if chosen is None else chosen)
        for name in contenders
        if CONTENDERS[name].runs(problem)
    ]
    # Of one problem only, which has its contenders one after the other: at most there are gigabytes.
    data = lru_cache(1)(lambda problem: measured(problem, DATA_SEED))
    return tabled(
        output,
        cases,
        key=lambda case: f"{case[0].name}/{case[1]}/{settings.seed}/{settings.tune}+{settings.draws}",
        measure=lambda case: measure(Path(output), case[1], data(case[0]), settings),
        what="Speed",
        progress=progress,
        score=score,
        name="speed",
        about=settings.heading,
    )


def measure(folder: Path, contender: str, data: Data, settings: Settings) -> dict[str, Any]:
    """One contender on one problem.

    Args:
        folder: For its files, which go.
        contender: By name.
        data: Data.
        settings: Settings.
    """
    with tempfile.TemporaryDirectory(dir=folder, prefix="contest-") as own:
        drawn, costs = contest(Path(own), contender, data, settings)
        shutil.rmtree(Path(own) / "compiled", ignore_errors=True)
    found = {} if drawn is None else figures(drawn)
    return {"problem": data.problem.name, "contender": contender, "cap": settings.cap, **costs, **found}


def score(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """One row for each contender on each problem.

    Args:
        rows: Of `measure`.

    Returns:
        By problem and contender: `theta_rate` and `eta_rate`, smallest bulk effective sample sizes over θ and η a
        second of the whole process, from its start, compiling included; `ratio`, how many times the first the contender
        of this package that has the same posterior gives; `ratio_cpu`, the same by CPU seconds; `ratio_drawing`, the
        same without what each spent on imports and compilers; `gradients` for an effective draw; `first` (seconds to a
        converged answer); `seconds`, `cpu`, `starting`, `memory` (MB); `divergences`; `r_hat_theta`, `r_hat`; `off` and
        `off_mcse` (posterior means of θ, see `apart`); `end`, where it is not the usual one.
    """
    known = {(row["problem"], row["contender"]): row for row in rows}
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
            **{key: row.get(key, math.nan) for key in ("gradients", "first", "seconds", "cpu", "starting", "memory")},
            "divergences": row.get("divergences", math.nan),
            "r_hat_theta": row.get("r_hat_theta", math.nan),
            "r_hat": row.get("r_hat", math.nan),
            "off": off,
            "off_mcse": off_mcse,
            "end": _end(row),
        }
    return pd.DataFrame.from_dict(table, orient="index").rename_axis(["problem", "contender"])


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
