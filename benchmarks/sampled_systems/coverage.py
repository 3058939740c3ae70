"""Coverage of 90 % intervals of coefficients: fits on samples of a position, and on rates made from them.

Three oscillators of `systems`, whose sensor has white or correlated noise, or which random pushes shake. All three
coefficients of the acceleration are learned. Rows of samples are fitted with the noise that the cell has, and refined
on the exact trajectory posterior, which knows no random pushes; rows of rates on velocity and acceleration from the
package's differentiator. The efficient estimate on the same samples is beside them.
"""

import time
from typing import Any

import numpy as np
from scipy.stats import norm

from benchmarks.runner import Asked, Benchmark, Case, Record, Tables, by_group, median

from .efficient import efficient_estimate
from .samples import sampled
from .systems import systems

NOISE_MODELS = {"white": {}, "correlated": {"correlation": "fit"}, "shaken": {"force": "fit"}}
"""Noise model of rows of samples, by the oscillator's name."""

ROW_KINDS = ("samples", "refined", "rates", "efficient")
"""Kinds of rows of the package, and the efficient estimate, which says how lucky the draws of the noise are."""

TRUTH = {"y": -2.0, "v": -0.15, "y**3": -0.3}
"""Coefficients of the acceleration, beside the force."""

SAMPLING = {"tune": 300, "draws": 500, "chains": 1, "progress": False}
"""The posterior has few dimensions: one chain's quantiles are good to a percent of probability."""


def cases(asked: Asked) -> list[Case]:
    """Return noise, kind of rows and repeat; nothing is refined where pushes move the path."""
    pairs = [(noise, kind) for noise in NOISE_MODELS for kind in ROW_KINDS if (noise, kind) != ("shaken", "refined")]
    return [
        Case(f"{noise}/{kind}/{asked.seed}/{k}", (noise, kind, k, asked.seed), {"noise": noise, "rows": kind})
        for k in range(asked.replicates)
        for noise, kind in pairs
    ]


def fitted(noise: str, kind: str, repeat: int, seed: int) -> dict[str, Any]:
    """Return which intervals of one repeat hold the truth, and how wide they are."""
    # Imported here: these bring JAX, which the module that makes the data does without.
    from bayes_greybox.greybox import GreyBox
    from bayes_greybox.model.noise.asked import Noise
    from bayes_greybox.model.rows.trajectory_rows import TrajectoryRows

    name = f"oscillator-{noise}"
    data, _ = sampled(systems()[name], repeat, seed)
    if kind == "efficient":
        error, sd = efficient_estimate(name, TRUTH, data.states["y"])
        half = float(norm.ppf(0.95)) * sd
        return {
            "holds": {k: bool(abs(e) <= h) for k, e, h in zip(TRUTH, error, half, strict=True)},
            "error": dict(zip(TRUTH, map(float, error), strict=True)),
            "sd": dict(zip(TRUTH, map(float, sd), strict=True)),
            "seconds": 0.0,
        }
    settings: dict[str, Any] = {"rows": TrajectoryRows(), "noise": Noise(**NOISE_MODELS[noise])}
    if kind == "rates":
        data, settings = data.differentiate(rates={"y": "v"}), {}
    model = GreyBox({"v": list(TRUTH)}, simulation={"y": "v", "v": "F"}, discrepancy=None, **settings)
    start = time.perf_counter()
    fit = model.fit(data, **SAMPLING, seed=repeat)
    if kind == "refined":
        fit = fit.refine(**SAMPLING, seed=repeat)
    table = fit.summary().loc["v"]
    return {
        "holds": {k: bool(table.loc[k, "lower"] <= b <= table.loc[k, "upper"]) for k, b in TRUTH.items()},
        "error": {k: float(table.loc[k, "mean"] - b) for k, b in TRUTH.items()},
        "sd": {k: float(table.loc[k, "sd"]) for k in TRUTH},
        "seconds": time.perf_counter() - start,
    }


def score(records: list[Record]) -> Tables:
    """Return a row for each noise and kind of rows.

    Its columns are repeats; refused (fits without an answer); coverage of each coefficient; bias (the largest mean
    error of a coefficient over its mean standard deviation); sd (of the last coefficient, median); seconds (median).
    """

    def of_group(group: list[Record]) -> Record:
        found = [record for record in group if "refused" not in record]
        counts = {"repeats": len(group), "refused": len(group) - len(found)}
        if not found:
            return counts
        error, sd, holds = (
            np.array([[record[key][k] for k in TRUTH] for record in found]) for key in ("error", "sd", "holds")
        )
        return {
            **counts,
            **dict(zip(TRUTH, map(float, holds.mean(axis=0)), strict=True)),
            "bias": float(np.max(np.abs(error.mean(axis=0) / sd.mean(axis=0)))),
            "sd": median(sd[:, -1]),
            "seconds": median([record["seconds"] for record in found]),
        }

    # Rows of one noise stand together.
    order = list(NOISE_MODELS)
    ordered = sorted(records, key=lambda record: order.index(record["noise"]))
    return {"coverage": by_group(ordered, {"noise": "noise", "rows": "rows"}, of_group)}


TITLE = "Share of 90 % intervals that hold the truth, of each coefficient; bias in SDs; SD of the last"

SAMPLED_COVERAGE = Benchmark(
    "sampled-coverage",
    "counts how often intervals of coefficients hold the truth in samples.",
    {"replicates": 200, "workers": 1, "seed": 0},
    cases,
    fitted,
    score,
    lambda tables: {TITLE: tables["coverage"]},
    threads=1,
    refusals=True,
)
