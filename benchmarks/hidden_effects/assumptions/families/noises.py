"""Noise that is not white, not normal, not the same everywhere, or not of the rate alone."""

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
    white,
)
from benchmarks.hidden_effects.assumptions.hosts import FORCED

OUTLIERS, OUTLYING = 0.02, 10.0
"""Share of gross errors, and their standard deviation in units of the noise."""

BURSTS, BURST = 6, 25
"""Bursts of jitter in a run of the usual length, and rows of one."""


# Noisy states: the study's equations hold them for exact. The size is the noise of each over its standard deviation.


def _noisy_states() -> Iterator[Setting]:
    levels = (0.01, 0.02, 0.05, 0.1)
    for turn, level in enumerate(levels):
        # More rows make a wrong name surer, not rarer.
        for place, rows in enumerate((601, 3001, 6002)):
            yield Setting("white", level, "machine", (0.02, 0.05)[(turn + place) % 2], rows)
    for level in (0.02, 0.05):
        yield Setting("white", level, "machine", level, rows=30_010)
    for turn, level in enumerate(levels):
        yield Setting("white", level, FORCED[1 + turn % 2], 0.02)


def _with_noisy_states(scene: Scene, part: str, rng: np.random.Generator) -> Measured:
    clean, level = white(scene, part, rng), scene.case.size
    noisy = {
        state: clean.columns[state] + level * scene.spread[state] * rng.standard_normal(len(clean.rate))
        for state in scene.case.system.states
    }
    return Measured({**clean.columns, **noisy}, clean.rate)


def _visible_noise(scene: Scene) -> float:
    """Return the noise that a user sees: the rate's, and that of the states through the simulation's own terms."""
    slopes = scene.paths["train"].visible.rates[scene.case.system.equation]
    through = [slopes.get(state, 0.0) * scene.case.size * scene.spread[state] for state in scene.case.system.states]
    return float(np.sqrt(scene.sigma**2 + np.sum(np.square(through))))


NOISY_STATES = Family(
    "noisy states",
    _noisy_states,
    _with_noisy_states,
    lambda case: (Suspect("noisy state"),),
    level=lambda case: float(np.hypot(case.noise, case.size)),
    sigma=_visible_noise,
)


# Correlated noise of the rate: a first-order autoregression. The size is the correlation of neighbouring rows.


def _correlated() -> Iterator[Setting]:
    for turn, correlation in enumerate((0.5, 0.9, 0.97)):
        for place, noise in enumerate((0.02, 0.05, 0.1)):
            yield Setting("AR(1)", correlation, "machine", noise)
            yield Setting("AR(1)", correlation, FORCED[1 + (turn + place) % 2], noise)


def autoregressive(
    rng: np.random.Generator, correlation: float, runs: int, samples: int
) -> Float[np.ndarray, "n_run n_time"]:
    """Draw stationary noise of unit standard deviation, the runs independent of each other."""
    shocks = rng.standard_normal((runs, samples))
    # The first value has the stationary spread already.
    shocks[:, 1:] *= np.sqrt(1.0 - correlation**2)
    return np.asarray(lfilter([1.0], [1.0, -correlation], shocks, axis=1))


def _with_correlated_noise(scene: Scene, part: str, rng: np.random.Generator) -> Measured:
    clean, samples = seen(scene, part), scene.case.system.samples
    noise = autoregressive(rng, scene.case.size, len(clean.rate) // samples, samples)
    return Measured(clean.columns, clean.rate + scene.sigma * noise.ravel())


CORRELATED_NOISE = Family(
    "correlated noise", _correlated, _with_correlated_noise, lambda case: (Suspect("correlated noise"),)
)


# Noise of the rate that grows with a displacement, a speed or the rate itself, the breach; a tenth is there at zero.


def _growing() -> Iterator[Setting]:
    for turn, breach in enumerate(("position", "velocity", "rate")):
        for place, noise in enumerate((0.02, 0.05, 0.1)):
            yield Setting(breach, 1.0, "machine", noise)
            yield Setting(breach, 1.0, FORCED[1 + (turn + place) % 2], noise)


def _with_growing_noise(scene: Scene, part: str, rng: np.random.Generator) -> Measured:
    def profile(part: str) -> np.ndarray:
        clean, name = seen(scene, part), scene.case.system.roles.get(scene.case.breach)
        return np.abs(clean.rate if name is None else clean.columns[name])

    clean, train = seen(scene, part), profile("train")
    floor = 0.1 * np.sqrt(np.mean(train**2))
    spread = scene.sigma * (profile(part) + floor) / np.sqrt(np.mean((train + floor) ** 2))
    return Measured(clean.columns, clean.rate + spread * rng.standard_normal(len(clean.rate)))


STATE_DEPENDENT_NOISE = Family(
    "state-dependent noise", _growing, _with_growing_noise, lambda case: (Suspect("state-dependent noise"),)
)


# Outliers: Student's t of as many degrees of freedom as the size says, gross errors, and stamps that jitter in bursts
# by as many sampling steps.


def _heavy() -> Iterator[Setting]:
    for noise in (0.02, 0.05):
        for host in FORCED:
            yield Setting("Student t", 2.0, host, noise)
            yield Setting("outliers", OUTLYING, host, noise)
        for host, jitter in zip(FORCED, (1.0, 2.0, 1.0), strict=True):
            yield Setting("jitter", jitter, host, noise)


def _with_outliers(scene: Scene, part: str, rng: np.random.Generator) -> Measured:
    case = scene.case
    if case.breach == "jitter":
        late = seen(scene, part, _jitter(scene, part, rng))
        # Only the rate's sensor has the restless clock.
        return Measured(seen(scene, part).columns, late.rate + scene.sigma * rng.standard_normal(len(late.rate)))
    if case.breach == "outliers":
        clean = white(scene, part, rng)
        hit = rng.uniform(size=len(clean.rate)) < OUTLIERS
        gross = hit * case.size * scene.sigma * rng.standard_normal(len(clean.rate))
        return Measured(clean.columns, clean.rate + gross)
    clean = seen(scene, part)
    return Measured(clean.columns, clean.rate + scene.sigma * rng.standard_t(case.size, len(clean.rate)))


def _jitter(scene: Scene, part: str, rng: np.random.Generator) -> np.ndarray:
    """Draw how late each row of each run is: up to the steps that the path is known beyond the run."""
    host = scene.case.system
    late = np.zeros((len(scene.paths[part].states), host.samples))
    for run in late:
        for start in rng.integers(0, host.samples - BURST, BURSTS):
            run[start : start + BURST] = scene.case.size * rng.standard_normal(BURST)
    return np.clip(late, -3.5, 3.5)


def _heavy_suspects(case: AssumptionCase) -> tuple[Suspect, ...]:
    return (Suspect("heavy tails"), *((Suspect("state-dependent noise"),) if case.breach == "jitter" else ()))


HEAVY_TAILS = Family("heavy tails", _heavy, _with_outliers, _heavy_suspects)
