"""A pull that no catalogue has

Mechanics. A magnet beside the track pulls the trolley while it is near. No law of the
catalogue has that shape: the study shows where the gap is, and says that most likely it
has no name for it.
"""

import numpy as np
from scipy.integrate import solve_ivp

import bayes_greybox as bg

rng, t = np.random.default_rng(9), np.arange(0, 40, 0.05)


def force(t):
    """Return the force that drives the trolley, in N."""
    return 6 * np.sin(2.1 * t) + 4 * np.sin(5.3 * t + 1)


def rates(t, state):
    """Return the rates of position and speed of the real trolley."""
    x, v = state
    return v, force(t) / 2 - 15 * x - 0.4 * v - 3.0 * np.exp(-(((x - 0.2) / 0.2) ** 2))


x, v = solve_ivp(rates, (0, 40), (0.0, 0.0), t_eval=t, rtol=1e-9, atol=1e-12).y
measured = bg.Trajectories.from_arrays(
    t,
    states={"x": x, "v": v},
    inputs={"F": force(t)},
    derivatives={"v": rates(t, (x, v))[1] + 0.1 * rng.standard_normal(len(t))},
    units={"t": "s", "x": "m", "v": "m/s", "F": "N"},
)
train, test = measured.split(0.7)
model = bg.GreyBox(simulation={"x": "v", "v": "F/2 - 15*x - 0.4*v"})
study = bg.find_missing_effects(
    model, train, test=test, catalogue="mechanical", settle=False
)
