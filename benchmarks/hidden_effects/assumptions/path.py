"""The true system at any time, so that a channel can be late by any part of a sampling step."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from benchmarks.hidden_effects.systems.hosts import Host
from benchmarks.hidden_effects.systems.ode import HostODE, paths
from benchmarks.hidden_effects.systems.trajectories import Excited, Runs, Signal, combine

LEAD = 4
"""Sampling steps by which the system is followed before the first row and after the last."""

FINE_POINTS, LONG = 4, 5000
"""States are known at so many points a step, and between them by cubic splines; at one for more rows than LONG."""

PATH_TOLERANCE = 1e-8
"""Relative tolerance of the integration, far below any noise."""


@dataclass(frozen=True)
class Path:
    """The system followed through all runs of a data set.

    Attributes:
        ode: The whole system.
        visible: The host as the study sees it, with its true coefficients.
        signal: The input, in time since the system was set going.
        fine: Times at which the states are known.
        states: States, those of effects with a memory last.
    """

    ode: HostODE
    visible: Host
    signal: Signal
    fine: Float[np.ndarray, " n_fine"]
    states: Float[np.ndarray, "n_run n_all n_fine"]

    @property
    def step(self) -> float:
        """Sampling step."""
        return self.visible.stop / (self.visible.samples - 1)

    def at(self, late: Any = 0.0) -> Runs:
        """Return exact quantities at the stamps less so many steps, of all rows or of each [n_run, n_time].

        The stamps "t" stay as they are. `known` is the visible simulation's rate, `hidden` all that it lacks.
        """
        host = self.visible
        stamps = np.broadcast_to(host.times, (len(self.states), host.samples))
        times = stamps + (LEAD - np.asarray(late)) * self.step
        found = np.stack(
            [CubicSpline(self.fine, run, axis=1)(when) for run, when in zip(self.states, times, strict=True)]
        )
        columns = {"t": stamps.ravel()}
        columns |= {state: found[:, i].ravel() for i, state in enumerate(self.ode.rates)}
        if self.signal is not None:
            columns[host.inputs[0]] = self._input(times).ravel()
        memory = found[:, len(self.ode.rates)].ravel() if self.ode.memories else 0.0
        rates = {state: np.broadcast_to(value, columns["t"].shape) for state, value in self.ode.known(columns).items()}
        # What acts at certain times only does so in the system's own time.
        own = {**columns, "t": times.ravel()}
        values = tuple(np.broadcast_to(value, own["t"].shape) for value in self.ode.values(own, memory))
        for act, value in zip(self.ode.acting, values, strict=True):
            rates[host.equation] = rates[host.equation] + act.coefficient * value
        known = combine(host.rates[host.equation], columns)
        return Runs(columns, known, values, rates[host.equation] - known, rates)

    def _input(self, times: np.ndarray) -> np.ndarray:
        assert self.signal is not None
        if np.all(times == times[0]):
            return np.array([self.signal(t) for t in times[0]]).T
        return np.array([[self.signal(t)[run] for t in row] for run, row in enumerate(times)])


def followed(ode: HostODE, visible: Host, excited: Excited) -> Path:
    """Follow the whole system from some steps before the first row to some after the last.

    Raises:
        LostError: The system cannot be followed.
    """
    host = ode.host
    fine = FINE_POINTS if host.samples * host.runs <= LONG else 1
    points = host.samples + 2 * LEAD
    longer = replace(
        host, stop=host.stop * (points - 1) / (host.samples - 1), samples=fine * (points - 1) + 1, runs=host.runs
    )
    found = paths(replace(ode, host=longer), excited.starts, excited.signal, PATH_TOLERANCE)
    return Path(ode, visible, excited.signal, longer.times, found)
