"""Populations: prey that nobody eats
==================================

Hares and lynxes, and a simulation in which the lynxes thrive and no hare is lost to them: both grow beyond all
bounds.
"""

import matplotlib.pyplot as plt
import numpy as np

import bayes_greybox as bg

t = np.linspace(0.0, 3.0, 401)
real = bg.systems.lotka_volterra().simulate(t=t, noise=0.0, seed=1)
lacking = bg.systems.lotka_volterra(b=0.0).simulate(t=t, noise=0.0, seed=1)

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
axes.plot(t, real.states["predator"], label="real system")
axes.plot(t, lacking.states["predator"], "--", label="simulation that lacks it")
axes.set(xlabel="time [year]", ylabel="predators [1000]", yscale="log")
axes.legend()
