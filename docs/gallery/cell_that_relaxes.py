"""A cell that relaxes

Batteries. The voltage of a cell in pulses of current, a sample a second, and a simulation
of its open-circuit voltage and one resistance. The voltage also has a slow part that
follows the current with a time constant of 25 s. Neither it nor the state of charge is
measured.
"""

import numpy as np

import bayes_greybox as bg

rng, n = np.random.default_rng(3), 900
current, slow = np.zeros(n), np.zeros(n)
for k in range(0, n, 40):
    current[k : k + int(rng.integers(8, 36))] = rng.uniform(-2, 3)
kept = np.exp(-1 / 25)  # share kept over a second, time constant 25 s
for k in range(1, n):
    slow[k] = kept * slow[k - 1] + (1 - kept) * current[k - 1]
charge = 0.8 - np.append(0.0, np.cumsum(current[:-1])) / 9000
volts = 3.2 + 0.9 * charge - 0.05 * current - 0.03 * slow + 1e-3 * rng.standard_normal(n)
measured = bg.Trajectories.from_arrays(
    np.arange(n),
    inputs={"i": current},
    outputs={"V": volts},
    units={"t": "s", "i": "A", "V": "V"},
)
train, test = measured.split(0.7)
model = bg.GreyBox(
    simulation={"soc": "-i/9000", "V": "3.2 + 0.9*soc - R0*i"},
    parameters={"R0": 0.05},
    starts={"soc": 0.8},
    rows=bg.DerivativeRows(interpolation="zoh"),
)
study = bg.find_missing_effects(model, train, test=test, catalogue="battery", settle=False)
