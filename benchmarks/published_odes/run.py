"""Parameters of the problems from samples: coefficients of terms first, then the parameters behind them.

Every parameter enters by coefficients θ = c(p) that are linear in the rates. Where there are more coefficients than
parameters, as for FitzHugh and Nagumo's, p̂ is that of least squares on the whitened rows y = Φ c(p) + ε near the model
with c(p̂), again and again until it stays: the estimate of the whole equations with p alone free. Nothing starts at a
guess of the parameters: the path is a spline through the samples at first, and all coefficients are zero. The estimate
knows, as the published methods do, that both sensors have the same noise, but not how large it is.
"""

import time
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.running.errors import InputError
from benchmarks.runner import Asked, Benchmark, Case, Record, Tables, by_group, median

from .problems import CELLS, LARGEST_PARAMETER, OdeCell, Problem

MOST_RELINEARISATIONS = 20
"""Most rounds of rows taken anew near the parameters."""

STAYS = 1e-4
"""Change of the parameters, over their size, at which they stay."""

OTHER_MINIMUM = 0.5
"""An error above it does not come from noise, but from another minimum."""

_BY_KEY = {cell.key: cell for cell in CELLS}


def cases(asked: Asked) -> list[Case]:
    """Return the draws of all cells."""
    return [
        Case(f"{key}, seed {asked.seed}, draw {draw}", (key, draw, asked.seed))
        for key in _BY_KEY
        for draw in range(asked.replicates)
    ]


def solved(key: str, draw: int, seed: int) -> dict[str, Any]:
    """Return the parameters of one draw, None where the package refuses it, and the seconds."""
    cell, start = _BY_KEY[key], time.perf_counter()
    try:
        parameters = estimate(cell.problem, cell.samples(draw, seed)).tolist()
    except InputError:
        parameters = None
    return {"parameters": parameters, "seconds": time.perf_counter() - start}


def estimate(problem: Problem, data: Trajectories) -> Float[np.ndarray, " n_parameter"]:
    """Estimate parameters between zero and `LARGEST_PARAMETER`; the true ones and the starts are not used.

    Raises:
        InputError: Coefficients do not settle.
    """
    # Imported here: these bring JAX, which the module that makes the data does without.
    from bayes_greybox.model.program import Program
    from bayes_greybox.model.rows.trajectory_rows import TrajectoryRows

    model, _ = Program(problem.dictionary, rows=TrajectoryRows(same_noise=True), discrepancy=None).near(data)
    (equation,) = model.assemble(data).values()
    terms = [term for term, _ in equation.ridge()]
    first = problem.inverse(np.array([value for _, value in equation.ridge()]))
    # Off the edges of the bounds.
    found = np.clip(first, 1e-3, LARGEST_PARAMETER - 1e-3)
    rows = equation
    for _ in range(MOST_RELINEARISATIONS):
        before = found
        Phi, y = np.asarray(rows.design.Phi) / rows.frame.coefficient_scale, np.asarray(rows.design.y)

        def residual(p: np.ndarray, Phi: np.ndarray = Phi, y: np.ndarray = y) -> np.ndarray:
            return Phi @ problem.coefficients(p) - y

        scale = np.maximum(before, 0.1)
        found = least_squares(residual, before, bounds=(0.0, LARGEST_PARAMETER), x_scale=scale).x
        if np.linalg.norm(found - before) <= STAYS * np.linalg.norm(before):
            break
        # Where coefficients are free they may be far from any parameters': the next rows are near the latter.
        pairs = list(zip(terms, problem.coefficients(found).tolist(), strict=True))
        near = replace(model, rows=model.rows.around(pairs, equation.frame.dictionary.acts_on))
        (rows,) = near.assemble(data).values()
    return found


def score(records: list[Record]) -> Tables:
    """Return a row for each cell; see `table_row`."""
    labelled = [{**record, "cell": record["key"].split(", seed")[0]} for record in records]
    return {"table": by_group(labelled, {"cell": "cell"}, lambda group: table_row(_BY_KEY[group[0]["cell"]], group))}


def table_row(cell: OdeCell, records: list[Record]) -> dict[str, object]:
    """Return the row of a cell.

    It has draws; median and max error (a draw without an answer counts as infinite), how many are above
    `OTHER_MINIMUM`; the median of an efficient estimator; the published medians by method; median seconds.
    """
    found = [record["parameters"] for record in records]
    errors = np.array([np.inf if parameters is None else cell.error(np.array(parameters)) for parameters in found])
    return {
        "draws": len(errors),
        "median": median(errors),
        "max": float(errors.max()),
        f"above {OTHER_MINIMUM:g}": int(np.sum(errors > OTHER_MINIMUM)),
        "efficient": cell.efficient,
        **cell.published,
        "seconds": median([record["seconds"] for record in records]),
    }


TITLE = "Relative error of the parameters; median of an efficient estimator, and published medians"

PUBLISHED_ODES = Benchmark(
    "published-odes",
    "finds parameters of differential equations from noisy samples, beside published results.",
    {"replicates": 100, "workers": 1, "seed": 0},
    cases,
    solved,
    score,
    lambda tables: {TITLE: tables["table"]},
    threads=1,
)
