"""States that are late against the state that is their rate: what the samples say of it without any model.

A position is the integral of its speed. One that is shown d later departs from it, x(t + T) − x(t) − ∫ v dt, by what
the speed gains within T times d; taken d earlier it does not. The rate of the speed may hardly tell such a delay from a
wrong damping; these samples do.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from bayes_greybox.data.rates.integral import running_integral
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.simulation.protocol import Simulation

SAMPLES = 10
"""Steps of a window: noise on samples counts twice in it, whatever its length, and the rate counts for all of it."""

AGREE = 0.01
"""Sensors that are right agree to within this share of the RMS of a state's changes."""

FURTHEST = 6.0
"""Largest delay that is looked for, in steps."""

SURE = 1e-6
"""p-value of the departures below which they need a reason, and from which on it is a delay that leaves none."""

FEWEST = 5
"""Windows that it takes to say anything."""


@dataclass(frozen=True)
class Late:
    """A state that is late.

    Attributes:
        by: How much, in units of time.
        sd: Its standard deviation.
        step: Between samples.
        p: p-value that the samples had as they came.
    """

    by: float
    sd: float
    step: float
    p: float


def late_states(data: Trajectories, simulation: Simulation, noise: Mapping[str, float]) -> dict[str, Late]:
    """States whose samples follow those of their rate once they are taken earlier, and do not as they came.

    Args:
        data: Samples.
        simulation: Knows which state is another's rate.
        noise: Standard deviation of the noise on the samples of states that have any.
    """
    found = {pair.state: pair.late() for pair in _pairs(data, simulation, noise)}
    return {name: late for name, late in found.items() if late is not None}


def in_step(data: Trajectories, simulation: Simulation, noise: Mapping[str, float]) -> dict[str, float]:
    """Return standard deviations of the delay between a state and its rate whose samples agree, for both by name.

    The arguments are those of `late_states`. What departs has none.
    """
    found: dict[str, float] = {}
    for pair in _pairs(data, simulation, noise):
        if pair.gained > 0 and pair.p(pair.departures(0.0)) >= SURE:
            sd = float(np.sqrt(pair.variance / pair.gained))
            found |= {each: min(sd, found.get(each, sd)) for each in (pair.state, pair.rate)}
    return found


def _pairs(data: Trajectories, simulation: Simulation, noise: Mapping[str, float]) -> Iterator["_Pair"]:
    """Yield states with the states that are their rates."""
    for name in data.state_names:
        rate = simulation.rate_name(name)
        if rate is None or rate not in data.state_names:
            continue
        runs = [own for own in (data.run == r for r in range(data.n_run)) if np.sum(own) > 3 * SAMPLES]
        paths = [_Path(data.time[own], data.states[name][own], data.states[rate][own]) for own in runs]
        if sum(len(path.start) for path in paths) >= FEWEST:
            yield _Pair(name, rate, paths, noise.get(name, 0.0), noise.get(rate, 0.0))


class _Path:
    """The windows of one run; those at its ends, which a shift would leave, have no part."""

    def __init__(self, time: np.ndarray, x: np.ndarray, v: np.ndarray) -> None:
        self.time, self.x = time, CubicSpline(time, x)
        self.integral, self.v = running_integral(time, v), v
        margin = int(np.ceil(FURTHEST)) + 1
        self.start = np.arange(margin, len(time) - SAMPLES - margin, SAMPLES)

    def departures(self, by: float) -> Float[np.ndarray, " n"]:
        end = self.start + SAMPLES
        moved = self.x(self.time[end] + by) - self.x(self.time[self.start] + by)
        return moved - (self.integral[end] - self.integral[self.start])

    @property
    def changes(self) -> Float[np.ndarray, " n"]:
        """What the state changes by in each window."""
        return self.x(self.time[self.start + SAMPLES]) - self.x(self.time[self.start])

    @property
    def gained(self) -> Float[np.ndarray, " n"]:
        """What the speed gains in each window."""
        return self.v[self.start + SAMPLES] - self.v[self.start]


@dataclass(frozen=True)
class _Pair:
    """Pair of a state and the state that is its rate, with the windows of their runs.

    Attributes:
        state: The state.
        rate: Its rate.
        paths: Windows by run.
        noise: Standard deviation of the noise on the state's samples.
        rate_noise: That on its rate's.
    """

    state: str
    rate: str
    paths: list[_Path]
    noise: float
    rate_noise: float

    @cached_property
    def step(self) -> float:
        return float(np.median(np.concatenate([np.diff(path.time) for path in self.paths])))

    @cached_property
    def changes(self) -> Float[np.ndarray, " n"]:
        return np.concatenate([path.changes for path in self.paths])

    @cached_property
    def variance(self) -> float:
        """Variance of a departure."""
        shown = 2 * self.noise**2 + SAMPLES * (self.rate_noise * self.step) ** 2
        return shown + AGREE**2 * float(np.mean(self.changes**2)) + np.finfo(float).tiny

    @cached_property
    def gained(self) -> float:
        return float(sum(np.sum(path.gained**2) for path in self.paths))

    def departures(self, by: float) -> Float[np.ndarray, " n"]:
        return np.concatenate([path.departures(by) for path in self.paths])

    def p(self, departures: Float[np.ndarray, " n"], free: int = 0) -> float:
        """p-value of departures after so many numbers were fitted to them."""
        return float(chi2.sf(np.sum(departures**2) / self.variance, len(departures) - free))

    def late(self) -> Late | None:
        """Return how late the state is, if that explains that it departs."""
        before = self.p(self.departures(0.0))
        if before >= SURE:
            return None
        most = FURTHEST * self.step
        found: Any = minimize_scalar(
            lambda by: float(np.sum(self.departures(by) ** 2)), bounds=(-most, most), method="bounded"
        )
        by = float(found.x)
        left = self.departures(by)
        if abs(by) > 0.95 * most or self.p(left, 1) < SURE or not self.gained > 0:
            return None
        # What is left is no white noise where samples are exact: sensors agree to within what they are trusted to.
        each = max(float(np.sum(left**2)) / max(len(left) - 1, 1), self.variance)
        return Late(by, float(np.sqrt(each / self.gained)), self.step, before)
