"""Studies of substances whose simulation knows elimination in proportion alone."""

from typing import Any

import numpy as np

from benchmarks.named import counted, named
from benchmarks.runner import Asked, Benchmark, Case, Record, Tables, replicated

from .substances import few_samples, measured, substance

KINDS = {
    "second compartment": "second-compartment",
    "saturable elimination": "saturable-elimination",
    "absorption": "absorption",
    "nothing lacking": "",
    "second compartment, 11 samples": "second-compartment",
    "nothing lacking, 11 samples": "",
}
"""The effect that is hidden, by the kind of substance."""

FEW = "11 samples"

UNITS = {"t": "h", "c": "mg/l", "u": "mg/(l*h)"}


def cases(asked: Asked) -> list[Case]:
    """Return substances of every kind."""
    return replicated("kind", asked.names(KINDS, "kind of substance"), asked)


def study(kind: str, replicate: int, seed: int) -> dict[str, Any]:
    """Return what the study of one substance names."""
    # Imported here: these bring JAX, which the module that makes the data does without.
    from bayes_greybox.data.trajectories import Trajectories
    from bayes_greybox.greybox import GreyBox
    from benchmarks.answers import studied

    rng = np.random.default_rng([seed, replicate, list(KINDS).index(kind)])
    each = substance(KINDS[kind], rng)
    few = kind.endswith(FEW)
    record = few_samples(each, rng) if few else measured(each, rng)
    inputs = {} if few else {"u": record["u"]}
    units = {name: unit for name, unit in UNITS.items() if name in record}
    data = Trajectories.from_arrays(record["t"], states={"c": record["c"]}, inputs=inputs, units=units)
    model = GreyBox(simulation={"c": "-k*c" if few else "u - k*c"}, parameters={"k": each.k})
    found, seconds = studied(model, data, catalogue="compartment", free_runs=False)
    return named(found, seconds, KINDS[kind], each.sizes.get(KINDS[kind]))


def score(records: list[Record]) -> Tables:
    """Return a row for each kind of substance; see `counted`."""
    return counted(records, "substances")


TITLE = "What the simulation of a concentration lacks; counts of substances, coverage of 90 % intervals"

COMPARTMENTS = Benchmark(
    "compartments",
    "hides a second compartment, saturable elimination or a depot from the simulation of a concentration.",
    {"cases": None, "only": None, "replicates": 20, "workers": 1, "seed": 0},
    cases,
    study,
    score,
    lambda tables: {TITLE: tables["substances"]},
    threads=1,
)
