"""What the samples of a state say of themselves: their own noise, and whether the sensor was at its end.

Noise on states that terms are evaluated at is a spurious force, E[e | x measured] = s² ∇log p(x), which more rows make
surer. Where the samples show white noise of their own, terms are evaluated at smoothed states instead.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import make_smoothing_spline

from bayes_greybox.data.sample_noise import sample_noise
from bayes_greybox.data.trajectories import Trajectories

LARGEST = 0.3
"""Noise above this share of a state's standard deviation is none: rows in no order in time look like nothing else."""

FEWEST = 30
"""Samples of a run below which nothing is smoothed."""

RESIDUAL = 0.75
"""Mean square of a smoothing spline's residuals over the noise's, with about a sample in four for the path."""

CLIPPED = 3
"""So many samples in a row at the very end of a sensor's range are clipped."""


@dataclass(frozen=True)
class SampleNoise:
    """White noise found on one state.

    Attributes:
        sd: Of the samples, user's units.
        left: Of the smoothed samples.
    """

    sd: float
    left: float


MOST_CLIPPED = 0.5
"""Share of the samples from which on a channel rests and is not clipped."""

MANY_LEVELS = 0.5
"""Different values over samples below which a sensor is coarse."""


def smoothed(data: Trajectories) -> tuple[Trajectories, dict[str, SampleNoise]]:
    """The data with states freed of white noise by a cubic smoothing spline (generalised cross-validation).

    Args:
        data: Measurements.

    Returns:
        The data, as they are where no state shows noise; and the noise by state.
    """
    # A filter that computed the rates has smoothed the states too, and its rows know what it left.
    if not _even(data) or data.filter is not None or data.n_obs < FEWEST:
        return data, {}
    states, noise = dict(data.states), {}
    found = sample_noise(data.time, data.matrix(data.state_names), data.run_lengths)
    for (name, values), s in zip(data.states.items(), map(float, found), strict=True):
        if not 0 < s < LARGEST * np.std(values):
            continue
        parts, left = [], []
        for r in dict.fromkeys(data.run.tolist()):
            own = data.run == r
            time, samples = data.time[own], values[own]
            if len(samples) < FEWEST:
                parts.append(samples)
                left.append(s)
                continue
            path = _smooth(time, samples, s)
            parts.append(path)
            # var(y − ŷ) = s² (1 − 2 tr H/n + tr HH/n), and tr HH is about 3/4 of tr H for a cubic spline
            rest = float(np.mean((samples - path) ** 2)) / s**2
            left.append(s * math.sqrt(min(max((1 - rest) * 0.75 / 1.25, 0.0), 1.0)))
        states[name] = np.concatenate(parts)
        noise[name] = SampleNoise(s, float(np.sqrt(np.mean(np.square(left)))))
    return (replace(data, states=states), noise) if noise else (data, {})


def clipped(values: Mapping[str, Float[np.ndarray, " n"]], run: np.ndarray) -> dict[str, Bool[np.ndarray, " n"]]:
    """Rows at which a channel's sensor was at its end, by channel; channels without any are left out.

    Args:
        values: Samples by channel.
        run: Run of each row.
    """
    found: dict[str, Any] = {}
    for name, x in values.items():
        if len(np.unique(x)) < MANY_LEVELS * len(x):
            # A coarse sensor stays on its last level at every turn.
            continue
        at_end = np.zeros(len(x), bool)
        for end in (float(np.max(x)), float(np.min(x))):
            here = x == end
            for r in np.unique(run):
                own = here[run == r]
                # Where it stays there once, every sample there is clipped.
                if np.any(np.convolve(own, np.ones(CLIPPED), "valid") >= CLIPPED):
                    at_end |= here
        if 0 < np.mean(at_end) < MOST_CLIPPED:
            found[name] = at_end
    return found


def _smooth(time: np.ndarray, samples: np.ndarray, s: float) -> np.ndarray:
    """The smoothing spline; where cross-validation smooths a path away, that whose residuals have the noise's size."""
    path = make_smoothing_spline(time, samples)(time)
    if np.mean((samples - path) ** 2) < 2 * s**2:
        return path
    step = float(np.median(np.diff(time)))
    low, high = -12.0, 12.0
    for _ in range(20):
        middle = 0.5 * (low + high)
        path = make_smoothing_spline(time, samples, lam=step**3 * 10.0**middle)(time)
        low, high = (middle, high) if np.mean((samples - path) ** 2) < RESIDUAL * s**2 else (low, middle)
    return path


def _even(data: Trajectories) -> bool:
    steps = np.diff(data.time)[np.diff(data.run) == 0]
    return bool(len(steps)) and bool(np.all(np.abs(steps - steps[0]) <= 1e-6 * abs(steps[0])))
