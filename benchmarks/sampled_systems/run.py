"""Studies of the sampled systems: names, coverage, and the held-out samples."""

from typing import Any

from benchmarks.answers import Answer, studied
from benchmarks.runner import Asked, Benchmark, Case, Record, Tables, by_group, mean, median, replicated

from .samples import sampled
from .systems import systems


def cases(asked: Asked) -> list[Case]:
    """Return the replicates of the chosen systems."""
    return replicated("system", asked.names(systems(), "system"), asked)


def study(name: str, replicate: int, seed: int) -> dict[str, Any]:
    """Return what the study of a replicate names, and whether its intervals hold the truth."""
    # Imported here: these bring JAX, which the module that makes the data does without.
    from bayes_greybox.greybox import GreyBox
    from bayes_greybox.model.rows.trajectory_rows import TrajectoryRows

    system = systems()[name]
    train, test = sampled(system, replicate, seed)
    model = GreyBox({system.equation: []}, simulation=dict(system.simulation), rows=TrajectoryRows())
    found, seconds = studied(model, train, test=test, catalogue=system.catalogue, roles=system.roles, free_runs=False)
    answer, hidden = Answer.of(found, system.truth), set(system.truth)
    excused = {slug for slug, suspect in system.same.items() if suspect in answer.instrument}
    gap = found.gap.sort_index().loc[("test", "sample NMSE")]
    return {
        "verdict": found.verdict,
        "against": list(found.against),
        "right": hidden <= answer.names | excused,
        "tied": hidden <= answer.tied | excused,
        "named": found.verdict == "named" and hidden == answer.names | excused,
        "wrong": answer.wrong,
        "covered": answer.covered,
        "instrument": answer.instrument,
        "noise_share": system.noise**2 / (1 + system.noise**2),
        "before": float(gap["before"].iloc[0]),
        "after": float(gap["after"].iloc[0]),
        "seconds": seconds,
    }


def score(records: list[Record]) -> Tables:
    """Return a row for each system.

    Its columns are replicates, right (all hidden effects are in the model), tied (or tied with one that is), named
    (with these very names), wrong (a wrong name, as in `Answer.wrong`), refused (no path was found), coverage (of 90 %
    intervals of coefficients that were found), found (such coefficients), left (median mean square error of held-out
    samples over that of the sensor's noise), seconds (median).
    """

    def of_group(group: list[Record]) -> Record:
        # No answer is an answer, and not a right one.
        answered = [record for record in group if "refused" not in record]
        covered = [each for record in answered for each in record["covered"].values()]
        return {
            "replicates": len(group),
            **{key: mean([bool(record.get(key)) for record in group]) for key in ("right", "tied", "named", "wrong")},
            "refused": len(group) - len(answered),
            "coverage": mean(covered),
            "found": len(covered),
            "left": median([record["after"] / record["noise_share"] for record in answered]),
            "seconds": median([record["seconds"] for record in answered]),
        }

    return {"systems": by_group(records, {"system": "system"}, of_group)}


TITLE = "Effects found from samples of one state; coverage of 90 % intervals; held-out error over the sensor's"

SAMPLED_SYSTEMS = Benchmark(
    "sampled-systems",
    "studies systems of which one state has a sensor: decays, an axis, a beam, an oscillator under noise of several "
    "kinds, two masses, tanks, predators and prey.",
    {"cases": None, "only": None, "replicates": 20, "workers": 1, "seed": 0},
    cases,
    study,
    score,
    lambda tables: {TITLE: tables["systems"]},
    refusals=True,
)
