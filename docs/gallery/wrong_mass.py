"""A wrong mass

Mechanics. Nothing is missing: one number of the simulation is off, and acts in all its
terms at once. The study says what it should be.
"""

import numpy as np

import bayes_greybox as bg

measured = bg.systems.duffing(m=2.3, c=0.8, k=30.0, k3=0.0).simulate(
    t=np.linspace(0, 40, 401), noise=0.05, seed=6
)
train, test = measured.split(0.7)
model = bg.GreyBox(
    simulation={"y": "ydot", "ydot": "(F - k*y - c*ydot)/m"},
    parameters={"m": bg.Parameter(2.0, unit="kg"), "k": 30.0, "c": 0.8},
)
study = bg.find_missing_effects(
    model, train, test=test, catalogue="mechanical", settle=False
)
