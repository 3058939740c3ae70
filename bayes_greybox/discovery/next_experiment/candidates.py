"""What could be measured next: input signals of a few families, and experiments made of them.

A family of signals is a frozen dataclass with `value(t)`, `text` and `usual`, listed in `SIGNALS`; nothing else asks
which one it holds.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.trajectories import Trajectories

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
        return self.offset + self.amplitude / peak * _sines(t, f, phase)

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
        return self.offset + self.amplitude / _peak(f, phase) * _sines(t, f, phase)

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


@dataclass(frozen=True)
class Candidate:
    """One experiment that could be done.

    Attributes:
        inputs: Signal of each input.
        start: State at the start, by name.
        duration: How long it runs.
        rows: Samples, evenly spread over it.
        sensors: What is measured: standard deviation of the noise by channel. Channels are states, or, where a study
            was given rates, the states whose rate is measured.
        name: What tables call it; made of the rest by default.
    """

    inputs: Mapping[str, Signal]
    start: Mapping[str, float]
    duration: float
    rows: int
    sensors: Mapping[str, float]
    name: str = field(default="")

    def __post_init__(self) -> None:
        """Refuse what nobody can do, and fill in the name."""
        if not (np.isfinite(self.duration) and self.duration > 0 and self.rows >= 2):
            raise InputError(
                f"An experiment needs a duration above 0 and two rows, not {self.duration} and {self.rows}."
            )
        for channel, sd in self.sensors.items():
            if not (np.isfinite(sd) and sd > 0):
                raise InputError(f"sensors: the noise of {channel!r} must be above 0, not {sd}.")
        if not self.sensors:
            raise InputError("An experiment without sensors tells nothing: name at least one channel with its noise.")
        if not self.name:
            object.__setattr__(self, "name", self._described())

    @property
    def times(self) -> Float[np.ndarray, " n_row"]:
        """Sampling times, from 0."""
        return np.linspace(0.0, self.duration, self.rows)

    def _described(self) -> str:
        parts = [f"{name}: {signal.text}" for name, signal in self.inputs.items()]
        start = ", ".join(f"{name} = {value:.3g}" for name, value in self.start.items())
        return "; ".join([*parts, f"start at {start}"])


def usual_candidates(
    data: Trajectories,
    sensors: Mapping[str, float],
    *,
    signals: Iterable[str] | None = None,
    amplitudes: Sequence[float] = (0.5, 1.0),
    starts: Sequence[Mapping[str, float]] | None = None,
    duration: float | None = None,
    rows: int | None = None,
) -> tuple[Candidate, ...]:
    """Experiments like those of the data, with other signals, amplitudes and starts.

    One input is driven at a time; the others are held in the middle of their range, and so is one that never moved in
    the data. Frequencies lie between a few
    periods a run and what the states move at.

    Args:
        data: What was measured.
        sensors: Noise by channel.
        signals: Families, keys of `SIGNALS`; all by default.
        amplitudes: Over half the range that the input had in the data: above 1 is beyond what was seen.
        starts: States at the start; by default where the runs of the data began, and where no input moves corners of
            the states' range, `amplitudes` times as far from its middle.
        duration: Of each; that of the longest run by default.
        rows: Samples of each; by default as close as those of the data.

    Raises:
        InputError: An unknown family, an amplitude that is none, or a start of an unknown state.
    """
    asked = tuple(SIGNALS if signals is None else signals)
    if unknown := [name for name in asked if name not in SIGNALS]:
        raise InputError(f"There are no signals called {unknown[0]!r}; there are {', '.join(SIGNALS)}.")
    if not len(amplitudes) or not all(np.isfinite(a) and a > 0 for a in amplitudes):
        raise InputError(f"amplitudes must be numbers above 0, such as (0.5, 1), not {amplitudes}.")
    families = [SIGNALS[name] for name in asked]
    spans = {r: np.ptp(data.time[data.run == r]) for r in range(data.n_run)}
    longest = data.run == max(spans, key=lambda r: spans[r])
    duration = float(spans[data.run[longest][0]]) if duration is None else float(duration)
    step = float(np.median(np.diff(data.time[longest])))
    rows = max(2, round(duration / step) + 1) if rows is None else rows
    low, high = _band(data, longest, duration)
    middles = {name: 0.5 * float(np.min(u) + np.max(u)) for name, u in data.inputs.items()}
    driven: list[dict[str, Signal]] = []
    moved = {name: u for name, u in data.inputs.items() if np.ptp(u) > 0}
    for (name, u), factor in product(moved.items(), amplitudes):
        usual = Usual(factor * 0.5 * float(np.ptp(u)), middles[name], low, high, duration)
        held = {other: Hold(level) for other, level in middles.items() if other != name}
        driven += [{**held, name: signal} for family in families for signal in family.usual(usual)]
    if starts is None:
        starts = _begun(data) if driven else _corners(data, amplitudes)
    for start in starts:
        if unknown := [name for name in start if name not in data.states]:
            raise InputError(f"starts: there is no state {unknown[0]!r}; there are {', '.join(data.state_names)}.")
    full = [{**_begun(data)[0], **start} for start in starts]
    still: list[dict[str, Signal]] = [{name: Hold(level) for name, level in middles.items()}]
    return tuple(Candidate(inputs, start, duration, rows, sensors) for inputs, start in product(driven or still, full))


def _begun(data: Trajectories, most: int = 2) -> list[dict[str, float]]:
    """Where the first runs of the data began."""
    firsts = [int(np.flatnonzero(data.run == r)[0]) for r in range(min(most, data.n_run))]
    return [{name: float(x[i]) for name, x in data.states.items()} for i in firsts]


def _corners(data: Trajectories, amplitudes: Sequence[float]) -> list[dict[str, float]]:
    """Each state at either end of its range with the others in the middle, and all of them at the same end."""
    middle = {name: 0.5 * float(np.min(x) + np.max(x)) for name, x in data.states.items()}
    half = {name: 0.5 * float(np.ptp(x)) for name, x in data.states.items()}
    found = []
    for factor, sign in product(amplitudes, (1.0, -1.0)):
        moved = {name: middle[name] + sign * factor * half[name] for name in middle}
        found += [{**middle, name: moved[name]} for name in middle] + ([moved] if len(middle) > 1 else [])
    return found


def _band(data: Trajectories, rows: np.ndarray, duration: float) -> tuple[float, float]:
    """Two periods in a run, and the frequency below which 95 % of the motion's power lies; at least twice the first."""
    low, high = 2.0 / duration, 4.0 / duration
    time = data.time[rows]
    even = np.linspace(time[0], time[-1], len(time))
    for x in data.states.values():
        power = np.abs(np.fft.rfft(np.interp(even, time, x[rows]) - np.mean(x[rows]))) ** 2
        frequency = np.fft.rfftfreq(len(even), even[1] - even[0])
        if power.sum() > 0:
            high = max(high, float(frequency[np.searchsorted(np.cumsum(power), 0.95 * power.sum())]))
    return low, high


def _sines(t: Time, f: np.ndarray, phase: np.ndarray) -> Time:
    return np.sum(np.sin(2 * np.pi * np.asarray(t)[..., None] * f + phase), axis=-1)


def _peak(f: np.ndarray, phase: np.ndarray) -> float:
    """Largest value over eight periods of the slowest tone that matters."""
    slow = max(float(np.min(f)), float(np.max(f)) / 32)
    t = np.linspace(0, 8 / slow, int(128 * max(1.0, np.max(f) / slow)))
    return float(np.max(np.abs(_sines(t, f, phase))))


def _about(offset: float) -> str:
    return f" about {offset:.3g}" if offset else ""
