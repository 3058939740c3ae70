"""A noisy displacement alone, measured fast; velocity and acceleration come from the package's own differentiator.

The differentiator is the user's way into the study and part of what is judged; the data before it are not its doing.
"""

from collections.abc import Iterator

import numpy as np

from bayes_greybox.data.trajectories import Trajectories
from benchmarks.hidden_effects.assumptions.case import Family, Measured, Scene, Setting, seen

LEVELS = (0.001, 0.002, 0.005, 0.01)
"""Noise of the displacement over its standard deviation."""

FAST = ("fast-machine", "fast-forced-oscillator", "fast-swept-oscillator")
"""Hosts with enough rows for a filter."""

SEEN_AFTER = 0.03
"""About what is left of the noise in the filtered acceleration, over its RMS; what effects are sized by."""


def _settings() -> Iterator[Setting]:
    for level in LEVELS:
        for host in FAST:
            yield Setting("displacement", level, host, level)


def _measure(scene: Scene, part: str, rng: np.random.Generator) -> Measured:
    clean = seen(scene, part)
    position = scene.case.system.states[0]
    noise = scene.case.size * scene.spread[position] * rng.standard_normal(len(clean.rate))
    return Measured({**clean.columns, position: clean.columns[position] + noise}, clean.rate)


def _finish(train: Trajectories, test: Trajectories) -> tuple[Trajectories, Trajectories]:
    """Differentiate as a user would: the window by the package's default, and the same for both parts."""
    position, velocity = train.state_names

    def bare(data: Trajectories) -> Trajectories:
        runs = [data.run == number for number in range(data.n_run)]
        return Trajectories.from_arrays(
            [data.time[rows] for rows in runs],
            states={position: [data.states[position][rows] for rows in runs]},
            inputs={name: [values[rows] for rows in runs] for name, values in data.inputs.items()},
            units={name: unit for name, unit in data.units.items() if name != velocity},
        )

    found = bare(train).differentiate("savgol", rates={position: velocity})
    window = found.dropped // found.n_run + 1
    return found, bare(test).differentiate("savgol", rates={position: velocity}, window=window)


FAMILY = Family("filtered rates", _settings, _measure, level=lambda case: SEEN_AFTER, finish=_finish)
