"""Exact quantities along the runs of a system, one row for each sample."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from .hosts import Host, term_value
from .ode import TIGHT, HostODE, paths

Signal = Callable[[float], Any] | None
"""The input of all runs as a function of time; None without an input."""


@dataclass(frozen=True)
class Excited:
    """Excitation of the runs of one data set: initial states, one row for each run, and the input."""

    starts: Float[np.ndarray, "n_run n_state"]
    signal: Signal


@dataclass(frozen=True)
class Runs:
    """Exact quantities, the runs one after another.

    Attributes:
        columns: States and inputs, and the time as "t".
        known: Rate of the studied equation by the host's true terms.
        values: Value of each hidden effect, before its coefficient.
        hidden: Sum of all of them in the studied equation.
        rates: True derivative of every state.
    """

    columns: Mapping[str, Float[np.ndarray, " n_obs"]]
    known: Float[np.ndarray, " n_obs"]
    values: tuple[Float[np.ndarray, " n_obs"], ...]
    hidden: Float[np.ndarray, " n_obs"]
    rates: Mapping[str, Float[np.ndarray, " n_obs"]]


def excite(host: Host, rng: np.random.Generator, runs: int) -> Excited:
    """Draw starts and input of several runs."""
    starts = np.column_stack([host.starts[state].draw(rng, runs) for state in host.states])
    signals = [signal.draw(rng, runs, host.stop) for signal in host.excitation.values()]
    return Excited(starts, signals[0] if signals else None)


def follow(ode: HostODE, excited: Excited, tolerance: float = TIGHT) -> Runs:
    """Integrate the runs and take down their exact quantities.

    Raises:
        LostError: The system cannot be followed.
    """
    host, times = ode.host, ode.host.times
    found = paths(ode, excited.starts, excited.signal, tolerance)
    n_run, n_state = excited.starts.shape
    columns = {"t": np.tile(times, n_run)}
    columns |= {state: found[:, i].ravel() for i, state in enumerate(ode.rates)}
    if excited.signal is not None:
        columns[host.inputs[0]] = np.array([excited.signal(t) for t in times]).T.ravel()
    memory = found[:, n_state].ravel() if ode.memories else 0.0
    known = {state: np.broadcast_to(value, columns["t"].shape) for state, value in ode.known(columns).items()}
    values = tuple(np.broadcast_to(value, columns["t"].shape) for value in ode.values(columns, memory))
    hidden = np.zeros(len(columns["t"]))
    for act, value in zip(ode.acting, values, strict=True):
        hidden = hidden + act.coefficient * value
    rates = {**known, host.equation: known[host.equation] + hidden}
    return Runs(columns, known[host.equation], values, hidden, rates)


def combine(terms: Mapping[str, float], columns: Mapping[str, np.ndarray]) -> Float[np.ndarray, " n_obs"]:
    """Return the sum of a simulation's terms at the rows of some data."""
    total = np.zeros(len(columns["t"]))
    for text, value in terms.items():
        total = total + value * term_value(text, columns)
    return total


def rms(values: Float[np.ndarray, " n"]) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))
