"""Traps in which the machine remembers, by states that no sensor shows and the simulation lacks."""

import numpy as np

from bayes_greybox.data.trajectories import Trajectories

from .trap import Trap, generator, multisine, noisy, path, staircase


def memory_traps() -> list[Trap]:
    """All of them."""
    return [_degrading_hysteresis(), _rubber_mount(), _autoparametric_absorber()]


def _degrading_hysteresis() -> Trap:
    """Bouc and Wen's joint, which loses strength with the energy that it has taken."""

    def data(seed: int) -> Trajectories:
        rng = generator(seed, 13)
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
        return Trajectories.from_arrays(t, states={"x": noisy(rng, x, 0.02)}, inputs={"u": u(t)})

    return Trap(
        "degrading-hysteresis",
        "Softening and loss come of one hidden state, and strength fades as the drive is raised: the nearest entries "
        "are a softening spring and drag, which remember nothing.",
        {"x": "v", "v": "-30*x - 0.6*v + u"},
        "v",
        data,
    )


def _rubber_mount() -> Trap:
    """Three of Maxwell's elements over two decades of time."""

    def data(seed: int) -> Trajectories:
        rng = generator(seed, 14)
        n, step = 2500, 0.012
        t = step * np.arange(n)
        u, breaks = staircase(rng, n * step, 1.2, 6.0)
        k, tau = (9.0, 7.0, 6.0), (0.03, 0.3, 3.0)

        def rates(_, x, u):
            x, v, *z = x
            creep = sum(stiff * each for stiff, each in zip(k, z, strict=True))
            return v, -25 * x - 0.3 * v - creep + u, *(v - each / time for each, time in zip(z, tau, strict=True))

        x = path(rates, [0.0] * 5, t, u, breaks=breaks)[0]
        return Trajectories.from_arrays(t, states={"x": noisy(rng, x, 0.01)}, inputs={"u": u(t)})

    return Trap(
        "rubber-mount",
        "Stiffness and damping, which are learned, take most of it; the creep that is left after each step looks like "
        "a drift of the sensor, or dry friction that holds the mass off its rest.",
        {"x": "v", "v": "-25*x - 0.3*v + u"},
        "v",
        data,
        learned=("x", "v"),
        hold="held",
    )


def _autoparametric_absorber() -> Trap:
    def data(seed: int) -> Trajectories:
        rng = generator(seed, 15)
        t = 0.015 * np.arange(4000)
        phase = rng.uniform(0, 2 * np.pi)
        start = 0.06 * rng.choice([-1, 1]) * rng.uniform(0.8, 1.2)

        def u(s):
            return (0.6 + 0.3 * np.sin(0.17 * s + phase)) * np.cos(6.0 * s)

        def rates(_, x, u):
            x, v, y, w = x
            return v, -36 * x - 0.3 * v - 2.0 * y**2 + u, w, -9 * y - 0.07 * w - 4.0 * x * y

        x = path(rates, (0.0, 0.0, start, 0.0), t, u)[0]
        return Trajectories.from_arrays(t, states={"x": noisy(rng, x, 0.02)}, inputs={"u": u(t)})

    return Trap(
        "autoparametric-absorber",
        "A hidden mode at half the frequency takes the energy once the motion is large: seen from x alone, a damper "
        "that is far from linear.",
        {"x": "v", "v": "-36*x - 0.3*v + u"},
        "v",
        data,
    )
