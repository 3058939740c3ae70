"""Studies of houses whose simulation knows the air alone."""

from typing import Any

import numpy as np

from benchmarks.named import counted, named
from benchmarks.runner import Asked, Benchmark, Case, Record, Tables, replicated

from .houses import house, measured

MASSES = {"one mass": 1, "two masses": 2}

HIDDEN = "second-mass"

UNITS = {"t": "h", "T": "degC", "outside": "degC", "heater": "K/h"}


def cases(asked: Asked) -> list[Case]:
    """Return houses of two masses, and half as many of one."""
    two = replicated("kind", ["two masses"], asked)
    one = replicated("kind", ["one mass"], asked)
    return [*two, *one[: len(two) // 2]]


def study(kind: str, replicate: int, seed: int) -> dict[str, Any]:
    """Return what the study of one house names."""
    # Imported here: these bring JAX, which the module that makes the data does without.
    from bayes_greybox.data.trajectories import Trajectories
    from bayes_greybox.greybox import GreyBox
    from benchmarks.answers import studied

    rng = np.random.default_rng([seed, replicate, MASSES[kind]])
    each = house(MASSES[kind], rng)
    record = measured(each, rng)
    inputs = {name: record[name] for name in ("outside", "heater")}
    data = Trajectories.from_arrays(record["t"], states={"T": record["T"]}, inputs=inputs, units=UNITS)
    model = GreyBox(simulation={"T": "loss*(outside - T) + heater"}, parameters={"loss": each.loss})
    found, seconds = studied(model, data, catalogue="thermal", free_runs=False)
    own = found.effects.set_index("slug").loc[HIDDEN]
    hidden = HIDDEN if each.exchange else ""
    storage = own["inner"].get("storage_time", np.nan)
    return {**named(found, seconds, hidden, each.exchange), "storage": float(storage / each.storage)}


def score(records: list[Record]) -> Tables:
    """Return a row for houses of one and of two masses; see `counted`."""
    return counted(records, "houses")


TITLE = "The second mass of a house from one thermometer; counts of houses, coverage of 90 % intervals"

TWO_MASS_HOUSES = Benchmark(
    "two-mass-houses",
    "hides the second thermal mass of a house that one thermometer and the weather are known of.",
    {"cases": None, "replicates": 40, "workers": 1, "seed": 0},
    cases,
    study,
    score,
    lambda tables: {TITLE: tables["houses"]},
    threads=1,
)
