"""Populations: prey that nobody eats
==================================

Hares and lynxes, and a simulation in which the lynxes thrive and no hare is lost to them: both grow beyond all
bounds.

The loss of hares that the simulation lacks, over the product of both populations, is what a study is given to name:
dots as noisy counts show it, and the law.
"""

import matplotlib.pyplot as plt
import numpy as np

import bayes_greybox as bg

t = np.linspace(0.0, 3.0, 401)
real = bg.systems.lotka_volterra().simulate(t=t, noise=0.0, seed=1)
lacking = bg.systems.lotka_volterra(b=0.0).simulate(t=t, noise=0.0, seed=1)

# What the simulation lacks of the rate, as a noisy sensor shows it.
measured = bg.systems.lotka_volterra().simulate(t=t, noise=0.3, seed=1)
over_prey = measured.states["prey"] * measured.states["predator"]
lacks = measured.derivatives["prey"] - 0.55 * measured.states["prey"]
at = over_prey
over = np.linspace(at.min(), at.max(), 200)

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
left.plot(t, real.states["predator"], label="real system")
left.plot(t, lacking.states["predator"], "--", label="simulation that lacks it")
left.set(xlabel="time [year]", ylabel="predators [1000]", yscale="log")
left.legend()
right.plot(at, lacks, ".", markersize=3, color="0.6", label="measured")
right.plot(over, -0.028 * over, label="−0.028 · prey · predators")
right.set(xlabel="prey times predators", ylabel="loss that it lacks [1000/year]")
right.legend()
