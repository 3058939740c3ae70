"""The sensors whose samples are the rows, and the inputs that drive their path, as suspects.

A sensor that shows (1 + κ) y + a (y − c)² + b (y − c)³ at t − d, + o + drift, adds to its rows, to first order,

    delay  −d ẏ    gain  κ y    offset  o    drift  o · (t − t̄) / range    bend  a (y − c)², b (y − c)³

and an input that is wrong acts as a force along the path, see `channels`.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.samples.clipping import seen_samples
from bayes_greybox.data.trajectories import Trajectories

from .bends import BEND_SD, POWERS
from .channels import (
    DELAY,
    DELAY_STEPS,
    DRIFT,
    GAIN,
    GAIN_SD,
    OFFSET,
    ZERO_SD,
    ChannelSuspect,
    Rate,
    curve_of,
    shifted,
    slope_along,
)

NEAR_ZERO = 0.2
"""Share of its range that a sensor may stay away from zero, and bends about it all the same."""


def sensor_columns(
    samples: Trajectories, path: Trajectories, late: Mapping[str, float] | None = None
) -> list[tuple[ChannelSuspect, Float[np.ndarray, " n_row"]]]:
    """Suspects about every sensor with their columns at all samples, in the sensor's unit per unit of their size.

    Args:
        samples: What the sensors showed; columns are ordered by sensor, then by sample.
        path: The path at the samples.
        late: What sensors were found to be late by, at which their delays' columns are taken.
    """
    found, names, late = [], samples.state_names, late or {}
    step = float(np.median(np.diff(samples.time)[np.diff(samples.run) == 0]))
    span = float(np.ptp(samples.time))
    for k, name in enumerate(names):

        def row(values: np.ndarray, k: int = k) -> np.ndarray:
            return np.concatenate([values if j == k else np.zeros(len(values)) for j in range(len(names))])

        by, ones = late.get(name, 0.0), np.ones(path.n_obs)
        # What a late sensor shows too large is what it shows.
        x = shifted(path, {name: -by}).column(name)
        size = float(np.sqrt(np.mean(x**2)))
        later, sooner = (shifted(path, {name: h - by}).column(name) for h in (-step / 4, step / 4))
        found.append((ChannelSuspect(DELAY, name, DELAY_STEPS * step, step), row((later - sooner) / (step / 2))))
        found.append((ChannelSuspect(GAIN, name, GAIN_SD), row(x)))
        found.append((ChannelSuspect(OFFSET, name, ZERO_SD * size), row(ones)))
        if span > 0:
            found.append((ChannelSuspect(DRIFT, name, ZERO_SD * size), row((path.time - np.mean(path.time)) / span)))
        low, high = float(np.min(x)), float(np.max(x))
        # A tank that starts empty passes zero as well, whatever the noise says.
        margin = NEAR_ZERO * (high - low)
        center = 0.0 if low < margin and high > -margin else 0.5 * (low + high)
        furthest = max(high - center, center - low)
        if high > low:
            for kind, p in POWERS.items():
                bend = ChannelSuspect(kind, name, BEND_SD / furthest ** (p - 1), center=center)
                found.append((bend, row((x - center) ** p)))
    return found


def bent_by(samples: Trajectories, sizes: Mapping[ChannelSuspect, float]) -> Float[np.ndarray, " n_sample"]:
    """What sensors that bend made of samples which are free of it, one sensor after the other.

    Args:
        samples: Free of the errors.
        sizes: Errors by suspect.
    """
    return np.concatenate([curve_of(sizes, name).bend(samples.column(name)) for name in samples.state_names])


def unit_of_rows(samples: Trajectories, sizes: Mapping[ChannelSuspect, float]) -> float:
    """Mean of log |d reading / d row| over samples that were put right and bent again, see `bent_by`.

    A row is x + B(x) + κ x̄, with x̄ of the model, where the reading is (1 + κ) x + B(x).

    Args:
        samples: Free of the errors.
        sizes: Errors by suspect.
    """
    seen, logs = seen_samples(samples), []
    for name in samples.state_names:
        curve = curve_of(sizes, name)
        slope = curve.slope(samples.column(name)[seen])
        logs.append(float(np.mean(np.log((curve.gain + slope) / (1.0 + slope)))) if len(slope) else 0.0)
    return float(np.mean(logs))


def input_columns(
    nodes: Trajectories, names: Sequence[str], rate: Rate, step: float
) -> list[tuple[ChannelSuspect, np.ndarray]]:
    """Suspects about inputs with the force that they stand for along the path.

    Args:
        nodes: States and inputs along the path.
        names: Inputs that are suspected.
        rate: The whole modelled rate.
        step: Between two samples.
    """
    found, ones = [], np.ones(nodes.n_obs)

    def slope(name: str, direction: np.ndarray) -> np.ndarray:
        return slope_along(nodes, rate, name, direction)

    for name in names:
        u = nodes.column(name)
        change = np.concatenate([_gradient(nodes.time[own], u[own]) for own in _runs(nodes)])
        size = float(np.sqrt(np.mean(u**2)))
        found.append((ChannelSuspect(DELAY, name, DELAY_STEPS * step, step), slope(name, change)))
        found.append((ChannelSuspect(GAIN, name, GAIN_SD), -slope(name, u)))
        found.append((ChannelSuspect(OFFSET, name, ZERO_SD * size), -slope(name, ones)))
    return [(suspect, column) for suspect, column in found if np.all(np.isfinite(column)) and np.any(column != 0)]


def _runs(data: Trajectories) -> list[np.ndarray]:
    return [np.flatnonzero(data.run == r) for r in dict.fromkeys(data.run.tolist())]


def _gradient(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """du/dt; where an input leaps at one time, through the middle of the leap."""
    at, place, count = np.unique(time, return_inverse=True, return_counts=True)
    if len(at) < 2:
        return np.zeros(len(time))
    return np.gradient(np.bincount(place, values) / count, at)[place]
