"""States that are late against the state that is their rate, by their samples alone and without any model.

A position is the integral of its speed. One that is shown d later departs from it, x(t + T) − x(t) − ∫ v dt, by the
speed's gain within T times d; taken d earlier it does not. The rate of the speed may hardly tell such a delay from a
wrong damping; these samples do.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from bayes_greybox.data.runs.resampling import running_integral
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.simulation.protocol import Simulation

WINDOW_STEPS = 10
"""Steps of a window: noise on samples counts twice in it, whatever its length, and the rate counts for all of it."""

AGREEING = 0.01
"""Sensors that are right agree to within this share of the RMS of a state's changes."""

FURTHEST, FEWEST_WINDOWS = 6.0, 5
"""Largest delay that is looked for, in steps, and least number of windows that say anything."""

SURELY_LATE = 1e-6
"""p-value below which departures need a reason. A delay is that reason if it brings the p-value back above."""


@dataclass(frozen=True)
class Late:
    """A state that is late by some time, and the p-value of its samples as they came."""

    by: float
    sd: float
    step: float
    p: float


def late_states(data: Trajectories, simulation: Simulation, noise: Mapping[str, float]) -> dict[str, Late]:
    """Return the states whose samples follow those of their rate once they are taken earlier, and not as they came."""
    delays = {pair.state: pair.late() for pair in _pairs(data, simulation, noise)}
    return {name: late for name, late in delays.items() if late is not None}


def in_step(data: Trajectories, simulation: Simulation, noise: Mapping[str, float]) -> dict[str, float]:
    """Return standard deviations of the delay between a state and its rate whose samples agree, for both by name."""
    spreads: dict[str, float] = {}
    for pair in _pairs(data, simulation, noise):
        if pair.gained > 0 and pair.p(pair.departures(0.0)) >= SURELY_LATE:
            sd = float(np.sqrt(pair.variance / pair.gained))
            spreads |= {each: min(sd, spreads.get(each, sd)) for each in (pair.state, pair.rate)}
    return spreads


def _pairs(data: Trajectories, simulation: Simulation, noise: Mapping[str, float]) -> Iterator["_Pair"]:
    for name in data.state_names:
        rate = simulation.rate_name(name)
        if rate is None or rate not in data.state_names:
            continue
        runs = [rows for rows in (data.run == r for r in range(data.n_run)) if np.sum(rows) > 3 * WINDOW_STEPS]
        paths = [_Path(data.time[rows], data.states[name][rows], data.states[rate][rows]) for rows in runs]
        if sum(len(path.start) for path in paths) >= FEWEST_WINDOWS:
            yield _Pair(name, rate, paths, noise.get(name, 0.0), noise.get(rate, 0.0))


class _Path:
    """The windows of one run, without those at its ends, which a shift would leave."""

    def __init__(self, time: np.ndarray, x: np.ndarray, v: np.ndarray) -> None:
        self.time, self.x, integral = time, CubicSpline(time, x), running_integral(time, v)
        margin = int(np.ceil(FURTHEST)) + 1
        self.start = np.arange(margin, len(time) - WINDOW_STEPS - margin, WINDOW_STEPS)
        self.end = self.start + WINDOW_STEPS
        self.predicted, self.gained = (values[self.end] - values[self.start] for values in (integral, v))

    def changes(self, by: float = 0.0) -> Float[np.ndarray, " n"]:
        """Return the change of the state within each window, so much later."""
        return self.x(self.time[self.end] + by) - self.x(self.time[self.start] + by)


class _Pair:
    """Pair of a state and the state that is its rate, with the windows of their runs."""

    def __init__(self, state: str, rate: str, paths: list[_Path], noise: float, rate_noise: float) -> None:
        self.state, self.rate, self.paths = state, rate, paths
        self.step = float(np.median(np.concatenate([np.diff(path.time) for path in paths])))
        changes = np.concatenate([path.changes() for path in paths])
        shown = 2 * noise**2 + WINDOW_STEPS * (rate_noise * self.step) ** 2
        # Variance of a departure.
        self.variance = shown + AGREEING**2 * float(np.mean(changes**2)) + np.finfo(float).tiny
        self.gained = float(sum(np.sum(path.gained**2) for path in paths))

    def departures(self, by: float) -> Float[np.ndarray, " n"]:
        return np.concatenate([path.changes(by) - path.predicted for path in self.paths])

    def p(self, departures: Float[np.ndarray, " n"], fitted: int = 0) -> float:
        """Return the p-value of departures after so many numbers were fitted to them."""
        return float(chi2.sf(np.sum(departures**2) / self.variance, len(departures) - fitted))

    def late(self) -> Late | None:
        """Return the delay of the state, if that explains its departures."""
        before = self.p(self.departures(0.0))
        if before >= SURELY_LATE:
            return None
        most = FURTHEST * self.step

        def misfit(by: float) -> float:
            return float(np.sum(self.departures(by) ** 2))

        by = float(cast(Any, minimize_scalar(misfit, bounds=(-most, most), method="bounded")).x)
        residual = self.departures(by)
        if abs(by) > 0.95 * most or self.p(residual, 1) < SURELY_LATE or not self.gained > 0:
            return None
        # The residual is no white noise where samples are exact: sensors agree to within what they are trusted to.
        variance = max(float(np.sum(residual**2)) / max(len(residual) - 1, 1), self.variance)
        return Late(by, float(np.sqrt(variance / self.gained)), self.step, before)
