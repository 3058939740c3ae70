"""Studies of records that were made by hand, each with the verdicts and names that are right: judgements and counts."""

import time
from collections.abc import Callable, Set
from typing import Any, Protocol, TypeVar

import numpy as np
import pandas as pd

from bayes_greybox.running.errors import InputError

from .answers import SURE
from .runner import Record, Tables

KINDS_OF_NOISE = ("correlated noise", "state-dependent noise", "heavy tails", "noisy state", "noise")
"""Suspects that say how a sensor scatters, and not that it misreads: none of them is counted as wrong."""

WRONG, WRONG_ERRORS = "wrong above 0.9", "wrong errors above 0.9"

WORDS = ["names above 0.5", "wrong above 0.5", WRONG, WRONG_ERRORS]

COLUMNS = ["kind", "truth", "verdict", "acceptable", *WORDS, "seconds"]


class Right(Protocol):
    """A record with its right answers, which were fixed before any study.

    Attributes:
        kind: Group of records that it is counted with.
        truth: What the simulation lacks, and how it was measured, in words.
        verdicts: Acceptable verdicts.
        right: Slugs of effects that are right.
        harmless: Slugs that are not right, and not absurd; any other name is wrong.
        errors: Errors of the measurement that are there, such as "offset of i"; any other is wrong. None where nobody
            wrote them down.
    """

    @property
    def kind(self) -> str: ...  # noqa: D102
    @property
    def truth(self) -> str: ...  # noqa: D102
    @property
    def verdicts(self) -> Set[str]: ...  # noqa: D102
    @property
    def right(self) -> Set[str]: ...  # noqa: D102
    @property
    def harmless(self) -> Set[str]: ...  # noqa: D102
    @property
    def errors(self) -> Set[str] | None: ...  # noqa: D102


R = TypeVar("R", bound=Right)


def judged(record: Right, study: Any) -> dict[str, Any]:
    """Return the verdict on a record, its names and errors of the measurement, and whether they are right."""
    likely = study.effects[study.effects["probability"] > 0.5]
    wrong = likely[~likely["slug"].isin({*record.right, *record.harmless})]
    named = [f"{slug}:{p:.3f}" for slug, p in zip(likely["slug"], likely["probability"], strict=True)]
    found = {
        "verdict": study.verdict,
        "acceptable": study.verdict in record.verdicts,
        "names above 0.5": " ".join(named),
        "wrong above 0.5": " ".join(wrong["slug"]),
        WRONG: " ".join(wrong.loc[wrong["probability"] > SURE, "slug"]),
    }
    if record.errors is None:
        return found
    suspects = study.instrument[study.instrument["probability"] > SURE]
    suspects = suspects[~suspects["suspect"].isin(KINDS_OF_NOISE)]
    errors = [f"{kind} of {channel}" for kind, channel in zip(suspects["suspect"], suspects["channel"], strict=True)]
    return {**found, WRONG_ERRORS: ", ".join(error for error in errors if error not in record.errors)}


def answer(record: R, study_of: Callable[[R], Any]) -> Record:
    """Return the judgement of the study of a record; a refusal is not acceptable."""
    about, started = {"kind": record.kind, "truth": record.truth}, time.perf_counter()
    try:
        found = judged(record, study_of(record))
    except InputError as error:
        return {**about, "verdict": f"refused: {error}", "acceptable": False}
    return {**about, **found, "seconds": round(time.perf_counter() - started, 1)}


def score(records: list[Record]) -> Tables:
    """Return the judgements, and the counts of each kind and of all."""
    table = pd.DataFrame(records, columns=pd.Index(["record", *COLUMNS])).set_index("record")
    table = table.fillna(dict.fromkeys(WORDS, ""))
    counts = {str(kind): _counted(group) for kind, group in table.groupby("kind", sort=False)}
    counts["all"] = _counted(table)
    return {"records": table, "counts": pd.DataFrame.from_dict(counts, orient="index").rename_axis("kind")}


def _counted(table: pd.DataFrame) -> Record:
    wrong = {column: int(np.sum(table[column] != "")) for column in (WRONG, WRONG_ERRORS)}
    return {"records": len(table), "acceptable": int(np.sum(table["acceptable"])), **wrong}


def show(tables: Tables) -> Tables:
    """Return the judgements, then counts."""
    shown = tables["records"].loc[:, ["verdict", "acceptable", "names above 0.5", WRONG_ERRORS, "seconds"]]
    return {"Records": shown, "Verdicts": tables["counts"]}
