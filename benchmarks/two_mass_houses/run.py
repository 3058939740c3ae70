"""Studies of houses whose simulation knows the air alone."""

from typing import Any

import numpy as np

from benchmarks.runner import Asked, Benchmark, Case, Record, Tables, by_group, mean, median, replicated

from .houses import house, measured

MASSES = {"one mass": 1, "two masses": 2}

HIDDEN = "second-mass"

SURE = 0.9
"""Probability from which a name counts."""

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
    found, seconds = studied(model, data, catalogue="thermal", free_runs=False, interpolation="zoh")
    effects: Any = found.effects.set_index("slug")
    likely = [str(slug) for slug, p in effects["probability"].items() if p > SURE]
    own = effects.loc[HIDDEN]
    storage = own["inner"].get("storage_time", np.nan)
    return {
        "verdict": found.verdict,
        "probability": float(own["probability"]),
        "right": HIDDEN in likely if each.exchange else found.verdict == "no gap",
        "named": found.verdict == "named" and likely == [HIDDEN],
        "wrong": sorted(set(likely) - ({HIDDEN} if each.exchange else set())),
        "covered": bool(own["lower"] <= each.exchange <= own["upper"]) if each.exchange else None,
        "storage": float(storage / each.storage),
        "instrument": [
            f"{row['suspect']} of {row['channel']}"
            for row in found.instrument.to_dict("records")
            if row["status"] and row["probability"] > SURE
        ],
        "seconds": seconds,
    }


def score(records: list[Record]) -> Tables:
    """Return a row for houses of one and of two masses.

    Its columns are houses; right (the second mass above 0.9; of one mass: *no gap*); named (*named* with
    it alone); wrong (another effect above 0.9); covered (90 % intervals of the exchange between the masses); seconds.
    """

    def of_group(group: list[Record]) -> Record:
        return {
            "houses": len(group),
            **{key: sum(bool(record[key]) for record in group) for key in ("right", "named", "wrong")},
            "covered": mean([record["covered"] for record in group if record["covered"] is not None]),
            "seconds": median([record["seconds"] for record in group]),
        }

    return {"houses": by_group(records, {"kind": "kind"}, of_group)}


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
