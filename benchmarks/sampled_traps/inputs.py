"""Traps in which the input that was recorded is not the one that acts."""

import numpy as np

from bayes_greybox.data.trajectories import Trajectories

from .trap import multisine, noisy, path, recorded, trap


@trap(
    9,
    {"x": "v", "v": "-25*x - 0.6*v + u"},
    # The catalogue's backlash has no memory: it is what a dead zone of the input takes away, and that is the truth.
    allowed={"backlash", "cubic-input", "input-gain"},
)
def _amplifier_crossover(rng: np.random.Generator) -> Trajectories:
    """An amplifier loses what is small of its input. At resonance force and speed are in phase, so that its loss c
    sign(u) is c sign(v): dry friction.
    """
    t = 0.01 * np.arange(3000)
    phase = rng.uniform(0, 2 * np.pi)

    def u(s):
        return (2.0 + 0.8 * np.sin(0.5 * s + phase)) * np.sin(5.0 * s + 0.1 * np.sin(0.33 * s))

    def acting(s):
        return u(s) - 0.4 * np.tanh(u(s) / 0.06)

    x, _ = path(lambda _, x, u: (x[1], -25 * x[0] - 0.6 * x[1] + u), (0.0, 0.0), t, acting, begin=-12.0)
    return recorded(t, noisy(rng, x, 0.02), u(t))


@trap(10, {"x": "v", "v": "-36*x - 1.5*v + u"}, learned=("v",), allowed={"input-gain"})
def _slewing_actuator(rng: np.random.Generator) -> Trajectories:
    """A valve lags behind its command, the more the larger it is: neither a delay nor a gain fits alone, and the rest
    looks like a damper or a spring that is not linear.
    """
    t = 0.015 * np.arange(3000)
    waves = multisine(rng, 1.0, 8.0, 10, 12.0)
    lag, slew = 0.04, 55.0

    def u(s):
        return (0.4 + 0.6 * np.sin(0.07 * s) ** 2) * waves(s)

    def rates(_, x, u):
        x, v, f = x
        return v, -36 * x - 1.5 * v + f, slew * np.tanh((u - f) / (lag * slew))

    x = path(rates, [0.0] * 3, t, u)[0]
    return recorded(t, noisy(rng, x, 0.015), u(t))


@trap(11, {"x": "v", "v": "-18*x - 0.5*v + u"}, learned=("x", "v"))
def _shaking_floor(rng: np.random.Generator) -> Trajectories:
    """The floor shakes in the machine's own band and is not recorded: so does every wrong law of x and v, and with some
    thirty periods the nearest one explains a part of it.
    """
    t = 0.02 * np.arange(2500)
    u = multisine(rng, 1.5, 6.0, 8, 2.0)
    floor = multisine(rng, 3.9, 4.6, 12, 0.35)
    x, _ = path(lambda s, x, u: (x[1], -18 * x[0] - 0.5 * x[1] + u - floor(s)), (0.0, 0.0), t, u)
    return recorded(t, noisy(rng, x, 0.02), u(t))
