"""Noise on the samples of an input, which the machine does not feel.

A simulation that is driven by what the sensor read, u + e, is off by ∂G/∂u e: something that follows the fast part of u
and nothing of its slow part, as a hysteresis with a small loop does. The true input is estimated by smoothing between
its leaps, and the column of an error is ∂G/∂u (ũ − u) over the RMS of ũ − u: its size is the noise's, in the unit of u.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.samples.sample_noise import sample_noise
from bayes_greybox.data.trajectories import Trajectories

from . import channels
from .channels import ChannelSuspect, ErrorColumns, Rate, Sizes
from .leaps import leaps
from .samples import LARGEST_NOISE, Smoothed, smooth

DEGREES = (0, 1, 2)
"""Degrees of the polynomials that a piece between two leaps may be."""

Quiet = Mapping[ChannelSuspect, Float[np.ndarray, " n_obs"]]
"""Inputs without their noise, by that noise, whose prior standard deviation is the RMS of what smoothing takes off."""


def noisy_inputs(data: Trajectories) -> Quiet:
    """Return the inputs whose samples show white noise, smoothed between their leaps."""
    names, found = data.input_names, {}
    noise = sample_noise(data.time, data.matrix(names), data.run_lengths)
    for name, s in zip(names, noise.tolist(), strict=True):
        if 0 < s < LARGEST_NOISE * np.std(data.column(name)):
            quiet = _quiet(data, name, s)
            size = float(np.sqrt(np.mean((quiet - data.column(name)) ** 2)))
            if size > 0:
                found[ChannelSuspect(channels.NOISE, name, size)] = quiet
    return found


def noise_columns(data: Trajectories, quiet: Trajectories, errors: Quiet, rate: Rate) -> ErrorColumns:
    """Return the noise of inputs with its columns, the change of the rate per unit of noise; `quiet` is without any."""
    away = {error: (quiet.column(error.channel) - data.column(error.channel)) / error.sd for error in errors}
    moved = {error: each for error, each in away.items() if np.any(each != 0)}
    return channels.with_column(
        [(error, channels.slope_along(data, rate, error.channel, each)) for error, each in moved.items()]
    )


def without_noise(data: Trajectories, sizes: Sizes) -> Trajectories:
    """Return the data with the noise taken off inputs, as large a share of it as was found on the training data."""
    return channels.nearer(data, sizes, channels.NOISE, lambda error: _quiet(data, error.channel, error.sd))


def _quiet(data: Trajectories, name: str, s: float) -> np.ndarray:
    """Return an input with noise of standard deviation s, smoothed between leaps."""
    pieces = []
    for rows in channels.run_slices(data.run):
        time, values = data.time[rows], data.column(name)[rows]
        at = np.flatnonzero(leaps(values)) + 1
        pieces += [_smoothed(t, u, s) for t, u in zip(np.split(time, at), np.split(values, at), strict=True)]
    return np.concatenate(pieces)


def _smoothed(time: np.ndarray, values: np.ndarray, s: float) -> np.ndarray:
    """Return a piece as it is, as a polynomial or smoothed: whichever has the least risk (Stein 1981)."""
    n, centred = len(values), (time - np.mean(time)) / (np.ptp(time) or 1.0)
    best = smooth(time, values, s)
    for degree in DEGREES:
        if degree + 1 < n:
            fit, left = np.polyval(np.polyfit(centred, values, degree), centred), (degree + 1) / n
            risk = float(np.mean((values - fit) ** 2)) + 2 * s**2 * left
            best = Smoothed(fit, left, risk) if risk < best.risk else best
    return best.path
