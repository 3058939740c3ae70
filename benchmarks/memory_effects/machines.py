"""The machines: forced oscillators, effects hidden in them, and samples of a sensor; by NumPy and SciPy alone.

A mass on a spring, y″ = F − ω₀² y − 2ζω₀ y′ − β y³ + θ φ(y, y′, z), is driven by ten waves. z is what remembers, at
rest where a run starts as the mass is; an absorber starts with a mass that moves, and moves along with it. The
simulation knows all but θφ. How stiff and damped the host is, the force, how large what is hidden is and its inner
parameters differ from replicate to replicate; every other host is Duffing's.

LuGre's friction is σ₀ z + σ₁ z′ + σ₂ y′, z′ = y′ − σ₀ |y′| z/(F_c + (F_s − F_c) exp(−(y′/v_s)²)); its σ₂ is part of the
2ζω₀ that the simulation knows.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import exp, log, pi, sin
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.integrate import ode

from bayes_greybox.data.trajectories import Trajectories

POSITION_NOISES = (0.01, 0.05)
"""Noise of the position over its spread."""

SAMPLES, A_PERIOD = 1500, 30
"""Samples of a run, and of a period of the host without the hidden effect."""

HELD_OUT_SAMPLES = 600
"""Samples of the run that is held out."""

WAVES, BAND = 10, (0.3, 2.0)
"""Waves of the force, and the band of their frequencies over ω₀."""

AMPLITUDE, NATURAL, DAMPED, DUFFING = (0.5, 2.0), (0.8, 2.0), (0.02, 0.1), (0.1, 0.5)
"""RMS of the linear host's position; ω₀; ζ; the Duffing force over the linear one at that position."""

INSET = 1.15
"""Nonlinear parameters keep this factor off the ends of the catalogue's ranges."""

MOVING = 0.7
"""Standard deviation of the start of a mass that moves, over the RMS of the linear host's position and its speed."""

MOST_INTEGRATIONS, SETTLED = 20, 0.01
"""Most integrations of a machine until its nonlinear parameters are the shares of its own motion that were
drawn, to this precision: strong friction changes the motion that it is scaled by."""

DOP853 = {"name": "dop853", "rtol": 1e-9, "atol": 1e-11, "nsteps": 100_000}

Rates = Callable[[float, float, float, list[float], list[float]], list[float]]
"""Rates of the hidden states, from y, y′, F, z and the nonlinear parameters: plain numbers, for speed."""

Range = tuple[str, float, float]
"""Scale of a nonlinear parameter, "position", "velocity", "period" (of the position), "period of v", "frequency" or
"number", and its least and largest share of that."""


@dataclass(frozen=True)
class Hidden:
    """An effect that may be hidden.

    Attributes:
        name: Slug in the catalogue, or a name of its own where the catalogue does not have it.
        inner: Ranges of its nonlinear parameters.
        size: Least and largest θ over ω₀² if `stiff`, else θ itself; its logarithm is uniform.
        stiff: True if θ is a stiffness.
        sign: Sign of θ.
        states: Number of hidden states.
        rates: Rates of the hidden states.
        force: φ, of the same arguments.
        known: True if the catalogue has it.
        moves: If true, the mass moves where a run starts, and the hidden states (a position, a velocity) along with it.
    """

    name: str
    inner: tuple[Range, ...]
    size: tuple[float, float]
    stiff: bool
    sign: int
    states: int
    rates: Rates
    force: Callable[[float, float, float, list[float], list[float]], float]
    known: bool = True
    moves: bool = False


@dataclass(frozen=True)
class Machine:
    """A kind of case.

    Attributes:
        name: Name of the kind.
        hidden: Effect that its machines hide; None: nothing.
        noise: Noise of the position over its spread.
        weight: Cases of the kind over those of an effect of the catalogue.
    """

    name: str
    hidden: Hidden | None
    noise: float
    weight: float = 1.0


@dataclass(frozen=True)
class Measured:
    """A replicate.

    Attributes:
        simulation: Right-hand sides that the study is given.
        train, test: Samples to learn from and others.
        truth: Coefficient of the hidden effect, by slug; empty where the catalogue does not have it.
        inner: Nonlinear parameters of the hidden effect.
        share: RMS of the hidden effect over that of the spring's force.
    """

    simulation: Mapping[str, str]
    train: Trajectories
    test: Trajectories
    truth: Mapping[str, float]
    inner: tuple[float, ...]
    share: float


