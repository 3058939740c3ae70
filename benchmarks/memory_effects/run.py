"""Studies of the machines with a memory, and what came of them: names, clean machines, coverage."""

import os
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.answers import Answer
from benchmarks.resumed import picked, tabled

from .machines import Machine, hidden, machines, measured

REPLICATES = 15
"""Of each effect of the catalogue at each noise, by default."""


def run(
    output: str | os.PathLike[str],
    names: Sequence[str] | None = None,
    *,
    replicates: int = REPLICATES,
    seed: int = 1,
    progress: bool = True,
) -> pd.DataFrame:
    """Study every replicate, or those that are left, and write the results.

    Args:
        output: Folder for results.jsonl, and for machines.csv and summary.json with a row for each kind.
        names: Of the kinds of machines; all by default.
        replicates: Of each effect of the catalogue; of machines that hide nothing there are as many as of all effects,
            of what the catalogue does not have a third.
        seed: Of the machines, of what is hidden and of the noise.
        progress: Whether to show a progress bar.

    Returns:
        The table of `score`.

    Raises:
        InputError: A folder that cannot be written to; an unknown kind.
    """
    return tabled(
        output,
        _cases(picked(machines(), names, "kind of machine"), replicates),
        key=lambda case: f"{case[0].name}/{seed}/{case[1]}",
        measure=lambda case: study(*case, seed),
        what="Memory effects",
        progress=progress,
        score=score,
        name="machines",
        about={"replicates": replicates, "seed": seed},
    )


def _cases(chosen: Sequence[Machine], replicates: int) -> list[tuple[Machine, int]]:
    """One of each kind after the other, so that a run that is stopped has some of all."""
    counts = {machine.name: max(1, round(machine.weight * replicates)) for machine in chosen}
    each = [(k / counts[machine.name], machine, k) for machine in chosen for k in range(counts[machine.name])]
    return [(machine, k) for _, machine, k in sorted(each, key=lambda case: case[0])]


def study(machine: Machine, replicate: int, seed: int) -> dict[str, Any]:
    """One replicate: what the study says, and whether its interval holds the truth.

    Args:
        machine: The kind.
        replicate: Its number.
        seed: Of everything that is drawn.
    """
    # Imported here: these bring JAX, which the module that makes the data does without.
    from bayes_greybox.greybox import GreyBox
    from bayes_greybox.missing_effects import find_missing_effects
    from bayes_greybox.model.rows.trajectory_rows import TrajectoryRows

    data = measured(machine, replicate, seed)
    start = time.perf_counter()
    found = find_missing_effects(
        GreyBox({"v": []}, simulation=dict(data.simulation), rows=TrajectoryRows()),
        data.train,
        test=data.test,
        settle=False,
        free_runs=False,
        progress=False,
    )
    seconds = time.perf_counter() - start
    answer = Answer(data.truth, found.verdict, found.effects, found.instrument)
    remembers = {each.name for each in hidden()}
    return {
        "kind": machine.name,
        "replicate": replicate,
        "verdict": found.verdict,
        "against": list(found.against),
        "added": answer.added,
        "right": found.verdict == "named" and set(data.truth) == answer.names
        if data.truth
        else found.verdict == "no gap",
        "tied": bool(data.truth) and found.verdict in ("named", "one of") and set(data.truth) <= answer.tied,
        "unknown": found.verdict == "unknown",
        "wrong": answer.wrong,
        "memoryless": sorted(set(answer.wrong) - remembers),
        "covered": answer.covered,
        "estimate": {
            slug: [truth, *(float(answer.table.loc[slug, column]) for column in ("mean", "sd"))]
            for slug, truth in data.truth.items()
            if slug in answer.names
        },
        "inner": data.inner,
        "share": data.share,
        "instrument": answer.instrument,
        "seconds": seconds,
    }


def score(rows: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """One row for each kind of machine.

    Args:
        rows: Of `study`.

    Returns:
        cases; right (named with this very name; where nothing is hidden: *no gap*); tied (that, or among the names that
        the study says the data cannot tell apart); unknown; wrong (cases with a wrong name, as `Answer.wrong` says),
        memoryless (those of them whose name remembers nothing); coverage (of 90 % intervals of coefficients that were
        found), found (such coefficients); seconds (median).
    """
    table = {}
    for name in dict.fromkeys(row["kind"] for row in rows):
        own = [row for row in rows if row["kind"] == name]
        covered = [each for row in own for each in row["covered"].values()]
        table[name] = {
            "cases": len(own),
            **{key: sum(bool(row[key]) for row in own) for key in ("right", "tied", "unknown", "wrong", "memoryless")},
            "coverage": float(np.mean(covered)) if covered else float("nan"),
            "found": len(covered),
            "seconds": float(np.median([row["seconds"] for row in own])),
        }
    return pd.DataFrame.from_dict(table, orient="index").rename_axis("kind")
