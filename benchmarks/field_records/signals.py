"""Inputs, disturbances and sensors that the makers of records share."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

Rates = Callable[[float, np.ndarray], Sequence[float]]
"""Function from time and states to their rates."""


def rounded(x: np.ndarray | float, step: float) -> np.ndarray:
    """Return values on the steps of a sensor."""
    return np.round(np.asarray(x) / step) * step


def held(t: np.ndarray, u: np.ndarray) -> Callable[[float], float]:
    """Return a function of time that holds each value until the next sample."""
    return lambda s: u[min(max(int(np.searchsorted(t, s + 1e-9, side="right")) - 1, 0), len(u) - 1)]


def levels(rng: np.random.Generator, n: int, choices: Sequence[float], shortest: int, longest: int) -> np.ndarray:
    """Return n values, each held for a random number of samples between the shortest and the longest."""
    values: list[float] = []
    while len(values) < n:
        values += [rng.choice(choices)] * int(rng.integers(shortest, longest + 1))
    return np.array(values[:n], float)


def wandering(rng: np.random.Generator, n: int, step: float, time: float, sd: float) -> np.ndarray:
    """Return n samples of an Ornstein-Uhlenbeck process with this correlation time and standard deviation."""
    keep = np.exp(-step / time)
    noise = rng.standard_normal(n) * sd * np.sqrt(1 - keep * keep)
    return np.asarray(lfilter([1], [1, -keep], noise, zi=[keep * sd * rng.standard_normal()])[0])


def path(rates: Rates, start: Sequence[float], t: np.ndarray, jumps: Iterable[float]) -> np.ndarray:
    """Return the states at the times t; the integrator starts anew at each of these and at each jump of the rates."""
    knots = np.unique(np.concatenate([t, [jump for jump in jumps if t[0] < jump < t[-1]]]))
    x = np.array(start, float)
    states = {knots[0]: x}
    for begin, end in zip(knots[:-1], knots[1:], strict=True):
        x = solve_ivp(rates, (begin, end), x, rtol=1e-8, atol=1e-10).y[:, -1]
        states[end] = x
    return np.array([states[time] for time in t])
