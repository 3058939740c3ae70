"""Mechanics: a hardening spring
=============================

A Duffing oscillator, and one without its cubic stiffness, under the same force.
"""

import matplotlib.pyplot as plt
import numpy as np

import bayes_greybox as bg

t = np.linspace(0.0, 20.0, 401)
real = bg.systems.duffing(k3=40.0).simulate(t=t, noise=0.0, seed=1)
lacking = bg.systems.duffing(k3=0.0).simulate(t=t, noise=0.0, seed=1)

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
axes.plot(t, real.states["y"], label="real system")
axes.plot(t, lacking.states["y"], "--", label="simulation that lacks it")
axes.set(xlabel="time [s]", ylabel="position [m]")
axes.legend()
