"""Noise of the rate that grows with a displacement, a speed or the rate itself."""

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
)

NOISE = (0.02, 0.05, 0.1)
"""Noise over the RMS of the rate, in root mean square over the training data."""

FLOOR = 0.1
"""Share that is there at zero, of the column's own RMS."""

BREACHES = ("position", "velocity", "rate")
"""What the noise grows with."""


def _settings() -> Iterator[Setting]:
    for turn, breach in enumerate(BREACHES):
        for place, noise in enumerate(NOISE):
            yield Setting(breach, 1.0, "machine", noise)
            yield Setting(breach, 1.0, ("forced-oscillator", "swept-oscillator")[(turn + place) % 2], noise)


def _profile(scene: Scene, part: str) -> np.ndarray:
    clean = seen(scene, part)
    name = scene.case.system.roles.get(scene.case.breach)
    return np.abs(clean.rate if name is None else clean.columns[name])


def _measure(scene: Scene, part: str, rng: np.random.Generator) -> Measured:
    clean, train = seen(scene, part), _profile(scene, "train")
    floor = FLOOR * np.sqrt(np.mean(train**2))
    spread = scene.sigma * (_profile(scene, part) + floor) / np.sqrt(np.mean((train + floor) ** 2))
    return Measured(clean.columns, clean.rate + spread * rng.standard_normal(len(clean.rate)))


def _suspects(case: AssumptionCase) -> tuple[Suspect, ...]:
    return (Suspect("state-dependent noise"),)


FAMILY = Family("state-dependent noise", _settings, _measure, _suspects)
