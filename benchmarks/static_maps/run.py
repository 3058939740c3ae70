"""Studies of the static maps: names, controls, coverage, and the held-out rows."""

from typing import Any

import numpy as np

from benchmarks.answers import SURE, Answer, studied
from benchmarks.runner import Asked, Benchmark, Case, Record, Tables, by_group, mean, median, replicated

from .maps import maps, measured
from .oracle import posterior


def cases(asked: Asked) -> list[Case]:
    """Return the replicates of the chosen maps."""
    return replicated("map", asked.names(maps(), "map"), asked)


def study(name: str, replicate: int, seed: int) -> dict[str, Any]:
    """Return what the study of a replicate names, and whether its interval holds the truth."""
    # Imported here: these bring JAX, which the module that makes the data does without.
    from bayes_greybox.greybox import GreyBox
    from bayes_greybox.model.noise.noise_model import CORRELATED

    each, data = maps()[name], measured(maps()[name], replicate, seed)
    model = GreyBox(simulation={each.output: each.simulation})
    found, seconds = studied(model, data.train, test=data.test, catalogue=each.catalogue, roles=each.roles)
    answer = Answer.of(found, data.truth)
    # That nothing is missing is right of a control, and so is correlated noise.
    silent = found.verdict in ("no gap", "instrument") and set(answer.instrument) <= {CORRELATED}
    gap = found.gap.sort_index().loc[("test", "output NMSE", each.output)]
    return {
        "verdict": found.verdict,
        "against": list(found.against),
        "added": answer.added,
        "right": set(data.truth) <= answer.names if data.truth else silent,
        "tied": set(data.truth) <= answer.tied if data.truth else silent,
        "named": found.verdict == "named" and set(data.truth) == answer.names if data.truth else silent,
        "wrong": answer.wrong,
        "oracle": posterior(each, data)[each.hidden or ""],
        "covered": answer.covered,
        "instrument": answer.instrument,
        "correlated": CORRELATED in answer.instrument,
        "noise_share": data.noise**2 / float(np.var(data.test.rate(each.output))),
        "before": float(gap["before"]),
        "after": float(gap["after"]),
        "seconds": seconds,
    }


def score(records: list[Record]) -> Tables:
    """Return a row for each map.

    Its columns are replicates; right (share in which the hidden effect is in the model; of a control: nothing is
    missing), tied (or tied with an effect that is), named (with this very name), wrong (a wrong name, as in
    `Answer.wrong`), correlated (the study reports correlated noise), sure (an oracle has the hidden effect, or that
    there is none, above `SURE`), coverage (of 90 % intervals of coefficients that were found), found (such
    coefficients), left (median mean square error of held-out rows over that of their noise), seconds (median).
    """

    def of_group(group: list[Record]) -> Record:
        covered = [each for record in group for each in record["covered"].values()]
        shares = ("right", "tied", "named", "wrong", "correlated")
        return {
            "replicates": len(group),
            **{key: mean([bool(record[key]) for record in group]) for key in shares},
            "sure": mean([record["oracle"] >= SURE for record in group]),
            "coverage": mean(covered),
            "found": len(covered),
            "left": median([record["after"] / record["noise_share"] for record in group]),
            "seconds": median([record["seconds"] for record in group]),
        }

    return {"maps": by_group(records, {"map": "map"}, of_group)}


TITLE = "Effects found from outputs; coverage of 90 % intervals; held-out error over that of the noise"

STATIC_MAPS = Benchmark(
    "static-maps",
    "studies forces and flows that were measured beside the columns that they depend on, without any derivative.",
    {"cases": None, "only": None, "replicates": 10, "workers": 1, "seed": 0},
    cases,
    study,
    score,
    lambda tables: {TITLE: tables["maps"]},
)
