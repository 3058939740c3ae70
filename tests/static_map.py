"""A force over position and speed as a rig measures it, and the study of what it lacks."""

from dataclasses import replace
from functools import cache

import numpy as np

import bayes_greybox as bg
from bayes_greybox.physics.catalogue.loading import load_catalogue

KNOWN = {"R": "20*x + 2*v"}
"""What the simulation knows of it."""


SLUGS = ("quadratic-drag", "viscous-damping", "cubic-damping", "cubic-stiffness", "linear-stiffness", "constant-force")
"""Drags that could be taken for each other, and what a rig could lack besides."""


def few():
    """Those effects alone: others cost time and tell no more."""
    return [
        replace(e, confusions=tuple({*SLUGS} & {*e.confusions}))
        for e in load_catalogue("mechanical")
        if e.slug in SLUGS
    ]


def rig(seed, drag=0.6, n=200, correlation=0.0, order=None):
    """The force over a sweep of both, with a drag that is hidden and noise of 5 %.

    Args:
        seed: Of the sweep and of the noise.
        drag: Coefficient of v|v|.
        n: Rows.
        correlation: Of the noise of neighbouring rows.
        order: Of the rows; that of time by default.
    """
    rng, t = np.random.default_rng(seed), 0.04 * np.arange(n)
    waves = [(0.8, 2.2, seed), (0.3, 5.6, 1.0), (0.15, 11.0, 2.0)]
    x = np.sum([a * np.sin(w * t + p) for a, w, p in waves], axis=0)
    v = np.sum([a * w * np.cos(w * t + p) for a, w, p in waves], axis=0)
    force = 20 * x + 2 * v + drag * v * np.abs(v)
    e = rng.standard_normal(n)
    for i in range(1, n):
        e[i] = correlation * e[i - 1] + np.sqrt(1 - correlation**2) * e[i]
    force = force + 0.05 * np.std(force) * e
    order = np.arange(n) if order is None else order
    return bg.Trajectories.from_arrays(
        t,
        states={"x": x[order], "v": v[order]},
        outputs={"R": force[order]},
        units={"t": "s", "x": "m", "v": "m/s", "R": "N"},
    )


@cache
def drag_study():
    """The study of the drag, not sampled; made once."""
    model = bg.GreyBox(simulation=KNOWN)
    return bg.find_missing_effects(model, rig(0), rig(1), catalogue=few(), settle=False, progress=False)
