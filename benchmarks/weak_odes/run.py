"""All draws of all systems at all noise levels, and one table.

What is measured is the model that weak rows are taken near (see `model.estimate.likeliest`): the likeliest set of terms
of all equations together, with the posterior of its coefficients in closed form, σ integrated out. Nothing is sampled.
"""

import os
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import norm

from bayes_greybox.running.errors import InputError
from benchmarks.resumed import picked, tabled

from .systems import NOISES, WeakSystem, weak_systems

REPLICATES = 20
"""Draws of the noise of each system at each level."""

COVERED, REPEATS = ("lotka-volterra",), 200
"""System whose intervals are counted in more draws of 10 % noise, and how many."""

NORMAL = float(norm.ppf(0.95))
"""Half a 90 % interval, in standard deviations."""


def run(
    output: str | os.PathLike[str],
    names: Sequence[str] | None = None,
    *,
    noises: Sequence[float] = NOISES,
    replicates: int = REPLICATES,
    seed: int = 1,
    progress: bool = True,
) -> pd.DataFrame:
    """Run the benchmark, or what is left of it, and write its table.

    Args:
        output: Folder for results.jsonl, and for systems.csv and summary.json.
        names: Of the systems; all by default.
        noises: Levels of the noise, over the RMS of all states.
        replicates: Draws of each.
        seed: Of the noise.
        progress: Whether to show a progress bar.

    Returns:
        The table of `score`.

    Raises:
        InputError: A folder that cannot be written to; an unknown system.
    """
    chosen = picked(weak_systems(), names, "system")
    return tabled(
        output,
        [(each, noise, k) for each in chosen for noise in noises for k in range(replicates)],
        key=lambda case: f"{case[0].name}/{case[1]:g}/{seed}/{case[2]}",
        measure=lambda case: identified(*case, seed),
        what="Weak ODEs",
        progress=progress,
        score=score,
        name="systems",
        about={"replicates": replicates, "seed": seed},
        threads=1,
    )


def identified(each: WeakSystem, noise: float, replicate: int, seed: int) -> dict[str, Any]:
    """One draw: terms, coefficients, and whether their intervals hold the truth.

    Args:
        each: The system; of its equations nothing is used but to score.
        noise: Level of the noise.
        replicate: Number of the draw.
        seed: Of all draws.
    """
    # Imported here: these bring JAX, which the module that makes the data does without.
    from bayes_greybox.model.estimate.likeliest import likeliest
    from bayes_greybox.model.program import Program
    from bayes_greybox.model.rows.weak_rows import WeakRows

    data = each.sampled(noise, replicate, seed)
    about = {"system": each.name, "noise": noise, "replicate": replicate}
    start = time.perf_counter()
    try:
        model = Program({name: each.candidates for name in each.states}, rows=WeakRows(), discrepancy=None)
        model, data = model.near(data)
        (equation,) = model.assemble(data).values()
        found = likeliest(equation)
    except InputError as error:
        return {**about, "refused": str(error)}
    seconds = time.perf_counter() - start
    # The package writes terms in a way of its own.
    said = dict(
        zip((t.text for t in equation.frame.dictionary.terms), each.candidates * len(each.states), strict=False)
    )
    coefficients: dict[str, dict[str, float]] = {name: {} for name in each.states}
    holds = []
    for (term, value), sd, state in zip(found.terms, found.sd, found.acts_on, strict=True):
        text = said[term.text]
        coefficients[state][text] = value
        if text in each.truth[state]:
            holds.append(bool(abs(value - each.truth[state][text]) <= NORMAL * sd))
    return {
        **about,
        "coefficients": coefficients,
        "error": each.error(coefficients),
        "tpr": each.true_positives(coefficients),
        "holds": holds,
        "probability": next(iter(found.weighed.values())),
        "rows": equation.rows.n_white,
        "seconds": seconds,
    }


def score(rows: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """One row for each system and level of noise.

    Args:
        rows: Of `identified`.

    Returns:
        draws; refused (without an answer); exact (share with all true terms and no other); TPR (mean); error (median
        ‖ŵ − w*‖/‖w*‖ of all that were not refused), largest; published (of one draw, at 10 % noise); efficient (median
        of an efficient estimate that knows the terms); coverage (of 90 % intervals of true terms in exact draws), and
        intervals (how many); seconds (median).
    """
    known, table = weak_systems(), {}
    for name, noise in dict.fromkeys((row["system"], row["noise"]) for row in rows):
        own = [row for row in rows if (row["system"], row["noise"]) == (name, noise)]
        found = [row for row in own if "refused" not in row]
        exact = [row for row in found if row["tpr"] == 1.0]
        holds = [each for row in exact for each in row["holds"]]
        table[name, noise] = {
            "draws": len(own),
            "refused": len(own) - len(found),
            "exact": len(exact) / len(own),
            "TPR": float(np.mean([row["tpr"] for row in found])) if found else float("nan"),
            "error": float(np.median([row["error"] for row in found])) if found else float("nan"),
            "largest": float(np.max([row["error"] for row in found])) if found else float("nan"),
            "published": known[name].published if noise == NOISES[0] else float("nan"),
            "efficient": known[name].efficient(noise),
            "coverage": float(np.mean(holds)) if holds else float("nan"),
            "intervals": len(holds),
            "seconds": float(np.median([row["seconds"] for row in found])) if found else float("nan"),
        }
    return pd.DataFrame.from_dict(table, orient="index").rename_axis(["system", "noise"])
