"""The machines: forced oscillators, what is hidden in them, and what a sensor shows; by NumPy and SciPy alone.

A mass on a spring, y″ = F − ω₀² y − 2ζω₀ y′ − β y³ + θ φ(y, y′, z), is driven by ten waves. z is what remembers, at
rest where a run starts as the mass is. The simulation knows all but θφ. How stiff and damped the host is, the force,
how large what is hidden is and its inner parameter differ from replicate to replicate; every other host is Duffing's.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import log, pi
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.integrate import solve_ivp

from bayes_greybox.data.trajectories import Trajectories

LEVELS = (0.01, 0.05)
"""Noise of the position over its spread."""

SAMPLES, A_PERIOD = 1500, 30
"""Of a run, and of a period of the host without what is hidden."""

HELD_OUT = 600
"""Samples of the run that is held out."""

WAVES, BAND = 10, (0.3, 2.0)
"""Waves of the force, and the band of their frequencies over ω₀."""

AMPLITUDE, NATURAL, DAMPED, BENT = (0.5, 2.0), (0.8, 2.0), (0.02, 0.1), (0.1, 0.5)
"""RMS of the linear host's position; ω₀; ζ; the Duffing force over the linear one at that position."""

INSET = 1.15
"""Inner parameters keep this factor off the ends of the catalogue's ranges."""

TURNS = 3
"""How often a machine is integrated until its inner parameter is the share of its own motion that was drawn."""

ACCURATE = {"method": "DOP853", "rtol": 1e-8, "atol": 1e-10}

Rates = Callable[[float, float, float, np.ndarray, float], list[float]]
"""Rates of what is hidden, from y, y′, F, z and the inner parameter."""


@dataclass(frozen=True)
class Hidden:
    """What is hidden.

    Attributes:
        name: Slug in the catalogue, or a name of its own where the catalogue does not have it.
        scale: What its inner parameter is a share of: "position", "period" (of the position), "period of v", or
            "frequency".
        share: Least and largest share.
        size: Least and largest θ over ω₀² if `stiff`, else θ itself; its logarithm is uniform.
        stiff: Whether θ is a stiffness.
        sign: Of θ.
        states: Hidden states.
        rates: Theirs.
        force: φ, of the same arguments.
        known: Whether the catalogue has it.
    """

    name: str
    scale: str
    share: tuple[float, float]
    size: tuple[float, float]
    stiff: bool
    sign: int
    states: int
    rates: Rates
    force: Callable[[float, float, float, np.ndarray, float], float]
    known: bool = True


@dataclass(frozen=True)
class Machine:
    """A kind of case.

    Attributes:
        name: Of the kind.
        hidden: What its machines hide; None: nothing.
        noise: Over the spread of the position.
        weight: Cases of the kind, over those of an effect of the catalogue.
    """

    name: str
    hidden: Hidden | None
    noise: float
    weight: float = 1.0


@dataclass(frozen=True)
class Measured:
    """A replicate.

    Attributes:
        simulation: What the study is given.
        train, test: Samples to learn from and others.
        truth: Coefficient of what is hidden, by slug; empty where the catalogue does not have it.
        inner: Its inner parameter.
        share: RMS of what is hidden over that of the spring's force.
    """

    simulation: Mapping[str, str]
    train: Trajectories
    test: Trajectories
    truth: Mapping[str, float]
    inner: float
    share: float


def hidden() -> tuple[Hidden, ...]:
    """All that may be hidden: what the catalogue has, then what it has not."""

    def pulled(y, v, F, z, _):
        return z[0]

    stiff: dict[str, Any] = {"stiff": True, "sign": -1, "states": 1, "force": pulled}
    return (
        Hidden("bouc-wen", "position", (0.05, 1.0), (0.2, 1.0), rates=_bouc_wen(1), **stiff),
        Hidden("dahl-friction", "position", (0.05, 0.6), (0.2, 1.0), rates=_dahl, **stiff),
        Hidden("maxwell-damper", "period", (0.05, 1.0), (0.1, 1.0), rates=_relaxing, **stiff),
        Hidden(
            "actuator-lag", "period of v", (0.03, 0.6), (1.0, 1.0), False, 1, 1,
            lambda y, v, F, z, tau: [(F - z[0]) / tau], lambda y, v, F, z, tau: z[0] - F,
        ),
        Hidden(
            "absorber", "frequency", (0.4, 2.5), (0.02, 0.2), False, 1, 2,
            lambda y, v, F, z, w: [z[1], -_pull(y, v, z, w)], lambda y, v, F, z, w: _pull(y, v, z, w),
        ),
        Hidden("bouc-wen-3", "position", (0.1, 0.6), (0.2, 1.0), rates=_bouc_wen(3), **stiff, known=False),
        Hidden("elastic-plastic", "position", (0.1, 0.6), (0.2, 1.0), rates=_held, **stiff, known=False),
        Hidden(
            "two-branches", "period", (0.05, 0.1), (0.2, 1.0), True, -1, 2,
            lambda y, v, F, z, tau: [v - z[0] / tau, v - z[1] / (10 * tau)], lambda y, v, F, z, tau: z[0] + z[1],
            known=False,
        ),
    )  # fmt: skip


