"""What the figures of a study show that its result holds in another form."""

import numpy as np
from jaxtyping import Bool, Float

from bayes_greybox.criticism import discrepancy
from bayes_greybox.discovery.answer.interval import INTERVAL_REACH
from bayes_greybox.discovery.answer.where import GapMap


def support(gap: GapMap) -> Bool[np.ndarray, "*grid"]:
    """Where the grid of a gap map lies within the data, as for the figures of a fit."""
    return discrepancy.support(np.reshape(gap.samples, (-1, len(gap.variables))), gap.axes)


def normal_band(mean: np.ndarray, sd: np.ndarray) -> Float[np.ndarray, "3 n_obs"]:
    """Mean, lower and upper end of a 90 % band."""
    return np.stack([mean, mean - INTERVAL_REACH * sd, mean + INTERVAL_REACH * sd])
