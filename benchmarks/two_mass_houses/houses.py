"""Houses heated by switching, in weather, and their thermometer; integrated by SciPy, apart from the package."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

HOURS, STEP, SWITCHED = 96.0, 0.5, 2.0
"""Duration, time between samples, and the time for which the heater stays on or off; hours."""

NOISE = 0.05
"""Noise of the thermometer, K."""


@dataclass(frozen=True)
class House:
    """T' = loss (T_out − T) + P + exchange (T_walls − T) of the air, T_walls' = (T − T_walls)/storage; hours and K.

    An exchange of zero is a house of one mass.
    """

    loss: float
    exchange: float
    storage: float


def house(masses: int, rng: np.random.Generator) -> House:
    """Draw a house of one or two masses."""
    loss, exchange = 0.15 * np.exp(0.3 * rng.standard_normal()), 0.35 * np.exp(0.3 * rng.standard_normal())
    return House(float(loss), float(exchange) * (masses == 2), float(15.0 * np.exp(0.4 * rng.standard_normal())))


def measured(each: House, rng: np.random.Generator) -> dict[str, Any]:
    """Return time, the thermometer, the weather and the heater of some days."""
    t = np.arange(0.0, HOURS, STEP)
    phase, front = rng.uniform(0.0, 2 * np.pi, 2)
    on = rng.uniform(size=int(HOURS / SWITCHED) + 1) > 0.5

    def outside(time: Any) -> Any:
        return 5.0 + 6.0 * np.sin(2 * np.pi * time / 24.0 + phase) + 2.0 * np.sin(2 * np.pi * time / 61.0 + front)

    def heater(time: Any) -> Any:
        return 3.0 * on[(np.asarray(time) // SWITCHED).astype(int)]

    def rates(time: float, x: np.ndarray) -> list[float]:
        air = each.loss * (outside(time) - x[0]) + heater(time) + each.exchange * (x[1] - x[0])
        return [air, (x[0] - x[1]) / each.storage]

    # The heater jumps: no step of the integrator passes over a switch.
    found = solve_ivp(rates, (0.0, t[-1]), [20.0, 20.0], t_eval=t, rtol=1e-8, atol=1e-8, max_step=0.1)
    return {"t": t, "T": found.y[0] + NOISE * rng.standard_normal(len(t)), "outside": outside(t), "heater": heater(t)}
