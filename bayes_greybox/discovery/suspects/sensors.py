"""The sensors whose samples are the rows, and the inputs that drive their path, as suspects.

A sensor that shows (1 + κ) y(t − d) + o + drift adds to its rows, to first order,

    delay  −d ẏ        gain  κ y        offset  o        drift  o · (t − t̄) / range

and an input that is wrong acts as a force along the path, see `channels`.
"""

from collections.abc import Sequence

import numpy as np
import sympy
from jaxtyping import Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.grammar import symbol
from bayes_greybox.physics.terms import Term

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
    shifted,
    slope_along,
)


def sensor_columns(
    samples: Trajectories, path: Trajectories
) -> list[tuple[ChannelSuspect, Float[np.ndarray, " n_row"]]]:
    """Suspects about every sensor with their columns at the rows, in the sensor's unit per unit of their size.

    Args:
        samples: What the sensors showed; rows are ordered by sensor, then by sample.
        path: The path at the samples.
    """
    found, names = [], samples.state_names
    step = float(np.median(np.diff(samples.time)[np.diff(samples.run) == 0]))
    span = float(np.ptp(samples.time))
    for k, name in enumerate(names):

        def row(values: np.ndarray, k: int = k) -> np.ndarray:
            return np.concatenate([values if j == k else np.zeros(len(values)) for j in range(len(names))])

        x, ones = path.column(name), np.ones(path.n_obs)
        size = float(np.sqrt(np.mean(x**2)))
        late = shifted(path, {name: -step / 4}).column(name) - shifted(path, {name: step / 4}).column(name)
        found.append((ChannelSuspect(DELAY, name, DELAY_STEPS * step, step), row(late / (step / 2))))
        found.append((ChannelSuspect(GAIN, name, GAIN_SD), row(x)))
        found.append((ChannelSuspect(OFFSET, name, ZERO_SD * size), row(ones)))
        if span > 0:
            found.append((ChannelSuspect(DRIFT, name, ZERO_SD * size), row((path.time - np.mean(path.time)) / span)))
    return found


def input_columns(nodes: Trajectories, rate: Rate, step: float) -> list[tuple[ChannelSuspect, np.ndarray]]:
    """Suspects about every input with the force that they stand for along the path.

    Args:
        nodes: States and inputs along the path.
        rate: The whole modelled rate.
        step: Between two samples.
    """
    found, ones = [], np.ones(nodes.n_obs)
    for name in nodes.input_names:
        u = nodes.column(name)
        slope = slope_along(nodes, rate, name, ones)
        change = np.concatenate([_gradient(nodes.time[own], u[own]) for own in _runs(nodes)])
        size = float(np.sqrt(np.mean(u**2)))
        found.append((ChannelSuspect(DELAY, name, DELAY_STEPS * step, step), slope * change))
        found.append((ChannelSuspect(GAIN, name, GAIN_SD), -slope * u))
        found.append((ChannelSuspect(OFFSET, name, ZERO_SD * size), -slope * ones))
    return [(suspect, column) for suspect, column in found if np.all(np.isfinite(column)) and np.any(column != 0)]


def input_force(suspect: ChannelSuspect, rate: Sequence[tuple[Term, float]]) -> Term | None:
    """What an input's error of a unit adds to a rate that is a sum of terms, as a term; None where no term says it.

    Args:
        suspect: The error.
        rate: Terms of the rate with their coefficients.
    """
    u = symbol(suspect.channel)
    slope = sympy.expand(sum(value * sympy.diff(term.expr, u) for term, value in rate))
    force = {OFFSET: -slope, GAIN: -slope * u}.get(suspect.kind)
    if force is None or force == 0 or force.has(sympy.Derivative, sympy.DiracDelta):
        return None
    return Term(force)


def _runs(data: Trajectories) -> list[np.ndarray]:
    return [np.flatnonzero(data.run == r) for r in dict.fromkeys(data.run.tolist())]


def _gradient(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """du/dt; zero on steps of no length, which end shorter segments."""
    inside = np.concatenate([[True], np.diff(time) > 0])
    found = np.zeros(len(time))
    if np.sum(inside) < 2:
        return found
    found[inside] = np.gradient(values[inside], time[inside])
    return found
