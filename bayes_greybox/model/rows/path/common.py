"""Findings on the paths of runs that all runs share, whichever are followed together: sizes, noise, steps."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from bayes_greybox.data.samples.clipping import clipped_states, seen_samples
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.simulation.protocol import Simulation

from .forced_rate import ForcedRate
from .path_segments import START_WIDTH


@dataclass(frozen=True)
class Common:
    """Findings on the paths of some runs that hold for further runs too.

    Attributes:
        clipped: Values at which the sensor of a state was at its end; looked for where there are further runs.
        slow: Time in which the slowest sensor's signal changes by half its spread.
        first_sd: Noise of each sensor before there is a path; `sd` is that along the path.
        steps: Number of steps between two samples, which are usually a `step` apart.
        ratio: Intensity of the unknown force, λ = q²/σ².
        gain: RMS response of an output to a force of unit RMS.
    """

    clipped: Mapping[str, tuple[float, ...]]
    sizes: tuple[float, ...]
    slow: float
    first_sd: tuple[float, ...]
    sd: tuple[float, ...]
    steps: int = 1
    step: float = math.nan
    ratio: float = math.nan
    passes: int = 0
    pieces: int = 1
    gain: float = math.nan

    def seen(self, samples: Trajectories) -> Bool[np.ndarray, " n_obs"]:
        """Return which samples of a run no sensor clipped."""
        if samples.unseen is not None:
            return seen_samples(samples)
        at_end = [np.isin(samples.states[name], ends) for name, ends in self.clipped.items()]
        return ~np.any([np.zeros(samples.n_obs, bool), *at_end], axis=0)


def ends_of_sensors(samples: Trajectories) -> dict[str, tuple[float, ...]]:
    """Return the values at which the sensor of a state was at its end, by state that was clipped."""
    clipped = {} if samples.unseen is not None else clipped_states(samples)
    return {name: tuple(np.unique(samples.states[name][rows]).tolist()) for name, rows in clipped.items()}


def sizes_of(samples: Trajectories, simulation: Simulation, at_rest: Mapping[str, str]) -> tuple[np.ndarray, float]:
    """Return the typical size of each state, and the time in which the slowest signal changes by half its spread."""
    times = []
    for x in samples.states.values():
        spread, lag = float(np.std(x)), 1
        for lag in range(1, max(2, min(samples.run_lengths) // 2)):
            inside = samples.run[lag:] == samples.run[:-lag]
            if np.sqrt(np.mean((x[lag:] - x[:-lag])[inside] ** 2)) >= 0.5 * spread:
                break
        times.append(lag * samples.usual_step)
    slow = min(times)
    size = {name: float(np.sqrt(np.mean(x**2))) for name, x in samples.states.items()}
    largest = max(size.values())
    for name in simulation.states:
        # A hidden state that is a measured one's rate changes it by its spread in that time.
        source = [m for m in samples.states if simulation.kinematic(m) and simulation.rate_name(m) == name]
        if name not in at_rest:
            size.setdefault(name, float(np.std(samples.states[source[0]])) / slow if source else largest)
    for name, column in at_rest.items():
        like = size[column] if column in size else float(np.sqrt(np.mean(samples.column(column) ** 2)))
        size.setdefault(name, like / START_WIDTH)
    return np.array([size[name] if size[name] > 0 else largest for name in simulation.states]), slow


def steps_needed(rate: ForcedRate, samples: Trajectories, path: np.ndarray, s: np.ndarray) -> int:
    """Return the number of steps between samples that resolve the equations along a path.

    An oscillation of the frequency ω loses the phase (ωh)⁴/120 each radian, for as long as its damping lets it be
    remembered, and that shall be 0.3 of what the samples together tell of it.
    """
    # Hidden states that the path lacks are taken to be as the others; a few samples tell the time scales.
    filled = np.where(np.isfinite(path), path, path[:, [rate.names.index(samples.state_names[0])]])
    some = np.unique(np.linspace(0, samples.n_obs - 1, 500).astype(int))
    points = np.column_stack([samples.time, filled, samples.matrix(samples.input_names)])[some]
    A = rate.jacobian(points)
    A = A[np.all(np.isfinite(A), axis=(1, 2))]
    if not len(A):
        return 1
    values = np.linalg.eigvals(A)
    fastest = float(np.quantile(np.abs(values).max(axis=-1), 0.99))
    step = samples.usual_step
    spread = np.std(samples.matrix(samples.state_names), axis=0)
    # A sensor that shows no motion tells nothing of a phase.
    seen = spread > 0
    lost = 0.3 * float(np.min(np.broadcast_to(s, spread.shape)[seen] / spread[seen], initial=math.inf))
    # Samples without any noise tell no more of a phase than rounding does.
    lost = max(lost / math.sqrt(samples.n_obs), 1e-12)
    # Mode by mode, the fastest first: how fast each turns, and how long what it does is remembered. A mode forgets
    # where it is damped along nine tenths of the path.
    values = np.take_along_axis(values, np.argsort(-np.abs(values.imag), axis=-1), axis=-1)
    turning = np.median(np.abs(values.imag), axis=0)
    damping = np.quantile(-values.real, 0.1, axis=0).clip(0.0)
    remembered = 1 / np.maximum(damping, 1 / (step * max(samples.run_lengths)))
    phase = float(np.max(turning**5 * remembered))
    longest = (120 * lost / phase) ** 0.25 if phase > 0 else math.inf
    if fastest > 0:
        # A tenth of the fastest time scale of the equations along the path.
        longest = min(0.1 / fastest, longest)
    return int(np.clip(math.ceil(step / longest), 1, 50))
