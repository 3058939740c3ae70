"""Studies of the static maps, and what came of them: names, controls, coverage, and the held-out rows."""

import os
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.answers import SURE, Answer
from benchmarks.resumed import picked, tabled

from .maps import StaticMap, maps, measured
from .oracle import told

REPLICATES = 10
"""Of each map, by default."""


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
        output: Folder for results.jsonl, and for maps.csv and summary.json with a row each.
        names: Of the maps; all by default.
        replicates: Of each map.
        seed: Of what is hidden and of the noise.
        progress: Whether to show a progress bar.

    Returns:
        The table of `score`.

    Raises:
        InputError: A folder that cannot be written to; an unknown map.
    """
    return tabled(
        output,
        [(each, replicate) for each in picked(maps(), names, "map") for replicate in range(replicates)],
        key=lambda case: f"{case[0].name}/{seed}/{case[1]}",
        measure=lambda case: study(*case, seed),
        what="Static maps",
        progress=progress,
        score=score,
        name="maps",
        about={"replicates": replicates, "seed": seed},
    )


def study(each: StaticMap, replicate: int, seed: int) -> dict[str, Any]:
    """One replicate: what the study says, and whether its interval holds the truth.

    Args:
        each: The map.
        replicate: Of what is hidden and of the noise.
        seed: Of all of them.
    """
    # Imported here: these bring JAX, which the module that makes the data does without.
    from bayes_greybox.greybox import GreyBox
    from bayes_greybox.missing_effects import find_missing_effects
    from bayes_greybox.model.noise.noise_model import CORRELATED

    data = measured(each, replicate, seed)
    start = time.perf_counter()
    found = find_missing_effects(
        GreyBox(simulation={each.output: each.simulation}),
        data.train,
        test=data.test,
        catalogue=each.catalogue,
        roles=each.roles,
        settle=False,
        progress=False,
    )
    seconds = time.perf_counter() - start
    answer = Answer(data.truth, found.verdict, found.effects, found.instrument)
    # That nothing is missing is right of a control, and so is what is said of its noise.
    silent = found.verdict in ("no gap", "instrument") and set(answer.instrument) <= {CORRELATED}
    gap = found.gap.sort_index().loc[("test", "output NMSE", each.output)]
    return {
        "map": each.name,
        "replicate": replicate,
        "verdict": found.verdict,
        "against": list(found.against),
        "added": answer.added,
        "right": set(data.truth) <= answer.names if data.truth else silent,
        "tied": set(data.truth) <= answer.tied if data.truth else silent,
        "named": found.verdict == "named" and set(data.truth) == answer.names if data.truth else silent,
        "wrong": answer.wrong,
        "oracle": told(each, data)[each.hidden or ""],
        "covered": answer.covered,
        "instrument": answer.instrument,
        "correlated": CORRELATED in answer.instrument,
        "noise_share": data.noise**2 / float(np.var(data.test.rate(each.output))),
        "before": float(gap["before"]),
        "after": float(gap["after"]),
        "seconds": seconds,
    }


def score(rows: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """One row a map.

    Args:
        rows: Of `study`.

    Returns:
        replicates, right (what was hidden is in the model; of a control: nothing is missing), tied (or tied with what
        is), named (with this very name), wrong (a wrong name, as `Answer.wrong` says), correlated (correlated noise is
        said), sure (an oracle has what is hidden, or that nothing is, above `SURE`), coverage (of 90 % intervals of
        coefficients that were found), found (such coefficients), left (median mean square error of held-out rows over
        that of their noise), seconds (median).
    """
    table = {}
    for name in dict.fromkeys(row["map"] for row in rows):
        own = [row for row in rows if row["map"] == name]
        covered = [each for row in own for each in row["covered"].values()]
        shares = ("right", "tied", "named", "wrong", "correlated")
        table[name] = {
            "replicates": len(own),
            **{key: float(np.mean([bool(row[key]) for row in own])) for key in shares},
            "sure": float(np.mean([row["oracle"] >= SURE for row in own])),
            "coverage": float(np.mean(covered)) if covered else float("nan"),
            "found": len(covered),
            "left": float(np.median([row["after"] / row["noise_share"] for row in own])),
            "seconds": float(np.median([row["seconds"] for row in own])),
        }
    found = pd.DataFrame.from_dict(table, orient="index")
    found.index.name = "map"
    return found
