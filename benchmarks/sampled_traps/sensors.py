"""Traps in which the sensor lies, and no machine lacks anything."""

import numpy as np

from bayes_greybox.data.trajectories import Trajectories

from .trap import multisine, noisy, path, recorded, trap


@trap(1, {"x": "v", "v": "-88.83*x"}, learned=("v",))
def _truncating_adc(rng: np.random.Generator) -> Trajectories:
    """A converter that truncates towards zero takes half a count times sign(x) from a free decay: its envelope is
    exactly that of viscous and Coulomb friction. Noise far below one count does not dither it.
    """
    t = 0.005 * np.arange(10_000)
    start = (rng.uniform(0.9, 1.1), 0.0)
    x, _ = path(lambda _, x, u: (x[1], -88.83 * x[0] - 0.11 * x[1]), start, t)
    count = 0.03
    return recorded(t, count * np.trunc(noisy(rng, x, 0.003) / count))


@trap(
    2,
    {
        "x1": "v1",
        "v1": "-40*x1 - 60*(x1 - x2) - 0.8*v1 + u",
        "x2": "v2",
        "v2": "90*(x1 - x2) + 150*(x1 - x2)**3 - 0.6*v2",
    },
    equation="v2",
)
def _lowpass_sensor(rng: np.random.Generator) -> Trajectories:
    """Lag and droop of a filter on one of two channels, through a resonance that a chirp crosses with an amplitude that
    follows its frequency: a delay is not quite it, and what is left asks for damping or stiffness. Two masses of which
    the second is read through a filter of order two at 6 Hz.
    """
    cut = 2 * np.pi * 6.0
    t = 0.01 * np.arange(3000)
    phase = rng.uniform(0, 2 * np.pi)
    low, high, end = 0.3, 2.6, t[-1]

    def u(s):
        chirp = 2 * np.pi * (low * s + (high - low) * s**2 / (2 * end))
        return (6 + 4 * s / end) * np.sin(chirp + phase)

    def rates(_, x, u):
        x1, v1, x2, v2, y, w = x
        d = x1 - x2
        passed = cut**2 * (x2 - y) - np.sqrt(2) * cut * w
        return v1, -40 * x1 - 60 * d - 0.8 * v1 + u, v2, 90 * d + 150 * d**3 - 0.6 * v2, w, passed

    x = path(rates, [0.0] * 6, t, u)
    states = {"x1": noisy(rng, x[0], 0.01), "x2": noisy(rng, x[4], 0.01)}
    return recorded(t, states, u(t))


@trap(3, {"x": "v", "v": "-12*x - 0.5*v + u"})
def _multiplicative_noise(rng: np.random.Generator) -> Trajectories:
    """The sensor's gain wanders: an error in proportion to the displacement, part of it coherent over half a period,
    looks like a force that amplitude switches on.
    """
    t = 0.015 * np.arange(3000)
    u = multisine(rng, 1.5, 5.0, 9, 4.0)
    x, _ = path(lambda _, x, u: (x[1], -12 * x[0] - 0.5 * x[1] + u), (0.0, 0.0), t, u)
    read = x * (1 + 0.03 * _wandering(rng, t, 1.5) + 0.015 * rng.standard_normal(len(t)))
    return recorded(t, noisy(rng, read, 0.005, x), u(t))


@trap(4, {"x": "v", "v": "-20*x - 0.6*v + u"})
def _freezing_tracker(rng: np.random.Generator) -> Trajectories:
    """An optical tracker freezes while its target is fast: near resonance a lag that grows with amplitude is a cubic
    spring or drag. Spikes to one side read as a constant force, and tails are heavy.
    """
    n = 10_000
    t = 0.005 * np.arange(n)
    u = multisine(rng, 4.15, 4.8, 6, 2.5)
    x, v = path(lambda _, x, u: (x[1], -20 * x[0] - 0.6 * x[1] + u), (0.0, 0.0), t, u)
    # All traps draw white noise here. This one has none, and passes over it.
    rng.standard_normal(n)
    read = x + 0.004 * np.std(x) * rng.standard_t(3.0, n)
    spikes = rng.random(n) < 0.003
    read[spikes] += rng.exponential(0.15 * np.std(x), spikes.sum())
    fast = np.abs(v) > 1.2 * np.std(v)
    i = 1
    while i < n:
        if fast[i] and rng.random() < 0.06:
            stop = min(n, i + rng.integers(5, 16))
            read[i:stop] = read[i - 1]
            i = stop
        else:
            i += 1
    return recorded(t, read, u(t))


@trap(5, {"h": "u"}, equation="h", learned=("h",), catalogue="fluid")
def _two_point_float(rng: np.random.Generator) -> Trajectories:
    """A bent float arm over a laminar outlet: the test is slow, so that a curved sensor and a curved outflow are one
    curve to first order.
    """
    t = 1.0 * np.arange(1500)
    pumped = multisine(rng, 0.008, 0.045, 8, 0.017)
    (h,) = path(lambda _, h, u: (u - 0.05 * h[0],), (1.0,), t, lambda s: 0.05 + pumped(s))
    # Right at the two levels of its calibration, 0 and 2 m.
    read = h + 0.06 * (h - 1.0) ** 2 - 0.06
    return recorded(t, {"h": noisy(rng, read, 0.012, h)}, 0.05 + pumped(t))


