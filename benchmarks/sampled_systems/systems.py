"""The systems: their motion, the effects that their simulations lack, and their sensors.

A test run with another start or another force lacks the same effects. Coulomb friction is tanh(v/v₀)
with v₀ far below anything that the sensor resolves.
"""

import numpy as np

from .samples import System

METRES = {"t": "s", "y": "m"}
"""Units of a position."""

HIDDEN_STATE_NOISES = (0.01, 0.05)
"""Noise of the systems with hidden states, over the spread of the one that is measured."""


def systems() -> dict[str, System]:
    """Return all systems by name."""
    every = [_pendulum(), _axis(), _beam(), *_oscillators()]
    for noise in HIDDEN_STATE_NOISES:
        every += [_two_masses(noise), _twin_tanks(noise), _predators(noise)]
    return {system.name: system for system in every}


def _pendulum() -> System:
    stiffness = 4 * np.pi**2
    return System(
        "pendulum-decay",
        {"y": "v", "v": f"-{stiffness!r}*sin(y)"},
        "v",
        {"coulomb-friction": -0.052, "quadratic-drag": -0.0045},
        lambda x, _: (x[1], -stiffness * np.sin(x[0]) - 0.052 * np.tanh(x[1] / 1e-4) - 0.0045 * x[1] * abs(x[1])),
        "y",
        step=0.02,
        samples=5000,
        noise=1e-3,
        start=((1.5, 0.0), (1.2, 0.0)),
        units=METRES,
    )


def _axis() -> System:
    return System(
        "positioning-axis",
        {"y": "v", "v": "u"},
        "v",
        {"coulomb-friction": -0.4, "viscous-damping": -1.5, "constant-force": 0.12},
        lambda x, u: (x[1], u - 0.4 * np.tanh(x[1] / 1e-4) - 1.5 * x[1] + 0.12),
        "y",
        step=1e-3,
        samples=8000,
        noise=1e-3,
        start=((0.0, 0.5), (0.0, -0.5)),
        force=(lambda t: _controlled(t, 0.0), lambda t: _controlled(t, 2.0)),
        input="u",
        units=METRES,
        same={"constant-force": "offset"},
    )


def _beam() -> System:
    omega = 2 * np.pi * 37
    return System(
        "beam-ring-down",
        {"y": "v", "v": f"-{omega**2!r}*y - {0.01 * omega!r}*v"},
        "v",
        {"quadratic-stiffness": -4e3, "cubic-stiffness": -8e3},
        lambda x, _: (x[1], -(omega**2) * x[0] - 0.01 * omega * x[1] - 4e3 * x[0] ** 2 - 8e3 * x[0] ** 3),
        "y",
        step=5e-4,
        samples=2000,
        noise=0.01,
        start=((1.0, 0.0), (0.8, 0.0)),
        units=METRES,
    )


def _oscillators() -> list[System]:
    oscillator = {
        "simulation": {"y": "v", "v": "F - 2*y - 0.15*v"},
        "equation": "v",
        "truth": {"cubic-stiffness": -0.3},
        "rates": lambda x, F: (x[1], F - 2 * x[0] - 0.15 * x[1] - 0.3 * x[0] ** 3),
        "measured": "y",
        "step": 0.1,
        "samples": 400,
        "noise": 0.03,
        "start": ((0.3, 0.0), (-0.4, 0.1)),
        "force": (lambda t: _waves(t, 0.0), lambda t: _waves(t, 1.0)),
        "units": METRES,
    }
    return [
        System("oscillator-white", **oscillator),
        System("oscillator-correlated", **oscillator, sensor="correlated"),
        System("oscillator-shaken", **oscillator, shaken=True),
    ]


def _two_masses(noise: float) -> System:
    """Two masses of which one is seen, and the spring between it and the wall hardens."""

    def rates(x, F):
        between = 1.2 * (x[0] - x[2])
        return x[1], F - 2 * x[0] - 0.15 * x[1] - between - 0.4 * x[0] ** 3, x[3], between - 0.1 * x[3] - 0.8 * x[2]

    return System(
        f"two-masses-{noise:g}",
        {"y": "v", "v": "F - 2*y - 0.15*v - 1.2*(y - z)", "z": "w", "w": "1.2*(y - z) - 0.1*w - 0.8*z"},
        "v",
        {"cubic-stiffness": -0.4},
        rates,
        "y",
        step=0.1,
        samples=600,
        noise=noise,
        start=((0.3, 0.0, 0.0, 0.0), (-0.2, 0.0, 0.1, 0.0)),
        force=(lambda t: _waves(t, 0.0), lambda t: _waves(t, 1.0)),
        units=METRES,
        roles={"position": "y", "velocity": "v", "input": "F"},
    )


def _twin_tanks(noise: float) -> System:
    """Two tanks of which the lower level is seen, and its outlet is not as the simulation has it."""

    def rates(h, u):
        upper, lower = np.sqrt(np.maximum(h, 0.0))
        return 0.1 * u - 0.045 * upper, 0.045 * upper - 0.02 * h[1] - 0.022 * lower

    def pumped(t, phase):
        return 1.0 + 0.6 * np.sin(0.03 * t + phase) + 0.3 * np.sign(np.sin(0.011 * t + 1 + phase))

    return System(
        f"twin-tanks-{noise:g}",
        {"h1": "0.1*u - 0.045*sqrt(h1)", "h2": "0.045*sqrt(h1) - 0.02*h2"},
        "h2",
        {"torricelli-outflow": -0.022},
        rates,
        "h2",
        step=1.0,
        samples=500,
        noise=noise,
        start=((4.0, 4.0), (2.5, 5.0)),
        force=(lambda t: pumped(t, 0.0), lambda t: pumped(t, 1.0)),
        input="u",
        units={"t": "s", "h2": "m", "u": "m/s"},
        catalogue="fluid",
    )


def _predators(noise: float) -> System:
    """Predators and prey, of which the prey is counted and crowds itself."""
    return System(
        f"predator-prey-{noise:g}",
        {"x": "1.5*x - x*y", "y": "x*y - 3*y"},
        "x",
        {"logistic-crowding": -0.12},
        lambda x, _: (1.5 * x[0] - x[0] * x[1] - 0.12 * x[0] ** 2, x[0] * x[1] - 3 * x[1]),
        "x",
        step=0.1,
        samples=200,
        noise=noise,
        start=((5.0, 3.0), (3.0, 2.0)),
        catalogue="population",
    )


def _waves(t: float, phase: float) -> float:
    return 0.9 * np.sin(1.1 * t + phase) + 0.5 * np.sin(2.3 * t + 1) + 0.4 * np.sin(0.47 * t + 2)


def _controlled(t: float, phase: float) -> float:
    """Force of a controller: friction along a reference of two waves made up for but for a part, and some more."""
    speed = 0.5 * np.cos(3.1 * t + phase) + 0.3 * np.cos(7.3 * t)
    change = -0.5 * 3.1 * np.sin(3.1 * t + phase) - 0.3 * 7.3 * np.sin(7.3 * t)
    return change + 1.5 * speed + 0.4 * np.tanh(speed / 0.05) - 0.12
