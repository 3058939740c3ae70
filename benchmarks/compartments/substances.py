"""Substances that are given by infusion, and their concentration; integrated by SciPy, apart from the package."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

HOURS, STEP, NOISE = 48.0, 0.5, 0.02
"""Duration and time between samples, hours; noise over the spread of the concentration."""


FEW, FEW_NOISE = (0.25, 0.5, 0.75, 1.0, 1.25, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0), 0.05
"""Hours of the blood samples after an injection, and their noise over the concentration itself."""


@dataclass(frozen=True)
class Substance:
    """c' = −k c + d + exchange (z − c) − most c/(half + c); z' = (c − z)/storage; d' = (u − d)/depot, or d = u.

    Rates in 1/h, times in h, concentrations in mg/l; parts of zero are not there.
    """

    k: float
    exchange: float = 0.0
    storage: float = 1.0
    most: float = 0.0
    half: float = 1.0
    depot: float = 0.0

    @property
    def sizes(self) -> dict[str, float]:
        """Coefficients of its effects by their slugs; that of the catalogue's saturable one is its slope at zero."""
        return {
            "second-compartment": self.exchange,
            "saturable-elimination": -self.most / self.half,
            "absorption": 1.0,
        }


def substance(hidden: str, rng: np.random.Generator) -> Substance:
    """Draw a substance with one hidden effect, or with none."""
    k, strength = 0.2 * np.exp(0.2 * rng.standard_normal()), np.exp(0.3 * rng.standard_normal())
    time = np.exp(0.3 * rng.standard_normal())
    if hidden == "second-compartment":
        return Substance(float(k), exchange=float(0.3 * strength), storage=float(6.0 * time))
    if hidden == "saturable-elimination":
        half = 2.0 * time
        return Substance(float(k), most=float(0.3 * strength * half), half=float(half))
    if hidden == "absorption":
        return Substance(float(k), depot=float(1.5 * time))
    return Substance(float(k))


def few_samples(each: Substance, rng: np.random.Generator) -> dict[str, Any]:
    """Return time and concentration of a few samples after an injection, which the blood has at time 0."""

    def rates(_: float, x: np.ndarray) -> list[float]:
        return [-each.k * x[0] + each.exchange * (x[1] - x[0]), (x[0] - x[1]) / each.storage]

    c = solve_ivp(rates, (0.0, FEW[-1]), [rng.uniform(2.0, 4.0), 0.0], t_eval=FEW, rtol=1e-9, atol=1e-9).y[0]
    return {"t": np.array(FEW), "c": c * (1 + FEW_NOISE * rng.standard_normal(len(c)))}


def measured(each: Substance, rng: np.random.Generator) -> dict[str, Any]:
    """Return time, the measured concentration and the rate of infusion."""
    t = np.arange(0.0, HOURS, STEP)
    given = np.zeros(len(t))
    for start in (0, 20, 48, 70):
        first = start + int(rng.integers(0, 8))
        given[first : first + int(rng.integers(2, 8))] = rng.uniform(1.5, 4.0)

    def rates(time: float, x: np.ndarray) -> list[float]:
        c, z, d = x
        u = given[min(int(time / STEP + 1e-9), len(given) - 1)]
        arrives = d if each.depot else u
        lost = each.k * c + each.most * c / (each.half + c)
        return [
            arrives - lost + each.exchange * (z - c),
            (c - z) / each.storage,
            (u - d) / each.depot if each.depot else 0.0,
        ]

    # The infusion jumps at samples: the integrator starts anew at each.
    x, path = np.zeros(3), [np.zeros(3)]
    for k in range(len(t) - 1):
        x = solve_ivp(rates, (t[k], t[k + 1] - 1e-9), x, rtol=1e-9, atol=1e-9).y[:, -1]
        path.append(x)
    c = np.array(path)[:, 0]
    return {"t": t, "c": c + NOISE * np.std(c) * rng.standard_normal(len(t)), "u": given}
