"""The systems and their samples, integrated by SciPy alone: nothing here knows how the study works.

Each has a simulation that lacks something, which a position of a test run with another start or another force lacks as
well. Coulomb friction is tanh(v/v₀) with v₀ far below anything that the sensor resolves.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from scipy.integrate import solve_ivp

from bayes_greybox.data.trajectories import Trajectories

Force = Callable[[float], float]
"""Input by time."""

CORRELATION = 0.9
"""Of neighbouring samples under correlated noise."""

SHAKEN = 0.03
"""RMS of the velocity that random pushes give within a unit of time, of the oscillator that is shaken."""


@dataclass(frozen=True)
class System:
    """A system, what its simulation lacks, and how its position is sampled.

    Attributes:
        name: Of the system.
        simulation: What the study is given.
        truth: Coefficients of what it lacks, by the catalogue's slug.
        rate: Acceleration from position, speed and input.
        step: Between samples.
        samples: Number of samples.
        noise: Of the sensor, over the spread of the position.
        start: Position and speed at the start of the training run and of the test run.
        force: Input of both; None where nothing drives the system.
        sensor: "white" or "correlated".
        shaken: Whether random pushes act on it, besides.
        same: Errors of the instrument that are the same as what is hidden, by slug: an input's offset is a constant
            force.
        tolerance: Of the integrator.
    """

    name: str
    simulation: Mapping[str, str]
    truth: Mapping[str, float]
    rate: Callable[[float, float, float], float]
    step: float
    samples: int
    noise: float
    start: tuple[tuple[float, float], tuple[float, float]]
    force: tuple[Force, Force] | None = None
    sensor: str = "white"
    shaken: bool = False
    same: Mapping[str, str] = field(default_factory=dict)
    tolerance: float = 1e-10


def systems() -> dict[str, System]:
    """All systems by name."""
    pendulum, friction = 4 * np.pi**2, {"coulomb-friction": -0.052, "quadratic-drag": -0.0045}
    omega = 2 * np.pi * 37
    oscillator = {
        "simulation": {"y": "v", "v": "F - 2*y - 0.15*v"},
        "truth": {"cubic-stiffness": -0.3},
        "rate": lambda y, v, F: F - 2 * y - 0.15 * v - 0.3 * y**3,
        "step": 0.1,
        "samples": 400,
        "noise": 0.03,
        "start": ((0.3, 0.0), (-0.4, 0.1)),
        "force": (lambda t: _waves(t, 0.0), lambda t: _waves(t, 1.0)),
    }
    axis = {"coulomb-friction": -0.4, "viscous-damping": -1.5, "constant-force": 0.12}
    every = [
        System(
            "pendulum-decay",
            {"y": "v", "v": f"-{pendulum!r}*sin(y)"},
            friction,
            lambda y, v, _: -pendulum * np.sin(y) - 0.052 * np.tanh(v / 1e-4) - 0.0045 * v * abs(v),
            step=0.02,
            samples=5000,
            noise=1e-3,
            start=((1.5, 0.0), (1.2, 0.0)),
        ),
        System(
            "positioning-axis",
            {"y": "v", "v": "u"},
            axis,
            lambda y, v, u: u - 0.4 * np.tanh(v / 1e-4) - 1.5 * v + 0.12,
            step=1e-3,
            samples=8000,
            noise=1e-3,
            start=((0.0, 0.5), (0.0, -0.5)),
            force=(lambda t: _controlled(t, 0.0), lambda t: _controlled(t, 2.0)),
            same={"constant-force": "offset"},
        ),
        System(
            "beam-ring-down",
            {"y": "v", "v": f"-{omega**2!r}*y - {0.01 * omega!r}*v"},
            {"quadratic-stiffness": -4e3, "cubic-stiffness": -8e3},
            lambda y, v, _: -(omega**2) * y - 0.01 * omega * v - 4e3 * y**2 - 8e3 * y**3,
            step=5e-4,
            samples=2000,
            noise=0.01,
            start=((1.0, 0.0), (0.8, 0.0)),
        ),
        System("oscillator-white", **oscillator),
        System("oscillator-correlated", **oscillator, sensor="correlated"),
        System("oscillator-shaken", **oscillator, shaken=True),
    ]
    return {system.name: system for system in every}


def sampled(system: System, replicate: int, seed: int = 1) -> tuple[Trajectories, Trajectories]:
    """Training and test samples.

    Args:
        system: The system.
        replicate: Of its noise.
        seed: Of all noise.
    """
    rng = np.random.default_rng([seed, replicate])
    train, test = (_run(system, part, rng) for part in (0, 1))
    return train, test


def _run(system: System, part: int, rng: np.random.Generator) -> Trajectories:
    t = system.step * np.arange(system.samples)
    y = _position(system, part, t, rng)
    shown = y + system.noise * np.std(y) * _noise(system.sensor, len(t), rng)
    inputs = {} if system.force is None else {_input(system): np.array([system.force[part](time) for time in t])}
    units = {"t": "s", "y": "m"}
    return Trajectories.from_arrays(t, states={"y": shown}, inputs=inputs, units=units)


def _position(system: System, part: int, t: Float[np.ndarray, " n"], rng: np.random.Generator) -> np.ndarray:
    drive = (lambda time: 0.0) if system.force is None else system.force[part]

    def motion(time: float, x: np.ndarray) -> list[float]:
        return [x[1], system.rate(x[0], x[1], drive(time))]

    accurate = {"rtol": system.tolerance, "atol": 1e-2 * system.tolerance, "method": "DOP853"}
    if not system.shaken:
        return solve_ivp(motion, (0, t[-1]), system.start[part], t_eval=t, **accurate).y[0]
    # Random pushes: a kick of the speed ten times between samples.
    x, found, h = np.array(system.start[part]), [system.start[part][0]], system.step / 10
    for time in t[:-1]:
        for k in range(10):
            x = solve_ivp(motion, (time + k * h, time + (k + 1) * h), x, rtol=1e-7, atol=1e-9).y[:, -1]
            x = x + np.array([0.0, SHAKEN * np.sqrt(h) * rng.standard_normal()])
        found.append(x[0])
    return np.array(found)


def _noise(sensor: str, n: int, rng: np.random.Generator) -> np.ndarray:
    e = rng.standard_normal(n)
    if sensor == "correlated":
        for i in range(1, n):
            e[i] = CORRELATION * e[i - 1] + np.sqrt(1 - CORRELATION**2) * e[i]
    return e


def _input(system: System) -> str:
    return "u" if "u" in system.simulation["v"] else "F"


def _waves(t: float, phase: float) -> float:
    return 0.9 * np.sin(1.1 * t + phase) + 0.5 * np.sin(2.3 * t + 1) + 0.4 * np.sin(0.47 * t + 2)


def _controlled(t: float, phase: float) -> float:
    """What a controller asks for: friction along a reference of two waves made up for but for a part, and some more."""
    speed = 0.5 * np.cos(3.1 * t + phase) + 0.3 * np.cos(7.3 * t)
    change = -0.5 * 3.1 * np.sin(3.1 * t + phase) - 0.3 * 7.3 * np.sin(7.3 * t)
    return change + 1.5 * speed + 0.4 * np.tanh(speed / 0.05) - 0.12
