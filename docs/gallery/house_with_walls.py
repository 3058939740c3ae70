"""Walls that store heat

Heat. A week of a house from one thermometer, every ten minutes, and a simulation of one
thermal mass. The walls are a second one, which no sensor sees.
"""

import numpy as np

import bayes_greybox as bg

rng, minutes = np.random.default_rng(4), 10
t = np.arange(0, 7 * 24, minutes / 60)  # in hours
outside = 5 + 4 * np.sin(2 * np.pi * t / 24) + np.cumsum(0.1 * rng.standard_normal(len(t)))
heater = np.repeat(rng.choice([0.0, 3.0], size=len(t) // 6), 6)
air = wall = 18.0
seen = []
for out, power in zip(outside, heater, strict=True):
    seen.append(air + 0.05 * rng.standard_normal())
    for _ in range(100):
        to_wall = 0.8 * (wall - air)
        air += minutes / 6000 * (0.15 * (out - air) + power + to_wall)
        wall += minutes / 6000 * (air - wall) / 8.0
measured = bg.Trajectories.from_arrays(
    t,
    states={"T": np.array(seen)},
    inputs={"outside": outside, "heater": heater},
    units={"t": "h", "T": "degC", "outside": "degC", "heater": "K/h"},
)
train, test = measured.split(0.7)
model = bg.GreyBox(
    simulation={"T": "0.15*(outside - T) + heater"},
    rows=bg.TrajectoryRows(interpolation="zoh"),
)
study = bg.find_missing_effects(model, train, test=test, catalogue="thermal", settle=False)
