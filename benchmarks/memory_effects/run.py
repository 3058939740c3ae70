"""Studies of the machines with a memory: names, clean machines, coverage."""

from dataclasses import replace
from typing import Any

from benchmarks.answers import Answer, studied
from benchmarks.runner import Asked, Benchmark, Case, Record, Tables, by_group, mean, median, replicated

from .machines import hidden, machines, measured


def cases(asked: Asked) -> list[Case]:
    """Return one case of each kind after the other, so that a run that is stopped has some of all.

    `replicates` counts those of each effect of the catalogue. There are as many machines that hide nothing as of all
    effects, and a third as many of an effect that the catalogue does not have.
    """
    known, found = machines(), []
    for name in asked.names(known, "kind of machine"):
        count = max(1, round(known[name].weight * asked.replicates))
        own = replicated("kind", [name], replace(asked, replicates=count))
        found += [(case.arguments[1] / count, case) for case in own]
    return [case for _, case in sorted(found, key=lambda pair: pair[0])]


def study(kind: str, replicate: int, seed: int) -> dict[str, Any]:
    """Return what the study of a replicate names, and whether its interval holds the truth."""
    # Imported here: these bring JAX, which the module that makes the data does without.
    from bayes_greybox.greybox import GreyBox
    from bayes_greybox.model.rows.trajectory_rows import TrajectoryRows

    data = measured(machines()[kind], replicate, seed)
    model = GreyBox({"v": []}, simulation=dict(data.simulation), rows=TrajectoryRows())
    found, seconds = studied(model, data.train, test=data.test, free_runs=False)
    answer, named = Answer.of(found, data.truth), found.verdict == "named"
    remembers = {each.name for each in hidden()}
    return {
        "verdict": found.verdict,
        "against": list(found.against),
        "added": answer.added,
        "right": named and set(data.truth) == answer.names if data.truth else found.verdict == "no gap",
        "tied": bool(data.truth) and (named or found.verdict == "one of") and set(data.truth) <= answer.tied,
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


def score(records: list[Record]) -> Tables:
    """Return a row for each kind of machine.

    Its columns are cases; right (named with this very name; where nothing is hidden: *no gap*); tied (that, or among
    the names that the study says the data cannot tell apart); unknown; wrong (cases with a wrong name, as in
    `Answer.wrong`), memoryless (those of them whose name remembers nothing); coverage (of 90 % intervals of
    coefficients that were found), found (such coefficients); seconds (median).
    """

    def of_group(group: list[Record]) -> Record:
        covered = [each for record in group for each in record["covered"].values()]
        counted = ("right", "tied", "unknown", "wrong", "memoryless")
        return {
            "cases": len(group),
            **{key: sum(bool(record[key]) for record in group) for key in counted},
            "coverage": mean(covered),
            "found": len(covered),
            "seconds": median([record["seconds"] for record in group]),
        }

    return {"machines": by_group(records, {"kind": "kind"}, of_group)}


TITLE = "Effects with memory found from samples of a position; counts of cases, coverage of 90 % intervals"

MEMORY_EFFECTS = Benchmark(
    "memory-effects",
    "hides hysteresis, relaxation, lags and absorbers in oscillators whose position is sampled.",
    {"cases": None, "only": None, "replicates": 15, "workers": 1, "seed": 0},
    cases,
    study,
    score,
    lambda tables: {TITLE: tables["machines"]},
)
