"""Studies of the measured records with default settings, as their owners would begin."""

from pathlib import Path
from typing import Any

import pandas as pd

from bayes_greybox.running.errors import InputError
from benchmarks.answers import studied
from benchmarks.runner import Asked, Benchmark, Case, Record, Tables

from .records import READ

LEAST_LISTED = 0.3
"""Effects, corrections and kinds of discrepancies that are likelier are listed."""

MEASURED_COLUMNS = ["samples", "verdict", "effects", "corrections", "kind of what is left", "right", "seconds", "says"]


def cases(asked: Asked) -> list[Case]:
    """Return the chosen records of the folder.

    Raises:
        InputError: There is no folder.
    """
    if asked.data is None:
        raise InputError("measured-records needs --data, the folder of the files, which are not part of the project.")
    return [Case(name, (name, asked.data), {"record": name}) for name in asked.names(READ, "record")]


def judged(name: str, folder: Path) -> dict[str, Any]:
    """Return the verdict on a record and its reasons; nothing is sampled."""
    import bayes_greybox as bg

    record = READ[name](folder)
    rows = {"rows": bg.TrajectoryRows()} if record.sampled else {}
    model = bg.GreyBox(simulation=record.simulation, dictionary={record.equation: []}, **rows)
    about: dict[str, Any] = {"catalogue": record.catalogue, "roles": record.roles or None}
    study, seconds = studied(model, record.data, free_runs=False, **about)
    return {
        "samples": record.data.n_obs,
        "verdict": study.verdict,
        "effects": _listed(study.effects, "slug"),
        "corrections": _listed(study.corrections, "term"),
        "kind of what is left": _listed(study.memory, "memory"),
        "right": record.right,
        "seconds": round(seconds, 1),
        "says": study.sentence,
    }


def _listed(table: pd.DataFrame, name: str) -> str:
    likely = table[table["probability"] > LEAST_LISTED].reset_index()
    return ", ".join(f"{each} {p:.2f}" for each, p in zip(likely[name], likely["probability"], strict=True))


def score(records: list[Record]) -> Tables:
    """Return a row for each record."""
    return {"records": pd.DataFrame(records, columns=["record", *MEASURED_COLUMNS]).set_index("record")}


MEASURED_RECORDS = Benchmark(
    "measured-records",
    "studies records that other people measured and published, from a folder of their files (--data).",
    {"cases": None, "only": None, "data": None, "workers": 1},
    cases,
    judged,
    score,
    lambda tables: {"Measured records": tables["records"].drop(columns=["samples", "right", "says"])},
)
