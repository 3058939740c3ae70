"""The gap table: errors of the simulation, and of the extended model, against the measurements."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from bayes_greybox.data.samples.clipping import seen_samples
from bayes_greybox.data.samples.sample_noise import MEDIAN_SQUARED_NORMAL, sample_noise
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.decision.criteria import CRITERIA, Criteria
from bayes_greybox.discovery.decision.vetoes import FAILURE, MISFIT, NAMES_ALONE
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.equation_rows import EquationRows, Evaluate, Jumps

from .amendment import Amendment
from .free_runs import FreePath, FreeRuns, relative
from .interval import INTERVAL_ENDS

RATE_DRAWS = 200
"""Posterior draws behind the intervals of rates."""

SHARE, NMSES = "unexplained share", ("derivative NMSE", "output NMSE", "sample NMSE")
"""Metrics: share of the measurement that neither model nor noise explains, and mean square error over its variance."""

NO_SHARES = (FAILURE, MISFIT)
"""Metrics whose fall is no share of the gap."""

Squares = Float[np.ndarray, "*n_draw n_row"]
Metrics = dict[str, Callable[[Squares], Any]]


def gap_rows(
    model: Program,
    amendments: Mapping[str, Amendment],
    data: Trajectories,
    part: str,
    free_runs: FreeRuns | None = None,
    criteria: Criteria = CRITERIA,
) -> tuple[pd.DataFrame, dict[str, FreePath]]:
    """Return the gap table's rows for one data set, and its free runs.

    The metrics, with y the measured rates, outputs or samples that rows are of, ŷ the model's, and σ the noise:

        derivative, output or sample NMSE    mean((y − ŷ)²)/var(y)
        unexplained share                    max(mean((y − ŷ)²) − σ², 0)/mean(y²), of an output over var(y)
        the same, names alone                beside f in the extended model, without f
        misfit of samples                    (median((y − ŷ)²)/0.455/(σ² + var ŷ))^½, of one sensor
        free-run NRMSE                       RMS(x − x̂)/SD(x) up to the first failure of either model
        time to failure                      of free runs that blow up, NaN of a model that never does

    A metric over a measurement at rest is NaN. In the misfit σ is at least what the samples themselves show, and
    `Criteria.forced` times as large beside a latent force; var ŷ is that of the draws. The figures are those of the
    mean over draws, the intervals those of the draws.
    """
    rows: list[tuple] = []
    names_matter = any(each.after.inner.size for each in amendments.values())
    for equation, amendment in amendments.items():
        if equation in data.derivatives:
            figures = _figures(model, amendment, data, equation, names_matter, criteria)
            rows += [(part, metric, equation, *values) for metric, values in figures.items()]
    paths: dict[str, FreePath] = {}
    if free_runs is not None:
        paths, path_rows = free_runs(data, part)
        rows += path_rows
    table = pd.DataFrame(rows, columns=["data", "metric", "variable", "before", "after", "lower", "upper"])
    ratio = table["after"] / table["before"].where(table["before"] > 0)
    table["closed"] = (1 - ratio).where(~table["metric"].isin(NO_SHARES))
    return table.set_index(["data", "metric", "variable"]), paths


def within_noise(gap: pd.DataFrame, part: str, equation: str, n_row: int | None) -> bool:
    """Return whether the gap of an equation was within the noise before: then there was none to close.

    The mean square of n normal errors of variance σ² has the standard deviation σ² (2/n)^½: an excess of up to two of
    these is no gap. Samples have a misfit instead, which is 1 of noise alone.
    """
    every = zip(gap.index, gap["before"], gap["after"], strict=True)
    rows = {key[1]: (before, after) for key, before, after in every if (key[0], key[2]) == (part, equation)}
    if MISFIT in rows:
        return bool(rows[MISFIT][0] <= 1.0)
    error = next((rows[name] for name in NMSES if name in rows), None)
    if error is None or SHARE not in rows or not n_row:
        return False
    (before, after), (error_before, error_after) = rows[SHARE], error
    if not (before > after and error_before > error_after):
        return False
    excess = before * (error_before - error_after) / (before - after)
    return bool(excess <= 2.0 * (error_before - excess) * np.sqrt(2.0 / n_row))


def _figures(
    model: Program, amendment: Amendment, data: Trajectories, equation: str, names_matter: bool, criteria: Criteria
) -> dict[str, tuple[float, ...]]:
    """Return one equation's errors by metric: before (where no sensor's error is known), after, and interval after."""
    raw = replace(model, rows=model.rows.around(amendment.terms_before())).equation_rows(data, equation)
    after = amendment.model(model)
    rows = after.equation_rows(after.started(amendment.corrected(data)), equation)
    added = _on_rows(raw, amendment, lambda at: amendment.rates_before(at)[:, None], 1)[:, 0]
    before, draws = _squares(raw, added), _draws(rows, amendment)
    sizes = _Sizes.of(rows, amendment, data, draws, criteria)
    metrics: Metrics = {f"{rows.measurement} NMSE": sizes.nmse, SHARE: sizes.share}
    if data.samples is not None and len(data.samples.state_names) == 1:
        metrics |= {MISFIT: sizes.misfit}

    def compared(metrics: Metrics, draws: np.ndarray) -> dict[str, tuple[float, ...]]:
        each, mean = _squares(rows, draws), _squares(rows, draws.mean(axis=0))
        ends = {name: np.quantile(size(each), INTERVAL_ENDS) for name, size in metrics.items()}
        return {name: (float(size(before)), float(size(mean)), *ends[name]) for name, size in metrics.items()}

    figures = compared(metrics, draws)
    if amendment.discrepancy is not None and names_matter:
        # f takes up any gap that is left: names are judged without it.
        figures |= compared({NAMES_ALONE: sizes.share}, _draws(rows, replace(amendment, discrepancy=None)))
    return figures


@dataclass(frozen=True)
class _Sizes:
    """Sizes that squared errors [n_row] or [n_draw, n_row] are compared with, in the unit of the sensor."""

    variance: float
    square: float
    noise: float
    allowed: float

    @classmethod
    def of(
        cls, rows: EquationRows, amendment: Amendment, data: Trajectories, draws: np.ndarray, criteria: Criteria
    ) -> "_Sizes":
        """Return the sizes for rows near the extended model, which may have another gain than the sensor."""
        gain, noise = rows.gain**2, (amendment.sigma * amendment.gain) ** 2
        allowed = max(noise, _sample_variance(data)) * (criteria.forced**2 if amendment.forced else 1.0)
        allowed += gain * float(np.mean(np.var(draws, axis=0)))
        # A measurement at rest has the variance of its rounding.
        at_rest = np.ptp(rows.measured) <= 1e-12 * np.max(np.abs(rows.measured))
        variance = 0.0 if at_rest else float(np.var(rows.measured))
        # The zero of a sensor is arbitrary; that of a rate is not.
        square = variance if rows.output else float(np.mean(rows.measured**2))
        return cls(variance * gain, square * gain, noise, allowed)

    def nmse(self, squares: Squares) -> Any:
        return relative(np.mean(squares, axis=-1), self.variance)

    def share(self, squares: Squares) -> Any:
        return relative(np.maximum(np.mean(squares, axis=-1) - self.noise, 0.0), self.square)

    def misfit(self, squares: Squares) -> Any:
        """Return the misfit; by the median, because single samples that are far off say nothing of the others."""
        return np.sqrt(relative(np.median(squares, axis=-1) / MEDIAN_SQUARED_NORMAL, self.allowed))


def _draws(rows: EquationRows, amendment: Amendment) -> Float[np.ndarray, "n_draw n_row"]:
    return _on_rows(rows, amendment, lambda at: amendment.rates(at, RATE_DRAWS)[1].T, RATE_DRAWS).T


def _squares(rows: EquationRows, added: np.ndarray) -> Squares:
    """Return squared errors; where a path started is no error."""
    left = rows.noise.without_starts(np.atleast_2d(rows.target - added).T).T
    return (rows.gain * left).reshape(np.shape(added)) ** 2


def _sample_variance(data: Trajectories) -> float:
    """Return the variance of the white noise that samples of one sensor show; 0 of several sensors, or of rates."""
    samples = data.samples
    if samples is None or len(samples.state_names) > 1:
        return 0.0
    shown = replace(samples, noise={}).keep(seen_samples(samples))
    return float(sample_noise(shown.time, shown.matrix(shown.state_names), shown.run_lengths)[0]) ** 2


def _on_rows(rows: EquationRows, amendment: Amendment, evaluate: Evaluate, k: int) -> Float[np.ndarray, "n_row k"]:
    """Return added rates as rows show them, filtered or along the path: if one of their terms jumps, they jump."""
    jumps, columns = None, amendment.jumping
    if columns:
        jumps = Jumps(range(k), evaluate, lambda at: amendment.statistics.evaluate(columns, at))
    return rows.operate(rows.at_samples(evaluate, jumps))
