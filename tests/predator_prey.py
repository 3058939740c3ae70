"""Samples of a predator and its prey, and the coefficients by integration of the whole equations."""

import numpy as np
from scipy.integrate import odeint
from scipy.optimize import least_squares

from bayes_greybox.data.trajectories import Trajectories

COEFFICIENTS = np.array([2.0, -1.0, 1.0, -4.0])
"""Of x and x·y in the rate of the prey x, of x·y and y in that of the predator y."""

STARTS = np.array([5.0, 3.0])


def populations(time, coefficients=COEFFICIENTS, starts=STARTS):
    """Both at some times."""

    def rate(t, z):
        x, y = z
        return [coefficients[0] * x + coefficients[1] * x * y, coefficients[2] * x * y + coefficients[3] * y]

    return odeint(rate, starts, time, tfirst=True, rtol=1e-8, atol=1e-8).T


def sampled(seed=0, noise=0.1, n=41, end=4.0, keep="xy"):
    """Noisy samples of both or of one."""
    time = np.linspace(0, end, n)
    x, y = populations(time) + noise * np.random.default_rng(seed).standard_normal((2, n))
    return Trajectories.from_arrays(time, states={name: z for name, z in {"x": x, "y": y}.items() if name in keep})


def by_integration(data, sd, free=(0, 1, 2, 3)):
    """Least squares of the whole equations: the free coefficients and their standard deviations.

    Args:
        data: Samples.
        sd: Noise of each sensor.
        free: Coefficients to be found; others are the true ones.
    """
    seen = ["xy".index(name) for name in data.state_names]
    measured = data.matrix(data.state_names).T

    def residual(p):
        coefficients = COEFFICIENTS.copy()
        coefficients[list(free)] = p[:-2]
        return ((populations(data.time, coefficients, p[-2:])[seen] - measured) / np.reshape(sd, (-1, 1))).ravel()

    # Its slopes by steps far above what the integration is off by, or they are of its rounding.
    found = least_squares(residual, [*COEFFICIENTS[list(free)], *STARTS], "3-point", diff_step=1e-3, ftol=1e-6)
    sigma2 = np.sum(found.fun**2) / (measured.size - len(found.x))
    covariance = sigma2 * np.linalg.inv(found.jac.T @ found.jac)
    return found.x[:-2], np.sqrt(np.diag(covariance))[:-2]
