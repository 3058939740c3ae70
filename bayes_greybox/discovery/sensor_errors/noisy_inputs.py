"""Noise on the samples of an input, which the machine does not feel.

A simulation that is driven by what the sensor read, u + e, is off by ∂G/∂u e: something that follows the fast part of u
and nothing of its slow part, as a hysteresis with a small loop does. The true input is estimated by smoothing between
its leaps, and the column of an error is ∂G/∂u (ũ − u) over the RMS of ũ − u: its size is the noise's, in the unit of u.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.samples.sample_noise import OUTLYING, sample_noise
from bayes_greybox.data.trajectories import Trajectories

from .channels import NOISE, ChannelSuspect, ErrorColumns, Rate, Sizes, run_slices, slope_along, with_column
from .samples import LARGEST_NOISE, Smoothed, smooth

DEGREES = (0, 1, 2)
"""Degrees of the polynomials that a piece between two leaps may be."""


def noise_columns(data: Trajectories, rate: Rate) -> ErrorColumns:
    """Return the noise of each input that looks noisy, with its column: the change of the rate per unit of noise."""
    columns = []
    for name, smooth_input in quiet_inputs(data).items():
        away = smooth_input - data.column(name)
        size = float(np.sqrt(np.mean(away**2)))
        if size > 0:
            columns.append((ChannelSuspect(NOISE, name, size), slope_along(data, rate, name, away / size)))
    return with_column(columns)


def without_noise(data: Trajectories, sizes: Sizes) -> Trajectories:
    """Return the data with the noise taken off inputs, as large a share of it as was found on the training data."""
    shares = {error.channel: np.clip(size / error.sd, 0.0, 1.0) for error, size in sizes.items() if error.kind == NOISE}
    if not shares:
        return data
    quiet = quiet_inputs(data)
    moved = {name: x + share * (quiet.get(name, x) - x) for name, share in shares.items() for x in [data.column(name)]}
    return replace(data, inputs={**data.inputs, **moved})


def quiet_inputs(data: Trajectories) -> Mapping[str, Float[np.ndarray, " n_obs"]]:
    """Return the inputs whose samples show white noise, smoothed between their leaps."""
    names, found = data.input_names, {}
    noise = sample_noise(data.time, data.matrix(names), data.run_lengths)
    for name, s in zip(names, noise.tolist(), strict=True):
        u = data.column(name)
        if 0 < s < LARGEST_NOISE * np.std(u):
            found[name] = np.concatenate([_quiet(data.time[rows], u[rows], s) for rows in run_slices(data.run)])
    return found


def _quiet(time: np.ndarray, values: np.ndarray, s: float) -> np.ndarray:
    """Return samples of one run, smoothed between leaps: steps that noise of standard deviation s does not make."""
    leaps = np.flatnonzero(np.abs(np.diff(values)) > OUTLYING * np.sqrt(2) * s) + 1
    pieces = zip(np.split(time, leaps), np.split(values, leaps), strict=True)
    return np.concatenate([_smoothed(t, u, s) for t, u in pieces])


def _smoothed(time: np.ndarray, values: np.ndarray, s: float) -> np.ndarray:
    """Return a piece as it is, as a polynomial or smoothed: whichever has the least risk (Stein 1981).

    A fit with k coefficients has the risk RSS/n + 2 s² k/n without bias, the samples as they are 2 s².
    """
    n, centred = len(values), (time - np.mean(time)) / (np.ptp(time) or 1.0)
    best = smooth(time, values, s)
    for degree in DEGREES:
        if degree + 1 < n:
            fit, left = np.polyval(np.polyfit(centred, values, degree), centred), (degree + 1) / n
            risk = float(np.mean((values - fit) ** 2)) + 2 * s**2 * left
            best = Smoothed(fit, left, risk) if risk < best.risk else best
    return best.path
