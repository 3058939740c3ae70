"""Runs of a system of prey and predators, and of an oscillator, in memory and one by one, for tests of streams."""

from dataclasses import replace
from functools import cache

import numpy as np
from predator_prey import populations
from sampled_oscillator import SIMULATION, sampled

import bayes_greybox as bg
from bayes_greybox.data.streams.row_stream import RowStream
from bayes_greybox.data.trajectories import Trajectories

LENGTHS = (120, 90, 150, 100, 75)
BOTH = {"x": ["x", "x*y"], "y": ["x*y", "y"]}


@cache
def animals(n_run=5):
    """Runs of different lengths of both populations, noise 0.1."""
    times, values = [], []
    for k in range(n_run):
        time, rng = 0.04 * np.arange(LENGTHS[k % 5]), np.random.default_rng(k)
        exact = populations(time, starts=np.array([5.0 - 0.3 * (k % 7), 3.0 + 0.2 * (k % 6)]))
        times.append(time)
        values.append(exact + 0.1 * rng.standard_normal(exact.shape))
    return Trajectories.from_arrays(times, states={"x": [x for x, _ in values], "y": [y for _, y in values]})


@cache
def oscillations():
    """Four runs of an oscillator with a cubic spring that its simulation lacks; its displacement alone."""
    return sampled(lambda y, v: -(y**3), runs=4, n=120)


@cache
def clipped():
    """The same with a sensor that ends at 0.55."""
    data = oscillations()
    return replace(data, states={"y": np.minimum(data.states["y"], 0.55)})


def stream_of(data, **further):
    """Its runs, one in a chunk."""
    return RowStream.from_chunks(lambda i: data.take(i), data.n_run, **{"sample": 10**6} | further)


def weak(**further):
    return bg.GreyBox(BOTH, **{"rows": bg.WeakRows(), "discrepancy": None} | further)


def path_of(**further):
    return bg.GreyBox({"v": ["y", "y**3"]}, **{"simulation": SIMULATION, "discrepancy": None} | further)
