"""A force that comes late

The sensor. The simulation is right; its input was logged by another device, 35 ms behind.
A delay would look like damping of the wrong sign, and is weighed beside it.
"""

import numpy as np

import bayes_greybox as bg

late = 0.035
t = np.linspace(0, 40, 801)
exact = bg.systems.duffing(k3=0.0).simulate(t=t, noise=0.05, seed=7)
measured = bg.Trajectories.from_arrays(
    t,
    states=dict(exact.states),
    inputs={"F": np.interp(t - late, t, exact.inputs["F"])},
    derivatives={"ydot": exact.derivatives["ydot"]},
    units=dict(exact.units),
)
train, test = measured.split(0.7)
model = bg.GreyBox(simulation={"y": "ydot", "ydot": "F - 10*y - 0.5*ydot"})
study = bg.find_missing_effects(
    model, train, test=test, catalogue="mechanical", settle=False
)
