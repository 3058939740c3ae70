"""Errors of the sensors whose samples are the rows, and of the inputs that drive their path.

A sensor that shows (1 + κ) y + a (y − c)² + b (y − c)³ at t − d, + o + drift, adds to its rows, to first order,

    delay  −d ẏ    gain  κ y    offset  o    drift  o · (t − t̄) / range    bend  a (y − c)², b (y − c)³

and an input that is wrong acts as a force along the path, see `channels`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.samples.clipping import seen_samples
from bayes_greybox.data.trajectories import Trajectories

from . import channels
from .bends import BEND_POWERS
from .channels import ErrorColumns, Rate, Sizes


def sensor_columns(samples: Trajectories, path: Trajectories, late: Mapping[str, float] | None = None) -> ErrorColumns:
    """Return every error of every sensor with its column at all samples, in the sensor's unit per unit of its size."""
    columns, late = [], late or {}
    step = float(np.median(np.diff(samples.time)[np.diff(samples.run) == 0]))
    span = float(np.ptp(samples.time))
    for k, name in enumerate(samples.state_names):
        by = late.get(name, 0.0)
        # The gain of a late sensor is that of its reading.
        read = channels.shifted(path, {name: -by})
        x, zero = read.column(name), channels.zero_error(read, name)
        later, sooner = (channels.shifted(path, {name: h - by}).column(name) for h in (-step / 4, step / 4))
        alone: ErrorColumns = [(channels.delay_error(name, step), (later - sooner) / (step / 2))]
        alone += [(channels.gain_error(name), x), (zero, np.ones(path.n_obs))]
        if span > 0:
            alone.append((replace(zero, kind=channels.DRIFT), (path.time - np.mean(path.time)) / span))
        alone += [(bend, (x - bend.center) ** BEND_POWERS[bend.kind]) for bend in channels.bend_errors(name, x)]
        for error, values in alone:
            table = np.zeros((len(samples.state_names), path.n_obs))
            table[k] = values
            columns.append((error, table.ravel()))
    return columns


def bent_by(samples: Trajectories, sizes: Sizes) -> Float[np.ndarray, " n_sample"]:
    """Return the bend of each sensor's reading at samples that are free of errors, one sensor after the other."""
    return np.concatenate([channels.curve_of(sizes, name).bend(samples.column(name)) for name in samples.state_names])


def unit_of_rows(samples: Trajectories, sizes: Sizes) -> float:
    """Return the mean of log |d reading / d row| over samples free of errors that are bent again, see `bent_by`.

    A row is x + B(x) + κ x̄, with x̄ of the model, where the reading is (1 + κ) x + B(x).
    """
    seen, logs = seen_samples(samples), []
    for name in samples.state_names:
        curve = channels.curve_of(sizes, name)
        slope = curve.slope(samples.column(name)[seen])
        logs.append(float(np.mean(np.log((curve.gain + slope) / (1.0 + slope)))) if len(slope) else 0.0)
    return float(np.mean(logs))


def input_columns(nodes: Trajectories, names: Sequence[str], rate: Rate, step: float) -> ErrorColumns:
    """Return every error of inputs with the force along the path that it stands for."""
    columns = []
    for name in names:
        u = nodes.column(name)
        change = np.concatenate([_gradient(nodes.time[rows], u[rows]) for rows in channels.run_slices(nodes.run)])
        columns += [
            (channels.delay_error(name, step), channels.slope_along(nodes, rate, name, change)),
            (channels.gain_error(name), -channels.slope_along(nodes, rate, name, u)),
            (channels.zero_error(nodes, name), -channels.slope_along(nodes, rate, name, np.ones(nodes.n_obs))),
        ]
    return channels.with_column(columns)


def _gradient(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return du/dt; where an input leaps at one time, through the middle of the leap."""
    at, place, count = np.unique(time, return_inverse=True, return_counts=True)
    if len(at) < 2:
        return np.zeros(len(time))
    return np.gradient(np.bincount(place, values) / count, at)[place]
