"""Simulated systems with known truth, for examples, tests and benchmarks."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from bayes_greybox.running.errors import InputError

from .simulated import Drive, System, multisine

__all__ = [
    "Drive",
    "System",
    "duffing",
    "lotka_volterra",
    "multisine",
    "oscillator",
    "pendulum",
    "two_tanks",
    "van_der_pol",
]


def oscillator(c: float = 0.2, k: float = 1.0) -> System:
    """Free oscillator with cubic stiffness and cubic damping, y'' = -c ydot^3 - k y^3.

    The example of Manna, Rogers and Bull (their equation of motion, labelled mkc) over its 100 s. The damping
    is cubic as in that equation; the state-space form below it has c ydot, which cannot give the ydot^3 term
    that they find. They state neither coefficients nor the start: those here give a decaying oscillation.

    Args:
        c: Damping coefficient, s/m^2.
        k: Stiffness coefficient, 1/(m^2 s^2).

    Returns:
        The system, starting at rest from y = 1 m.
    """
    _check("oscillator", c=c, k=k)
    return _system(
        "oscillator",
        {"ydot": {"y**3": -float(k), "ydot**3": -float(c)}},
        units={"t": "s", "y": "m", "ydot": "m/s"},
        t=np.linspace(0.0, 100.0, 1001),
        x0=(1.0, 0.0),
    )


def duffing(m: float = 1.0, c: float = 0.5, k: float = 10.0, k3: float = 40.0) -> System:
    """Forced Duffing oscillator, m y'' + c y' + k y + k3 y^3 = F.

    Args:
        m: Mass, kg.
        c: Damping, N s/m.
        k: Linear stiffness, N/m.
        k3: Cubic stiffness, N/m^3.

    Returns:
        The system, at rest and driven by a multisine force of at most 8 N between 0.1 and 1.5 Hz.
    """
    _check("duffing", positive=("m",), m=m, c=c, k=k, k3=k3)
    return _system(
        "duffing",
        {"ydot": {"F": 1.0 / m, "ydot": -c / m, "y": -k / m, "y**3": -k3 / m}},
        units={"t": "s", "y": "m", "ydot": "m/s", "F": "N"},
        t=np.linspace(0.0, 60.0, 1201),
        x0=(0.0, 0.0),
        drives={"F": Drive(band=(0.1, 1.5), amplitude=8.0)},
    )


def van_der_pol(mu: float = 1.5) -> System:
    """Van der Pol oscillator in the time of its linear part, y'' = mu (1 - y^2) y' - y.

    Args:
        mu: Strength of the nonlinear damping.

    Returns:
        The system, spiralling out to its limit cycle; all quantities are plain numbers.
    """
    _check("van_der_pol", mu=mu)
    return _system(
        "van_der_pol",
        {"ydot": {"y": -1.0, "ydot": float(mu), "y**2*ydot": -float(mu)}},
        units={"t": "1", "y": "1", "ydot": "1"},
        t=np.linspace(0.0, 30.0, 601),
        x0=(0.1, 0.0),
    )


def pendulum(length: float = 1.0, b: float = 0.2, g: float = 9.81) -> System:
    """Pendulum with viscous friction, theta'' = -(g / length) sin(theta) - b theta'.

    Args:
        length: Length, m.
        b: Friction, 1/s.
        g: Gravity, m/s^2.

    Returns:
        The system, released at rest from 2.5 rad.
    """
    _check("pendulum", positive=("length",), length=length, b=b, g=g)
    return _system(
        "pendulum",
        {"omega": {"sin(theta)": -g / length, "omega": -float(b)}},
        units={"t": "s", "theta": "rad", "omega": "rad/s"},
        t=np.linspace(0.0, 20.0, 801),
        x0=(2.5, 0.0),
    )


def lotka_volterra(a: float = 0.55, b: float = 0.028, c: float = 0.84, d: float = 0.026) -> System:
    """Prey and predators, prey' = a prey - b prey predator, predator' = -c predator + d prey predator.

    Args:
        a: Growth of the prey, 1/year.
        b: Losses of the prey per predator, 1/year.
        c: Decline of the predators, 1/year.
        d: Growth of the predators per prey, 1/year.

    Returns:
        The system, with populations counted in thousands; both equations are to be learned.
    """
    _check("lotka_volterra", a=a, b=b, c=c, d=d)
    return _system(
        "lotka_volterra",
        {
            "prey": {"prey": float(a), "prey*predator": -float(b)},
            "predator": {"predator": -float(c), "prey*predator": float(d)},
        },
        units={"t": "year", "prey": "1", "predator": "1"},
        t=np.linspace(0.0, 30.0, 601),
        x0=(30.0, 4.0),
    )


def two_tanks(gain: float = 0.05, c1: float = 0.1, c2: float = 0.1, c3: float = 0.09) -> System:
    """Two tanks in cascade, filled by a pump and emptied by gravity (Torricelli's law).

    h1' = gain u - c1 sqrt(h1), h2' = c2 sqrt(h1) - c3 sqrt(h2); an empty tank has no outflow.

    Args:
        gain: Pump gain, cm/(V s).
        c1: Outflow of the upper tank, cm^0.5/s.
        c2: Inflow of the lower tank, cm^0.5/s.
        c3: Outflow of the lower tank, cm^0.5/s.

    Returns:
        The system, with a pump voltage between 1 V and 9 V; both equations are to be learned.
    """
    _check("two_tanks", gain=gain, c1=c1, c2=c2, c3=c3)
    return _system(
        "two_tanks",
        {
            "h1": {"u": float(gain), "sqrt(max(h1,0))": -float(c1)},
            "h2": {"sqrt(max(h1,0))": float(c2), "sqrt(max(h2,0))": -float(c3)},
        },
        units={"t": "s", "h1": "cm", "h2": "cm", "u": "V"},
        t=np.linspace(0.0, 1200.0, 601),
        x0=(4.0, 2.0),
        drives={"u": Drive(band=(1 / 600, 1 / 60), amplitude=4.0, offset=5.0)},
    )


def _system(name: str, truth: Mapping[str, Mapping[str, float]], units: Mapping[str, str], **settings: Any) -> System:
    """Return a system; `units` name t, states and inputs. The rate of a state without terms is the next state."""
    columns, n_state = tuple(units)[1:], len(settings["x0"])
    states = columns[:n_state]
    rates = {state: _sum(truth[state]) if state in truth else columns[i + 1] for i, state in enumerate(states)}
    return System(name, states, columns[n_state:], rates, truth, units, **settings)


def _sum(terms: Mapping[str, float]) -> str:
    """Write the right-hand side as text, in which every number reads back to the last bit."""
    text = " ".join(f"{'-' if value < 0 else '+'} {abs(value)!r}*{term}" for term, value in terms.items())
    return text.removeprefix("+ ") if text.startswith("+") else text.replace("- ", "-", 1)


def _check(system: str, positive: tuple[str, ...] = (), **parameters: float) -> None:
    for name, value in parameters.items():
        if not math.isfinite(value) or (name in positive and value <= 0):
            wanted = "a positive number" if name in positive else "a finite number"
            raise InputError(f"{name} of {system} is {value}; it must be {wanted}.")
