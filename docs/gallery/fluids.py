"""Fluids: an outflow left out
===========================

Two tanks in cascade, and a simulation whose lower tank has no outflow.

The rate that the simulation lacks, over the level, is what a study is given to name: dots as a noisy sensor shows it,
and the law.
"""

import matplotlib.pyplot as plt
import numpy as np

import bayes_greybox as bg

t = np.linspace(0.0, 600.0, 401)
real = bg.systems.two_tanks().simulate(t=t, noise=0.0, seed=1)
lacking = bg.systems.two_tanks(c3=0.0).simulate(t=t, noise=0.0, seed=1)

# What the simulation lacks of the rate, as a noisy sensor shows it.
measured = bg.systems.two_tanks().simulate(t=t, noise=0.2, seed=1)
lacks = measured.derivatives["h2"] - 0.1 * np.sqrt(measured.states["h1"])
at = measured.states["h2"]
over = np.linspace(at.min(), at.max(), 200)

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
left.plot(t, real.states["h2"], label="real system")
left.plot(t, lacking.states["h2"], "--", label="simulation that lacks it")
left.set(xlabel="time [s]", ylabel="level [cm]")
left.legend()
right.plot(at, lacks, ".", markersize=3, color="0.6", label="measured")
right.plot(over, -0.09 * np.sqrt(over), label="−0.09 √h")
right.set(xlabel="level [cm]", ylabel="rate that it lacks [cm/s]")
right.legend()
