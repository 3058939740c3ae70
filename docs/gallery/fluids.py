"""Fluids: an outflow left out
===========================

Two tanks in cascade, and a simulation whose lower tank has no outflow.
"""

import matplotlib.pyplot as plt
import numpy as np

import bayes_greybox as bg

t = np.linspace(0.0, 600.0, 401)
real = bg.systems.two_tanks().simulate(t=t, noise=0.0, seed=1)
lacking = bg.systems.two_tanks(c3=0.0).simulate(t=t, noise=0.0, seed=1)

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
axes.plot(t, real.states["h2"], label="real system")
axes.plot(t, lacking.states["h2"], "--", label="simulation that lacks it")
axes.set(xlabel="time [s]", ylabel="level [cm]")
axes.legend()
