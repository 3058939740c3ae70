"""All draws of all cells, and one table: a line of JSON for each finished draw, so that a stopped run goes on."""

import os
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.running.errors import InputError
from bayes_greybox.running.plain_values import plain_rows
from benchmarks.resumed import tabled

from .estimate import estimate
from .problems import CELLS, OdeCell

REPLICATES = 100
"""Draws of each cell."""

LOST = 0.5
"""An error above it is none of noise, but of another minimum."""


def run(
    output: str | os.PathLike[str], *, replicates: int = REPLICATES, seed: int = 0, progress: bool = True
) -> pd.DataFrame:
    """Run the benchmark, or what is left of it, and write its table.

    Args:
        output: Folder for results.jsonl, table.csv and summary.json. Draws that results.jsonl has are not run again,
            unless another version of the package ran them.
        replicates: Draws of the noise of each cell.
        seed: Seed of the draws.
        progress: Whether to show a progress bar.

    Returns:
        The rows of `table_row` by cell.

    Raises:
        InputError: A folder that cannot be written to.
    """

    def score(rows: Sequence[dict]) -> pd.DataFrame:
        draws = [rows[k * replicates : (k + 1) * replicates] for k in range(len(CELLS))]
        return pd.DataFrame([table_row(cell, own) for cell, own in zip(CELLS, draws, strict=True)]).set_index("cell")

    return tabled(
        output,
        [(cell, draw) for cell in CELLS for draw in range(replicates)],
        key=lambda case: f"{case[0].key}, seed {seed}, draw {case[1]}",
        measure=lambda case: _solved(*case, seed),
        what="Published ODEs",
        progress=progress,
        score=score,
        name="table",
        about={},
        beside=lambda table: {"table": plain_rows(table)},
        threads=1,
    )


def table_row(cell: OdeCell, rows: Sequence[dict]) -> dict[str, object]:
    """One row of the table.

    Args:
        cell: The cell.
        rows: Its draws.

    Returns:
        cell, draws; median and max error (a draw without an answer counts as infinite), how many are above `LOST`; the
        median of an efficient estimator; the published medians by method; median seconds.
    """
    errors = np.array(
        [np.inf if row["parameters"] is None else cell.error(np.array(row["parameters"])) for row in rows]
    )
    return {
        "cell": cell.key,
        "draws": len(errors),
        "median": float(np.median(errors)),
        "max": float(errors.max()),
        f"above {LOST:g}": int(np.sum(errors > LOST)),
        "efficient": cell.efficient,
        **cell.published,
        "seconds": float(np.median([row["seconds"] for row in rows])),
    }


def _solved(cell: OdeCell, draw: int, seed: int) -> dict[str, Any]:
    start = time.perf_counter()
    try:
        parameters = estimate(cell.problem, cell.samples(draw, seed)).tolist()
    except InputError:
        parameters = None
    return {"parameters": parameters, "seconds": time.perf_counter() - start}
