"""The gap before and after: how far the simulation, and the amended model, are from the measurements."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from bayes_greybox.data.samples.clipping import seen_samples
from bayes_greybox.data.samples.sample_noise import MEDIAN_SQUARED_NORMAL, sample_noise
from bayes_greybox.data.samples.starts import Starts
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.answer.amendment import Amendment
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.equation_rows import EquationRows, Evaluate, Jumps

from .denials import MISFIT, NAMED
from .free_runs import LEVEL, FreePath, FreeRuns, over

RATE_DRAWS = 200
"""Posterior draws behind the intervals of rates."""

NO_SHARES = ("time to failure", MISFIT)
"""Metrics whose fall is no share of the gap."""

FORCED = 2.0
"""An unknown force may leave so many times as much of one record as of another, which it moves for longer."""


def gap_rows(
    model: Program,
    amendments: Mapping[str, Amendment],
    data: Trajectories,
    part: str,
    free_runs: FreeRuns | None = None,
    *,
    starts: Starts | None = None,
    seed: int = 0,
) -> tuple[pd.DataFrame, dict[str, FreePath]]:
    """The gap table's rows for one data set, and its free runs.

    Metrics: derivative NMSE, mean((ẋ − x̂̇)²)/var(ẋ), or output NMSE, the same of an output, or sample NMSE, that of the
    samples that rows are of; unexplained share, (mean((ẋ − x̂̇)²) − σ²)/mean(ẋ²), not below zero, and where the model
    after holds f beside what has a name the same without f; misfit of samples of
    one sensor, (median((y − ŷ)²)/0.455/(σ² + var ŷ))^½, σ not below what the samples themselves show, `FORCED` times as
    large beside an unknown force, and var ŷ that of the draws; free-run NRMSE,
    RMS(x − x̂)/SD(x) up to the first failure of either; time to failure of runs that blow up, NaN where a model never
    does. What is over a measurement at rest is NaN. The figures are those of the mean over draws, the intervals those
    of the draws.

    Args:
        model: The model before.
        amendments: By equation.
        data: Measurements to compare with.
        part: "train" or "test".
        free_runs: Integrates free runs; without it there are none.
        starts: State of each run at its first row, of which each draw has its own; estimated from the data by default.
        seed: Seed of these draws.
    """
    rows = []
    for equation, amendment in amendments.items():
        if equation not in data.derivatives:
            continue
        # Rows that are linear only near a model are near the one that they are compared with, before and after.
        own = replace(model, rows=model.rows.around(amendment.terms_before()))
        raw, corrected = own.equation_rows(data, equation), amendment.corrected(data)
        near = amendment.model(model)
        measured = near.equation_rows(corrected, equation)
        size = float(np.mean(measured.measured**2)) * measured.gain**2
        # Before, nothing was known of the sensors either. A filtered rate is compared with the filter's mean of what
        # was added.
        before = _on_rows(raw, amendment, lambda at, own=amendment: own.rates_before(at)[:, None], 1)[:, 0]
        after = _on_rows(measured, amendment, lambda at, own=amendment: own.rates(at, RATE_DRAWS)[1].T, RATE_DRAWS).T
        # In the unit of the sensor: rows near another model are over another gain.
        variance = float(np.var(measured.measured)) * measured.gain**2
        noise = (amendment.sigma * amendment.gain) ** 2
        allowed = max(noise, _own_noise(data)) * (FORCED**2 if amendment.forced else 1.0)
        allowed += measured.gain**2 * float(np.mean(np.var(after, axis=0)))

        def squares(added: np.ndarray, rows=measured) -> np.ndarray:
            # [n_row] or [n_draw, n_row]; where a path started is nobody's error.
            left = rows.noise.without_starts(np.atleast_2d(rows.target - added).T).T
            return (rows.gain * left).reshape(np.shape(added)) ** 2

        def nmse(left: np.ndarray, variance=variance) -> Any:
            return over(np.mean(left, axis=-1), variance)

        def share(left: np.ndarray, size=size, noise=noise) -> Any:
            return over(np.maximum(np.mean(left, axis=-1) - noise, 0.0), size)

        def misfit(left: np.ndarray, allowed=allowed) -> Any:
            # Single samples that are far off say nothing of the others.
            return np.sqrt(over(np.median(left, axis=-1) / MEDIAN_SQUARED_NORMAL, allowed))

        of = measured.measurement
        metrics: dict[str, Callable] = {f"{of} NMSE": nmse, "unexplained share": share}
        if data.samples is not None and len(data.samples.state_names) == 1:
            metrics[MISFIT] = misfit
        first, each, mean = squares(before, raw), squares(after), squares(after.mean(axis=0))
        for metric, f in metrics.items():
            low, high = np.quantile(f(each), [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
            rows.append((part, metric, equation, float(f(first)), float(f(mean)), low, high))
        if amendment.discrepancy is not None and any(each.after.inner.size for each in amendments.values()):
            # f takes up whatever is left: what the names are worth is theirs alone.
            alone = replace(amendment, discrepancy=None)
            after = _on_rows(measured, alone, lambda at, own=alone: own.rates(at, RATE_DRAWS)[1].T, RATE_DRAWS).T
            low, high = np.quantile(share(squares(after)), [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
            left = float(share(squares(after.mean(axis=0))))
            rows.append((part, NAMED, equation, float(share(first)), left, low, high))
    paths: dict[str, FreePath] = {}
    if free_runs is not None:
        paths, more = free_runs(data, part, starts, seed)
        rows += more
    table = pd.DataFrame(rows, columns=["data", "metric", "variable", "before", "after", "lower", "upper"])
    ratio = table["after"] / table["before"].where(table["before"] > 0)
    table["closed"] = (1 - ratio).where(~table["metric"].isin(NO_SHARES))
    return table.set_index(["data", "metric", "variable"]), paths


def _own_noise(data: Trajectories) -> float:
    """Variance of the white noise that samples of one sensor show by themselves; 0 for several, or for rates."""
    samples = data.samples
    if samples is None or len(samples.state_names) > 1:
        return 0.0
    shown = replace(samples, noise={}).keep(seen_samples(samples))
    return float(sample_noise(shown.time, shown.matrix(shown.state_names), shown.run_lengths)[0]) ** 2


def _on_rows(rows: EquationRows, amendment: Amendment, evaluate: Evaluate, k: int) -> Float[np.ndarray, "n_row k"]:
    """What the filter, or the path, makes of what was added: where a term of it jumps, all of it does."""
    jumps, columns = None, amendment.jumping
    if columns:
        jumps = Jumps(range(k), evaluate, lambda at: amendment.statistics.evaluate(columns, at))
    return rows.operate(rows.at_samples(evaluate, jumps))
