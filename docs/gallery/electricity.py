"""Electricity: a resistor that feeds
==================================

Van der Pol's circuit, in the time of its linear part, and one without the nonlinear resistor.

The rate that the simulation lacks depends on two quantities: over the voltage it is no curve, divided by the rate of
the voltage it is one, which a study is given to name. Dots as a noisy sensor shows it, and the law.
"""

import matplotlib.pyplot as plt
import numpy as np

import bayes_greybox as bg

t = np.linspace(0.0, 30.0, 401)
real = bg.systems.van_der_pol().simulate(t=t, noise=0.0, seed=1)
lacking = bg.systems.van_der_pol(mu=0.0).simulate(t=t, noise=0.0, seed=1)

# What the simulation lacks of the rate, as a noisy sensor shows it.
measured = bg.systems.van_der_pol().simulate(t=t, noise=0.1, seed=1)
y, v = measured.states["y"], measured.states["ydot"]
kept = np.abs(v) > 0.5
lacks = ((measured.derivatives["ydot"] + y) / np.where(kept, v, 1.0))[kept]
at = y[kept]
over = np.linspace(at.min(), at.max(), 200)

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
left.plot(t, real.states["y"], label="real system")
left.plot(t, lacking.states["y"], "--", label="simulation that lacks it")
left.set(xlabel="time", ylabel="voltage")
left.legend()
right.plot(at, lacks, ".", markersize=3, color="0.6", label="measured")
right.plot(over, 1.5 * (1 - over**2), label="1.5 (1 − y²)")
right.set(xlabel="voltage", ylabel="rate that it lacks, over dy/dt")
right.legend()
