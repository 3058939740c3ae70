"""What could be measured next: experiments, and those that are like the data's."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from numbers import Real

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.trajectories import Trajectories

from .signals import SIGNALS, Hold, Signal, Usual


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
        if wrong := [name for name, value in self.start.items() if not np.isfinite(value)]:
            raise InputError(f"start: {wrong[0]!r} is {self.start[wrong[0]]}; give it a number.")
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
    if not np.ndim(amplitudes) or not len(amplitudes) or not all(np.isfinite(a) and a > 0 for a in amplitudes):
        raise InputError(f"amplitudes must be numbers above 0, such as (0.5, 1), not {amplitudes}.")
    if duration is not None and not (isinstance(duration, Real) and np.isfinite(duration) and duration > 0):
        raise InputError(f"duration must be a number above 0, not {duration}.")
    families = [SIGNALS[name] for name in asked]
    spans = {r: np.ptp(data.time[data.run == r]) for r in range(data.n_run)}
    longest = data.run == max(spans, key=lambda r: spans[r])
    duration = float(spans[data.run[longest][0]]) if duration is None else float(duration)
    step = float(np.median(np.diff(data.time[longest])))
    if rows is None:
        # About as many as the data have in as long a time, whose rows may come in bursts.
        most = np.ceil(np.sum(longest) * duration / np.ptp(data.time[longest]))
        rows = max(2, min(round(duration / step), int(most)) + 1)
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