@trap(6, {"x": "v", "v": "-14*x - 1.2*v + u"}, learned=("x", "v"))
def _flexible_bracket(rng: np.random.Generator) -> Trajectories:
    """The sensor's bracket rings near the third harmonic of a rounded square wave: the reading carries a harmonic
    locked to the motion, as of a cubic spring or dry friction.
    """
    t = 0.02 * np.arange(3000)
    w, rings = 2.2 + 0.05 * rng.standard_normal(), 6.8
    phase = rng.uniform(0, 2 * np.pi)

    def u(s):
        return 4 * (1 + 0.25 * np.sin(0.21 * s + phase)) * np.tanh(2 * np.sin(w * s))

    def rates(_, x, u):
        x, v, b, q = x
        pushed = 0.25 * (14 * x + 1.2 * v)
        return v, -14 * x - 1.2 * v + u, q, -(rings**2) * b - 0.1 * rings * q + pushed

    x, _, b, _ = path(rates, [0.0] * 4, t, u)
    return recorded(t, noisy(rng, x - b, 0.01, x), u(t))


@trap(7, {"x": "v", "v": "-20*x - 0.6*v + u"}, learned=("x", "v"))
def _aliased_hum(rng: np.random.Generator) -> Trajectories:
    """Mains hum on the sensor is aliased to exactly the third harmonic of a drive of one amplitude; stiffness and
    damping, which are learned, take up what a cubic spring would do to the fundamental.
    """
    t = np.arange(2910) / 48.5
    k, c, w = 20.0, 0.6, np.pi
    phase = rng.uniform(0, 2 * np.pi)

    def u(s):
        return 5.0 * np.cos(w * s + phase)

    x, _ = path(lambda _, x, u: (x[1], -k * x[0] - c * x[1] + u), (0.1, 0.0), t, u, begin=-25.0)
    # Sampled at 48.5 Hz, 50 Hz are 1.5 Hz, here with a phase near that of what a cubic spring would answer.
    lag = np.arctan2(c * w, k - w**2) - phase
    third = np.arctan2(c * 3 * w, k - 9 * w**2)
    locked = np.pi / 2 - 3 * lag - third + np.pi + 0.08 * rng.standard_normal()
    wander = 0.12 * np.sin(2 * np.pi * t / 45 + rng.uniform(0, 6))
    hum = 0.03 * np.std(x) * np.sqrt(2) * np.sin(2 * np.pi * 50 * t + locked + wander)
    return recorded(t, noisy(rng, x + hum, 0.01, x), u(t))


@trap(8, {"x": "v", "v": "-25*x - 0.7*v + u"}, learned=("x",))
def _drifting_clock(rng: np.random.Generator) -> Trajectories:
    """Stamps drift from 20 ms early to 30 ms late while the drive is raised: near resonance phase depends on amplitude,
    as with a cubic spring. The mean delay is about nil, and jitter is noise in proportion to speed.
    """
    n = 4000
    stamps = 0.015 * np.arange(n)
    late = 0.0006 * stamps + 0.01 * (1 - np.exp(-stamps / 15)) + rng.exponential(0.002, n)
    burst = rng.random(n) < 0.01
    late[burst] += rng.exponential(0.012, burst.sum())
    taken, end = np.maximum.accumulate(stamps - late + 0.02), stamps[-1]
    phase = rng.uniform(0, 2 * np.pi)

    def u(s):
        return 2.5 * (0.3 + 0.7 * s / end) * np.sin(5.0 * s + 0.3 * np.sin(0.25 * s + phase))

    t, back = np.unique([0.0, *taken], return_inverse=True)
    x = path(lambda _, x, u: (x[1], -25 * x[0] - 0.7 * x[1] + u), (0.0, 0.0), t, u)[0, back[1:]]
    return recorded(stamps, noisy(rng, x, 0.01), u(stamps))


@trap(26, {"x": "v", "v": "u - x - 0.1*v"})
def _slow_sensor(rng: np.random.Generator) -> Trajectories:
    """A sensor with a lag of the first order, 4 % of the period: of a linear machine it does exactly what an actuator
    does that lags, and no sample tells which of the two it is.
    """
    t = 0.2 * np.arange(800)
    u, lag = multisine(rng, 0.5, 1.6, 10, 1.0), 0.25
    shown = path(lambda _, x, u: (x[1], u - x[0] - 0.1 * x[1], (x[0] - x[2]) / lag), [0.0] * 3, t, u)[2]
    return recorded(t, noisy(rng, shown, 0.01), u(t))


@trap(29, {"x": "v", "v": "u - 144*x - 4*v"})
def _compressing_sensor(rng: np.random.Generator) -> Trajectories:
    """A displacement sensor that saturates, by 6 to 10 % at the ends of its range, on a machine that is driven far
    below its resonance: displacement and force are in phase, and what bends one may as well bend the other.
    """
    t, end = 0.1 * np.arange(1200), 0.02
    u = multisine(rng, 0.2, 1.5, 8, 0.7)
    x, _ = path(lambda _, x, u: (x[1], u - 144 * x[0] - 4 * x[1]), (0.0, 0.0), t, u)
    shown = end * np.tanh(x / end)
    return recorded(t, noisy(rng, shown, 0.005), u(t))


def _wandering(rng: np.random.Generator, t: np.ndarray, tau: float) -> np.ndarray:
    """Draw Ornstein and Uhlenbeck's process of unit variance."""
    rho = np.exp(-np.diff(t) / tau)
    e = rng.standard_normal(len(t))
    for i in range(1, len(t)):
        e[i] = rho[i - 1] * e[i - 1] + np.sqrt(1 - rho[i - 1] ** 2) * e[i]
    return e