def hidden() -> tuple[Hidden, ...]:
    """Return all effects that may be hidden: those of the catalogue, then the others."""

    def pulled(y, v, F, z, _):
        return z[0]

    stiff: dict[str, Any] = {"stiff": True, "sign": -1, "states": 1, "force": pulled}
    return (
        Hidden("bouc-wen", (("position", 0.05, 1.0),), (0.2, 1.0), rates=_bouc_wen(1), **stiff),
        Hidden("dahl-friction", (("position", 0.05, 0.6),), (0.2, 1.0), rates=_dahl, **stiff),
        Hidden(
            "lugre-friction",
            (("position", 0.03, 0.6), ("velocity", 0.05, 0.6), ("number", 0.1, 1.5), ("period", 0.002, 0.1)),
            (0.4, 2.0), True, -1, 1, lambda y, v, F, z, p: [_bending(v, z[0], p)],
            lambda y, v, F, z, p: z[0] + p[3] * _bending(v, z[0], p),
        ),
        Hidden("maxwell-damper", (("period", 0.05, 1.0),), (0.1, 1.0), rates=_relaxing, **stiff),
        Hidden(
            "actuator-lag", (("period of v", 0.03, 0.6),), (1.0, 1.0), False, 1, 1,
            lambda y, v, F, z, p: [(F - z[0]) / p[0]], lambda y, v, F, z, p: z[0] - F,
        ),
        Hidden(
            "absorber", (("frequency", 0.4, 2.5), ("number", 0.01, 0.3)), (0.02, 0.2), False, 1, 2,
            lambda y, v, F, z, p: [z[1], -_pull(y, v, z, p)], lambda y, v, F, z, p: _pull(y, v, z, p), moves=True,
        ),
        Hidden("bouc-wen-3", (("position", 0.1, 0.6),), (0.2, 1.0), rates=_bouc_wen(3), **stiff, known=False),
        Hidden("elastic-plastic", (("position", 0.1, 0.6),), (0.2, 1.0), rates=_held, **stiff, known=False),
        Hidden(
            "two-branches", (("period", 0.05, 0.1),), (0.2, 1.0), True, -1, 2,
            lambda y, v, F, z, p: [v - z[0] / p[0], v - z[1] / (10 * p[0])], lambda y, v, F, z, p: z[0] + z[1],
            known=False,
        ),
    )  # fmt: skip


def machines() -> dict[str, Machine]:
    """Return all kinds of cases by name; half of those of the catalogue's effects hide nothing."""
    every = hidden()
    known = [each for each in every if each.known]
    found = []
    for noise in POSITION_NOISES:
        found += [Machine(f"{each.name}-{noise:g}", each, noise) for each in known]
        found.append(Machine(f"nothing-{noise:g}", None, noise, float(len(known))))
        found += [Machine(f"{each.name}-{noise:g}", each, noise, 1 / 3) for each in every if not each.known]
    return {machine.name: machine for machine in found}


