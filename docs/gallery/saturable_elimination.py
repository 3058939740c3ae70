"""An enzyme that saturates

Drugs. The concentration of a substance in the blood after three doses. An enzyme takes it
away too, which the simulation does not know: it leaves faster than the simulation says,
least so after large doses, when the enzyme is saturated.
"""

import numpy as np

import bayes_greybox as bg

rng, t = np.random.default_rng(5), np.arange(0.0, 60.0, 0.5)
dose = np.where(t % 20 < 2, np.select([t < 20, t < 40], [2.0, 6.0], 12.0), 0.0)
blood, seen = 0.0, []
for rate in dose:
    seen.append(blood + 0.05 * rng.standard_normal())
    for _ in range(500):
        blood += 1e-3 * (rate - 0.1 * blood - 3.0 * blood / (4.0 + blood))
measured = bg.Trajectories.from_arrays(
    t,
    states={"c": np.array(seen)},
    inputs={"dose": dose},
    units={"t": "h", "c": "mg/l", "dose": "mg/l/h"},
)
model = bg.GreyBox(
    simulation={"c": "dose - 0.1*c"}, rows=bg.TrajectoryRows(interpolation="zoh")
)
study = bg.find_missing_effects(model, measured, catalogue="compartment", settle=False)
