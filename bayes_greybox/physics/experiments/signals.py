"""Input signals as functions of time, from which experiments are made.

A family is a frozen dataclass with `value(t)` and `text`, listed in `SIGNALS`, with its usual members in
`USUAL_SIGNALS`; no other module asks for the family. A signal of your own needs `value` and `text`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.writing import unit_text

Time = Float[np.ndarray, "*n"]


@runtime_checkable
class Signal(Protocol):
    """An input as a function of time since the start of a run."""

    def value(self, t: Time) -> Time:
        """Return its values."""
        ...

    @property
    def text(self) -> str:
        """A few words with its numbers."""
        ...


@dataclass(frozen=True)
class Usual:
    """The input as it was in the data, from which default signals are made.

    Attributes:
        amplitude: Half its range, times a factor.
        offset: Middle of its range.
        low: Lowest frequency of which a run holds a few periods, cycles per unit of time.
        high: Frequency below which most of the states' motion lies.
        duration: Duration of a run.
    """

    amplitude: float
    offset: float
    low: float
    high: float
    duration: float


class _Family:
    """Signal whose words are a template with the names of its fields."""

    words: ClassVar[str]

    @property
    def text(self) -> str:
        """The signal in a few words, without units."""
        return self.in_units()

    def in_units(self, unit: str | None = None, time: str | None = None) -> str:
        """Return the signal in a few words, with the units of the input and of time."""
        frequency = "Hz" if time == "s" else f"1/{time}" if time else None
        # Other fields are values of the input, or whole numbers without a unit.
        units = {"at": time, **dict.fromkeys(("frequency", "low", "high"), frequency)}
        fields = {
            name: str(value)
            if name in ("tones", "seed")
            else f"{value:.3g} {unit_text(units.get(name, unit))}".rstrip()
            for name, value in vars(self).items()
        }
        offset = fields.get("offset", "") if getattr(self, "offset", 0.0) else ""
        return self.words.format(**fields) + (f" about {offset}" if offset else "")


@dataclass(frozen=True)
class Hold(_Family):
    """A constant level."""

    level: float
    words: ClassVar[str] = "held at {level}"

    def value(self, t: Time) -> Time:
        """Return the level."""
        return np.full(np.shape(t), self.level)


@dataclass(frozen=True)
class Step(_Family):
    """A step from one level to another."""

    before: float
    after: float
    at: float
    words: ClassVar[str] = "step from {before} to {after} at {at}"

    def value(self, t: Time) -> Time:
        """Return one level, then the other."""
        return np.where(np.asarray(t) < self.at, self.before, self.after)


@dataclass(frozen=True)
class Sine(_Family):
    """A sine of one frequency."""

    amplitude: float
    frequency: float
    offset: float = 0.0
    words: ClassVar[str] = "sine of amplitude {amplitude} at {frequency}"

    def value(self, t: Time) -> Time:
        """Return o + a sin 2πft."""
        return self.offset + self.amplitude * np.sin(2 * np.pi * self.frequency * np.asarray(t))


@dataclass(frozen=True)
class Sweep(_Family):
    """A sine whose frequency rises evenly over the duration."""

    amplitude: float
    low: float
    high: float
    duration: float
    offset: float = 0.0
    words: ClassVar[str] = "sweep of amplitude {amplitude} from {low} to {high}"

    def value(self, t: Time) -> Time:
        """Return o + a sin 2π(f₀ t + (f₁ − f₀) t²/2T)."""
        t = np.asarray(t)
        phase = self.low * t + (self.high - self.low) * t**2 / (2 * self.duration)
        return self.offset + self.amplitude * np.sin(2 * np.pi * phase)


@dataclass(frozen=True)
class Multisine(_Family):
    """A sum of sines of one size with phases from a seed; `amplitude` is the largest value that it has in a period."""

    amplitude: float
    low: float
    high: float
    tones: int = 6
    seed: int = 0
    offset: float = 0.0
    words: ClassVar[str] = "multisine of {tones} tones from {low} to {high}, seed {seed}, amplitude {amplitude}"

    def value(self, t: Time) -> Time:
        """Return o + a Σ sin(2πf_k t + φ_k) over its largest value."""
        f = np.linspace(self.low, self.high, self.tones)
        phase = np.random.default_rng(self.seed).uniform(0, 2 * np.pi, self.tones)
        return self.offset + self.amplitude * _of_unit_size(t, f, phase)


@dataclass(frozen=True)
class Noise(_Family):
    """A random signal of 32 random frequencies and phases (Rice 1944); `amplitude` is its peak."""

    amplitude: float
    high: float
    seed: int = 0
    offset: float = 0.0
    words: ClassVar[str] = "noise up to {high}, seed {seed}, amplitude {amplitude}"

    def value(self, t: Time) -> Time:
        """Return its values."""
        rng = np.random.default_rng(self.seed)
        f, phase = rng.uniform(0, self.high, 32), rng.uniform(0, 2 * np.pi, 32)
        return self.offset + self.amplitude * _of_unit_size(t, f, phase)


SIGNALS = {"hold": Hold, "step": Step, "sine": Sine, "sweep": Sweep, "multisine": Multisine, "noise": Noise}
"""Families by name."""

USUAL_SIGNALS: dict[str, Callable[[Usual], tuple[Signal, ...]]] = {
    "hold": lambda u: (Hold(u.offset + u.amplitude), Hold(u.offset - u.amplitude)),
    # After a third of the run.
    "step": lambda u: tuple(Step(u.offset, u.offset + a, u.duration / 3) for a in (u.amplitude, -u.amplitude)),
    "sine": lambda u: tuple(Sine(u.amplitude, f, u.offset) for f in (u.low, np.sqrt(u.low * u.high).item(), u.high)),
    "sweep": lambda u: (Sweep(u.amplitude, u.low, u.high, u.duration, u.offset),),
    "multisine": lambda u: (Multisine(u.amplitude, u.low, u.high, offset=u.offset),),
    "noise": lambda u: (Noise(u.amplitude, u.high, offset=u.offset),),
}
"""Usual signals of each family, by name."""


def band(states: Mapping[str, Time], time: Time, duration: float) -> tuple[float, float]:
    """Return the frequency of two periods in a run, and that below which 95 % of the states' power lies.

    The second is at least twice the first. `states` and `time` are of one run, `duration` is that of a run to come.
    """
    low, high = 2.0 / duration, 4.0 / duration
    even = np.linspace(time[0], time[-1], len(time))
    for x in states.values():
        power = np.abs(np.fft.rfft(np.interp(even, time, x) - np.mean(x))) ** 2
        if power.sum() > 0:
            frequency = np.fft.rfftfreq(len(even), even[1] - even[0])
            high = max(high, float(frequency[np.searchsorted(np.cumsum(power), 0.95 * power.sum())]))
    return low, high


def _of_unit_size(t: Time, f: np.ndarray, phase: np.ndarray) -> Time:
    """Return a sum of sines over its peak, cut where a long run would go beyond what an actuator can do."""
    slow = max(float(np.min(f)), float(np.max(f)) / 32)
    # Over eight periods of the slowest tone that matters.
    near = np.linspace(0, 8 / slow, int(128 * max(1.0, np.max(f) / slow)))
    every, peak = (np.sum(np.sin(2 * np.pi * np.asarray(x)[..., None] * f + phase), axis=-1) for x in (t, near))
    return np.clip(every / np.max(np.abs(peak)), -1.0, 1.0)
