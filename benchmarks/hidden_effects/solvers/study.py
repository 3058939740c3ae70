"""The study on a case, boiled down to the scored values."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool

from bayes_greybox.running.plain_values import plain_rows
from benchmarks.answers import studied
from benchmarks.hidden_effects.assumptions.case import AssumptionCase
from benchmarks.hidden_effects.generate import CaseData
from benchmarks.hidden_effects.systems.hidden import CATALOGUE

Solve = Callable[[CaseData], dict[str, Any]]
"""Solves a case without looking at its truth.

The result has "verdict"; "effects", a list of records, best first, each with slug, probability, mean, sd, lower and
upper (90 % interval of the coefficient), status ("added" or "") and tied_with (slugs); and, where the solver can tell,
"closed" (share of the held-out gap closed, by metric), "overlap" and "seconds"; "closable" where the true model
closes another share than `CaseData.closable`, because the solver did not see the rates. Cases of broken assumptions
also read "elsewhere" (records of effects of other equations, with the equation), "instrument" (rows of
`study.instrument`), "free_run" ("before" and "after" on the test data by state, None where it blew up) and "sentence".
All are plain values.
"""

ONE_STEP = ("derivative NMSE", "sample NMSE")
"""Metrics of the gap in the measured rates or samples. A study has one of them."""

LISTED = 8
"""Effects that are not added are recorded up to this place."""

CERTAIN = 0.9
"""Above this probability an effect is as good as named."""


def study_case(data: CaseData, free_runs: bool | None = None, seed: int = 0) -> dict[str, Any]:
    """Run `find_missing_effects` as a user would, without NUTS, and record the answer.

    Args:
        data: Data of the case.
        free_runs: If true, the gap is also measured in free runs, which takes most of the time; by default in cases of
            broken assumptions only, where derivatives alone cannot be trusted.
        seed: Seed of the study.
    """
    # Imported here: it brings JAX, which the modules that make the data do without.
    from bayes_greybox.greybox import GreyBox

    model = GreyBox(simulation=dict(data.simulation), dictionary={data.equation: []})
    about: dict[str, Any] = {"test": data.test, "catalogue": data.host.domain, "roles": all_roles(data), "seed": seed}
    free_runs = isinstance(data.case, AssumptionCase) if free_runs is None else free_runs
    study, seconds = studied(model, data.train, free_runs=free_runs, **about)
    return {**record(study, data), "seconds": seconds}


def all_roles(data: CaseData) -> dict[str, str | tuple[str, ...]]:
    """Return the column of each role, and none for roles that the host does not have: nothing is left to guess."""
    needed = {role for effect in CATALOGUE[data.host.domain].values() for role in effect.roles}
    return {role: data.host.roles.get(role, ()) for role in sorted(needed)}


def record(study: Any, data: CaseData) -> dict[str, Any]:
    """Return the scored values of a study; the truth of the case is used for the overlap only."""
    here = study.effects["equation"] == data.equation
    entries = _entries(study.effects[here])
    others = [
        {"equation": equation, **entry}
        for equation, entry in zip(study.effects["equation"][~here], _entries(study.effects[~here]), strict=True)
        if entry["status"] or (entry["probability"] or 0.0) > CERTAIN
    ]
    instrument = getattr(study, "instrument", None)
    kept = [entry for i, entry in enumerate(entries) if entry["status"] or i < LISTED]
    probabilities = study.hypotheses.loc[data.equation]["probability"]
    return {
        "verdict": study.verdict,
        "effects": kept,
        "ties": [list(tie["slugs"]) for tie in study.ties if tie["equation"] == data.equation],
        "hypotheses": {
            name: _number(probabilities[name])
            for name in ("no gap", "recalibrate", "recalibration", "unknown")
            if name in probabilities.index
        },
        "closed": _closed(study.gap),
        "overlap": _overlap(study, data),
        "elsewhere": others,
        "instrument": None if instrument is None else plain_rows(instrument.reset_index(drop=True)),
        "free_run": _free_run(study.gap),
        "sentence": getattr(study, "sentence", None),
    }


def overlap(found: Bool[np.ndarray, " n_obs"], true: Bool[np.ndarray, " n_obs"]) -> dict[str, float | None]:
    """Return how the rows that a study points at overlap with those where the true gap exceeds the noise.

    Args:
        found: Rows where the study has P(|gap| > threshold) > 1/2.
        true: Rows where the true gap exceeds one noise standard deviation.

    Returns:
        Intersection over union, None where neither has a row; and the shares of rows found and true.
    """
    union = int(np.sum(found | true))
    return {
        "iou": float(np.sum(found & true) / union) if union else None,
        "found": float(np.mean(found)),
        "true": float(np.mean(true)),
    }


def _entries(effects: pd.DataFrame) -> list[dict[str, Any]]:
    numbers = ("probability", "mean", "sd", "lower", "upper")
    return [
        {
            "slug": row["slug"],
            **{name: _number(row[name]) for name in numbers},
            "tied_with": list(row["tied_with"]),
            "status": row["status"],
        }
        for row in effects.to_dict("records")
    ]


def _overlap(study: Any, data: CaseData) -> dict[str, float | None]:
    """Return the overlap of the study's rows and the true ones; nothing where it looked at other rows."""
    found, true = study.traces[data.equation].probability > 0.5, np.abs(data.gap()) > data.sigma
    return overlap(found, true) if len(found) == len(true) else {"iou": None, "found": None, "true": None}


def _free_run(gap: pd.DataFrame) -> dict[str, dict[str, float | None]]:
    """Return the NRMSE of free runs over the held-out data before and after, by state; None for a run that blew up."""
    if ("test", "free-run NRMSE") not in gap.index.droplevel("variable"):
        return {}
    rows = gap.xs(("test", "free-run NRMSE"), level=("data", "metric"))
    return {
        str(state): {"before": _number(row["before"]), "after": _number(row["after"])} for state, row in rows.iterrows()
    }


def _closed(gap: Any) -> dict[str, float | None]:
    """Return the share of the held-out gap that is closed, by metric; over all states in free runs."""
    closed: dict[str, float | None] = {}
    for metric in (*ONE_STEP, "free-run NRMSE"):
        if ("test", metric) not in gap.index.droplevel("variable"):
            continue
        rows = gap.xs(("test", metric), level=("data", "metric"))
        before = float(rows["before"].sum())
        closed[metric] = _number(1.0 - float(rows["after"].sum()) / before) if before > 0 else None
    return closed


def _number(value: Any) -> float | None:
    """Return a plain number; None for one that JSON cannot hold."""
    return float(value) if np.isfinite(value) else None
