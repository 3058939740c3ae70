"""Samples of a system by one sensor, integrated by SciPy alone: nothing here knows how the study works."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from scipy.integrate import solve_ivp

from bayes_greybox.data.trajectories import Trajectories

Force = Callable[[float], float]
"""Input by time."""

CORRELATION = 0.9
"""Correlation of neighbouring samples under correlated noise."""

SHAKEN, KICKS = 0.03, 10
"""RMS of the velocity that random pushes give within a unit of time, and pushes between two samples, of the shaken
oscillator."""


@dataclass(frozen=True)
class System:
    """A system, what its simulation lacks, and how one of its states is sampled.

    Attributes:
        name: Name of the system.
        simulation: Right-hand sides that the study is given.
        equation: The state whose equation lacks something.
        truth: Coefficients of the effects that it lacks, by the catalogue's slug.
        rates: Rates of all states, from the states and the input.
        measured: The state that has a sensor; the others are hidden.
        step: Time between samples.
        samples: Number of samples.
        noise: Noise of the sensor over the spread of the measured state.
        start: States at the start of the training run and of the test run.
        force: Input of both; None where nothing drives the system.
        input: Name of the input.
        units: Units of columns.
        catalogue: Domain of the effects that are weighed.
        roles: Columns by role of the catalogue, where their names do not say it.
        sensor: "white" or "correlated".
        shaken: If true, random pushes act on the last state besides.
        same: Errors of the instrument that are the same as a hidden effect, by slug: an input's offset is a constant
            force.
        tolerance: Relative tolerance of the integrator.
    """

    name: str
    simulation: Mapping[str, str]
    equation: str
    truth: Mapping[str, float]
    rates: Callable[[Float[np.ndarray, " n_state"], float], Sequence[float]]
    measured: str
    step: float
    samples: int
    noise: float
    start: tuple[tuple[float, ...], tuple[float, ...]]
    force: tuple[Force, Force] | None = None
    input: str = "F"
    units: Mapping[str, str] = field(default_factory=dict)
    catalogue: str = "mechanical"
    roles: Mapping[str, str] | None = None
    sensor: str = "white"
    shaken: bool = False
    same: Mapping[str, str] = field(default_factory=dict)
    tolerance: float = 1e-10


def sampled(system: System, replicate: int, seed: int = 1) -> tuple[Trajectories, Trajectories]:
    """Sample a training and a test run with the noise of a replicate."""
    rng = np.random.default_rng([seed, replicate])
    train, test = (_run(system, part, rng) for part in (0, 1))
    return train, test


def _run(system: System, part: int, rng: np.random.Generator) -> Trajectories:
    t = system.step * np.arange(system.samples)
    x = _path(system, part, t, rng)
    shown = x + system.noise * np.std(x) * sensor_noise(system.sensor, len(t), rng)
    inputs = {} if system.force is None else {system.input: np.array([system.force[part](time) for time in t])}
    return Trajectories.from_arrays(t, states={system.measured: shown}, inputs=inputs, units=dict(system.units))


def _path(system: System, part: int, t: Float[np.ndarray, " n"], rng: np.random.Generator) -> np.ndarray:
    """Integrate the measured state."""
    drive = (lambda time: 0.0) if system.force is None else system.force[part]
    measured = list(system.simulation).index(system.measured)

    def motion(time: float, x: np.ndarray) -> Sequence[float]:
        return system.rates(x, drive(time))

    if not system.shaken:
        # No step is longer than a sample's, so that no edge of an input is stepped over.
        accurate = {"rtol": system.tolerance, "atol": 1e-2 * system.tolerance, "method": "DOP853"}
        whole = solve_ivp(motion, (0, t[-1]), system.start[part], t_eval=t, max_step=system.step, **accurate)
        return whole.y[measured]
    # Random pushes: a kick of the speed ten times between samples.
    x, found, h = np.array(system.start[part]), [system.start[part][measured]], system.step / KICKS
    for time in t[:-1]:
        for k in range(KICKS):
            x = solve_ivp(motion, (time + k * h, time + (k + 1) * h), x, rtol=1e-7, atol=1e-9).y[:, -1]
            x[-1] += SHAKEN * np.sqrt(h) * rng.standard_normal()
        found.append(x[measured])
    return np.array(found)


def sensor_noise(sensor: str, n: int, rng: np.random.Generator) -> Float[np.ndarray, " n"]:
    """Draw noise of unit spread, "white" or "correlated"."""
    e = rng.standard_normal(n)
    if sensor == "correlated":
        for i in range(1, n):
            e[i] = CORRELATION * e[i - 1] + np.sqrt(1 - CORRELATION**2) * e[i]
    return e
