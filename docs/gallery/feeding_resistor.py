"""A resistor that feeds energy in

Electricity. Van der Pol's circuit, with time scaled so that its linear part has frequency
one, and a simulation without the nonlinear resistor, which feeds small oscillations and
damps large ones. The mechanical catalogue calls the resistor's two parts Van der Pol
damping and viscous damping of reversed sign.
"""

import numpy as np

import bayes_greybox as bg

measured = bg.systems.van_der_pol().simulate(t=np.linspace(0, 60, 601), noise=0.05, seed=1)
train, test = measured.split(0.7)
model = bg.GreyBox(simulation={"y": "ydot", "ydot": "-y"})
study = bg.find_missing_effects(
    model, train, test=test, catalogue="mechanical", settle=False
)
