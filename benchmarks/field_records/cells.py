"""Battery cells under pulses of current, and their voltage."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .record import Measured
from .signals import levels, rounded

OPEN = "3.0 + 1.1*soc - 0.7*soc**2 + 0.6*soc**3"
CAPACITY, RESISTANCE = 2.5, 0.05
"""Formula of the open-circuit voltage; capacity, A h, and resistance, Ω, as they are written down."""

PULSES = (-1.5, 0.0, 0.8, 1.6, 2.5, 4.0)
"""Currents of the pulses, A."""

Voltage = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Function from times, currents and states of charge to a part of the voltage."""


def open_voltage(soc: np.ndarray) -> np.ndarray:
    """Return the open-circuit voltage of the formula."""
    return 3.0 + 1.1 * soc - 0.7 * soc**2 + 0.6 * soc**3


@dataclass(frozen=True)
class Current:
    """Currents at the samples, and at the finer times at which they switch; each is held until the next."""

    t: np.ndarray
    i: np.ndarray
    fine_t: np.ndarray
    fine_i: np.ndarray


@dataclass(frozen=True)
class Cell:
    """V = open(soc) − R0 i + extra; capacity in A h, charge at the start."""

    capacity: float = CAPACITY
    start: float = 0.9
    curve: Callable[[np.ndarray], np.ndarray] = open_voltage
    extra: Voltage | None = None


@dataclass(frozen=True)
class Sensors:
    """Noise, steps and offset of the current's sensor, A, and noise and steps of the voltage's, V."""

    current_noise: float = 0.004
    current_step: float = 20 / 4096
    current_offset: float = 0.0
    voltage_noise: float = 0.0007
    voltage_step: float = 0.001


def regular(i: np.ndarray) -> Current:
    """Return a current that is sampled every two seconds, and switches at samples."""
    t = np.arange(len(i)) * 2.0
    return Current(t, i, t, i)


def sampled(kept: np.ndarray, fine_t: np.ndarray, fine_i: np.ndarray) -> Current:
    """Return a current of which some times are sampled."""
    return Current(fine_t[kept], fine_i[kept], fine_t, fine_i)


def pulses(rng: np.random.Generator, n: int = 700) -> Current:
    """Return a regular train of pulses of 10 to 60 seconds."""
    return regular(levels(rng, n, PULSES, 5, 30))


def measured(
    rng: np.random.Generator, current: Current, cell: Cell | None = None, sensors: Sensors | None = None
) -> Measured:
    """Return what the sensors of a cell read under a current."""
    cell, sensors, t, i = cell or Cell(), sensors or Sensors(), current.t, current.i
    charge = np.concatenate([[0], np.cumsum(current.fine_i[:-1] * np.diff(current.fine_t))])
    soc = cell.start - np.interp(t, current.fine_t, charge) / (3600 * cell.capacity)
    v = cell.curve(soc) - RESISTANCE * i
    if cell.extra is not None:
        v = v + cell.extra(t, i, soc)
    i_read = i + sensors.current_offset + sensors.current_noise * rng.standard_normal(len(t))
    v_read = v + sensors.voltage_noise * rng.standard_normal(len(t))
    return Measured(
        t,
        {"i": rounded(i_read, sensors.current_step)},
        {"t": "s", "i": "A", "V": "V"},
        {"soc": "-i/(3600*Q)", "V": f"{OPEN} - R0*i"},
        {"Q": CAPACITY, "R0": RESISTANCE},
        outputs={"V": rounded(v_read, sensors.voltage_step)},
        starts={"soc": cell.start},
        held=True,
        split=0.7,
    )


def relaxation(resistance: float, time: float) -> Voltage:
    """Return the voltage of a resistance with a capacitance beside it."""

    def extra(t: np.ndarray, i: np.ndarray, soc: np.ndarray) -> np.ndarray:
        z, follows = 0.0, []
        for k in range(len(t)):
            follows.append(z)
            if k + 1 < len(t):
                z = i[k] + (z - i[k]) * np.exp(-(t[k + 1] - t[k]) / time)
        return -resistance * np.array(follows)

    return extra


def hysteresis(size: float, rate: float) -> Voltage:
    """Return a voltage that follows the sign of the current with the charge that has passed."""

    def extra(t: np.ndarray, i: np.ndarray, soc: np.ndarray) -> np.ndarray:
        h, follows = 0.0, []
        for k in range(len(t)):
            follows.append(h)
            if k + 1 < len(t) and i[k] != 0:
                end = -np.sign(i[k])
                h = end + (h - end) * np.exp(-rate * abs(i[k]) * (t[k + 1] - t[k]) / (3600 * 2.5))
        return size * np.array(follows)

    return extra
