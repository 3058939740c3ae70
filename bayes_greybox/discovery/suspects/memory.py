"""Forces that remember: elements whose sums are hysteresis and relaxation of any shape.

What a state x did before acts through elements that are driven by its changes alone:

    Iwan      ż = ẋ, held within ±r      friction that gives way elastically (Iwan 1966, J. Appl. Mech. 33:893)
    Maxwell   ż = ẋ − z/τ                a spring and a damper in series

Sums of the first over r are hysteresis of Masing's kind, whose loops close and have one shape whatever their size
(Prandtl–Ishlinskii operators); sums of the second over τ every relaxation that decays without swinging. None is a
function of the states, so that neither an effect of the catalogue nor an unknown f over the states is what they are.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from scipy.special import exprel

from bayes_greybox.data.trajectories import Trajectories

HYSTERESIS, RELAXATION = KINDS = ("hysteresis", "relaxation")

LAW = "law"
"""What has no name may be no memory either, but a function that the catalogue does not have."""

LIMITS = (0.02, 0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8)
"""Limits r over half the range of x."""

TIMES = (0.1, 0.3, 1.0)
"""Time constants τ of a state, over the period of a wave with the spread of x and of its rate: faster ones are its rate
and its acceleration, with which any force on it would be explained by what it does."""

FACTOR, MOST_TIMES = 2.0, 12
"""Time constants of an input are about this factor apart, from two steps to half a run, and so many at most: a
decay with any other one is a sum of theirs to within 0.002 of its height."""

REACH = 30.0
"""Time constants whose exponentials are summed at once."""

RETURNS = 1.5
"""Way of a channel within a run over its range there, from which on it comes back to where it was: a memory of one that
does not is a function of what it is."""

PLAY = 0.1
"""Share of the range that a turn has at least, or it is noise and no way."""


@dataclass(frozen=True)
class Memory:
    """One kind of memory of one channel.

    Attributes:
        kind: `HYSTERESIS` or `RELAXATION`.
        channel: A state or an input.
        share: Which of several of the kind.
        behind: Of files of before: whether it was some samples behind.
    """

    kind: str
    channel: str
    share: float = 0.0
    behind: bool = False

    @property
    def text(self) -> str:
        """What it is, in words."""
        return f"{self.kind} of {self.channel}"


def kind_and_channel(text: str) -> tuple[str, str]:
    """Return kind and channel of a memory from its text, the inverse of `Memory.text`."""
    kind, _, channel = text.partition(" of ")
    return kind, channel


Chosen = Callable[[str], bool]
"""Test of whether a memory is asked for, by its text."""


def everything(text: str) -> bool:
    """Return that each one is."""
    return True


def memory_columns(
    data: Trajectories, chosen: Chosen = everything
) -> Iterator[tuple[Memory, Float[np.ndarray, "n_obs n_element"]]]:
    """Yield every memory with the forces of its elements, by the paths that were measured; of channels that come back.

    Elements are at rest where a run starts; of an input, which may begin there, also as if it had been zero before.

    Args:
        data: Samples in order of time.
        chosen: Which ones.
    """
    runs = [np.flatnonzero(data.run == r) for r in dict.fromkeys(data.run.tolist())]
    runs = [own for own in runs if len(own) > 2]
    for name in (*data.state_names, *data.input_names):
        hysteresis, relaxation = Memory(HYSTERESIS, name), Memory(RELAXATION, name)
        if not (chosen(hysteresis.text) or chosen(relaxation.text)):
            continue
        x = data.column(name)
        half = np.ptp(x) / 2
        # What is applied from outside may be held from each sample to the next, and may begin with the run.
        applied = name in data.inputs
        if not any(_returns(x[own]) or (applied and _returns(np.append(0.0, x[own]))) for own in runs):
            continue
        times = relaxation_times(x, data.time, runs, applied)
        held = np.zeros((data.n_obs, len(LIMITS)))
        relaxing = np.zeros((data.n_obs, (4 if applied else 1) * len(times)))
        for own in runs:
            changes, steps = np.diff(x[own]), np.diff(data.time[own])
            held[own] = _held(changes, half * np.array(LIMITS))
            elements = [_relaxing(changes, steps, times)]
            if applied:
                begun = x[own][0] * np.exp(-(data.time[own] - data.time[own][0])[:, None] / times)
                leaping = _leaping(changes, steps, times)
                # It may act at once and relax, or come to act late: no coefficient is off for either.
                elements += [leaping, begun, x[own][:, None] - leaping]
            relaxing[own] = np.hstack(elements)
        yield from ((each, table) for each, table in ((hysteresis, held), (relaxation, relaxing)) if chosen(each.text))


def relaxation_times(
    x: Float[np.ndarray, " n"], time: Float[np.ndarray, " n"], runs: Sequence[np.ndarray], applied: bool
) -> Float[np.ndarray, " n_time"]:
    """Return the time constants of the Maxwell elements of a channel.

    Args:
        x: Its samples.
        time: Of the samples.
        runs: Places of the samples of each run.
        applied: Whether it is an input.
    """
    if not applied:
        # What leaps has two values at one time: how fast it moves, the last ones tell.
        later = [own[np.append(np.diff(time[own]) > 0, True)] for own in runs]
        changes, steps = (np.concatenate([np.diff(v[own]) for own in later]) for v in (x, time))
        period = 2 * np.pi * np.std(x) / np.sqrt(np.sum(changes**2 / steps) / np.sum(steps))
        return period * np.array(TIMES)
    steps = np.concatenate([np.diff(time[own]) for own in runs])
    # An input that leaps has two values at one time.
    least, most = 2 * float(np.median(steps[steps > 0])), max(float(np.ptp(time[own])) for own in runs) / 2
    count = int(np.clip(np.ceil(np.log(most / least) / np.log(FACTOR)) + 1, 1, MOST_TIMES))
    return np.geomspace(least, max(most, least), count)


def _returns(x: np.ndarray) -> bool:
    span = np.ptp(x)
    way = np.diff(x) - np.diff(_held(np.diff(x), np.array([PLAY / 2 * span]))[:, 0])
    return bool(span > 0 and np.sum(np.abs(way)) > RETURNS * span)


def _held(changes: np.ndarray, limits: np.ndarray) -> np.ndarray:
    # From one turn of x to the next an element reaches its limit and stays there.
    z = np.zeros((len(changes) + 1, len(limits)))
    direction = np.sign(changes)
    turns = np.flatnonzero(direction[1:] * direction[:-1] <= 0) + 1
    for first, last in pairwise([0, *turns.tolist(), len(changes)]):
        moved = np.cumsum(changes[first:last])[:, None]
        z[first + 1 : last + 1] = np.clip(z[first] + moved, -limits, limits)
    return z


def _relaxing(changes: np.ndarray, steps: np.ndarray, times: np.ndarray) -> np.ndarray:
    # Exact where x moves at a steady speed within a step.
    return _summed(exprel(-steps[:, None] / times) * changes[:, None], steps, times)


def _leaping(changes: np.ndarray, steps: np.ndarray, times: np.ndarray) -> np.ndarray:
    # Exact where x is held within a step, and leaps at its end.
    return _summed(np.repeat(changes[:, None], len(times), axis=1), steps, times)


def _summed(gained: np.ndarray, steps: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return z with z_k = exp(−h/τ) z_(k−1) + gained, as sums over stretches whose exponentials are numbers."""
    z, past = np.zeros((len(gained) + 1, len(times))), np.concatenate([[0.0], np.cumsum(steps)])[:, None] / times
    stretch = np.floor(past[:, np.argmin(times)] / REACH)
    for first, last in pairwise(sorted({0, *np.flatnonzero(np.diff(stretch)).tolist(), len(gained)})):
        since = past[first + 1 : last + 1] - past[first + 1 : first + 2]
        begun = np.exp(past[first] - past[first + 1]) * z[first]
        z[first + 1 : last + 1] = np.exp(-since) * (begun + np.cumsum(np.exp(since) * gained[first:last], axis=0))
    return z
