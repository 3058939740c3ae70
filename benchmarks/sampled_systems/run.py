"""Studies of the sampled systems, and what came of them: names, coverage, and the held-out samples."""

import os
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.running.errors import InputError
from benchmarks.answers import Answer
from benchmarks.resumed import picked, tabled

from .samples import System, sampled
from .systems import systems

REPLICATES = 20
"""Of each system, by default."""


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
        output: Folder for results.jsonl, and for systems.csv and summary.json with a row each.
        names: Of the systems; all by default.
        replicates: Of each system.
        seed: Of the noise.
        progress: Whether to show a progress bar.

    Returns:
        The table of `score`.

    Raises:
        InputError: A folder that cannot be written to; an unknown system.
    """
    return tabled(
        output,
        [(system, replicate) for system in picked(systems(), names, "system") for replicate in range(replicates)],
        key=lambda case: f"{case[0].name}/{seed}/{case[1]}",
        measure=lambda case: _answer(*case, seed),
        what="Sampled systems",
        progress=progress,
        score=score,
        name="systems",
        about={"replicates": replicates, "seed": seed},
    )


def study(system: System, replicate: int, seed: int) -> dict[str, Any]:
    """One replicate: what the study says, and whether its intervals hold the truth.

    Args:
        system: The system.
        replicate: Of its noise.
        seed: Of all noise.
    """
    # Imported here: these bring JAX, which the module that makes the data does without.
    from bayes_greybox.greybox import GreyBox
    from bayes_greybox.missing_effects import find_missing_effects
    from bayes_greybox.model.rows.trajectory_rows import TrajectoryRows

    train, test = sampled(system, replicate, seed)
    start = time.perf_counter()
    found = find_missing_effects(
        GreyBox({system.equation: []}, simulation=dict(system.simulation), rows=TrajectoryRows()),
        train,
        test=test,
        catalogue=system.catalogue,
        roles=system.roles,
        settle=False,
        free_runs=False,
        progress=False,
    )
    seconds = time.perf_counter() - start
    answer = Answer(system.truth, found.verdict, found.effects, found.instrument)
    excused = {slug for slug, suspect in system.same.items() if suspect in answer.instrument}
    gap = found.gap.sort_index().loc[("test", "sample NMSE")]
    return {
        "system": system.name,
        "replicate": replicate,
        "verdict": found.verdict,
        "against": list(found.against),
        "right": set(system.truth) <= answer.names | excused,
        "tied": set(system.truth) <= answer.tied | excused,
        "named": found.verdict == "named" and set(system.truth) == answer.names | excused,
        "wrong": answer.wrong,
        "covered": answer.covered,
        "instrument": answer.instrument,
        "noise_share": system.noise**2 / (1 + system.noise**2),
        "before": float(gap["before"].iloc[0]),
        "after": float(gap["after"].iloc[0]),
        "seconds": seconds,
    }


def score(rows: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """One row a system.

    Args:
        rows: Of `study`.

    Returns:
        replicates, right (all that was hidden is in the model), tied (or tied with what is), named (with these very
        names), wrong (a wrong name, as `Answer.wrong` says), refused (no path was found), coverage (of 90 % intervals
        of coefficients that were found), found (such coefficients), left (median mean square error of held-out samples
        over that of the sensor's noise), seconds (median).
    """
    table = {}
    for name in dict.fromkeys(row["system"] for row in rows):
        own = [row for row in rows if row["system"] == name]
        answered = [row for row in own if "refused" not in row]
        covered = [each for row in answered for each in row["covered"].values()]
        left = [row["after"] / row["noise_share"] for row in answered]
        table[name] = {
            "replicates": len(own),
            **{key: float(np.mean([bool(row.get(key)) for row in own])) for key in ("right", "tied", "named", "wrong")},
            "refused": len(own) - len(answered),
            "coverage": float(np.mean(covered)) if covered else float("nan"),
            "found": len(covered),
            "left": float(np.median(left)) if left else float("nan"),
            "seconds": float(np.median([row["seconds"] for row in answered])) if answered else float("nan"),
        }
    found = pd.DataFrame.from_dict(table, orient="index")
    found.index.name = "system"
    return found


def _answer(system: System, replicate: int, seed: int) -> dict[str, Any]:
    try:
        return study(system, replicate, seed)
    except InputError as error:
        # No answer is an answer, and not a right one.
        return {"system": system.name, "replicate": replicate, "refused": str(error)}
