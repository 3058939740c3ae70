"""An oscillator whose displacement alone is sampled, for tests of rows of samples; integrated by SciPy."""

import numpy as np
from scipy.integrate import odeint

from bayes_greybox.data.trajectories import Trajectories

SIMULATION = {"y": "v", "v": "F - 2*y - 0.15*v"}


def force(t, phase=0.0):
    return 0.9 * np.sin(1.1 * t + phase) + 0.5 * np.sin(2.3 * t + 1) + 0.4 * np.sin(0.47 * t + 2)


def sampled(hidden=lambda y, v: 0.0 * y, noise=0.02, n=400, step=0.1, runs=1, seed=0, bend=lambda t, y: y, keep=None):
    """Samples of y with white noise, and the exact force.

    Args:
        hidden: What the simulation lacks.
        noise: Over the spread of y.
        n: Samples of a run.
        step: Between samples.
        runs: Runs, each with its own start and force.
        seed: Of the noise.
        bend: What the sensor makes of y at times t.
        keep: Samples that stay, all by default.
    """
    rng, columns = np.random.default_rng(seed), ([], [], [])
    for r in range(runs):
        t = step * np.arange(n)

        def rate(time, x, r=r):
            return [x[1], force(time, r) - 2 * x[0] - 0.15 * x[1] + hidden(x[0], x[1])]

        y = odeint(rate, [0.3 + 0.2 * r, 0.0], t, tfirst=True, rtol=1e-10, atol=1e-10)[:, 0]
        shown = bend(t, y) + noise * np.std(y) * rng.standard_normal(n)
        own = slice(None) if keep is None else keep
        for column, values in zip(columns, (t, shown, force(t, r)), strict=True):
            column.append(values[own])
    t, y, F = columns
    return Trajectories.from_arrays(t, states={"y": y}, inputs={"F": F}, units={"t": "s", "y": "m"})
