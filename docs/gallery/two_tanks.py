"""An outflow left out

Fluids. Two tanks in cascade, and a simulation whose lower tank has no outflow. The lower
level's rate is measured with noise; the square root of the level is found.
"""

import numpy as np

import bayes_greybox as bg

measured = bg.systems.two_tanks().simulate(t=np.linspace(0, 1200, 601), noise=0.05, seed=1)
train, test = measured.split(0.7)
model = bg.GreyBox(simulation={"h1": "0.05*u - 0.1*sqrt(h1)", "h2": "0.1*sqrt(h1)"})
study = bg.find_missing_effects(model, train, test=test, catalogue="fluid", settle=False)
