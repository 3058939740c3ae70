"""Integral of a rate from the first sample on."""

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline


def running_integral(
    time: Float[np.ndarray, " n"], rate: Float[np.ndarray, "n ..."], at: Float[np.ndarray, " m"] | None = None
) -> Float[np.ndarray, "k ..."]:
    """Integrate a rate from the first sample up to each time, by the cubic spline through the samples.

    The rate may have further axes; `at` are the upper limits, by default the times of the samples.
    """
    return CubicSpline(time, rate).antiderivative()(time if at is None else at)
