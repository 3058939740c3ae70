"""Noise with outliers: Student t with two degrees of freedom, gross errors, and stamps that jitter in bursts."""

from collections.abc import Iterator

import numpy as np

from benchmarks.hidden_effects.assumptions.case import (
    AssumptionCase,
    Family,
    Measured,
    Scene,
    Setting,
    Suspect,
    seen,
    white,
)

NOISE = (0.02, 0.05)
"""Noise over the RMS of the rate; of Student's t its scale."""

OUTLIERS, OUTLYING = 0.02, 10.0
"""Share of gross errors, and their standard deviation in units of the noise."""

BURSTS, LENGTH = 6, 25
"""Bursts of jitter in a run of the usual length, and rows of one."""

JITTER = (1.0, 2.0)
"""Standard deviation of a stamp in a burst, in sampling steps."""


def _settings() -> Iterator[Setting]:
    hosts = ("machine", "forced-oscillator", "swept-oscillator")
    for noise in NOISE:
        for host in hosts:
            yield Setting("Student t", 2.0, host, noise)
            yield Setting("outliers", OUTLYING, host, noise)
        for host, jitter in zip(hosts, (*JITTER, JITTER[0]), strict=True):
            yield Setting("jitter", jitter, host, noise)


def _measure(scene: Scene, part: str, rng: np.random.Generator) -> Measured:
    case = scene.case
    if case.breach == "jitter":
        clean = seen(scene, part, _jitter(scene, part, rng))
        # Only the rate's sensor has the restless clock.
        return Measured(seen(scene, part).columns, clean.rate + scene.sigma * rng.standard_normal(len(clean.rate)))
    if case.breach == "outliers":
        clean = white(scene, part, rng)
        hit = rng.uniform(size=len(clean.rate)) < OUTLIERS
        return Measured(
            clean.columns, clean.rate + hit * case.size * scene.sigma * rng.standard_normal(len(clean.rate))
        )
    clean = seen(scene, part)
    return Measured(clean.columns, clean.rate + scene.sigma * rng.standard_t(case.size, len(clean.rate)))


def _jitter(scene: Scene, part: str, rng: np.random.Generator) -> np.ndarray:
    """How late each row of each run is: up to the steps that the path is known beyond the run."""
    host = scene.case.system
    late = np.zeros((len(scene.paths[part].states), host.samples))
    for run in late:
        for start in rng.integers(0, host.samples - LENGTH, BURSTS):
            run[start : start + LENGTH] = scene.case.size * rng.standard_normal(LENGTH)
    return np.clip(late, -3.5, 3.5)


def _suspects(case: AssumptionCase) -> tuple[Suspect, ...]:
    if case.breach == "jitter":
        return (Suspect("heavy tails"), Suspect("state-dependent noise"))
    return (Suspect("heavy tails"),)


FAMILY = Family("heavy tails", _settings, _measure, _suspects)