def machines() -> dict[str, Machine]:
    """All kinds of cases by name; half of those of the catalogue's effects hide nothing."""
    every = hidden()
    known = [each for each in every if each.known]
    found = []
    for noise in LEVELS:
        found += [Machine(f"{each.name}-{noise:g}", each, noise) for each in known]
        found.append(Machine(f"nothing-{noise:g}", None, noise, float(len(known))))
        found += [Machine(f"{each.name}-{noise:g}", each, noise, 1 / 3) for each in every if not each.known]
    return {machine.name: machine for machine in found}


def measured(machine: Machine, replicate: int, seed: int) -> Measured:
    """Integrate a replicate and sample it.

    Args:
        machine: Of what kind it is.
        replicate: Its number; odd ones are Duffing's.
        seed: Of everything that is drawn.
    """
    rng = np.random.default_rng([seed, replicate, *machine.name.encode()])
    w0, zeta, amplitude = (_drawn(rng, *limits) for limits in (NATURAL, DAMPED, AMPLITUDE))
    beta = _drawn(rng, *BENT) * w0**2 / amplitude**2 if replicate % 2 else 0.0
    frequency = w0 * rng.uniform(*BAND, WAVES)
    level = amplitude * np.sqrt(2) / np.linalg.norm(1 / np.abs(w0**2 - frequency**2 + 2j * zeta * w0 * frequency))
    forces = [_waves(frequency, rng.uniform(0, 2 * pi, WAVES), level) for _ in range(2)]
    own, step = machine.hidden, 2 * pi / w0 / A_PERIOD
    theta, inner, share = 0.0, 1.0, 1.0
    if own is not None:
        theta = own.sign * _drawn(rng, *own.size) * (w0**2 if own.stiff else 1.0)
        share = _drawn(rng, own.share[0] * INSET, own.share[1] / INSET)

    def integrated(force: Callable, n: int) -> tuple[np.ndarray, np.ndarray]:
        def motion(t: float, x: np.ndarray) -> list[float]:
            y, v, z, F = x[0], x[1], x[2:], force(t)
            pull = theta * own.force(y, v, F, z, inner) if own is not None else 0.0
            known = F - w0**2 * y - 2 * zeta * w0 * v - beta * y**3
            return [v, known + pull, *(own.rates(y, v, F, z, inner) if own is not None else ())]

        t, start = step * np.arange(n), np.zeros(2 + (own.states if own is not None else 0))
        return t, solve_ivp(motion, (0, t[-1]), start, t_eval=t, max_step=step, **ACCURATE).y

    t, x = integrated(forces[0], SAMPLES)
    if own is not None:
        for _ in range(TURNS):
            inner = share * _size(own, x, step)
            t, x = integrated(forces[0], SAMPLES)
    F = np.array([forces[0](each) for each in t])
    hid = [0.0]
    if own is not None:
        hid = [theta * own.force(x[0, i], x[1, i], F[i], x[2:, i], inner) for i in range(len(t))]
    simulation = {"y": "v", "v": f"F - {w0**2!r}*y - {2 * zeta * w0!r}*v" + (f" - {beta!r}*y**3" if beta else "")}
    parts = []
    for force, (time, path) in zip(forces, ((t, x), integrated(forces[1], HELD_OUT)), strict=True):
        shown = path[0] + machine.noise * np.std(x[0]) * rng.standard_normal(len(time))
        inputs = {"F": np.array([force(each) for each in time])}
        units = {"t": "s", "y": "m", "F": "m/s^2"}
        parts.append(Trajectories.from_arrays(time, states={"y": shown}, inputs=inputs, units=units))
    truth = {own.name: theta} if own is not None and own.known else {}
    of_spring = float(np.sqrt(np.mean(np.square(hid)))) / (w0**2 * float(np.sqrt(np.mean(x[0] ** 2))))
    return Measured(simulation, parts[0], parts[1], truth, inner, of_spring)


def _drawn(rng: np.random.Generator, low: float, high: float) -> float:
    """A number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(log(low), log(high))))


def _waves(frequency: np.ndarray, phase: np.ndarray, level: float) -> Callable[[float], float]:
    return lambda t: float(level * np.sum(np.sin(frequency * t + phase)))


def _size(own: Hidden, x: Float[np.ndarray, "n_state n"], step: float) -> float:
    """What the share of an inner parameter is of, by the motion itself."""
    y, v = x[0], x[1]
    if own.scale == "position":
        return float(np.max(np.abs(y)))
    if own.scale == "frequency":
        return float(np.sqrt(np.mean(v**2)) / np.std(y))
    if own.scale == "period":
        return float(2 * pi * np.std(y) / np.sqrt(np.mean(v**2)))
    return float(2 * pi * np.std(v) / np.sqrt(np.mean(np.gradient(v, step) ** 2)))


def _bouc_wen(n: int) -> Rates:
    def rates(y, v, F, z, limit):
        return [v - (abs(v) * abs(z[0]) ** (n - 1) * z[0] + v * abs(z[0]) ** n) / (2 * limit**n)]

    return rates


def _dahl(y, v, F, z, limit):
    return [v - abs(v) * z[0] / limit]


def _relaxing(y, v, F, z, tau):
    return [v - z[0] / tau]


def _held(y, v, F, z, limit):
    """An elastic element that slides at its limit."""
    return [0.0 if abs(z[0]) >= limit and z[0] * v > 0 else v]


def _pull(y, v, z, w):
    """Of a mass on a spring and a damper of 5 % of the critical one, over its mass."""
    return w**2 * (z[0] - y) + 0.1 * w * (z[1] - v)
