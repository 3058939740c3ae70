"""Smooth paths, sampled evenly or not, with or without noise."""

import numpy as np

from bayes_greybox.data.samples.sample_noise import sample_noise
from bayes_greybox.data.trajectories import Trajectories

STEP = 0.05


def path(t, phase=0.0):
    return np.sin(t + phase) + 0.3 * np.sin(2.3 * t)


def steps(n, dt, rng=None):
    """Times with a spacing of dt, jittered by a third of it where there is a generator."""
    t = dt * np.arange(n)
    return t if rng is None else t + dt * rng.uniform(-1, 1, n) / 3


def runs(times, noise=0.0, seed=0, size=1.0, phase=0.0):
    rng = np.random.default_rng(seed)
    x = [size * (path(t, phase) + noise * rng.standard_normal(len(t))) for t in times]
    return Trajectories.from_arrays(times, states={"x": x}, constant="keep")


def noise_of(data):
    return sample_noise(data.time, data.matrix(data.state_names), data.run_lengths)


def paths(n=800):
    t = np.arange(n) * STEP
    forced = np.sin(t) + 0.5 * np.cos(2.3 * t)
    decaying = np.exp(-0.1 * t) * np.cos(3 * t)
    bouncing = np.abs(np.sin(1.1 * t))  # kinks
    square = np.tanh(20 * np.sin(0.7 * t))
    ramp = 0.3 * t
    return {"forced": forced, "decaying": decaying, "bouncing": bouncing, "square": square, "ramp": ramp}
