"""Traps in which the machine remembers, by states that no sensor shows; and rates of a filter, of one that sticks."""

import numpy as np

from bayes_greybox.data.trajectories import Trajectories

from .trap import multisine, noisy, path, recorded, staircase, trap

FINER = 200
"""Plain steps between two samples: a mass that sticks has no smooth equation that a solver could follow."""


@trap(13, {"x": "v", "v": "-30*x - 0.6*v + u"})
def _degrading_hysteresis(rng: np.random.Generator) -> Trajectories:
    """Softening and loss come of one hidden state, and strength fades as the drive is raised: the nearest entries are a
    softening spring and drag, which remember nothing. Bouc and Wen's joint, which loses strength with the energy that
    it has taken.
    """
    t = 0.015 * np.arange(3000)
    waves, end = multisine(rng, 1.5, 6.0, 9, 5.0), t[-1]
    k, share, c = 30.0, 0.45, 0.6

    def u(s):
        return (0.3 + 0.7 * s / end) * waves(s)

    def rates(_, x, u):
        x, v, h, taken = x
        slip = v - (1 + 0.15 * taken) * (1.2 * abs(v) * h + 0.5 * v * abs(h))
        return v, -share * k * x - (1 - share) * k * h - c * v + u, slip, h * v

    x = path(rates, [0.0] * 4, t, u)[0]
    return recorded(t, noisy(rng, x, 0.02), u(t))


@trap(14, {"x": "v", "v": "-25*x - 0.3*v + u"}, learned=("x", "v"), hold="held")
def _rubber_mount(rng: np.random.Generator) -> Trajectories:
    """Stiffness and damping, which are learned, take most of it; the creep that is left after each step looks like a
    drift of the sensor, or dry friction that holds the mass off its rest. Three of Maxwell's elements over two decades
    of time.
    """
    n, step = 2500, 0.012
    t = step * np.arange(n)
    u, breaks = staircase(rng, n * step, 1.2, 6.0)
    k, tau = (9.0, 7.0, 6.0), (0.03, 0.3, 3.0)

    def rates(_, x, u):
        x, v, *z = x
        creep = sum(stiff * each for stiff, each in zip(k, z, strict=True))
        return v, -25 * x - 0.3 * v - creep + u, *(v - each / time for each, time in zip(z, tau, strict=True))

    x = path(rates, [0.0] * 5, t, u, breaks=breaks)[0]
    return recorded(t, noisy(rng, x, 0.01), u(t))


@trap(15, {"x": "v", "v": "-36*x - 0.3*v + u"})
def _autoparametric_absorber(rng: np.random.Generator) -> Trajectories:
    """A hidden mode at half the frequency takes the energy once the motion is large: seen from x alone, a damper that
    is far from linear.
    """
    t = 0.015 * np.arange(4000)
    phase = rng.uniform(0, 2 * np.pi)
    start = 0.06 * rng.choice([-1, 1]) * rng.uniform(0.8, 1.2)

    def u(s):
        return (0.6 + 0.3 * np.sin(0.17 * s + phase)) * np.cos(6.0 * s)

    def rates(_, x, u):
        x, v, y, w = x
        return v, -36 * x - 0.3 * v - 2.0 * y**2 + u, w, -9 * y - 0.07 * w - 4.0 * x * y

    x = path(rates, (0.0, 0.0, start, 0.0), t, u)[0]
    return recorded(t, noisy(rng, x, 0.02), u(t))


@trap(28, {"x": "v", "v": "-40*x - 0.4*v + u"}, rates={"x": "v"}, allowed={"coulomb-friction"})
def _filtered_coulomb(rng: np.random.Generator) -> Trajectories:
    """Dry friction that sticks, behind rates that a filter computed: what is smoothed there looks rounded. Friction of
    0.55 N on 1 kg under some 2 N; the position with 2 % noise.
    """
    n, step = 2000, 0.01
    u = multisine(rng, 2.0, 9.0, 4, 1.7)
    fine = u(step / FINER * np.arange(n * FINER))
    x, v, h, found = 0.02, 0.0, step / FINER, np.empty(n)
    for i, push in enumerate(fine.tolist()):
        if i % FINER == 0:
            found[i // FINER] = x
        pull = push - 40 * x - 0.4 * v
        if v == 0.0:
            v = 0.0 if abs(pull) <= 0.55 else h * (pull - np.copysign(0.55, pull))
        else:
            after = v + h * (pull - np.copysign(0.55, v))
            # What would turn round within a step comes to rest first.
            v = after if after * v > 0 else 0.0
        x += h * v
    return recorded(step * np.arange(n), noisy(rng, found, 0.02), fine[::FINER])
