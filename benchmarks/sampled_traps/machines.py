"""Traps in which the machine changes, or mimics an entry of the catalogue."""

import numpy as np

from bayes_greybox.data.trajectories import Trajectories

from .trap import multisine, noisy, path, recorded, trap


@trap(12, {"x": "v", "v": "-16*x + u"}, allowed={"coulomb-friction", "smooth-friction", "quadratic-drag"})
def _two_laws_as_one(rng: np.random.Generator) -> Trajectories:
    """Dry friction and drag about the one amplitude of speed at which their sum is flat: what they take is that of
    viscous damping, and of their third harmonics 40 % are left.
    """
    t = 0.01 * np.arange(4000)
    dry = 0.25
    drag = 1.5 * dry / 0.8**2
    phase = rng.uniform(0, 2 * np.pi)

    def u(s):
        return 0.637 * (1 + 0.30 * np.sin(0.4 * s + phase)) * np.sin(4.0 * s)

    def rates(_, x, u):
        x, v = x
        return v, -16 * x - dry * np.tanh(v / 0.05) - drag * v * abs(v) + u

    x, _ = path(rates, (-0.2, 0.0), t, u, begin=-15.0)
    return recorded(t, noisy(rng, x, 0.015), u(t))


@trap(16, {"x": "v", "v": "-39.48*x - 0.06*v"})
def _cooling_spring(rng: np.random.Generator) -> Trajectories:
    """A spring cools while it rings down: its frequency follows amplitude squared at all times, as that of a softening
    cubic spring does. Only a third harmonic of 0.3 % would tell them apart.
    """
    k, c = 39.48, 0.06
    t = 0.006 * np.arange(10_000)
    drop, start = 0.10 * rng.uniform(0.9, 1.1), rng.uniform(0.9, 1.1)

    def rates(s, x, u):
        return x[1], -k * (1 - drop * np.exp(-c * s)) * x[0] - c * x[1]

    x, _ = path(rates, (start, 0.0), t)
    return recorded(t, noisy(rng, x, 0.02))


@trap(17, {"x": "v", "v": "-64*x - 0.9*v + u"})
def _loosening_bolt(rng: np.random.Generator) -> Trajectories:
    """Stiffness is lower and damping higher where amplitude is large, because something broke there, and not because of
    amplitude: a softening spring and drag. Two runs: a gentle one, and a hard one in which a bolt gives way.
    """
    t = 0.012 * np.arange(1500)
    paths, inputs = [], []
    for level, change in ((2.0, 0.0), (9.0, 1.0)):
        u = multisine(rng, 4.0, 10.0, 9, level)

        def rates(s, x, u, change=change):
            loose = change * 0.5 * (1 + np.tanh((s - 0.25 * t[-1]) / 0.1))
            return x[1], -64 * (1 - 0.07 * loose) * x[0] - (0.9 + 0.25 * loose) * x[1] + u

        paths.append(path(rates, (0.0, 0.0), t, u)[0])
        inputs.append(u(t))
    x = noisy(rng, np.concatenate(paths), 0.01)
    return recorded([t, t], np.split(x, 2), inputs)


@trap(18, {"x": "v", "v": "-36*x - 0.4*v + u"}, learned=("x", "v"))
def _gear_mesh(rng: np.random.Generator) -> Trajectories:
    """Stiffness swings at twice the drive and locked to it: first and third harmonics, as of a cubic spring, whose
    ratio the learned stiffness mends. Amplitude hardly varies.
    """
    k, c, w = 36.0, 0.4, 5.0
    t = 0.01 * np.arange(4000)
    phase = rng.uniform(0, 2 * np.pi)
    locked = 2 * phase - 2 * np.arctan2(c * w, k - w**2) + 0.05 * rng.standard_normal()

    def u(s):
        return 5.0 * np.cos(w * s + phase)

    def rates(s, x, u):
        return x[1], -k * (1 + 0.10 * np.cos(2 * w * s + locked)) * x[0] - c * x[1] + u

    x, _ = path(rates, (0.3, 0.0), t, u, begin=-24.0)
    return recorded(t, noisy(rng, x, 0.006), u(t))


@trap(19, {"x": "v", "v": "-4*x + 0.3*v"})
def _one_limit_cycle(rng: np.random.Generator) -> Trajectories:
    """A limit cycle that a damper −|x|v bounds, which no catalogue has: on one orbit every damper that takes the same
    energy fits, and small harmonics choose the nearest entry.
    """
    t = 0.05 * np.arange(2000)
    bound, start = 0.7 * rng.uniform(0.9, 1.1), 0.1 * rng.standard_normal()

    def rates(_, x, u):
        return x[1], -4 * x[0] + 0.3 * x[1] - bound * abs(x[0]) * x[1]

    x, _ = path(rates, (0.9, start), t, begin=-60.0)
    return recorded(t, noisy(rng, x, 0.03))


@trap(
    20,
    {
        "x1": "v1",
        "v1": "-50*x1 - 1.0*v1 - 40*(x1 - x2) - 120*(x1 - x2)**3 + u",
        "x2": "v2",
        "v2": "60*(x1 - x2) + 180*(x1 - x2)**3 - 0.5*v2",
    },
    equation="v1",
    learned=("x1",),
    # These are its terms, and every one of them has a wrong coefficient.
    allowed={"input-gain", "linear-stiffness", "viscous-damping", "coupling-stiffness", "cubic-coupling-stiffness"},
)
def _wrong_mass(rng: np.random.Generator) -> Trajectories:
    """One number is wrong and five terms move together, the input's among them; one of them may be learned, and what is
    left looks like a new spring. Two masses of which the first is 10 % heavier than the drawing.
    """
    t = 0.012 * np.arange(2500)
    u = multisine(rng, 2.0, 9.0, 10, 10.0)

    def rates(_, x, u):
        x1, v1, x2, v2 = x
        d = x1 - x2
        return v1, (-50 * x1 - 1.0 * v1 - 40 * d - 120 * d**3 + u) / 1.10, v2, 60 * d + 180 * d**3 - 0.5 * v2

    x = path(rates, [0.0] * 4, t, u)
    states = {"x1": noisy(rng, x[0], 0.015), "x2": noisy(rng, x[2], 0.015)}
    return recorded(t, states, u(t))
