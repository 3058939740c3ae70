"""Many runs of dx/dt = f(t, x, u) at once on fixed steps: candidates of an experiment under draws of a model.

The method is the classical one of Runge and Kutta, of order four (Kutta 1901). All runs take the same steps, so that
one evaluation of the rate serves thousands of them and nothing is compiled; how many steps are enough, the caller finds
by doubling them.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

Rate = Callable[[Float[np.ndarray, "n_run n_draw d"], Float[np.ndarray, "n_run 1 p"], float], np.ndarray]
"""(states, inputs, time) -> rates of the states."""


def stage_times(times: Float[np.ndarray, " n"], steps: int) -> Float[np.ndarray, " n_stage"]:
    """Times at which inputs are needed: the start, middle and end of each step.

    Args:
        times: Of the samples.
        steps: Between two of them.
    """
    share = np.arange(2 * steps) / (2 * steps)
    inside = times[:-1, None] + np.diff(times)[:, None] * share
    return np.append(inside.ravel(), times[-1])


def side_by_side(
    rate: Rate,
    starts: Float[np.ndarray, "n_run n_draw d"],
    times: Float[np.ndarray, " n"],
    inputs: Float[np.ndarray, "n_run n_stage p"],
    limit: Float[np.ndarray, " d"],
) -> Float[np.ndarray, "n_run n_draw n d"]:
    """States at the samples; NaN from where a run has left its limits, which is a result and no error.

    Args:
        rate: Of all runs at once.
        starts: States at the first sample.
        times: Of the samples.
        inputs: At the `stage_times`.
        limit: A run has failed once a state is larger.
    """
    steps = (inputs.shape[1] - 1) // (2 * (len(times) - 1))
    found = np.full((*starts.shape[:2], len(times), starts.shape[2]), np.nan)
    found[:, :, 0] = x = np.array(starts, float)
    place = 0
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for i, (begin, length) in enumerate(zip(times[:-1], np.diff(times), strict=True)):
            h = length / steps
            for k in range(steps):
                t = begin + k * h
                first, middle, last = (inputs[:, None, place + j] for j in range(3))
                k1 = rate(x, first, t)
                k2 = rate(x + 0.5 * h * k1, middle, t + 0.5 * h)
                k3 = rate(x + 0.5 * h * k2, middle, t + 0.5 * h)
                k4 = rate(x + h * k3, last, t + h)
                x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
                place += 2
            x = np.where(np.all(np.abs(x) < limit, axis=-1, keepdims=True), x, np.nan)
            found[:, :, i + 1] = x
    return found
