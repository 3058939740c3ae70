"""Coverage of intervals of learned parameters, and names of parameters that are a tenth off."""

import time
from typing import Any

import numpy as np

from benchmarks.runner import Asked, Benchmark, Case, Record, Tables, by_group, mean, median

from .machines import LINEAR, MACHINES, RATE_NOISE, SAMPLE_NOISE, SPREAD, noisy, simulated

ROWS = ("rates", "samples")

LEARNED, OFF = ("linear", "all"), "off"
"""Fits that learn the parameters that a machine is linear in, or all; and studies of one that is off."""

ERROR = 0.1
"""Share by which a parameter is off."""

SURE = 0.9
"""Probability from which a name counts."""

SAMPLING = {"tune": 300, "draws": 500, "chains": 1, "progress": False}
"""The posterior has few dimensions: one chain's quantiles are good to a percent of probability."""


def cases(asked: Asked) -> list[Case]:
    """Return what is asked, rows, machine and repeat; each parameter is off in turn."""
    return [
        Case(f"{what}/{rows}/{name}/{asked.seed}/{k}", (what, rows, name, k, asked.seed), {"what": what, "rows": rows})
        for k in range(asked.replicates)
        for name in asked.names(MACHINES, "machine")
        for what in (*LEARNED, OFF)
        for rows in ROWS
    ]


def asked_of(what: str, rows: str, name: str, repeat: int, seed: int) -> dict[str, Any]:
    """Return which intervals hold the truth, or what a study says is off."""
    rng = np.random.default_rng([seed, repeat, *map(ord, f"{what}{rows}{name}")])
    machine = MACHINES[name]
    typical = dict(machine.typical)
    # The truth is a draw of the prior: then intervals hold it as often as they say.
    truth = {p: value * (1 + SPREAD * rng.standard_normal()) for p, value in typical.items()}
    record = simulated(machine, truth, rng)
    data = _data(machine, record, rows, rng)
    return _studied(machine, truth, data, repeat) if what == OFF else _fitted(what, name, truth, data, repeat)


def _data(machine: Any, record: dict[str, Any], rows: str, rng: np.random.Generator) -> Any:
    # Imported here, as below: these bring JAX, which the module that makes the data does without.
    from bayes_greybox.data.trajectories import Trajectories

    inputs = {"u": record["u"]}
    if rows == "rates":
        rate = {machine.learned: noisy(record["rates"][machine.learned], RATE_NOISE, rng)}
        return Trajectories.from_arrays(record["t"], states=record["states"], derivatives=rate, inputs=inputs)
    first = next(iter(record["states"]))
    shown = {first: noisy(record["states"][first], SAMPLE_NOISE, rng)}
    return Trajectories.from_arrays(record["t"], states=shown, inputs=inputs)


def _fitted(what: str, name: str, truth: dict[str, float], data: Any, repeat: int) -> dict[str, Any]:
    from bayes_greybox.greybox import GreyBox
    from bayes_greybox.physics.parameters import Parameter

    machine = MACHINES[name]
    learned = LINEAR[name] if what == "linear" else tuple(machine.typical)
    known = {p: Parameter(value) for p, value in truth.items()}
    priors = {p: Parameter(machine.typical[p], sd=SPREAD * machine.typical[p]) for p in learned}
    model = GreyBox(simulation=machine.formulas, parameters=known | priors, discrepancy=None)
    start = time.perf_counter()
    table = model.fit(data, **SAMPLING, seed=repeat).summary().loc[machine.learned]
    return {
        "holds": {p: bool(table.loc[p, "lower"] <= truth[p] <= table.loc[p, "upper"]) for p in learned},
        "error": {p: float((table.loc[p, "mean"] - truth[p]) / table.loc[p, "sd"]) for p in learned},
        "shrunk": {p: float(table.loc[p, "sd"] / (SPREAD * machine.typical[p])) for p in learned},
        "seconds": time.perf_counter() - start,
    }


def _studied(machine: Any, truth: dict[str, float], data: Any, repeat: int) -> dict[str, Any]:
    from bayes_greybox.greybox import GreyBox
    from benchmarks.answers import studied

    off = list(truth)[repeat % len(truth)]
    given = {**truth, off: truth[off] / (1 + ERROR)}
    found, seconds = studied(GreyBox(simulation=machine.formulas, parameters=given), data, free_runs=False)
    table = found.corrections.reset_index().set_index("term")
    likely = [p for p in truth if table.loc[p, "probability"] >= SURE]
    value, sd = table.loc[off, "nominal"] + table.loc[off, "mean"], table.loc[off, "sd"]
    effects = found.effects
    return {
        "off": off,
        "verdict": found.verdict,
        "probability": {p: float(table.loc[p, "probability"]) for p in truth},
        "right": found.verdict == "recalibrate" and likely == [off],
        "others": sorted(set(likely) - {off}),
        "wrong": sorted(effects[effects["probability"] > SURE]["slug"]),
        "z": float((value - truth[off]) / sd) if sd > 0 else None,
        "seconds": seconds,
    }


def score(records: list[Record]) -> Tables:
    """Return coverage by what is learned and the rows, and names by the rows.

    Columns of the first: repeats; coverage (of 90 % intervals of all parameters); intervals; spread (standard deviation
    of errors over posterior standard deviations); seconds (median). Of the second: cases; right (*recalibrate*, and
    this parameter alone above 0.9); others (another parameter above 0.9); effects (an effect above 0.9); covered (90 %
    intervals of its value); seconds.
    """

    def fits(group: list[Record]) -> Record:
        holds = [each for record in group for each in record["holds"].values()]
        errors = [each for record in group for each in record["error"].values()]
        return {
            "repeats": len(group), "coverage": mean(holds), "intervals": len(holds), "spread": float(np.std(errors)),
            "seconds": median([record["seconds"] for record in group]),
        }  # fmt: skip

    def studies(group: list[Record]) -> Record:
        z = [record["z"] for record in group if record["right"]]
        return {
            "cases": len(group), "right": sum(record["right"] for record in group),
            "others": sum(bool(record["others"]) for record in group),
            "effects": sum(bool(record["wrong"]) for record in group),
            "covered": mean([abs(each) < 1.645 for each in z]),
            "seconds": median([record["seconds"] for record in group]),
        }  # fmt: skip

    learned, off = ([r for r in records if (r["what"] == OFF) == which] for which in (False, True))
    return {
        "coverage": by_group(learned, {"what": "learned", "rows": "rows"}, fits),
        "off": by_group(off, {"rows": "rows"}, studies),
    }


TITLES = {
    "coverage": "Share of 90 % intervals of learned parameters that hold the truth",
    "off": "One parameter a tenth off: counts of studies that name it, and of wrong names",
}

NAMED_PARAMETERS = Benchmark(
    "named-parameters",
    "counts how often intervals of named parameters hold the truth, and whether one that is off is named.",
    {"cases": None, "only": None, "replicates": 30, "workers": 1, "seed": 0},
    cases,
    asked_of,
    score,
    lambda tables: {title: tables[name] for name, title in TITLES.items()},
    threads=1,
)
