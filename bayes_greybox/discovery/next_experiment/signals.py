"""Input signals of a few families, from which experiments are made.

A family is a frozen dataclass with `value(t)`, `text` and `usual`, listed in `SIGNALS`; nothing else asks which one it
holds. A signal of your own needs `value` and `text`.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

Time = Float[np.ndarray, "*n"]


@runtime_checkable
class Signal(Protocol):
    """An input as a function of time since the start of a run."""

    def value(self, t: Time) -> Time:
        """Its values."""
        ...

    @property
    def text(self) -> str:
        """What it is, in a few words with its numbers."""
        ...


@dataclass(frozen=True)
class Usual:
    """What default signals are made from: the input as it was in the data.

    Attributes:
        amplitude: Half its range, times a factor.
        offset: Middle of its range.
        low: Lowest frequency of which a run holds a few periods, cycles per unit of time.
        high: Frequency below which the states' motion is, about.
        duration: Of a run.
    """

    amplitude: float
    offset: float
    low: float
    high: float
    duration: float

    @property
    def middle(self) -> float:
        """Geometric mean of the frequencies."""
        return float(np.sqrt(self.low * self.high))


@dataclass(frozen=True)
class Hold:
    """The same all the time."""

    level: float

    def value(self, t: Time) -> Time:
        """The level."""
        return np.full(np.shape(t), self.level)

    @property
    def text(self) -> str:
        """In words."""
        return f"held at {self.level:.3g}"

    @classmethod
    def usual(cls, u: Usual) -> "tuple[Hold, ...]":
        """Held at either side of the middle."""
        return cls(u.offset + u.amplitude), cls(u.offset - u.amplitude)


@dataclass(frozen=True)
class Step:
    """From one level to another at a time."""

    before: float
    after: float
    at: float

    def value(self, t: Time) -> Time:
        """Before and after."""
        return np.where(np.asarray(t) < self.at, self.before, self.after)

    @property
    def text(self) -> str:
        """In words."""
        return f"step from {self.before:.3g} to {self.after:.3g} at {self.at:.3g}"

    @classmethod
    def usual(cls, u: Usual) -> "tuple[Step, ...]":
        """Up from the middle, and down, after a third of the run."""
        at = u.duration / 3
        return tuple(cls(u.offset, u.offset + sign * u.amplitude, at) for sign in (1, -1))


@dataclass(frozen=True)
class Sine:
    """One frequency."""

    amplitude: float
    frequency: float
    offset: float = 0.0

    def value(self, t: Time) -> Time:
        """O + a sin 2πft."""
        return self.offset + self.amplitude * np.sin(2 * np.pi * self.frequency * np.asarray(t))

    @property
    def text(self) -> str:
        """In words."""
        return f"sine of amplitude {self.amplitude:.3g} at {self.frequency:.3g}{_about(self.offset)}"

    @classmethod
    def usual(cls, u: Usual) -> "tuple[Sine, ...]":
        """Slow, in the middle, and fast."""
        return tuple(cls(u.amplitude, f, u.offset) for f in (u.low, u.middle, u.high))


@dataclass(frozen=True)
class Sweep:
    """A sine whose frequency rises evenly over the duration."""

    amplitude: float
    low: float
    high: float
    duration: float
    offset: float = 0.0

    def value(self, t: Time) -> Time:
        """O + a sin 2π(f₀ t + (f₁ − f₀) t²/2T)."""
        t = np.asarray(t)
        phase = self.low * t + (self.high - self.low) * t**2 / (2 * self.duration)
        return self.offset + self.amplitude * np.sin(2 * np.pi * phase)

    @property
    def text(self) -> str:
        """In words."""
        return f"sweep of amplitude {self.amplitude:.3g} from {self.low:.3g} to {self.high:.3g}{_about(self.offset)}"

    @classmethod
    def usual(cls, u: Usual) -> "tuple[Sweep, ...]":
        """Through the whole band."""
        return (cls(u.amplitude, u.low, u.high, u.duration, u.offset),)


@dataclass(frozen=True)
class Multisine:
    """Several sines of one size with phases from a seed; `amplitude` is the largest value that it has in a period."""

    amplitude: float
    low: float
    high: float
    tones: int = 6
    seed: int = 0
    offset: float = 0.0

    def value(self, t: Time) -> Time:
        """O + a Σ sin(2πf_k t + φ_k) over its largest value."""
        f, phase, peak = self._tones()
        return self.offset + self.amplitude * _within(_sines(t, f, phase) / peak)

    @property
    def text(self) -> str:
        """In words."""
        band = f"from {self.low:.3g} to {self.high:.3g}, seed {self.seed}"
        return f"multisine of {self.tones} tones {band}, amplitude {self.amplitude:.3g}{_about(self.offset)}"

    @classmethod
    def usual(cls, u: Usual) -> "tuple[Multisine, ...]":
        """Over the whole band."""
        return (cls(u.amplitude, u.low, u.high, offset=u.offset),)

    def _tones(self) -> tuple[np.ndarray, np.ndarray, float]:
        f = np.linspace(self.low, self.high, self.tones)
        phase = np.random.default_rng(self.seed).uniform(0, 2 * np.pi, self.tones)
        return f, phase, _peak(f, phase)


@dataclass(frozen=True)
class Noise:
    """Random up to a frequency: many sines of random frequencies and phases (Rice 1944); `amplitude` is its peak."""

    amplitude: float
    high: float
    seed: int = 0
    offset: float = 0.0

    def value(self, t: Time) -> Time:
        """Values."""
        rng = np.random.default_rng(self.seed)
        f, phase = rng.uniform(0, self.high, 32), rng.uniform(0, 2 * np.pi, 32)
        return self.offset + self.amplitude * _within(_sines(t, f, phase) / _peak(f, phase))

    @property
    def text(self) -> str:
        """In words."""
        return f"noise up to {self.high:.3g}, seed {self.seed}, amplitude {self.amplitude:.3g}{_about(self.offset)}"

    @classmethod
    def usual(cls, u: Usual) -> "tuple[Noise, ...]":
        """As fast as the states move."""
        return (cls(u.amplitude, u.high, offset=u.offset),)


SIGNALS = {"hold": Hold, "step": Step, "sine": Sine, "sweep": Sweep, "multisine": Multisine, "noise": Noise}
"""Families by name."""


def _sines(t: Time, f: np.ndarray, phase: np.ndarray) -> Time:
    return np.sum(np.sin(2 * np.pi * np.asarray(t)[..., None] * f + phase), axis=-1)


def _peak(f: np.ndarray, phase: np.ndarray) -> float:
    """Largest value over eight periods of the slowest tone that matters."""
    slow = max(float(np.min(f)), float(np.max(f)) / 32)
    t = np.linspace(0, 8 / slow, int(128 * max(1.0, np.max(f) / slow)))
    return float(np.max(np.abs(_sines(t, f, phase))))


def _within(x: Time) -> Time:
    """Cut at what an actuator can do, where a long run would go beyond."""
    return np.clip(x, -1.0, 1.0)


def _about(offset: float) -> str:
    return f" about {offset:.3g}" if offset else ""
