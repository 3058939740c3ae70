"""States that are measured with noise, which the study's equations hold for exact."""

from collections.abc import Iterator

import numpy as np

from benchmarks.hidden_effects.assumptions.case import (
    AssumptionCase,
    Family,
    Measured,
    Scene,
    Setting,
    Suspect,
    white,
)

LEVELS = (0.01, 0.02, 0.05, 0.1)
"""Noise of each state over its standard deviation."""

ROWS = (601, 3001, 6002)
"""Rows of the training data; more rows make a wrong name surer, not rarer."""

MANY = 30_010
"""Rows of the largest data."""


def _settings() -> Iterator[Setting]:
    for turn, level in enumerate(LEVELS):
        for place, rows in enumerate(ROWS):
            yield Setting("white", level, "machine", (0.02, 0.05)[(turn + place) % 2], rows)
    yield Setting("white", 0.02, "machine", 0.02, MANY)
    yield Setting("white", 0.05, "machine", 0.05, MANY)
    for turn, level in enumerate(LEVELS):
        yield Setting("white", level, ("forced-oscillator", "swept-oscillator")[turn % 2], 0.02)


def _measure(scene: Scene, part: str, rng: np.random.Generator) -> Measured:
    clean = white(scene, part, rng)
    level = scene.case.size
    noisy = {
        state: clean.columns[state] + level * scene.spread[state] * rng.standard_normal(len(clean.rate))
        for state in scene.case.system.states
    }
    return Measured({**clean.columns, **noisy}, clean.rate)


def _sigma(scene: Scene) -> float:
    """Of what a user sees: the rate's noise, and that of the states through the simulation's own terms."""
    path = scene.paths["train"]
    slopes = path.visible.rates[scene.case.system.equation]
    through = [slopes.get(state, 0.0) * scene.case.size * scene.spread[state] for state in scene.case.system.states]
    return float(np.sqrt(scene.sigma**2 + np.sum(np.square(through))))


def _suspects(case: AssumptionCase) -> tuple[Suspect, ...]:
    return (Suspect("noisy state"),)


FAMILY = Family(
    "noisy states",
    _settings,
    _measure,
    _suspects,
    level=lambda case: float(np.hypot(case.noise, case.size)),
    sigma=_sigma,
)
