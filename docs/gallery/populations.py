"""Populations: predators that eat nothing
=======================================

Hares and lynxes, and a simulation in which prey is never eaten.
"""

import matplotlib.pyplot as plt
import numpy as np

import bayes_greybox as bg

t = np.linspace(0.0, 8.0, 401)
real = bg.systems.lotka_volterra().simulate(t=t, noise=0.0, seed=1)
lacking = bg.systems.lotka_volterra(b=0.0).simulate(t=t, noise=0.0, seed=1)

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
axes.plot(t, real.states["predator"], label="real system")
axes.plot(t, lacking.states["predator"], "--", label="simulation that lacks it")
axes.set(xlabel="time [year]", ylabel="predators [1000]")
axes.legend()
