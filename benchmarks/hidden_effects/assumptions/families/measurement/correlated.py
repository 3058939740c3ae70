"""Noise of the rate that hangs together in time: a first-order autoregression."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float
from scipy.signal import lfilter

from benchmarks.hidden_effects.assumptions.case import (
    AssumptionCase,
    Family,
    Measured,
    Scene,
    Setting,
    Suspect,
    seen,
)

CORRELATIONS = (0.5, 0.9, 0.97)
"""Correlation of neighbouring rows."""

NOISE = (0.02, 0.05, 0.1)
"""Total standard deviation over the RMS of the rate."""


def _settings() -> Iterator[Setting]:
    for turn, correlation in enumerate(CORRELATIONS):
        for place, noise in enumerate(NOISE):
            yield Setting("AR(1)", correlation, "machine", noise)
            yield Setting("AR(1)", correlation, ("forced-oscillator", "swept-oscillator")[(turn + place) % 2], noise)


def autoregressive(
    rng: np.random.Generator, correlation: float, runs: int, samples: int
) -> Float[np.ndarray, "n_run n_time"]:
    """Stationary noise of unit standard deviation, the runs independent of each other."""
    shocks = rng.standard_normal((runs, samples))
    # The first value has the stationary spread already.
    shocks[:, 1:] *= np.sqrt(1.0 - correlation**2)
    return np.asarray(lfilter([1.0], [1.0, -correlation], shocks, axis=1))


def _measure(scene: Scene, part: str, rng: np.random.Generator) -> Measured:
    clean = seen(scene, part)
    samples = scene.case.system.samples
    noise = autoregressive(rng, scene.case.size, len(clean.rate) // samples, samples)
    return Measured(clean.columns, clean.rate + scene.sigma * noise.ravel())


def _suspects(case: AssumptionCase) -> tuple[Suspect, ...]:
    return (Suspect("correlated noise"),)


FAMILY = Family("correlated noise", _settings, _measure, _suspects)
