"""Integral of a rate from the first sample on."""

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline


def running_integral(
    time: Float[np.ndarray, " n"], rate: Float[np.ndarray, "n ..."], at: Float[np.ndarray, " m"] | None = None
) -> Float[np.ndarray, "k ..."]:
    """Integrate a rate from the first sample up to each time, by the cubic spline through the samples.

    Args:
        time: Times of one run, increasing.
        rate: Rate at these times, or several along further axes.
        at: Upper limits of the integral; the times of the samples by default.
    """
    return CubicSpline(time, rate).antiderivative()(time if at is None else at)
