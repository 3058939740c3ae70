"""The maps: columns, simulation and what it lacks; by NumPy alone, which knows nothing of the study.

A rig moves a part back and forth at several amplitudes and frequencies, a run each, and measures the force that this
takes; or a pump drives a flow through a valve at several pressures. All runs are sampled at one rate. How large what is
hidden is, and where it bends, differs from replicate to replicate.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.trajectories import Trajectories
from benchmarks.sampled_systems.samples import sensor_noise

NOISE_OF_OUTPUT = 0.05
"""Standard deviation of the output's noise over the output's spread."""

SWEEP_SAMPLES, STEP_OF = 100, {"F": 0.04, "q": 0.4}
"""Samples of a run, and time from sample to sample by output."""

HIDDEN = (0.02, 0.4)
"""RMS of what is hidden over that of what the simulation knows, least and most; its logarithm is uniform."""

CREEP = (0.05, 0.3)
"""Speed over which friction builds up, over the largest speed, least and most."""

STIFFNESS, DAMPING, LEAK = 2000.0, 50.0, 0.3
"""Coefficients of the force and of the flow that simulations know."""

Columns = Mapping[str, Float[np.ndarray, " n"]]
"""Columns of a run beside the output."""


@dataclass(frozen=True)
class StaticMap:
    """A map and what its simulation lacks.

    Attributes:
        name: Name of the map.
        output: Name of the measured output.
        simulation: Formula that the study is given.
        hidden: Slug of the effect that it lacks; None where it lacks nothing.
        sensor: "white" or "correlated".
        catalogue: Domain of the effects that are weighed.
        roles: Columns by role of the catalogue, where their units do not say it.
        units: Units of columns.
    """

    name: str
    output: str
    simulation: str
    hidden: str | None
    sensor: str
    catalogue: str
    roles: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Measured:
    """A replicate.

    Attributes:
        train, test: Rows to learn from and others.
        truth: Coefficient of the hidden effect, by slug.
        noise: Standard deviation of the noise.
    """

    train: Trajectories
    test: Trajectories
    truth: Mapping[str, float]
    noise: float


def maps() -> dict[str, StaticMap]:
    """Return all maps by name."""
    every = []
    for sensor in ("white", "correlated"):
        for name, hidden in (("friction", "smooth-friction"), ("drag", "quadratic-drag"), ("force-control", None)):
            simulation = f"{STIFFNESS}*x + {DAMPING}*v"
            units = {"t": "s", "x": "m", "v": "m/s", "F": "N"}
            every.append(StaticMap(f"{name}-{sensor}", "F", simulation, hidden, sensor, "mechanical", units=units))
        for name, hidden in (("valve", "torricelli-outflow"), ("flow-control", None)):
            units = {"t": "s", "p": "bar", "q": "m^3/h"}
            every.append(
                StaticMap(
                    f"{name}-{sensor}", "q", f"{LEAK}*p", hidden, sensor, "fluid", roles={"level": "p"}, units=units
                )
            )
    return {each.name: each for each in every}


def measured(each: StaticMap, replicate: int, seed: int = 1) -> Measured:
    """Measure training and test rows of a replicate."""
    # Maps share no noise: what is unlucky for one is not so for all.
    rng = np.random.default_rng([seed, replicate, *each.name.encode()])
    sweep = _rig if each.output == "F" else _pump
    parts = [sweep(part, rng) for part in (0, 1)]
    share, bend = np.exp(rng.uniform(*np.log(HIDDEN))), rng.uniform(*CREEP)
    first = _joined(parts[0])
    creep = bend * float(np.max(np.abs(first["v"]))) if "v" in first else 0.0
    size = 0.0
    if each.hidden is not None:
        size = share * rms(known(each, first)) / rms(_shape(each.hidden, first, creep))

    def run_of(columns: Columns) -> Float[np.ndarray, " n"]:
        return known(each, columns) + (size * _shape(each.hidden, columns, creep) if each.hidden else 0.0)

    # One sensor: its noise is as large on test rows as on training rows.
    noise = NOISE_OF_OUTPUT * float(np.std(np.concatenate([run_of(columns) for columns in parts[0]])))
    tables = []
    for part in parts:
        outputs = [run_of(columns) + noise * sensor_noise(each.sensor, SWEEP_SAMPLES, rng) for columns in part]
        rest = {name: [columns[name] for columns in part] for name in part[0]}
        states, inputs = (rest, None) if each.output == "F" else (None, rest)
        stamps = [STEP_OF[each.output] * np.arange(SWEEP_SAMPLES)] * len(part)
        tables.append(
            Trajectories.from_arrays(
                stamps, states=states, inputs=inputs, outputs={each.output: outputs}, units=dict(each.units)
            )
        )
    return Measured(*tables, truth={each.hidden: size} if each.hidden else {}, noise=noise)


def known(each: StaticMap, columns: Columns) -> Float[np.ndarray, " n"]:
    """Evaluate the simulation at columns of one run or of several."""
    return LEAK * columns["p"] if each.output == "q" else STIFFNESS * columns["x"] + DAMPING * columns["v"]


def rms(values: Float[np.ndarray, " n"]) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def _rig(part: int, rng: np.random.Generator) -> list[Columns]:
    """Return position and speed of each run."""
    amplitudes, frequencies = (((0.02, 0.05, 0.1), (0.5, 2.0)), ((0.035, 0.08), (0.8, 1.6)))[part]
    runs = []
    for amplitude, frequency in product(amplitudes, frequencies):
        angle = 2 * np.pi * frequency * STEP_OF["F"] * np.arange(SWEEP_SAMPLES) + rng.uniform(0, 2 * np.pi)
        runs.append({"x": amplitude * np.sin(angle), "v": 2 * np.pi * frequency * amplitude * np.cos(angle)})
    return runs


def _pump(part: int, rng: np.random.Generator) -> list[Columns]:
    """Return the pressure difference of each run."""
    pressures, frequencies = (((0.5, 2.0, 4.0), (0.05, 0.2)), ((1.0, 3.0), (0.08, 0.15)))[part]
    runs = []
    for pressure, frequency in product(pressures, frequencies):
        angle = 2 * np.pi * frequency * STEP_OF["q"] * np.arange(SWEEP_SAMPLES) + rng.uniform(0, 2 * np.pi)
        runs.append({"p": pressure * (1 + 0.95 * np.sin(angle)) / 2})
    return runs


def _shape(hidden: str, columns: Columns, creep: float) -> Float[np.ndarray, " n"]:
    """Return the hidden effect per unit of its coefficient."""
    if hidden == "smooth-friction":
        return np.tanh(columns["v"] / creep)
    return columns["v"] * np.abs(columns["v"]) if hidden == "quadratic-drag" else np.sqrt(columns["p"])


def _joined(part: Sequence[Columns]) -> Columns:
    return {name: np.concatenate([columns[name] for columns in part]) for name in part[0]}
