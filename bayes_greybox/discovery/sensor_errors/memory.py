"""Forces with memory: elements whose sums are hysteresis and relaxation of any shape.

The past of a state x acts through elements that are driven by its changes alone:

    Iwan      ż = ẋ, held within ±r      friction that gives way elastically (Iwan 1966, J. Appl. Mech. 33:893)
    Maxwell   ż = ẋ − z/τ                a spring and a damper in series

Sums of the first over r are hysteresis of Masing's kind, whose loops close and have one shape whatever their size
(Prandtl–Ishlinskii operators); sums of the second over τ every relaxation that decays without swinging. None is a
function of the states, so that neither an effect of the catalogue nor an unknown f over the states can replace them.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from scipy.special import exprel

from bayes_greybox.data.trajectories import Trajectories

from .channels import DRIFT, run_slices

HYSTERESIS, RELAXATION = "hysteresis", "relaxation"

LIMITS = (0.02, 0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8)
"""Limits r over half the range of x."""

STATE_TIMES = (0.1, 0.3, 1.0)
"""Time constants τ of a state, over the period of a wave like it; faster ones are its rate and acceleration."""

TIME_FACTOR, MOST_TIMES = 2.0, 12
"""Ratio of an input's time constants, from two steps to half a run, and their largest number."""

RETURNS, RETURN_PLAY = 1.5, 0.1
"""Way of a channel within a run, over its range there, from which on it comes back, or a memory is a function of it;
least share of the range that is a turn."""


@dataclass(frozen=True)
class Memory:
    """One kind of memory of one channel."""

    kind: str
    channel: str
    share: float = 0.0

    @property
    def text(self) -> str:
        """Return its name."""
        return f"{self.kind} of {self.channel}"


Chosen = Callable[[str], bool]
"""Test of whether a memory is asked for, by its text."""


Memories = Iterator[tuple[Memory, Float[np.ndarray, "n_obs n_element"]]]
"""Memories with their elements at the samples."""


def memory_columns(data: Trajectories, chosen: Chosen = lambda text: True) -> Memories:
    """Yield every memory with the forces of its elements along the measured paths, for channels that come back.

    Elements are at rest where a run starts; those of an input also as if it had been zero before.
    """
    runs = [rows for rows in run_slices(data.run) if rows.stop - rows.start > 2]
    for name in (*data.state_names, *data.input_names):
        hysteresis, relaxation = Memory(HYSTERESIS, name), Memory(RELAXATION, name)
        if not (chosen(hysteresis.text) or chosen(relaxation.text)):
            continue
        # An applied input may be held from each sample to the next, and may begin with the run.
        x, applied = data.column(name), name in data.inputs
        if not any(_returns(x[rows]) or (applied and _returns(np.append(0.0, x[rows]))) for rows in runs):
            continue
        times, limits = relaxation_times(x, data.time, runs, applied), np.ptp(x) / 2 * np.array(LIMITS)
        held = np.zeros((data.n_obs, len(limits)))
        relaxing = np.zeros((data.n_obs, (4 if applied else 1) * len(times)))
        for rows in runs:
            changes, steps = np.diff(x[rows]), np.diff(data.time[rows])
            held[rows] = _held(changes, limits)
            # Exact where x moves at a steady speed within a step.
            elements = [_summed(exprel(-steps[:, None] / times) * changes[:, None], steps, times)]
            if applied:
                begun = x[rows][0] * np.exp(-(data.time[rows] - data.time[rows][0])[:, None] / times)
                # Exact where x is held within a step, and leaps at its end.
                leaping = _summed(np.repeat(changes[:, None], len(times), axis=1), steps, times)
                # It may act at once and relax, or come to act late: no coefficient is off for either.
                elements += [leaping, begun, x[rows][:, None] - leaping]
            relaxing[rows] = np.hstack(elements)
        yield from ((each, table) for each, table in ((hysteresis, held), (relaxation, relaxing)) if chosen(each.text))


def relaxation_times(
    x: Float[np.ndarray, " n"], time: Float[np.ndarray, " n"], runs: Sequence[slice], applied: bool
) -> Float[np.ndarray, " n_time"]:
    """Return the time constants of the Maxwell elements of a channel."""
    if not applied:
        # A leap is two values at one time; the last ones tell the speed.
        later = [np.arange(len(x))[rows][np.append(np.diff(time[rows]) > 0, True)] for rows in runs]
        changes, steps = (np.concatenate([np.diff(v[rows]) for rows in later]) for v in (x, time))
        period = 2 * np.pi * np.std(x) / np.sqrt(np.sum(changes**2 / steps) / np.sum(steps))
        return period * np.array(STATE_TIMES)
    steps = np.concatenate([np.diff(time[rows]) for rows in runs])
    least, most = 2 * float(np.median(steps[steps > 0])), max(float(np.ptp(time[rows])) for rows in runs) / 2
    count = int(np.clip(np.ceil(np.log(most / least) / np.log(TIME_FACTOR)) + 1, 1, MOST_TIMES))
    return np.geomspace(least, max(most, least), count)


def _returns(x: np.ndarray) -> bool:
    span = np.ptp(x)
    way = np.diff(x) - np.diff(_held(np.diff(x), np.array([RETURN_PLAY / 2 * span]))[:, 0])
    return bool(span > 0 and np.sum(np.abs(way)) > RETURNS * span)


def _held(changes: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Return the Iwan elements: from one turn of x to the next each reaches its limit and stays there."""
    z = np.zeros((len(changes) + 1, len(limits)))
    direction = np.sign(changes)
    turns = np.flatnonzero(direction[1:] * direction[:-1] <= 0) + 1
    for first, last in pairwise([0, *turns.tolist(), len(changes)]):
        moved = np.cumsum(changes[first:last])[:, None]
        z[first + 1 : last + 1] = np.clip(z[first] + moved, -limits, limits)
    return z


def _summed(gained: np.ndarray, steps: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return z with z_k = exp(−h/τ) z_(k−1) + gained, as sums over stretches whose exponentials do not overflow."""
    z, past = np.zeros((len(gained) + 1, len(times))), np.concatenate([[0.0], np.cumsum(steps)])[:, None] / times
    stretch = np.floor(past[:, np.argmin(times)] / 30.0)
    for first, last in pairwise(sorted({0, *np.flatnonzero(np.diff(stretch)).tolist(), len(gained)})):
        since = past[first + 1 : last + 1] - past[first + 1 : first + 2]
        begun = np.exp(past[first] - past[first + 1]) * z[first]
        z[first + 1 : last + 1] = np.exp(-since) * (begun + np.cumsum(np.exp(since) * gained[first:last], axis=0))
    return z


SETTLING = (0.08, 0.14, 0.25, 0.45, 0.8, 2.0)
"""Time constants τ over the duration of the record."""


def drift_columns(data: Trajectories, chosen: Chosen = lambda text: True) -> Memories:
    """Yield every state and input times each way of settling, one element each: x exp(−(t − t₀)/τ).

    A spring warms up, a bolt comes loose, a battery sags. A coefficient that does not change is a correction of the
    simulation. Runs that go on at the time at which others ended belong to one record.
    """
    since = data.time - np.min(data.time)
    duration = np.max(since)
    if duration <= 0:
        return
    for name in (*data.state_names, *data.input_names):
        for share in SETTLING if chosen(Memory(DRIFT, name).text) else ():
            yield Memory(DRIFT, name, share), (data.column(name) * np.exp(-since / (share * duration)))[:, None]