def measured(machine: Machine, replicate: int, seed: int) -> Measured:
    """Integrate a replicate and sample it; odd ones are Duffing's."""
    rng = np.random.default_rng([seed, replicate, *machine.name.encode()])
    w0, zeta, amplitude = (_drawn(rng, *limits) for limits in (NATURAL, DAMPED, AMPLITUDE))
    beta = _drawn(rng, *DUFFING) * w0**2 / amplitude**2 if replicate % 2 else 0.0
    frequency = w0 * rng.uniform(*BAND, WAVES)
    level = amplitude * np.sqrt(2) / np.linalg.norm(1 / np.abs(w0**2 - frequency**2 + 2j * zeta * w0 * frequency))
    forces = [_waves(frequency, rng.uniform(0, 2 * pi, WAVES), level) for _ in range(2)]
    own, step = machine.hidden, 2 * pi / w0 / A_PERIOD
    theta, inner, shares = 0.0, np.ones(len(own.inner) if own is not None else 1), np.ones(1)
    begun = np.zeros(2 + (own.states if own is not None else 0))
    if own is not None:
        theta = own.sign * _drawn(rng, *own.size) * (w0**2 if own.stiff else 1.0)
        shares = np.array([_drawn(rng, low * INSET, high / INSET) for _, low, high in own.inner])
        if own.moves:
            begun[:2] = MOVING * amplitude * rng.standard_normal(2) * [1.0, w0]
            begun[2:] = begun[:2]

    def integrated(force: Callable, n: int) -> tuple[np.ndarray, np.ndarray]:
        p = inner.tolist()

        def motion(t: float, x: np.ndarray) -> list[float]:
            y, v, *z = x.tolist()
            F = force(t)
            pull = theta * own.force(y, v, F, z, p) if own is not None else 0.0
            known = F - w0**2 * y - 2 * zeta * w0 * v - beta * y**3
            return [v, known + pull, *(own.rates(y, v, F, z, p) if own is not None else ())]

        t = step * np.arange(n)
        # From sample to sample, by a compiled solver.
        solver = ode(motion).set_integrator(**DOP853, first_step=step).set_initial_value(begun)
        path = np.stack([begun, *(solver.integrate(each) for each in t[1:])], axis=1)
        assert solver.successful()
        return t, path

    t, x = integrated(forces[0], SAMPLES)
    if own is not None:
        for _ in range(MOST_INTEGRATIONS):
            before, inner = inner, shares * [_size(scale, x, step) for scale, _, _ in own.inner]
            t, x = integrated(forces[0], SAMPLES)
            if np.all(np.abs(np.log(inner / before)) < SETTLED):
                break
    F = np.array([forces[0](each) for each in t])
    hid = [0.0]
    if own is not None:
        hid = [theta * own.force(y, v, f, z, inner.tolist()) for (y, v, *z), f in zip(x.T.tolist(), F, strict=True)]
    simulation = {"y": "v", "v": f"F - {w0**2!r}*y - {2 * zeta * w0!r}*v" + (f" - {beta!r}*y**3" if beta else "")}
    parts = []
    for force, (time, path) in zip(forces, ((t, x), integrated(forces[1], HELD_OUT_SAMPLES)), strict=True):
        shown = path[0] + machine.noise * np.std(x[0]) * rng.standard_normal(len(time))
        inputs = {"F": np.array([force(each) for each in time])}
        units = {"t": "s", "y": "m", "F": "m/s^2"}
        parts.append(Trajectories.from_arrays(time, states={"y": shown}, inputs=inputs, units=units))
    truth = {own.name: theta} if own is not None and own.known else {}
    of_spring = float(np.sqrt(np.mean(np.square(hid)))) / (w0**2 * float(np.sqrt(np.mean(x[0] ** 2))))
    return Measured(simulation, parts[0], parts[1], truth, tuple(map(float, inner)), of_spring)


def _drawn(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(log(low), log(high))))


def _waves(frequency: np.ndarray, phase: np.ndarray, level: float) -> Callable[[float], float]:
    waves = list(zip(frequency.tolist(), phase.tolist(), strict=True))
    return lambda t: level * sum([sin(w * t + shift) for w, shift in waves])


def _size(scale: str, x: Float[np.ndarray, "n_state n"], step: float) -> float:
    """Return the scale of a nonlinear parameter by the motion itself."""
    y, v = x[0], x[1]
    if scale == "number":
        return 1.0
    if scale in ("position", "velocity"):
        return float(np.max(np.abs(y if scale == "position" else v)))
    if scale == "frequency":
        return float(np.sqrt(np.mean(v**2)) / np.std(y))
    if scale == "period":
        return float(2 * pi * np.std(y) / np.sqrt(np.mean(v**2)))
    return float(2 * pi * np.std(v) / np.sqrt(np.mean(np.gradient(v, step) ** 2)))


def _bouc_wen(n: int) -> Rates:
    def rates(y, v, F, z, p):
        return [v - (abs(v) * abs(z[0]) ** (n - 1) * z[0] + v * abs(z[0]) ** n) / (2 * p[0] ** n)]

    return rates


def _dahl(y, v, F, z, p):
    return [v - abs(v) * z[0] / p[0]]


def _bending(v, z, p):
    """Return the rate of LuGre's asperities, from F_c/σ₀, v_s, F_s/F_c − 1 and σ₁/σ₀."""
    presliding, stribeck, excess, _ = p
    return v - abs(v) * z / (presliding * (1 + excess * exp(-((v / stribeck) ** 2))))


def _relaxing(y, v, F, z, p):
    return [v - z[0] / p[0]]


def _held(y, v, F, z, p):
    """An elastic element that slides at its limit."""
    return [0.0 if abs(z[0]) >= p[0] and z[0] * v > 0 else v]


def _pull(y, v, z, p):
    """Return the force of a mass on a spring and a damper, over its mass, by its frequency and damping ratio."""
    return p[0] ** 2 * (z[0] - y) + 2 * p[1] * p[0] * (z[1] - v)
