"""The gap before and after: how far the simulation, and the amended model, are from the measurements."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

from bayes_greybox.criticism.bands import Band
from bayes_greybox.criticism.free_run import integrate_runs
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.program import Program
from bayes_greybox.physics.simulation import Simulation

from .coefficients import Coefficients
from .sufficient_statistics import SufficientStatistics

LEVEL = 0.9
"""Probability of the intervals."""

RATE_DRAWS, PATH_DRAWS = 200, 40
"""Posterior draws behind the intervals of rates and of free runs."""


@dataclass(frozen=True)
class Amendment:
    """What was added to one equation: columns of its statistics and posterior draws of their coefficients.

    Attributes:
        statistics: Of the equation.
        before: Coefficients of the user's own dictionary alone, scaled [n_free].
        after: Draws of all coefficients, with the effects that were added.
        sigma: Noise standard deviation after, user's units.
    """

    statistics: SufficientStatistics
    before: Float[np.ndarray, " n_free"]
    after: Coefficients
    sigma: float

    def rates(self, columns: Mapping[str, np.ndarray], n_draw: int) -> tuple[np.ndarray, np.ndarray]:
        """What is added to the simulation's rate at rows: before [n_row], and draws of after [n_draw, n_row]."""
        statistics, scale = self.statistics, self.statistics.target_scale
        own = [i for i in self.after.indices if statistics.columns[i].kind != "effect"]
        before = scale * statistics.evaluate(statistics.of_kind("free"), columns) @ self.before
        pick = np.linspace(0, len(self.after.draws) - 1, n_draw).astype(int)
        beta, inner = self.after.draws[pick], self.after.inner[pick]
        after = beta[:, : len(own)] @ statistics.evaluate(own, columns).T
        for k in range(inner.shape[1]):
            for index in np.unique(inner[:, k]):
                rows = inner[:, k] == index
                after[rows] += np.outer(beta[rows, len(own) + k], statistics.evaluate([int(index)], columns)[:, 0])
        return before, scale * after


@dataclass(frozen=True)
class FreePath:
    """One state in free run from its measured start: measured, and bands before and after."""

    time: np.ndarray
    run: np.ndarray
    measured: np.ndarray
    before: Band
    after: Band


