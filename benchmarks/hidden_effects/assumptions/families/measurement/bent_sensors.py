"""Sensors that bend what they measure: they compress, have play, have a zero that is off, or let slow motion decay.

The zero alone is among what the study suspects, and all look like some effect: a position that is read too small at its
ends like a spring that is not linear, a speed like drag. The states still tell, for a bent displacement is not the
integral of the speed, and a bent speed not that of the acceleration.
"""

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
from benchmarks.hidden_effects.assumptions.families.physics.smooth_friction import either_friction

POSITION, SPEED = "position compresses", "speed compresses"
"""Read too small by a cubic; the size is the share that is lost at the largest value of the training data."""

PLAY = "position play"
"""The size is half of the play, over the largest displacement of the training data."""

ZERO = "position zero"
"""On a spring that is not linear, where a zero that is off is no constant force; the size is over the RMS."""

COUPLED = "AC-coupled rate"
"""A first-order high-pass; the size is its corner over the natural frequency of the host's mass on its spring."""

_TRIED = (
    (POSITION, ((0.05, "machine", 0.02), (0.02, "swept-oscillator", 0.01))),
    # A speed acts through the damping that the simulation knows, so that there has to be some.
    (SPEED, ((0.1, "damped-machine", 0.01), (0.06, "damped-oscillator", 0.005))),
    (PLAY, ((0.04, "forced-oscillator", 0.02), (0.03, "machine", 0.01))),
    (ZERO, ((0.2, "hardening-machine", 0.02), (0.2, "hardening-oscillator", 0.05))),
    (COUPLED, ((0.15, "machine", 0.05), (0.15, "forced-oscillator", 0.02))),
)


def _settings() -> Iterator[Setting]:
    for breach, tried in _TRIED:
        for size, host, noise in tried:
            yield Setting(breach, size, host, noise)


def compressed(values: Float[np.ndarray, " n_obs"], largest: float, share: float) -> Float[np.ndarray, " n_obs"]:
    """Values less a cubic, c y^3, that takes this share of the largest one."""
    return values - share * values**3 / largest**2


def with_play(values: Float[np.ndarray, "n_run n_time"], half: float) -> Float[np.ndarray, "n_run n_time"]:
    """What a follower shows that is moved only by the ends of its play; it starts in the middle.

    Args:
        values: What it follows.
        half: Half of the play.
    """
    shown = np.array(values)
    for run in shown:
        for row in range(1, len(run)):
            run[row] = np.clip(run[row - 1], run[row] - half, run[row] + half)
    return shown


def high_passed(
    values: Float[np.ndarray, "n_run n_time"], corner: float, step: float
) -> Float[np.ndarray, "n_run n_time"]:
    """First-order high-pass of every run, switched on at its first row.

    Args:
        values: What is measured.
        corner: Frequency at which 3 dB are lost, in cycles per unit of time.
        step: Sampling step.
    """
    # Bilinear, exact at the corner.
    turn = np.tan(np.pi * corner * step)
    return np.asarray(lfilter([1.0, -1.0], [1.0 + turn, turn - 1.0], values, axis=1))


def natural_frequency(scene: Scene) -> float:
    """Of the host's mass on its linear spring, in cycles per unit of time."""
    host = scene.paths["train"].visible
    return float(np.sqrt(-host.rates[host.equation][host.roles["position"]]) / (2.0 * np.pi))


def _measure(scene: Scene, part: str, rng: np.random.Generator) -> Measured:
    case, host = scene.case, scene.case.system
    clean, train = white(scene, part, rng), seen(scene, "train").columns
    columns, rate, size = dict(clean.columns), clean.rate, case.size
    position, speed = host.roles["position"], host.roles["velocity"]
    if case.breach in (POSITION, SPEED):
        name = position if case.breach == POSITION else speed
        columns[name] = compressed(columns[name], float(np.max(np.abs(train[name]))), size)
    elif case.breach == PLAY:
        half = size * float(np.max(np.abs(train[position])))
        columns[position] = with_play(columns[position].reshape(-1, host.samples), half).ravel()
    elif case.breach == ZERO:
        columns[position] = columns[position] + size * float(np.sqrt(np.mean(train[position] ** 2)))
    else:
        # What the electronics add comes after the filter.
        exact = seen(scene, part).rate
        passed = high_passed(
            exact.reshape(-1, host.samples), size * natural_frequency(scene), scene.paths[part].step
        ).ravel()
        rate = passed + (rate - exact)
    return Measured(columns, rate)


def _suspects(case: AssumptionCase) -> tuple[Suspect, ...]:
    return (Suspect("offset", (case.system.roles["position"],)),) if case.breach == ZERO else ()


FAMILY = Family(
    "bent sensors",
    _settings,
    _measure,
    _suspects,
    accepted=either_friction,
    # Most of these sensors' errors are not on the study's list: something is wrong, and it cannot say what.
    silent=lambda case: ("instrument", "unknown", "partly named"),
)
