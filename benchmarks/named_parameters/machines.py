"""Machines with named parameters, and what their sensors show; integrated by SciPy, apart from the package."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

SAMPLES, SAMPLES_EACH_PERIOD = 300, 25
"""Samples of a record, and of a period of the machine."""

RATE_NOISE, SAMPLE_NOISE = 0.02, 0.01
"""Noise of a measured rate and of a sampled state, over their standard deviations."""

SPREAD = 0.1
"""Standard deviation of a prior, over the parameter's typical value."""

Rates = Callable[[np.ndarray, float, Mapping[str, float]], list[float]]
"""(states, drive, parameters) -> rates."""


@dataclass(frozen=True)
class Machine:
    """A machine as an engineer writes it.

    Attributes:
        formulas: Rates by state; the drive is u.
        rates: The same, as a function.
        typical: Typical values of the parameters.
        learned: State whose rate has them.
        period: Function from parameters to a time scale.
        drive: Size of the drive.
    """

    formulas: Mapping[str, str]
    rates: Rates
    typical: Mapping[str, float]
    learned: str
    period: Callable[[Mapping[str, float]], float]
    drive: float


MACHINES = {
    "mass": Machine(
        {"y": "v", "v": "(u - k*y - c*v)/m"},
        lambda x, u, p: [x[1], (u - p["k"] * x[0] - p["c"] * x[1]) / p["m"]],
        {"m": 2.0, "k": 30.0, "c": 0.8}, "v", lambda p: 2 * np.pi * np.sqrt(p["m"] / p["k"]), 5.0,
    ),
    "pendulum": Machine(
        {"q": "w", "w": "u/(m*l**2) - 9.81/l*sin(q) - d*w"},
        lambda x, u, p: [x[1], u / (p["m"] * p["l"] ** 2) - 9.81 / p["l"] * np.sin(x[0]) - p["d"] * x[1]],
        {"m": 1.5, "l": 0.6, "d": 0.3}, "w", lambda p: 2 * np.pi * np.sqrt(p["l"] / 9.81), 3.0,
    ),
    "heater": Machine(
        {"T": "(P*u - T)/tau"},
        lambda x, u, p: [(p["P"] * u - x[0]) / p["tau"]],
        {"P": 8.0, "tau": 120.0}, "T", lambda p: 4 * p["tau"], 1.0,
    ),
}  # fmt: skip
"""Machines by name: nonlinear in m, in m and l, and in tau."""

LINEAR = {"mass": ("k", "c"), "pendulum": ("d",), "heater": ("P",)}
"""Parameters that each machine is linear in."""


def simulated(machine: Machine, values: Mapping[str, float], rng: np.random.Generator) -> dict[str, Any]:
    """Return times, drive, states and rates of one record without noise."""
    step = machine.period(machine.typical) / SAMPLES_EACH_PERIOD
    t = step * np.arange(SAMPLES)
    slow = 2 * np.pi / machine.period(machine.typical)
    frequencies, phases = slow * rng.uniform(0.2, 2.0, 6), rng.uniform(0, 2 * np.pi, 6)

    def drive(time: Any) -> Any:
        return machine.drive * np.sin(np.multiply.outer(time, frequencies) + phases).sum(axis=-1) / np.sqrt(3.0)

    start = np.zeros(len(machine.formulas))
    found = solve_ivp(
        lambda time, x: machine.rates(x, drive(time), values), (0.0, t[-1]), start, t_eval=t, rtol=1e-9, atol=1e-10
    )
    u = drive(t)
    rates = np.array([machine.rates(x, each, values) for x, each in zip(found.y.T, u, strict=True)]).T
    return {"t": t, "u": u, "states": dict(zip(machine.formulas, found.y, strict=True)),
            "rates": dict(zip(machine.formulas, rates, strict=True))}  # fmt: skip


def noisy(values: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """Return values with white noise of a share of their standard deviation."""
    return values + share * float(np.std(values)) * rng.standard_normal(len(values))
