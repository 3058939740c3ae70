"""Nothing is missing

A simulation that is right, and measurements with 5 % of noise: most likely nothing is
missing.
"""

import numpy as np

import bayes_greybox as bg

measured = bg.systems.pendulum().simulate(t=np.linspace(0, 40, 401), noise=0.05, seed=8)
train, test = measured.split(0.7)
model = bg.GreyBox(simulation={"theta": "omega", "omega": "-9.81*sin(theta) - 0.2*omega"})
study = bg.find_missing_effects(
    model, train, test=test, catalogue="mechanical", settle=False
)
