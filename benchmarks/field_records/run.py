"""Studies of the records of four fields with default settings, as their owner would ask for them."""

import time
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bayes_greybox.running.errors import InputError
from benchmarks.answers import SURE, studied
from benchmarks.runner import Asked, Benchmark, Case, Record, Tables

from .record import FieldRecord
from .records import RECORDS

if TYPE_CHECKING:
    from bayes_greybox.missing_effects import Study

KINDS_OF_NOISE = ("correlated noise", "state-dependent noise", "heavy tails", "noisy state", "noise")
"""Suspects that say how a sensor scatters, and not that it misreads: none of them is counted as wrong."""

WRONG, WRONG_ERRORS = "wrong above 0.9", "wrong errors above 0.9"

WORDS = ["names above 0.5", "wrong above 0.5", WRONG, WRONG_ERRORS]

COLUMNS = ["kind", "truth", "verdict", "acceptable", *WORDS, "seconds"]


def cases(asked: Asked) -> list[Case]:
    """Return the chosen records."""
    return [Case(name, (name,), {"record": name}) for name in asked.names(RECORDS, "record")]


def study_of(record: FieldRecord) -> "Study":
    """Return the study of a record; nothing is sampled."""
    # Imported here: these bring JAX, which the modules that make the data do without.
    import bayes_greybox as bg

    made = record.measured()
    data = bg.Trajectories.from_arrays(
        made.time,
        states=dict(made.states) or None,
        inputs=dict(made.inputs),
        outputs=dict(made.outputs) or None,
        units=dict(made.units),
    )
    train, test = data.split(made.split) if made.split else (data, None)
    said: dict[str, Any] = {"starts": dict(made.starts)} if made.starts else {}
    if made.held:
        said["rows"] = bg.DerivativeRows(interpolation="zoh")
    model = bg.GreyBox(simulation=dict(made.simulation), parameters=dict(made.parameters), **said)
    roles = dict(made.roles) or None
    return studied(model, train, test=test, catalogue=record.kind, roles=roles)[0]


def judged(record: FieldRecord, study: Any) -> dict[str, Any]:
    """Return the verdict on a record, its names and errors of the measurement, and whether they are right."""
    likely = study.effects[study.effects["probability"] > 0.5]
    wrong = likely[~likely["slug"].isin({*record.right, *record.harmless})]
    named = [f"{slug}:{p:.3f}" for slug, p in zip(likely["slug"], likely["probability"], strict=True)]
    suspects = study.instrument[study.instrument["probability"] > SURE]
    suspects = suspects[~suspects["suspect"].isin(KINDS_OF_NOISE)]
    errors = [f"{kind} of {channel}" for kind, channel in zip(suspects["suspect"], suspects["channel"], strict=True)]
    return {
        "verdict": study.verdict,
        "acceptable": study.verdict in record.verdicts,
        "names above 0.5": " ".join(named),
        "wrong above 0.5": " ".join(wrong["slug"]),
        WRONG: " ".join(wrong.loc[wrong["probability"] > SURE, "slug"]),
        WRONG_ERRORS: ", ".join(error for error in errors if error not in record.errors),
    }


def answer(name: str) -> Record:
    """Return the judgement of the study of a record."""
    record, started = RECORDS[name], time.perf_counter()
    about = {"kind": record.kind, "truth": record.truth}
    try:
        found = judged(record, study_of(record))
    except InputError as error:
        return {**about, "verdict": f"refused: {error}", "acceptable": False}
    return {**about, **found, "seconds": round(time.perf_counter() - started, 1)}


def counted(table: pd.DataFrame) -> Record:
    """Return the counts of some judgements."""
    wrong = {column: int(np.sum(table[column] != "")) for column in (WRONG, WRONG_ERRORS)}
    return {"records": len(table), "acceptable": int(np.sum(table["acceptable"])), **wrong}


def score(records: list[Record]) -> Tables:
    """Return the judgements, and the counts of each field and of all."""
    table = pd.DataFrame(records, columns=pd.Index(["record", *COLUMNS])).set_index("record")
    table = table.fillna(dict.fromkeys(WORDS, ""))
    counts = {str(kind): counted(group) for kind, group in table.groupby("kind", sort=False)}
    counts["all"] = counted(table)
    return {"records": table, "counts": pd.DataFrame.from_dict(counts, orient="index").rename_axis("kind")}


def show(tables: Tables) -> Tables:
    """Return the judgements, then counts."""
    shown = tables["records"].loc[:, ["verdict", "acceptable", "names above 0.5", WRONG_ERRORS, "seconds"]]
    return {"Records of four fields": shown, "Verdicts": tables["counts"]}


FIELD_RECORDS = Benchmark(
    "field-records",
    "studies batteries, houses, drugs and vehicles that were made to fool a study, with what sensors do there.",
    {"cases": None, "only": None, "workers": 1},
    cases,
    answer,
    score,
    show,
)
