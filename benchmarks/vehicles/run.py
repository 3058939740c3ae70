"""Studies of vehicles whose simulation lacks one effect, or none."""

from typing import Any

import numpy as np

from benchmarks.named import counted, named
from benchmarks.runner import Asked, Benchmark, Case, Record, Tables, replicated

from .drives import known, lacking, measured, vehicle

KINDS = (
    *("rolling-resistance", "driveline-loss", "aerodynamic-drag", "grade", "steady-push"),
    *("input-saturation", "drive-dead-zone", "drive-lag", "nothing lacking"),
)
"""The effect that is hidden."""

UNITS = {"t": "s", "v": "m/s", "F": "N", "slope": "rad"}


def cases(asked: Asked) -> list[Case]:
    """Return vehicles of every kind."""
    return replicated("kind", list(KINDS), asked)


def study(kind: str, replicate: int, seed: int) -> dict[str, Any]:
    """Return what the study of one drive names."""
    # Imported here: these bring JAX, which the module that makes the data does without.
    from bayes_greybox.data.trajectories import Trajectories
    from bayes_greybox.greybox import GreyBox
    from benchmarks.answers import studied

    rng = np.random.default_rng([seed, replicate, KINDS.index(kind)])
    hidden = kind if kind != "nothing lacking" else ""
    each, size = lacking(vehicle(rng), hidden, rng)
    record = measured(each, rng)
    inputs = {name: record[name] for name in ("F", "slope")}
    data = Trajectories.from_arrays(record["t"], states={"v": record["v"]}, inputs=inputs, units=UNITS)
    model = GreyBox(simulation=known(each, hidden))
    about: dict[str, Any] = {"catalogue": "vehicle", "roles": {"grade": "slope"}, "free_runs": False}
    found, seconds = studied(model, data, **about)
    return named(found, seconds, hidden, size)


def score(records: list[Record]) -> Tables:
    """Return a row for each hidden effect; see `counted`."""
    return counted(records, "vehicles")


TITLE = "What the simulation of a vehicle's speed lacks; counts of vehicles, coverage of 90 % intervals"

VEHICLES = Benchmark(
    "vehicles",
    "hides resistances, slopes and the limits of a drive from the simulation of a vehicle's speed.",
    {"cases": None, "replicates": 10, "workers": 1, "seed": 0},
    cases,
    study,
    score,
    lambda tables: {TITLE: tables["vehicles"]},
    threads=1,
)
