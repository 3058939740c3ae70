"""Prey that nobody eats

Populations. Hares and lynxes, and a simulation in which the lynxes thrive and no hare is
lost to them.
"""

import numpy as np

import bayes_greybox as bg

measured = bg.systems.lotka_volterra().simulate(
    t=np.linspace(0, 30, 601), noise=0.05, seed=1
)
train, test = measured.split(0.7)
model = bg.GreyBox(
    simulation={"prey": "0.55*prey", "predator": "0.026*prey*predator - 0.84*predator"}
)
study = bg.find_missing_effects(
    model, train, test=test, catalogue="population", settle=False
)
