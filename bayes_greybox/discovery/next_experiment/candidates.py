"""Experiments like those of the data."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from numbers import Real

import numpy as np

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.experiments.candidate import Candidate
from bayes_greybox.physics.experiments.signals import SIGNALS, USUAL_SIGNALS, Hold, Signal, Usual, band
from bayes_greybox.running.errors import InputError


def usual_candidates(
    data: Trajectories, sensors: Mapping[str, float], *, signals: Iterable[str] | None = None,
    amplitudes: Sequence[float] = (0.5, 1.0), starts: Sequence[Mapping[str, float]] | None = None,
    duration: float | None = None, rows: int | None = None,
) -> tuple[Candidate, ...]:  # fmt: skip
    """Return experiments like those of the data, with other signals, amplitudes and starts.

    One input is driven at a time; the others are held in the middle of their range, and so is one that never moved in
    the data. Frequencies lie between a few periods a run and the band of the states.

    Args:
        data: Training data.
        sensors: Noise by channel.
        signals: Families of signals, keys of `SIGNALS`; all by default.
        amplitudes: Amplitudes over half the range that the input had in the data: above 1 is beyond the data.
        starts: States at the start; by default where the first runs of the data began, and where no input moves
            corners of the states' range, `amplitudes` times as far from its middle.
        duration: Duration of each; that of the longest run by default.
        rows: Samples of each; by default as close as those of the data.

    Raises:
        InputError: An unknown family, an amplitude that is none, or a start of an unknown state.
    """
    families = tuple(SIGNALS if signals is None else signals)
    if unknown := [name for name in families if name not in SIGNALS]:
        raise InputError(f"There are no signals called {unknown[0]!r}; there are {', '.join(SIGNALS)}.")
    if not np.ndim(amplitudes) or not len(amplitudes) or not all(np.isfinite(a) and a > 0 for a in amplitudes):
        raise InputError(f"amplitudes must be numbers above 0, such as (0.5, 1), not {amplitudes}.")
    if duration is not None and not (isinstance(duration, Real) and np.isfinite(duration) and duration > 0):
        raise InputError(f"duration must be a number above 0, not {duration}.")
    if unknown := [name for start in starts or () for name in start if name not in data.states]:
        raise InputError(f"starts: there is no state {unknown[0]!r}; there are {', '.join(data.state_names)}.")
    longest = data.run == max(range(data.n_run), key=lambda r: np.ptp(data.time[data.run == r]))
    time = data.time[longest]
    duration = float(np.ptp(time)) if duration is None else float(duration)
    if rows is None:
        # About as many as the data have in as long a time, whose rows may come in bursts.
        most = np.ceil(len(time) * duration / np.ptp(time))
        rows = max(2, min(round(duration / float(np.median(np.diff(time)))), int(most)) + 1)
    low, high = band({name: x[longest] for name, x in data.states.items()}, time, duration)
    still: dict[str, Signal] = {name: Hold(0.5 * float(np.min(u) + np.max(u))) for name, u in data.inputs.items()}
    driven: list[dict[str, Signal]] = []
    for (name, u), factor in product(data.inputs.items(), amplitudes):
        usual = Usual(factor * 0.5 * float(np.ptp(u)), 0.5 * float(np.min(u) + np.max(u)), low, high, duration)
        driven += [{**still, name: s} for family in families for s in USUAL_SIGNALS[family](usual) if np.ptp(u) > 0]
    firsts = [int(np.flatnonzero(data.run == r)[0]) for r in range(min(2, data.n_run))]
    begun = [{name: float(x[i]) for name, x in data.states.items()} for i in firsts]
    if starts is None:
        starts = begun if driven else _corners(data, amplitudes)
    pairs = product(driven or [still], [{**begun[0], **start} for start in starts])
    return tuple(Candidate(inputs, start, duration, rows, sensors) for inputs, start in pairs)


def _corners(data: Trajectories, amplitudes: Sequence[float]) -> list[dict[str, float]]:
    """Return each state at either end of its range with the others in the middle, and all of them at the same end."""
    middle = {name: 0.5 * float(np.min(x) + np.max(x)) for name, x in data.states.items()}
    starts = []
    for factor in (sign * amplitude for amplitude in amplitudes for sign in (1.0, -1.0)):
        moved = {name: middle[name] + factor * 0.5 * float(np.ptp(x)) for name, x in data.states.items()}
        starts += [{**middle, name: moved[name]} for name in middle] + ([moved] if len(middle) > 1 else [])
    return starts
