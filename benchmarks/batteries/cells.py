"""Cells that are charged and discharged in pulses, and their voltage; computed step by step, apart from the package."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

STEP, SAMPLES, NOISE = 1.0, 1200, 1e-3
"""Time between samples, s, their number, and noise of the voltage, V."""

CAPACITY, OPEN, SLOPE = 2.5, 3.2, 0.9
"""Capacity, A h; voltage of an empty cell without current, V; and its rise from empty to full."""


@dataclass(frozen=True)
class Cell:
    """Series resistance, Ω, and pairs of a resistance with its relaxation time, s."""

    series: float
    pairs: tuple[tuple[float, float], ...]


def cell(pairs: int, rng: np.random.Generator) -> Cell:
    """Draw a cell with up to two pairs: a fast one, and one that is five to twenty times slower."""
    fast = 6.0 * np.exp(0.4 * rng.standard_normal())
    times = fast, fast * rng.uniform(5.0, 20.0)
    resistances = 0.02 * np.exp(0.3 * rng.standard_normal(2))
    each = tuple((float(r), float(time)) for r, time in zip(resistances, times, strict=True))
    return Cell(float(0.05 * np.exp(0.2 * rng.standard_normal())), each[:pairs])


def pulses(rng: np.random.Generator) -> np.ndarray:
    """Return currents that are held for a while, with rests between them; two in three discharge."""
    current, k = np.zeros(SAMPLES), 0
    while k < SAMPLES:
        lasting, rest = int(rng.integers(10, 60)), int(rng.integers(10, 80))
        current[k : k + lasting] = rng.uniform(0.5, 3.0) * rng.choice([1.0, 1.0, -1.0])
        k += lasting + rest
    return current


def one_pulse() -> np.ndarray:
    """Return a single long pulse."""
    current = np.zeros(SAMPLES)
    current[100:700] = 1.5
    return current


def voltage(each: Cell, current: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the voltage at the samples, of a full cell at first; the current is held between them."""
    charge = 1.0 - np.append(0.0, np.cumsum(current[:-1])) * STEP / (3600.0 * CAPACITY)
    return (
        OPEN
        + SLOPE * charge
        - each.series * current
        - drops(each.pairs, current)
        + NOISE * rng.standard_normal(SAMPLES)
    )


def drops(pairs: Sequence[tuple[float, float]], current: np.ndarray) -> np.ndarray:
    """Return the sum of the voltages of pairs."""
    total = np.zeros(SAMPLES)
    for resistance, time in pairs:
        left, value = np.exp(-STEP / time), 0.0
        for k in range(1, SAMPLES):
            value = left * value + (1.0 - left) * resistance * current[k - 1]
            total[k] += value
    return total
