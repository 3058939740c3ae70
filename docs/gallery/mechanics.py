"""Mechanics: a hardening spring
=============================

A Duffing oscillator, and one without its cubic stiffness, under the same force.

The rate that the simulation lacks, over what it depends on, is what a study is given to name: dots as a noisy
sensor shows it, and the law.
"""

import matplotlib.pyplot as plt
import numpy as np

import bayes_greybox as bg

t = np.linspace(0.0, 20.0, 401)
real = bg.systems.duffing(k3=40.0).simulate(t=t, noise=0.0, seed=1)
lacking = bg.systems.duffing(k3=0.0).simulate(t=t, noise=0.0, seed=1)

# What the simulation lacks of the rate, as a noisy sensor shows it.
measured = bg.systems.duffing(k3=40.0).simulate(t=t, noise=0.2, seed=1)
y, v = measured.states["y"], measured.states["ydot"]
lacks = measured.derivatives["ydot"] - (measured.inputs["F"] - 10 * y - 0.5 * v)
at = measured.states["y"]
over = np.linspace(at.min(), at.max(), 200)

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
left.plot(t, real.states["y"], label="real system")
left.plot(t, lacking.states["y"], "--", label="simulation that lacks it")
left.set(xlabel="time [s]", ylabel="position [m]")
left.legend()
right.plot(at, lacks, ".", markersize=3, color="0.6", label="measured")
right.plot(over, -40 * over**3, label="−40 y³")
right.set(xlabel="position [m]", ylabel="acceleration that it lacks [m/s²]")
right.legend()
