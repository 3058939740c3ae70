"""Studies of the traps, and what came of them: who was tempted, and whether controls were answered."""

import os
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.running.errors import InputError
from benchmarks.answers import SURE
from benchmarks.resumed import picked, tabled

from .controls import controls
from .filters import filter_traps
from .inputs import input_traps
from .machines import machine_traps
from .memories import memory_traps
from .sensors import sensor_traps
from .trap import Trap

HELD_OUT = 1000
"""What the seed of a test run is beyond that of its training run."""


def traps() -> dict[str, Trap]:
    """All traps and controls by name."""
    every = [*sensor_traps(), *input_traps(), *machine_traps(), *memory_traps(), *filter_traps(), *controls()]
    return {trap.name: trap for trap in every}


def run(
    output: str | os.PathLike[str], *, cases: Sequence[str] | None = None, seed: int = 1, progress: bool = True
) -> pd.DataFrame:
    """Study every trap, or those that are left, and write the results.

    Args:
        output: Folder for results.jsonl, and for traps.csv and summary.json.
        cases: Names of the traps; all by default.
        seed: Of their draws.
        progress: Whether to show a progress bar.

    Returns:
        The table of `score`.

    Raises:
        InputError: A folder that cannot be written to; an unknown trap.
    """
    return tabled(
        output,
        picked(traps(), cases, "trap"),
        key=lambda trap: f"{trap.name}/{seed}",
        measure=lambda trap: _answer(trap, seed),
        what="Sampled traps",
        progress=progress,
        score=score,
        name="traps",
        about={"seed": seed},
        beside=lambda table: counts(table).to_dict("index"),
    )


def study(trap: Trap, seed: int) -> dict[str, Any]:
    """One trap: what the study says, and whether that is wrong.

    Args:
        trap: The trap.
        seed: Of its draws.
    """
    # Imported here: these bring JAX, which the module that makes the data does without.
    from bayes_greybox.greybox import GreyBox
    from bayes_greybox.missing_effects import find_missing_effects
    from bayes_greybox.model.rows.derivative_rows import DerivativeRows
    from bayes_greybox.model.rows.trajectory_rows import TrajectoryRows

    train, test = trap.data(seed), trap.data(seed + HELD_OUT)
    # Free runs take inputs between samples as the rows do.
    rows = TrajectoryRows(interpolation="zoh" if trap.hold == "held" else None)
    if trap.rates:
        train = train.differentiate(rates=trap.rates)
        test, rows = test.differentiate(like=train), DerivativeRows()
    start = time.perf_counter()
    found = find_missing_effects(
        GreyBox({trap.equation: list(trap.learned)}, simulation=dict(trap.simulation), rows=rows),
        train,
        test=test,
        catalogue=trap.catalogue,
        settle=False,
        free_runs=True,
        progress=False,
    )
    seconds = time.perf_counter() - start
    effects = found.effects.reset_index()
    sensors = found.instrument.reset_index()
    likeliest = effects.iloc[0] if len(effects) else None
    return {
        "trap": trap.name,
        "control": trap.control,
        "verdict": found.verdict,
        "likeliest": None if likeliest is None else str(likeliest["slug"]),
        "probability": None if likeliest is None else float(likeliest["probability"]),
        **judged(trap, found.verdict, effects),
        "against": list(found.against),
        "ring": bool(found.against),
        "instrument": sensors.loc[sensors["status"] != "", "suspect"].tolist(),
        "seconds": seconds,
    }


def judged(trap: Trap, verdict: str, effects: pd.DataFrame) -> dict[str, Any]:
    """Whether an answer is wrong, and whether it is right.

    Args:
        trap: The trap.
        verdict: Of the study.
        effects: What it weighed: slug, probability, status.

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


def score(rows: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """One row a trap.

    Args:
        rows: Of `study`, or of what it refused.

    Returns:
        control, verdict ("refused" where there was none), likeliest (effect) and its probability, wrong (names,
        separated by commas), right, ring (whether checks of the study's own speak against its verdict), seconds.
    """
    table = [
        {
            "trap": row["trap"],
            "control": row["control"],
            "verdict": row.get("verdict", "refused"),
            "likeliest": row.get("likeliest"),
            "probability": row.get("probability"),
            "wrong": ", ".join(row["wrong"]),
            "right": row["right"],
            "ring": row.get("ring", False),
            "seconds": row.get("seconds"),
        }
        for row in rows
    ]
    return pd.DataFrame(table).set_index("trap")


def counts(table: pd.DataFrame) -> pd.DataFrame:
    """How many traps, and how many controls, came to what.

    Args:
        table: Of `score`.

    Returns:
        Rows traps and controls; cases, right, wrong (cases with a wrong name), refused, ring.
    """
    control = table["control"].to_numpy(dtype=bool)
    marks = {
        "cases": np.ones(len(table), dtype=bool),
        "right": table["right"].to_numpy(dtype=bool),
        "wrong": table["wrong"].to_numpy() != "",
        "refused": table["verdict"].to_numpy() == "refused",
        "ring": table["ring"].to_numpy(dtype=bool),
    }
    found = {name: [int(np.sum(mark[kind])) for kind in (~control, control)] for name, mark in marks.items()}
    return pd.DataFrame(found, index=pd.Index(["traps", "controls"], name="kind"))


def _answer(trap: Trap, seed: int) -> dict[str, Any]:
    try:
        return study(trap, seed)
    except InputError as error:
        # No answer names nothing: a trap is escaped, and a control is not answered.
        return {
            "trap": trap.name,
            "control": trap.control,
            "refused": str(error),
            "wrong": [],
            "right": not trap.control,
        }
