"""Studies of cells whose simulation lacks one relaxation, two, or none, or has a wrong capacity."""

from typing import Any

import numpy as np

from benchmarks.answers import SURE
from benchmarks.named import counted, named
from benchmarks.runner import Asked, Benchmark, Case, Record, Tables, replicated

from .cells import CAPACITY, OPEN, SLOPE, STEP, Cell, cell, one_pulse, pulses, voltage

KINDS = {
    "one lacking": (1, 0, "relaxation"),
    "two lacking": (2, 0, "two-relaxations"),
    "one of two lacking": (2, 1, "relaxation"),
    "two lacking, one pulse": (2, 0, "two-relaxations"),
    "none lacking": (1, 1, ""),
    "none lacking, capacity off": (1, 1, ""),
    "one lacking, capacity off": (1, 0, "relaxation"),
}
"""Pairs of the cell, those that its simulation has, and the effect that is lacking."""

OFF = "capacity off"
"""Cells whose simulation has a capacity that is 3 to 15 % too small or too large."""

ONE_PULSE = "two lacking, one pulse"

INTERVAL = (0.05, 0.95)

UNITS = {"t": "s", "i": "A", "V": "V"}


def cases(asked: Asked) -> list[Case]:
    """Return cells of every kind."""
    return replicated("kind", asked.names(KINDS, "kind of cell"), asked)


def simulation(each: Cell, known: int) -> dict[str, str]:
    """Return the formulas of a cell with its first pairs, of which the slow one is known first."""
    pairs = each.pairs[::-1][:known]
    formulas = {f"v{k}": f"({r!r}*i - v{k})/{time!r}" for k, (r, time) in enumerate(pairs)}
    drop = "".join(f" - {name}" for name in formulas)
    return {"soc": "-i/(3600*Q)", **formulas, "V": f"{OPEN} + {SLOPE}*soc - R0*i{drop}"}


def study(kind: str, replicate: int, seed: int) -> dict[str, Any]:
    """Return what the study of one cell names."""
    # Imported here: these bring JAX, which the module that makes the data does without.
    from bayes_greybox.data.trajectories import Trajectories
    from bayes_greybox.greybox import GreyBox
    from benchmarks.answers import studied

    pairs, known, lacking = KINDS[kind]
    rng = np.random.default_rng([seed, replicate, list(KINDS).index(kind)])
    each = cell(pairs, rng)
    current = one_pulse() if kind == ONE_PULSE else pulses(rng)
    time = STEP * np.arange(len(current))
    data = Trajectories.from_arrays(
        time, inputs={"i": current}, outputs={"V": voltage(each, current, rng)}, units=UNITS
    )
    formulas = simulation(each, known)
    starts = {name: 1.0 if name == "soc" else 0.0 for name in formulas if name != "V"}
    off = np.exp(rng.choice([-1, 1]) * rng.uniform(0.03, 0.15)) if kind.endswith(OFF) else 1.0
    model = GreyBox(simulation=formulas, parameters={"R0": each.series, "Q": CAPACITY * off}, starts=starts)
    train, test = data.split(0.7)
    found, seconds = studied(model, train, test=test, catalogue="battery")
    record = {**named(found, seconds, lacking), **_times(found, each, known)}
    if kind.endswith(OFF):
        record |= _capacity(found, record, CAPACITY * (1 - off))
    return {**record, "left": float(found.gap.loc[("test", "unexplained share", "V"), "after"])}


def _capacity(found: Any, record: Record, change: float) -> Record:
    """Return whether the capacity is found off beside what is lacking, and whether its 90 % interval holds."""
    rows = found.corrections.reset_index().to_dict("records")
    likely = {row["term"]: row for row in rows if row["probability"] > SURE}
    own, right = likely.get("Q"), list(likely) == ["Q"]
    return {
        "right": right and (record["right"] or found.verdict == "recalibrate"),
        "named": right and (record["named"] or found.verdict == "recalibrate"),
        "holds": own and bool(own["lower"] <= change <= own["upper"]),
    }


def _times(found: Any, each: Cell, known: int) -> dict[str, Any]:
    """Return whether the 90 % interval of the first relaxation time holds, and its mean over the true one."""
    amendment = found.amendments["V"]
    columns = amendment.statistics.columns
    drawn = [columns[int(k)].inner for k in np.ravel(amendment.after.inner)]
    times = np.array([next(iter(inner.values())) for inner in drawn if inner])
    lacking = each.pairs[: len(each.pairs) - known]
    if not lacking or not len(times):
        return {"holds": None, "time": None}
    low, high = np.quantile(times, INTERVAL)
    return {"holds": bool(low <= lacking[0][1] <= high), "time": float(np.mean(times) / lacking[0][1])}


def score(records: list[Record]) -> Tables:
    """Return a row for each kind of cell; see `counted`.

    Intervals are those of its time, the faster one of two, or of a capacity that is off.
    """
    return counted(records, "cells")


TITLE = "The relaxation that a cell's simulation lacks; counts of cells, coverage of 90 % intervals of its time"

BATTERIES = Benchmark(
    "batteries",
    "hides the relaxations of a cell from the simulation of its voltage under pulses of current.",
    {"cases": None, "only": None, "replicates": 40, "workers": 1, "seed": 0},
    cases,
    study,
    score,
    lambda tables: {TITLE: tables["cells"]},
    threads=1,
)
