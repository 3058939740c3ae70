"""The benchmark from cases to tables."""

import traceback
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from typing import Any, NamedTuple

import pandas as pd

from bayes_greybox.running.errors import InputError
from bayes_greybox.running.plain_values import plain_values
from benchmarks.runner import Asked, Benchmark, Case, Record, Tables

from .assumptions.case import AssumptionCase
from .assumptions.cases import assumption_cases
from .assumptions.generate import AssumptionData
from .assumptions.generate import generate as generate_assumption
from .cases import HiddenCase, all_cases, subset
from .generate import CaseData, generate
from .scoring.case_scores import SOLVERS
from .scoring.score import score
from .solvers import displacement_oracle, displacement_peers, peers
from .solvers.displacement import displacement_cases, study_displacement
from .solvers.oracle import Oracle, nearest
from .solvers.oracle import ask as ask_oracle
from .solvers.study import Solve, study_case

AnyCase = HiddenCase | AssumptionCase
"""A case of either kind."""

BROKEN = {
    "cases": "cases",
    "wrong above 0.9": "wrong > 0.9",
    **{name: name for name in ("wrong", "right", "silent", "unknown")},
    "instrument found": "instr.",
    "claim denied": "denied",
    "free run before": "before",
    "free run after": "after",
    "stlsq wrong": "STLSQ wrong",
    "stlsq right": "right ",
}
"""Columns of broken assumptions on a terminal, and their titles."""


class Ways(NamedTuple):
    """Solvers of a case.

    Attributes:
        solve: The study, or a solver of one's own.
        oracle: Answer that nobody can beat.
        rivals: Other methods; None where none is asked.
    """

    solve: Solve = study_case
    oracle: Oracle = ask_oracle
    rivals: peers.Rivals | None = None


def cases(asked: Asked) -> list[Case]:
    """Return the cases that the options ask for; PySINDy solves them too where it is installed.

    Raises:
        InputError: Both options have cases of their own.
    """
    noise, installed = asked.displacement, peers.available()
    if noise is not None:
        if asked.families is not None:
            raise InputError("--displacement has cases of its own, of hidden-effects: leave --families out.")
        functions = (study_displacement, displacement_oracle.ask, displacement_peers.ask)
        solve, seen, rivals = (partial(function, noise=noise) for function in functions)
        ways = Ways(solve, seen, rivals if installed else None)
        every: Sequence[AnyCase] = displacement_cases(asked.seed)
    else:
        ways = Ways(rivals=peers.ask if installed else None)
        hold = () if asked.families == "assumptions" else all_cases(asked.seed)
        broken = () if asked.families == "effects" else assumption_cases(asked.seed)
        every = (*hold, *broken)
    return to_solve(every if asked.cases is None else subset(every, asked.cases, asked.seed), ways)


def to_solve(chosen: Sequence[AnyCase], ways: Ways) -> list[Case]:
    """Return cases as the runner takes them, with nothing known of them yet.

    Cases of one's own are `HiddenCase` objects with any host of `HOSTS` and any effects of its domain, or
    `AssumptionCase` objects of any family of `assumptions.families` with any of its breaches.
    """
    return [Case(case.key, (case, ways)) for case in chosen]


def run_case(case: AnyCase, ways: Ways, before: Mapping[str, Any] | None = None) -> Record:
    """Return everything about one case that is not known yet; an error is a result."""
    before = before or {}
    row = {"domain": case.system.domain, **asdict(case), "truth": [], "off": None, "closable": None, **before}
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
    """Make the data of a case of either kind."""
    return generate_assumption(case) if isinstance(case, AssumptionCase) else generate(case)


def rest(case: Case, record: Record) -> Case | None:
    """Return the parts of a case that an earlier run did not have: it failed, or PySINDy was not installed."""
    hidden, ways, *_ = case.arguments
    return replace(case, arguments=(hidden, ways, record)) if _lacking(record, ways) else None


def _lacking(row: Mapping[str, Any], ways: Ways) -> tuple[str, ...]:
    """Return the missing parts of a case; an oracle that says nothing of what is visible is an older one."""
    wanted = ("oracle", "study", *(("stlsq",) if ways.rivals is not None else ()))
    return tuple(p for p in wanted if p not in row or (p == "oracle" and "visible" not in row))


def show(tables: Tables) -> dict[str, pd.DataFrame]:
    """Return right answers of the study and of its rivals, then the bars."""
    shown = {}
    if len(tables["families"]):
        columns = ["cases", *SOLVERS, "right or tied", "closed", "seconds"]
        shown["Share of right answers; gap closed, of what the true model closes"] = tables["families"].loc[:, columns]
    if len(tables["assumptions"]):
        title = "Broken assumptions: shares of cases; error of the held-out free run"
        shown[title] = tables["assumptions"].loc[:, list(BROKEN)].rename(columns=BROKEN)
    return {**shown, "What must hold": tables["bars"]}


HIDDEN_EFFECTS = Benchmark(
    "hidden-effects",
    "hides known effects from simulations and counts how often the study finds them, beside an oracle and PySINDy.",
    {"cases": None, "workers": 2, "families": None, "displacement": None, "seed": 0},
    cases,
    run_case,
    score,
    show,
    threads=1,
    rest=rest,
    in_summary=lambda name: name not in ("cases", "assumption_cases"),
)
