"""Leaps of an input from one sample to the next: those of a switch, and none of noise or of a steep slope."""

import numpy as np
from jaxtyping import Bool, Float

from bayes_greybox.data.samples.sample_noise import OUTLYING
from bayes_greybox.discovery.grid.latent_force import MEDIAN_ABSOLUTE_NORMAL

NEIGHBOURS, ROUNDING = 2, 1e-9
"""Steps on either side that a step is compared with, and share of the range that is the rounding of a file."""


def leaps(values: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n_step"]:
    """Return true for each step that differs from the median of its neighbours by far more than is usual."""
    steps, m = np.diff(values), NEIGHBOURS
    if len(steps) <= 2 * m:
        return np.zeros(len(steps), bool)
    padded = np.pad(steps, m, mode="reflect", reflect_type="odd")
    around = [padded[k : k + len(steps)] for k in range(2 * m + 1) if k != m]
    away = np.abs(steps - np.median(around, axis=0))
    usual = float(np.median(away)) / MEDIAN_ABSOLUTE_NORMAL
    return away > max(OUTLYING * usual, ROUNDING * float(np.ptp(values)))


def beside_leaps(values: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Return true for the samples before and after a leap."""
    found = leaps(values)
    return np.append(found, False) | np.append(False, found)
