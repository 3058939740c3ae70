"""Studies of the blind records with default settings, as their owner would ask for them."""

import time
from typing import TYPE_CHECKING, Any

import pandas as pd

from bayes_greybox.running.errors import InputError
from benchmarks import answers
from benchmarks.runner import Asked, Benchmark, Case, Record, Tables

from . import sampled_records  # noqa: F401 - its records are among those of that name
from .records import names, record

if TYPE_CHECKING:
    from bayes_greybox.missing_effects import Study

    from .records import Record as BlindRecord

HELD_OUT_SHARE = 0.3
"""Last part of each table, held out as in the README."""

BLIND_COLUMNS = ["kind", "verdict", "acceptable", "names above 0.5", "wrong above 0.5", "wrong above 0.9", "seconds"]


def cases(asked: Asked) -> list[Case]:
    """Return the chosen records."""
    return [Case(name, (name,), {"record": name}) for name in asked.names(names(), "record")]


def studied(made: "BlindRecord") -> "Study":
    """Return the study of a record; nothing is sampled."""
    import bayes_greybox as bg

    settings = dict(made.study_kwargs)
    reading = {
        key: settings.pop(key) for key in ("states", "inputs", "derivatives", "units", "missing") if key in settings
    }
    learned, rows = settings.pop("learn", None), bg.TrajectoryRows() if settings.pop("sampled", False) else None
    train, test = bg.read(made.table, time="t", **reading).split(1 - HELD_OUT_SHARE)
    asked = {"dictionary": {learned: []} if learned else None, "rows": rows}
    model = bg.GreyBox(simulation=made.equations, **{key: value for key, value in asked.items() if value is not None})
    return answers.studied(model, train, test=test, **settings)[0]


def judged(name: str) -> dict[str, Any]:
    """Return the verdict on a record and its names, and whether they are right."""
    made, started = record(name), time.perf_counter()
    try:
        study = studied(made)
    except InputError as error:
        return {"kind": made.kind, "verdict": f"refused: {error}", "acceptable": False}
    likely = study.effects[study.effects["probability"] > 0.5]
    wrong = likely[~likely["slug"].isin(made.right | made.harmless)]
    named = [f"{slug}:{p:.3f}" for slug, p in zip(likely["slug"], likely["probability"], strict=True)]
    return {
        "kind": made.kind,
        "verdict": study.verdict,
        "acceptable": study.verdict in made.verdicts_ok,
        "names above 0.5": " ".join(named),
        "wrong above 0.5": " ".join(wrong["slug"]),
        "wrong above 0.9": " ".join(wrong.loc[wrong["probability"] > answers.SURE, "slug"]),
        "seconds": round(time.perf_counter() - started, 1),
    }


def score(records: list[Record]) -> Tables:
    """Return the verdicts, and how many of them are acceptable."""
    table = pd.DataFrame(records, columns=["record", *BLIND_COLUMNS]).set_index("record")
    table = table.fillna({name: "" for name in BLIND_COLUMNS if " above " in name})
    wrong = int((table["wrong above 0.9"] != "").sum())
    counts = {"records": len(table), "acceptable": int(table["acceptable"].sum()), "wrong above 0.9": wrong}
    return {"records": table, "counts": pd.DataFrame(counts, index=pd.Index(["all"], name="kind"))}


def show(tables: Tables) -> dict[str, pd.DataFrame]:
    """Return the verdicts, then counts."""
    shown = tables["records"][["verdict", "acceptable", "names above 0.5", "seconds"]]
    return {"Blind records": shown, "Verdicts": tables["counts"]}


BLIND_RECORDS = Benchmark(
    "blind-records",
    "studies records that were made to fool a study by someone who had not seen its code.",
    {"cases": None, "only": None, "workers": 1},
    cases,
    judged,
    score,
    show,
)
