"""A hardening spring

Mechanics. A Duffing oscillator under a random force; its simulation has a linear spring.
Two laws close the gap, the cubic one and a power of the position whose exponent came out
close to three, and the study says how far it tells them apart.
"""

import numpy as np

import bayes_greybox as bg

measured = bg.systems.duffing(k3=40.0).simulate(
    t=np.linspace(0, 60, 601), noise=0.05, seed=1
)
train, test = measured.split(0.7)
model = bg.GreyBox(simulation={"y": "ydot", "ydot": "F - 10*y - 0.5*ydot"})
study = bg.find_missing_effects(
    model, train, test=test, catalogue="mechanical", settle=False
)
