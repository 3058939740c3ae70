"""Machines of which one short record is there, and their motion in an experiment; in plain NumPy and SciPy.

Machines and effects are those of the hidden-effects benchmark. Of a case's runs the first alone is the record.
"""

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.running.errors import InputError
from benchmarks.hidden_effects.cases import HiddenCase, all_cases
from benchmarks.hidden_effects.generate import CaseData
from benchmarks.hidden_effects.systems.ode import HostODE, LostError
from benchmarks.hidden_effects.systems.trajectories import Excited, Runs, follow

SMALL_GAP_NOISES = (0.05, 0.2)
"""Standard deviation of the rate's noise over the rate's RMS."""

RATIOS = (0.5, 4.0)
"""Range of the RMS of an effect over that of the noise: small gaps."""


@dataclass(frozen=True)
class Driven:
    """An experiment: what sets a machine going.

    Attributes:
        start: State at the start, by name.
        inputs: Input as a function of time, by name.
        stop: Length of the run.
        rows: Number of samples, evenly spread.
    """

    start: Mapping[str, float]
    inputs: Mapping[str, Callable[[Any], Any]]
    stop: float
    rows: int


def small_gaps(seed: int = 0) -> tuple[HiddenCase, ...]:
    """Return each effect of the catalogue in both its hosts at each level of noise, small and in mixed order."""
    rng = np.random.default_rng(seed)
    known = [c for c in all_cases(seed, crossed=True) if c.family == "catalogue" and c.noise in SMALL_GAP_NOISES]
    # One ratio from each of as many equal parts of the range.
    parts = (rng.permutation(len(known)) + rng.uniform(size=len(known))) / len(known)
    ratios = np.exp(np.interp(parts, [0, 1], np.log(RATIOS)))
    cases = [
        replace(c, ratios=(float(r),), seed=zlib.crc32(f"{seed} next {c.host} {c.effects} {c.noise}".encode()))
        for c, r in zip(known, ratios, strict=True)
    ]
    return tuple(cases[i] for i in rng.permutation(len(cases)))


def again(data: CaseData) -> Driven:
    """Return the experiment of the record: its start and its input once more."""
    excited, host = data.excited["train"], data.host
    signal = excited.signal
    inputs: dict[str, Callable[[Any], Any]] = {}
    if signal is not None:
        # Of the inputs of all runs, the first.
        inputs = {host.inputs[0]: lambda t: np.array([signal(s)[0] for s in np.ravel(t)]).reshape(np.shape(t))}
    start = dict(zip(host.states, excited.starts[0].tolist(), strict=True))
    return Driven(start, inputs, host.stop, host.samples)


def exact(data: CaseData, driven: Driven) -> Runs | None:
    """Follow the machine without noise; None where that cannot be done: it leaves its bounds or sticks."""
    if data.ode is None:
        raise InputError("The case has no system that could be run again.")
    host = replace(data.host, stop=driven.stop, samples=driven.rows)
    starts = np.array([[driven.start[name] for name in host.states]])
    signal = None
    if host.inputs:
        value = driven.inputs[host.inputs[0]]
        signal = lambda t: np.asarray(value(np.array([float(t)])))  # noqa: E731
    try:
        return follow(HostODE(host, data.ode.rates, data.ode.acting), Excited(starts, signal))
    except LostError:
        return None


def joined(data: CaseData, runs: Sequence[Runs], noise: Mapping[str, Sequence[np.ndarray]]) -> Trajectories:
    """Return the record, and runs after it as they are measured."""
    host, record = data.host, record_of(data)
    return Trajectories.from_arrays(
        [record.time, *(r.columns["t"] for r in runs)],
        states={name: [record.states[name], *(r.columns[name] for r in runs)] for name in host.states},
        inputs={name: [record.inputs[name], *(r.columns[name] for r in runs)] for name in host.inputs},
        derivatives={
            name: [
                record.derivatives[name],
                *(r.rates[name] + e for r, e in zip(runs, noise[name], strict=True)),
            ]
            for name in host.states
        },
        units=dict(host.units),
        constant="keep",
    )


def record_of(data: CaseData) -> Trajectories:
    """Return the first of the runs that the case would train on."""
    return data.train.take(0)


def noise_of(data: CaseData, rows: int) -> dict[str, Float[np.ndarray, " n_row"]]:
    """Draw the noise of a further run of a case, the same whatever is done in it: compared runs share it."""
    rng = np.random.default_rng([data.case.seed, 1])
    exact = data.exact["train"].rates
    return {
        name: data.case.noise * float(np.sqrt(np.mean(rate**2))) * rng.standard_normal(rows)
        for name, rate in exact.items()
    }
