"""Studies of the traps: who was tempted, and whether controls were answered."""

from typing import Any

import numpy as np
import pandas as pd

from benchmarks.answers import SURE, studied
from benchmarks.runner import Asked, Benchmark, Case, Record, Tables

from . import controls, inputs, machines, memories, sensors
from .trap import Trap

TEST_SEED = 1000
"""Seed of a test run beyond that of its training run."""


def traps() -> dict[str, Trap]:
    """Return all traps and controls by name."""
    every = [each for part in (sensors, inputs, machines, memories, controls) for each in vars(part).values()]
    return {each.name: each for each in every if isinstance(each, Trap)}


def cases(asked: Asked) -> list[Case]:
    """Return the chosen traps."""
    known = traps()
    return [
        Case(f"{name}/{asked.seed}", (name, asked.seed), {"trap": name, "control": known[name].control})
        for name in asked.names(known, "trap")
    ]


def study(name: str, seed: int) -> dict[str, Any]:
    """Return the answer of the study of a trap, and whether that is wrong."""
    # Imported here: these bring JAX, which the module that makes the data does without.
    from bayes_greybox.greybox import GreyBox
    from bayes_greybox.model.rows.derivative_rows import DerivativeRows
    from bayes_greybox.model.rows.trajectory_rows import TrajectoryRows

    trap = traps()[name]
    train, test = trap.data(seed), trap.data(seed + TEST_SEED)
    # Free runs take inputs between samples as the rows do.
    rows = TrajectoryRows(interpolation="zoh" if trap.hold == "held" else None)
    if trap.rates:
        train = train.differentiate(rates=trap.rates)
        test, rows = test.differentiate(like=train), DerivativeRows()
    model = GreyBox({trap.equation: list(trap.learned)}, simulation=dict(trap.simulation), rows=rows)
    found, seconds = studied(model, train, test=test, catalogue=trap.catalogue, free_runs=True)
    effects, sensor_errors = found.effects.reset_index(), found.instrument.reset_index()
    likeliest = effects.iloc[0] if len(effects) else None
    return {
        "verdict": found.verdict,
        "likeliest": None if likeliest is None else str(likeliest["slug"]),
        "probability": None if likeliest is None else float(likeliest["probability"]),
        **judged(trap, found.verdict, effects),
        "against": list(found.against),
        "ring": bool(found.against),
        "instrument": sensor_errors.loc[sensor_errors["status"] != "", "suspect"].tolist(),
        "seconds": seconds,
    }


def judged(trap: Trap, verdict: str, effects: pd.DataFrame) -> dict[str, Any]:
    """Judge an answer.

    Returns:
        wrong (slugs that nothing excuses, above `SURE` or in a verdict *named*), right (of a trap: nothing is wrong;
        of a control: besides, its verdict, or one of the effects that are wanted and none that is not is added).
    """
    added = set(effects.loc[effects["status"] == "added", "slug"])
    sure = set(effects.loc[effects["probability"] > SURE, "slug"])
    fine = trap.allowed | trap.wanted
    wrong = (added | sure if verdict == "named" else sure) - fine
    answered = verdict == trap.answer or (bool(added & trap.wanted) and added <= fine)
    return {"wrong": sorted(wrong), "right": not wrong and (answered or not trap.control)}


def score(records: list[Record]) -> Tables:
    """Return a row for each trap, and how many traps and controls came to what.

    The rows have control, verdict ("refused" where there was none), likeliest (effect) and its probability, wrong
    (names, separated by commas), right, ring (checks of the study contradict its verdict), seconds. The counts have
    cases, right, wrong (cases with a wrong name), refused, ring.
    """
    # No answer names nothing: a trap is escaped, and a control is not answered.
    silent = {"verdict": "refused", "likeliest": None, "probability": None, "wrong": [], "ring": False, "seconds": None}
    rows = [{**silent, "right": not record["control"], **record} for record in records]
    columns = ["trap", "control", "verdict", "likeliest", "probability", "wrong", "right", "ring", "seconds"]
    table = pd.DataFrame([{**row, "wrong": ", ".join(row["wrong"])} for row in rows], columns=columns).set_index("trap")
    control = table["control"].to_numpy(dtype=bool)
    marks = {
        "cases": np.ones(len(table), dtype=bool),
        "right": table["right"].to_numpy(dtype=bool),
        "wrong": table["wrong"].to_numpy() != "",
        "refused": table["verdict"].to_numpy() == "refused",
        "ring": table["ring"].to_numpy(dtype=bool),
    }
    counts = {name: [int(np.sum(mark[kind])) for kind in (~control, control)] for name, mark in marks.items()}
    return {"traps": table, "counts": pd.DataFrame(counts, index=pd.Index(["traps", "controls"], name="kind"))}


def show(tables: Tables) -> dict[str, pd.DataFrame]:
    """Return the answer to each trap, then counts."""
    columns = {"likeliest": "likeliest", "probability": "P", "wrong": "wrong", "right": "right", "seconds": "s"}
    shown = tables["traps"].loc[:, ["verdict", *columns]].rename(columns=columns)
    # Words, and not slugs: they may be broken to fit the terminal.
    shown = shown.replace({"likeliest": "-", "wrong": "-"}, " ", regex=True)
    return {"Traps and controls: likeliest effect, wrong names": shown, "Counts": tables["counts"]}


SAMPLED_TRAPS = Benchmark(
    "sampled-traps",
    "tempts the study to wrong names: sensors and inputs that lie, machines that no catalogue has, with controls.",
    {"cases": None, "only": None, "workers": 1, "seed": 0},
    cases,
    study,
    score,
    show,
    refusals=True,
)
