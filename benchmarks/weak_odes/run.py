"""All draws of all systems at all noise levels.

The model that weak rows are taken near is judged (see `model.estimate.likeliest`): the likeliest set of terms of all
equations together, with the posterior of its coefficients in closed form, σ integrated out. Nothing is sampled.
"""

import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import pandas as pd
from scipy.stats import norm

from benchmarks.runner import Asked, Benchmark, Case, Record, Tables, by_group, mean, median

from .systems import NOISES, weak_systems

HALF_INTERVAL = float(norm.ppf(0.95))
"""Half a 90 % interval, in standard deviations."""


def cases(asked: Asked, names: Iterable[str] | None = None, noises: Sequence[float] = NOISES) -> list[Case]:
    """Return every draw of the chosen systems at each level of the noise."""
    return [
        Case(
            f"{name}/{noise:g}/{asked.seed}/{k}",
            (name, noise, k, asked.seed),
            {"system": name, "noise": noise, "replicate": k},
        )
        for name in names or asked.names(weak_systems(), "system")
        for noise in noises
        for k in range(asked.replicates)
    ]


def identified(name: str, noise: float, replicate: int, seed: int) -> dict[str, Any]:
    """Return terms and coefficients of one draw, and which of their intervals hold the truth."""
    # Imported here: these bring JAX, which the module that makes the data does without.
    from bayes_greybox.model.estimate.likeliest import likeliest
    from bayes_greybox.model.program import Program
    from bayes_greybox.model.rows.weak_rows import WeakRows

    system = weak_systems()[name]
    data = system.sampled(noise, replicate, seed)
    start = time.perf_counter()
    model = Program({state: system.candidates for state in system.states}, rows=WeakRows(), discrepancy=None)
    model, data = model.near(data)
    (equation,) = model.assemble(data).values()
    found = likeliest(equation)
    seconds = time.perf_counter() - start
    # The package writes terms in a way of its own.
    terms, written = equation.frame.dictionary.terms, system.candidates * len(system.states)
    texts = {term.text: text for term, text in zip(terms, written, strict=False)}
    coefficients: dict[str, dict[str, float]] = {state: {} for state in system.states}
    holds = []
    for (term, value), sd, state in zip(found.terms, found.sd, found.acts_on, strict=True):
        text = texts[term.text]
        coefficients[state][text] = value
        if text in system.truth[state]:
            holds.append(bool(abs(value - system.truth[state][text]) <= HALF_INTERVAL * sd))
    return {
        "coefficients": coefficients,
        "error": system.error(coefficients),
        "tpr": system.true_positives(coefficients),
        "holds": holds,
        "probability": next(iter(found.weighed.values())),
        "rows": equation.rows.n_white,
        "seconds": seconds,
    }


def score(records: list[Record]) -> Tables:
    """Return a row for each system and level of noise.

    Its columns are draws; refused (without an answer); exact (share with all true terms and no other); TPR (mean);
    error (median ‖ŵ − w*‖/‖w*‖ of all that were not refused), largest; published (of one draw, at 10 % noise);
    efficient (median of an efficient estimate that knows the terms); coverage (of 90 % intervals of true terms in exact
    draws), and intervals (how many); seconds (median).
    """
    known = weak_systems()

    def of_group(group: list[Record]) -> Record:
        found = [record for record in group if "refused" not in record]
        exact = [record for record in found if record["tpr"] == 1.0]
        holds = [each for record in exact for each in record["holds"]]
        errors, system, noise = [record["error"] for record in found], known[group[0]["system"]], group[0]["noise"]
        return {
            "draws": len(group),
            "refused": len(group) - len(found),
            "exact": len(exact) / len(group),
            "TPR": mean([record["tpr"] for record in found]),
            "error": median(errors),
            "largest": max(errors, default=float("nan")),
            "published": system.published if noise == NOISES[0] else float("nan"),
            "efficient": system.efficient(noise),
            "coverage": mean(holds),
            "intervals": len(holds),
            "seconds": median([record["seconds"] for record in found]),
        }

    return {"systems": by_group(records, {"system": "system", "noise": "noise"}, of_group)}


def show(tables: Tables) -> dict[str, pd.DataFrame]:
    """Return terms, errors and coverage of each system at each level of noise."""
    title = "Terms from samples of all states; relative error of the coefficients; coverage of 90 % intervals"
    columns = ["noise", "exact", "TPR", "error", "published", "efficient", "coverage"]
    return {title: tables["systems"].reset_index(level="noise").loc[:, columns]}


WEAK_ODES = Benchmark(
    "weak-odes",
    "finds the terms of differential equations from noisy samples of all states.",
    {"cases": None, "only": None, "replicates": 20, "workers": 1, "seed": 0},
    cases,
    identified,
    score,
    show,
    threads=1,
    refusals=True,
)

WEAK_COVERAGE = replace(
    WEAK_ODES,
    name="weak-coverage",
    about="counts how often the intervals of one system's coefficients hold the truth at 10 % noise.",
    options={"replicates": 200, "workers": 1, "seed": 0},
    cases=lambda asked: cases(asked, ["lotka-volterra"], NOISES[:1]),
)
