"""Tables of the confounding study: coefficients against the truth, and how well the chains moved."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from .cells import converged
from .situations import SITUATIONS

CELL = ["situation", "kernel", "measure"]


@dataclass(frozen=True)
class Confounding:
    """Scores.

    Attributes:
        terms: Indexed by (situation, kernel, measure, term): theta (true), projection (what the missing part adds to it
            by least squares under the measure), bias (mean posterior mean less theta), bias_se, sd (mean posterior
            standard deviation), coverage (share of 90 % intervals that hold theta) and coverage_projection (that hold
            theta + projection).
        cells: Indexed by (situation, kernel, measure): replicates, bias (largest |bias| over terms, in mean posterior
            standard deviations), coverage (of the term where it is farthest from 90 %), correlation (median of the
            largest |corr(θ, f-projection)|), r_hat (median of the worst), r_hat_90 (its 90 % quantile), converged
            (share that passes R̂, effective sample size and divergences), ess_per_second (median of the smallest;
            compilation left out), overlap (share of what is missing that the dictionary can copy).
    """

    terms: pd.DataFrame
    cells: pd.DataFrame


def score(rows: Iterable[Mapping[str, Any]]) -> Confounding:
    """Tables from the cells' results."""
    terms, cells = [], []
    names = {situation.name: tuple(situation.theta) for situation in SITUATIONS}
    for row in rows:
        measure = "–" if row["variant"] == "none" else row["measure"]
        key = {"situation": row["situation"], "kernel": row["variant"], "measure": measure}
        truth, added = np.array(row["theta"]), np.array(row["projected"])
        mean, sd, lower, upper = (np.array(row[name]) for name in ("mean", "sd", "lower", "upper"))
        found = pd.DataFrame(
            {
                **key,
                "term": names[row["situation"]],
                "theta": truth,
                "projection": added,
                "bias": mean.mean(axis=0) - truth,
                "bias_se": mean.std(axis=0, ddof=1) / np.sqrt(len(mean)) if len(mean) > 1 else np.nan,
                "sd": sd.mean(axis=0),
                "coverage": np.mean((lower <= truth) & (truth <= upper), axis=0),
                "coverage_projection": np.mean((lower <= truth + added) & (truth + added <= upper), axis=0),
            }
        )
        terms.append(found)
        passed = [converged(*each) for each in zip(row["r_hat"], row["ess"], row["divergences"], strict=True)]
        farthest = int(np.argmax(np.abs(found["coverage"] - 0.9)))
        cells.append(
            {
                **key,
                "replicates": len(mean),
                "bias": float(np.max(np.abs(found["bias"] / found["sd"]))),
                "coverage": float(found["coverage"].iloc[farthest]),
                "correlation": float(np.median(row["correlation"])),
                "r_hat": float(np.median(row["r_hat"])),
                "r_hat_90": float(np.quantile(row["r_hat"], 0.9)),
                "converged": float(np.mean(passed)),
                "ess_per_second": float(np.median(row["ess"])) / row["seconds"] if row["seconds"] > 0 else np.nan,
                "overlap": row["overlap"],
            }
        )
    return Confounding(pd.concat(terms).set_index([*CELL, "term"]), pd.DataFrame(cells).set_index(CELL))
