"""Electricity: a resistor that feeds
==================================

Van der Pol's circuit, in the time of its linear part, and one without the nonlinear resistor.
"""

import matplotlib.pyplot as plt
import numpy as np

import bayes_greybox as bg

t = np.linspace(0.0, 30.0, 401)
real = bg.systems.van_der_pol().simulate(t=t, noise=0.0, seed=1)
lacking = bg.systems.van_der_pol(mu=0.0).simulate(t=t, noise=0.0, seed=1)

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
axes.plot(t, real.states["y"], label="real system")
axes.plot(t, lacking.states["y"], "--", label="simulation that lacks it")
axes.set(xlabel="time", ylabel="voltage")
axes.legend()
