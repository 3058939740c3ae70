"""How often 90 % intervals of coefficients hold the truth: fits on samples of a position, and on rates made from them.

Three oscillators of `systems`, whose sensor has white or correlated noise, or which random pushes shake. All three
coefficients of the acceleration are learned. Rows of samples are fitted with the noise that the cell has, and refined
on the exact trajectory posterior, which knows no random pushes; rows of rates on velocity and acceleration from the
package's differentiator. The efficient estimate on the same samples is beside them.
"""

import os
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import norm

from bayes_greybox.running.errors import InputError
from benchmarks.resumed import tabled

from .efficient import efficient_estimate
from .samples import sampled
from .systems import systems

REPEATS = 200
"""Of each cell, by default."""

NOISES = {"white": {}, "correlated": {"correlation": "fit"}, "shaken": {"force": "fit"}}
"""What the noise of rows of samples may be, by the oscillator's name."""

ROWS = ("samples", "refined", "rates", "efficient")
"""Of the package, and the efficient estimate, which says how lucky the draws of the noise are."""

TRUTH = {"y": -2.0, "v": -0.15, "y**3": -0.3}
"""Coefficients of the acceleration, beside the force."""

NORMAL = float(norm.ppf(0.95))
"""Half a 90 % interval, in standard deviations."""

SAMPLING = {"tune": 300, "draws": 500, "chains": 1, "progress": False}
"""The posterior has few dimensions: one chain's quantiles are good to a percent of probability."""


def run(
    output: str | os.PathLike[str], *, repeats: int = REPEATS, seed: int = 1, progress: bool = True
) -> pd.DataFrame:
    """Fit every repeat, or those that are left, and write the table.

    Args:
        output: Folder for results.jsonl, and for coverage.csv and summary.json.
        repeats: Of each cell.
        seed: Of the noise.
        progress: Whether to show a progress bar.

    Returns:
        The table of `score`.

    Raises:
        InputError: A folder that cannot be written to.
    """
    return tabled(
        output,
        _cells(repeats),
        key=lambda cell: f"{cell[0]}/{cell[1]}/{seed}/{cell[2]}",
        measure=lambda cell: fitted(*cell, seed),
        what="Coverage",
        progress=progress,
        score=score,
        name="coverage",
        about={"repeats": repeats, "seed": seed},
        threads=1,
    )


def _cells(repeats: int) -> list[tuple[str, str, int]]:
    """Noise, rows and repeat; nothing is refined where pushes move the path."""
    pairs = [(noise, kind) for noise in NOISES for kind in ROWS if (noise, kind) != ("shaken", "refined")]
    return [(*pair, k) for k in range(repeats) for pair in pairs]


def fitted(noise: str, kind: str, repeat: int, seed: int) -> dict[str, Any]:
    """One repeat: which intervals hold the truth, and how wide they are.

    Args:
        noise: One of `NOISES`.
        kind: One of `ROWS`.
        repeat: Of the noise.
        seed: Of all noise.
    """
    # Imported here: these bring JAX, which the module that makes the data does without.
    from bayes_greybox.greybox import GreyBox
    from bayes_greybox.model.noise.asked import Noise
    from bayes_greybox.model.rows.trajectory_rows import TrajectoryRows

    name = f"oscillator-{noise}"
    data, _ = sampled(systems()[name], repeat, seed)
    if kind == "efficient":
        error, sd = efficient_estimate(name, TRUTH, data.states["y"])
        return {
            "noise": noise,
            "rows": kind,
            "holds": {k: bool(abs(e) <= NORMAL * s) for k, e, s in zip(TRUTH, error, sd, strict=True)},
            "error": dict(zip(TRUTH, map(float, error), strict=True)),
            "sd": dict(zip(TRUTH, map(float, sd), strict=True)),
            "seconds": 0.0,
        }
    given: dict[str, Any] = {"rows": TrajectoryRows(), "noise": Noise(**NOISES[noise])}
    if kind == "rates":
        data, given = data.differentiate(rates={"y": "v"}), {}
    model = GreyBox({"v": list(TRUTH)}, simulation={"y": "v", "v": "F"}, discrepancy=None, **given)
    start = time.perf_counter()
    try:
        fit = model.fit(data, **SAMPLING, seed=repeat)
        if kind == "refined":
            fit = fit.refine(**SAMPLING, seed=repeat)
        table = fit.summary().loc["v"]
    except InputError as error:
        return {"noise": noise, "rows": kind, "refused": str(error)}
    return {
        "noise": noise,
        "rows": kind,
        "holds": {k: bool(table.loc[k, "lower"] <= b <= table.loc[k, "upper"]) for k, b in TRUTH.items()},
        "error": {k: float(table.loc[k, "mean"] - b) for k, b in TRUTH.items()},
        "sd": {k: float(table.loc[k, "sd"]) for k in TRUTH},
        "seconds": time.perf_counter() - start,
    }


def score(rows: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """One row for each noise and kind of rows.

    Args:
        rows: Of `fitted`.

    Returns:
        repeats; refused (fits without an answer); coverage of each coefficient; bias (the largest mean error of a
        coefficient over its mean standard deviation); sd (of the last coefficient, median); seconds (median).
    """
    table = {}
    for noise in dict.fromkeys(row["noise"] for row in rows):
        for kind in dict.fromkeys(row["rows"] for row in rows):
            own = [row for row in rows if (row["noise"], row["rows"]) == (noise, kind)]
            if not own:
                continue
            found = [row for row in own if "refused" not in row]
            table[noise, kind] = {"repeats": len(own), "refused": len(own) - len(found), **_measured(found)}
    return pd.DataFrame.from_dict(table, orient="index").rename_axis(["noise", "rows"])


def _measured(rows: Sequence[dict[str, Any]]) -> dict[str, float]:
    if not rows:
        return {}
    error, sd, holds = (np.array([[row[key][k] for k in TRUTH] for row in rows]) for key in ("error", "sd", "holds"))
    return {
        **dict(zip(TRUTH, map(float, holds.mean(axis=0)), strict=True)),
        "bias": float(np.max(np.abs(error.mean(axis=0) / sd.mean(axis=0)))),
        "sd": float(np.median(sd[:, -1])),
        "seconds": float(np.median([row["seconds"] for row in rows])),
    }