def gap_rows(
    model: Program,
    amendments: Mapping[str, Amendment],
    data: Trajectories,
    part: str,
    free_runs: bool,
    interpolation: str | Sequence[str] | None = None,
) -> tuple[pd.DataFrame, dict[str, FreePath]]:
    """The gap table's rows for one data set, and its free runs.

    Metrics: derivative NMSE, mean((ẋ − x̂̇)²)/var(ẋ); unexplained share, (mean((ẋ − x̂̇)²) − σ²)/mean(ẋ²), not below
    zero; free-run NRMSE, RMS(x − x̂)/SD(x) up to the first failure of either; time to failure of runs that blow up.

    Args:
        model: The model before.
        amendments: By equation.
        data: Measurements to compare with.
        part: "train" or "test".
        free_runs: Whether to integrate free runs.
        interpolation: Of the inputs between samples in free runs, see `criticism.free_run.integrate_runs`.
    """
    simulation = model.simulator(data)
    rows = []
    for equation, amendment in amendments.items():
        if equation not in data.derivatives:
            continue
        measured = model.equation_rows(data, equation)
        target, size = measured.target, float(np.mean(measured.measured**2))
        before, after = amendment.rates(measured.columns, RATE_DRAWS)
        # A filtered rate is compared with the same filter's mean of the rates that were added.
        before, after = measured.operate(before[:, None])[:, 0], measured.operate(after.T).T
        variance, noise = float(np.var(measured.measured)), amendment.sigma**2

        def error(added: np.ndarray, target=target, variance=variance) -> Any:
            return np.mean((target - added) ** 2, axis=-1) / variance

        def share(values: Any, variance=variance, size=size, noise=noise) -> Any:
            return np.maximum(values * variance - noise, 0.0) / size

        errors = error(after)
        for metric, f in (("derivative NMSE", lambda v: v), ("unexplained share", share)):
            low, high = np.quantile(f(errors), [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
            mean = f(error(after.mean(axis=0)))
            rows.append((part, metric, equation, float(f(error(before))), float(mean), low, high))
    paths: dict[str, FreePath] = {}
    if free_runs and set(data.state_names) <= {*simulation.equations, *amendments}:
        paths, more = _free_runs(simulation, amendments, data, part, interpolation)
        rows += more
    table = pd.DataFrame(rows, columns=["data", "metric", "variable", "before", "after", "lower", "upper"])
    ratio = table["after"] / table["before"].where(table["before"] > 0)
    table["closed"] = (1 - ratio).where(table["metric"] != "time to failure")
    return table.set_index(["data", "metric", "variable"]), paths


def _free_runs(
    simulation: Simulation,
    amendments: Mapping[str, Amendment],
    data: Trajectories,
    part: str,
    interpolation: str | Sequence[str] | None,
) -> tuple[dict[str, FreePath], list[tuple]]:
    n_draw = PATH_DRAWS if any(len(a.after.indices) for a in amendments.values()) else 1
    names = (*data.state_names, *data.input_names)
    added = {name: _added(a, n_draw) for name, a in amendments.items()}
    terms = {name: [c.term for c in columns] for name, (columns, _) in added.items()}
    # The first row of coefficients is the model before, the others are draws of the model after.
    parameters = {name: jnp.asarray(values) for name, (_, values) in added.items()}
    places = {name: data.state_names.index(name) for name in amendments}

    def right_hand_side(t: Array, x: Array, u: Array, args: dict) -> Array:
        rate = simulation.rate(t, x, u)
        columns = dict(zip(names, (*x, *u), strict=True))
        for name, coefficient in args.items():
            # Sums and a mask, which compile into the step; products and scatters would be calls at each stage.
            added = sum((coefficient[i] * term.evaluate(columns) for i, term in enumerate(terms[name])), jnp.zeros(()))
            rate = rate + jnp.where(jnp.arange(len(rate)) == places[name], added, 0.0)
        return rate

    joined, failed_at = integrate_runs(
        right_hand_side,
        data,
        parameters,
        interpolation,
        rtol=1e-6,
        atol=1e-7,
    )
    paths, rows = {}, []
    for i, name in enumerate(data.state_names):
        measured = data.states[name]
        before, after = joined[:1, :, i], joined[1:, :, i]
        paths[name] = FreePath(
            data.time, data.run, measured, Band.surviving(before, LEVEL), Band.surviving(after, LEVEL)
        )
        spread = float(np.std(measured))
        alive = np.isfinite(before[0]) & np.isfinite(after).all(axis=0)

        def error(values: np.ndarray, measured=measured, alive=alive, spread=spread) -> Any:
            return np.sqrt(np.mean((measured[alive] - values[..., alive]) ** 2, axis=-1)) / spread

        low, high = np.quantile(error(after), [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
        rows.append(
            (part, "free-run NRMSE", name, float(error(before)[0]), float(error(after.mean(axis=0))), low, high)
        )
    if np.isfinite(failed_at).any():
        starts = np.array([data.take(i).time[0] for i in range(data.n_run)])
        lasted = failed_at - starts[:, None]
        first = np.where(np.isfinite(lasted), lasted, np.inf).min(axis=0)
        low, high = np.quantile(first[1:], [(1 - LEVEL) / 2, (1 + LEVEL) / 2], method="nearest")
        rows.append((part, "time to failure", "all", first[0], np.median(first[1:]), low, high))
    return paths, rows


def _added(amendment: Amendment, n_draw: int) -> tuple[list, np.ndarray]:
    """Columns of one equation's free run and their coefficients in user's units [1 + n_draw, n_column]."""
    statistics, after = amendment.statistics, amendment.after
    n_own = len(after.indices) - after.inner.shape[1]
    # The inner parameter is held at its likeliest value; its spread is in the tables.
    likeliest = [int(np.bincount(column).argmax()) for column in after.inner.T]
    columns = [statistics.columns[i] for i in (*after.indices[:n_own], *likeliest)]
    scale = np.array([statistics.target_scale / c.scale for c in columns])
    pick = np.linspace(0, len(after.draws) - 1, n_draw).astype(int)
    before = np.zeros(len(columns))
    before[: len(amendment.before)] = amendment.before
    return columns, np.vstack([before, after.draws[pick]]) * scale if columns else np.zeros((1 + n_draw, 0))
