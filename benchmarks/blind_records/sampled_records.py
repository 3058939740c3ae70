"""16 records of samples of one state, meant to fool a study; truths were decided before any study.

The conventions are those of `records`; rates and speeds have no sensor, so that the rows are samples along a path.
"""

import functools

import numpy as np

from .records import (
    DRY,
    DRY_TOO,
    FOUND,
    HARDENING,
    INSTRUMENT,
    NO_GAP,
    PARTLY,
    RECALIBRATE,
    UNKNOWN,
    answers,
    build,
    held,
    integrate,
    noisy,
    rounded,
    sign,
    switched,
    waves,
    words,
)
from .records import asked as _asked

asked = functools.partial(_asked, sampled=True)

HARD = HARDENING | words("cubic-stiffness power-law-stiffness")


def coloured(rng, n, keep):
    """Noise of unit variance where each value keeps a share of the one before."""
    e = rng.normal(size=n)
    for i in range(1, n):
        e[i] = keep * e[i - 1] + np.sqrt(1 - keep**2) * e[i]
    return e


# --- nothing is missing, or only the instrument is to blame ---


@build("nothing or instrument", 3101, {"x": "v", "v": "1.5*u - 6*x - 2*v"})
@asked("mechanical", "x", "u", "s m N", interpolation="zoh")
@answers({NO_GAP, INSTRUMENT})
def loop_feeds_noise_back(rng):
    """Nothing is missing; a fast PID on the noisy position makes the held force a filtered copy of the sensor's noise,
    stronger than the command most of the time.
    """
    t = np.arange(500) * 0.04
    target = switched(rng, t, 3.0, 7.0, [-0.5, 0.0, 0.3, 0.6])
    noise = 0.015 * coloured(rng, len(t), 0.5)
    last, total = [0.0, 0.0], 0.0

    def control(i, s):
        nonlocal total
        shown = s[0] + noise[i]
        slope = 0.5 * last[1] + 0.5 * (shown - last[0]) / 0.04 if i else 0.0
        last[:] = shown, slope
        e = target[i] - shown
        total += 0.04 * e
        return float(np.clip(12.0 * e + 8.0 * total - 2.0 * slope, -9, 9))

    y, u = held(lambda t, s, u: [s[1], 1.5 * u - 6.0 * s[0] - 2.0 * s[1]], [0.0, 0.0], t, control)
    return {"t": t, "x": y[:, 0] + noise, "u": u}


@build("nothing or instrument", 3102, {"th": "w", "w": "T - 18*th - 0.9*w"})
@asked("mechanical", "th", "T", "s rad N*m")
# Beside a linear spring an offset of the sensor is a constant force, and nothing in the record tells them apart.
@answers({NO_GAP, INSTRUMENT, UNKNOWN}, harmless="constant-force")
def eccentric_encoder(rng):
    """Nothing is missing; the encoder's disc is off centre and adds a sine of the angle, once a turn, to the reading, as
    a pendulum's weight would add to the torque if the motion were slow; it is not.
    """
    T = waves(rng, 0.25, 1.5, 7, 16.0)
    t = np.arange(600) * 0.03
    th = integrate(lambda t, s: [s[1], T(t) - 18 * s[0] - 0.9 * s[1]], [0.3, 0.0], t)[:, 0]
    return {"t": t, "th": noisy(rng, th + 0.06 * np.sin(th + 0.7), 0.008), "T": T(t)}


@build("nothing or instrument", 3103, {"x": "v", "v": "F - 22*x - 0.8*v"})
@asked("mechanical", "x", "F", "s m N")
@answers({NO_GAP, INSTRUMENT})
def ranger_late_echoes(rng):
    """Nothing is missing; an ultrasonic ranger's noise grows with distance, and 4 % of its echoes are late and read too
    far, mostly when the target is far: outliers of one sign at one end, like a spring that is softer there.
    """
    F = waves(rng, 0.25, 1.3, 6, 4.0)
    t = np.arange(600) * 0.035
    x = integrate(lambda t, s: [s[1], F(t) - 22 * s[0] - 0.8 * s[1]], [0.1, 0.0], t)[:, 0]
    far = 1 / (1 + np.exp(-2.0 * x / x.std()))
    shown = x + x.std() * (0.01 + 0.04 * far) * rng.normal(size=len(t))
    hit = rng.random(len(t)) < 0.08 * far
    shown[hit] += x.std() * rng.exponential(0.5, size=hit.sum())
    return {"t": t, "x": shown, "F": F(t)}


@build("nothing or instrument", 3104, {"x": "v", "v": "F - 35*x - v"})
@asked("mechanical", "x", "F", "s m N")
@answers({NO_GAP, INSTRUMENT, UNKNOWN}, harmless="actuator-lag input-gain")
def force_at_a_third_rate(rng):
    """Nothing is missing; the force is smooth, but its logger is three times slower than the position's and the table
    repeats the last value: stairs that are late by one sample on average, as no lag of an actuator is (it is early).
    """
    F = waves(rng, 0.3, 1.6, 6, 5.0)
    t = np.arange(600) * 0.03
    x = integrate(lambda t, s: [s[1], F(t) - 35 * s[0] - 1.0 * s[1]], [0.0, 0.3], t)[:, 0]
    return {"t": t, "x": noisy(rng, x, 0.01), "F": F(t)[np.arange(600) // 3 * 3]}


@build("nothing or instrument", 3105, {"x": "v", "v": "F - 30*x - 0.8*v"})
@asked("mechanical", "x", "F", "s m N")
@answers({NO_GAP, INSTRUMENT, UNKNOWN} | FOUND, right="cubic-stiffness", harmless=HARD | words("pendulum-restoring"))
def spring_below_the_noise(rng):
    """A cubic spring moves the path by a quarter of the noise, which is 12 % and hangs together: silence is
    right, and so is the spring, but no other name.
    """
    F = waves(rng, 0.3, 1.5, 5, 4.0)
    t = np.arange(450) * 0.035
    x = integrate(lambda t, s: [s[1], F(t) - 30 * s[0] - 0.8 * s[1] - 1.5 * s[0] ** 3], [0.0, 0.0], t)[:, 0]
    return {"t": t, "x": x + 0.12 * x.std() * coloured(rng, len(t), 0.6), "F": F(t)}


# --- one effect of the catalogue, under unfriendly conditions ---


@build("one effect, unfriendly", 3201, {"x": "v", "v": "F - 0.7*v"})
@asked("mechanical", "x", "F", "s m N")
@answers(
    FOUND | {RECALIBRATE, UNKNOWN},
    right=DRY,
    harmless=DRY_TOO | words("constant-force direction-dependent-friction viscous-damping"),
)
def haul_that_hardly_reverses(rng):
    """Dry friction of a hoist that runs forward but for a few short moments; its position is a ramp, and friction is
    a constant force, or a curve of the speed, or a pull that grows with the way.
    """
    F = waves(rng, 0.02, 0.25, 6, 1.3)
    t = np.arange(500) * 0.1
    rhs = lambda t, s: [s[1], 2.2 + F(t) - 0.7 * s[1] - 0.8 * sign(s[1], 1e-3)]
    x = integrate(rhs, [0.0, 1.0], t, jumps=True)[:, 0]
    return {"t": t, "x": x + 0.03 * rng.normal(size=len(t)), "F": 2.2 + F(t)}


@build("one effect, unfriendly", 3202, {"x": "v", "v": "8 - 9*x - 0.6*v"})
@asked("mechanical", "x", "", "s m")
@answers(
    FOUND | {RECALIBRATE, UNKNOWN},
    right="quadratic-drag power-law-drag",
    harmless="cubic-damping viscous-damping velocity-squared linear-stiffness",
)
def start_up_in_a_liquid(rng):
    """One hundred samples of a start under a constant force: drag is missing and the stiffness is 6 % off; a few swings
    about one place, so that damping, drag, friction and springs are all seen along one spiral.
    """
    t = np.arange(100) * 0.08
    x = integrate(lambda t, s: [s[1], 8.0 - 8.5 * s[0] - 0.6 * s[1] - 0.45 * s[1] * abs(s[1])], [0.0, 0.0], t)[:, 0]
    return {"t": t, "x": noisy(rng, x, 0.015)}


@build("one effect, unfriendly", 3203, {"x": "v", "v": "F - 40*x - 0.9*v"})
@asked("mechanical", "x", "F", "s m N")
@answers(FOUND, right="cubic-stiffness", harmless=HARD | words("actuator-lag pendulum-restoring"))
def late_force_cubic_spring(rng):
    """A cubic spring is missing and the force arrives 1.6 samples later than logged, which takes away damping, just where
    the spring hardens; the zero of the sensor creeps along a line.
    """
    F = waves(rng, 0.4, 1.8, 6, 8.0)
    t = np.arange(550) * 0.025
    rhs = lambda t, s: [s[1], F(t - 0.04) - 40 * s[0] - 0.9 * s[1] - 90 * s[0] ** 3]
    x = integrate(rhs, [0.0, 0.0], t)[:, 0]
    return {"t": t, "x": noisy(rng, x, 0.01) + 0.3 * x.std() * t / t[-1], "F": F(t)}


@build("one effect, unfriendly", 3204, {"x": "v", "v": "u - 0.8*v"})
@asked("mechanical", "x", "u", "s mm N", interpolation="zoh")
@answers(FOUND | {UNKNOWN}, right=DRY, harmless=DRY_TOO | words("viscous-damping backlash"))
def stick_slip_on_an_encoder(rng):
    """A slow PI loop sticks and slips; the encoder has some 50 steps over the whole motion, and the controller's force
    is made of those steps: standstill is all that is seen of the friction, and a step looks like a jump.
    """
    t = np.arange(600) * 0.08
    r = waves(rng, 0.02, 0.06, 3, 3.0)
    q, last, total = 0.25, [0.0, 0.0], 0.0

    def control(i, s):
        nonlocal total
        shown = float(rounded(s[0], q))
        slope = 0.7 * last[1] + 0.3 * (shown - last[0]) / 0.08 if i else 0.0
        last[:] = shown, slope
        e = float(r(t[i])) - shown
        total += 0.08 * e
        return 2.5 * e + 0.6 * total - 1.2 * slope

    rhs = lambda t, s, u: [s[1], u - 0.8 * s[1] - 1.2 * sign(s[1], 2e-3)]
    y, u = held(rhs, [0.0, 0.0], t, control, jumps=True)
    return {"t": t, "x": rounded(y[:, 0], q), "u": u}


@build("one effect, unfriendly", 3205, {"x": "v", "v": "F - 30*x - 1.1*v"})
@asked("mechanical", "x", "F", "s m N", missing="drop")
@answers(FOUND, right="input-saturation", harmless="cubic-input input-gain backlash")
def clipped_drive_lost_packets(rng):
    """The drive clips the logged command; stamps are uneven, a sixth of the rows are lost, mostly at the largest forces,
    where the drive clips, and one hole is as long as two swings.
    """
    F = waves(rng, 0.25, 1.2, 6, 6.0)
    t = np.cumsum(rng.uniform(0.015, 0.065, size=750))
    limit = 0.6 * np.abs(F(t)).max()
    rhs = lambda t, s: [s[1], np.clip(F(t), -limit, limit) - 30 * s[0] - 1.1 * s[1]]
    x = integrate(rhs, [0.1, 0.0], t)[:, 0]
    lost = rng.random(len(t)) < np.where(np.abs(F(t)) > limit, 0.5, 0.08)
    keep = ~lost & ~((t > 9.0) & (t < 11.3))
    return {"t": t[keep], "x": noisy(rng, x, 0.01)[keep], "F": F(t)[keep]}


@build("one effect, unfriendly", 3206, {"x": "v", "v": "F - 25*x - 0.5*v"})
@asked("mechanical", "x", "F", "s m N")
@answers(
    FOUND | {RECALIBRATE, UNKNOWN}, right="van-der-pol-damping", harmless="viscous-damping position-velocity-coupling"
)
def two_tones_damping_with_stroke(rng):
    """Damping grows with the square of the stroke; the force has two tones a fifth apart in pitch, so that the motion is
    a beat along one curve, and drag, cubed speed or a wrong damper lose nearly as much energy.
    """
    F = lambda t: 2.5 * np.sin(2 * np.pi * 0.74 * t) + 2.0 * np.sin(2 * np.pi * 0.89 * t + 1.0)
    t = np.arange(600) * 0.05
    x = integrate(lambda t, s: [s[1], F(t) - 25 * s[0] - (0.5 + 3.0 * s[0] ** 2) * s[1]], [0.2, 0.0], t)[:, 0]
    e = rng.standard_t(3, size=len(t))
    return {"t": t, "x": x + 0.02 * x.std() * e, "F": F(t)}


# --- in no catalogue, or several at once ---


@build("off catalogue or several", 3301, {"x": "v", "v": "F/0.8 - 50*x - 1.5*v"})
@asked("mechanical", "x", "F", "s m N")
@answers(
    FOUND | {RECALIBRATE},
    right="quadratic-stiffness",
    harmless="bilinear-stiffness input-gain linear-stiffness viscous-damping constant-force",
)
def wrong_mass_lopsided_spring(rng):
    """The mass is 25 % too small in the simulation, so that all three coefficients are off alike, the spring is stiffer
    on one side, and the sensor's zero swings slowly with the room: rectified motion looks like drift.
    """
    F = waves(rng, 0.3, 1.6, 6, 6.0)
    t = np.arange(600) * 0.03
    x = integrate(lambda t, s: [s[1], F(t) - 40 * s[0] - 1.2 * s[1] - 15.0 * s[0] ** 2], [0.0, 0.0], t)[:, 0]
    drift = 0.25 * x.std() * np.sin(2 * np.pi * t / 14.0 + 0.5)
    return {"t": t, "x": noisy(rng, x, 0.01) + drift, "F": F(t)}


@build("off catalogue or several", 3302, {"x": "v", "v": "F - 36*x - 0.7*v"})
@asked("mechanical", "x", "F", "s m N")
@answers({UNKNOWN, PARTLY})
def spring_breathes(rng):
    """A shaft's stiffness swings by 20 % at nearly twice its own pitch (parametric excitation): a law of position and
    time, which feeds energy in and takes it out in turns, as a nonlinear spring or damper does.
    """
    F = waves(rng, 0.3, 1.6, 6, 4.0)
    t = np.arange(600) * 0.04
    k = lambda t: 36 * (1 + 0.2 * np.cos(2 * np.pi * 1.87 * t + 0.4))
    x = integrate(lambda t, s: [s[1], F(t) - k(t) * s[0] - 0.7 * s[1]], [0.1, 0.0], t)[:, 0]
    return {"t": t, "x": noisy(rng, x, 0.01), "F": F(t)}


@build("off catalogue or several", 3303, {"x": "v", "v": "F - 45*x - v"})
@asked("mechanical", "x", "F", "s m N")
@answers(
    FOUND | {UNKNOWN},
    right=DRY | words("quadratic-stiffness actuator-lag"),
    harmless=DRY_TOO | words("bilinear-stiffness viscous-damping constant-force power-law-drag input-gain"),
)
def three_small_from_position(rng):
    """A little dry friction, a slightly lopsided spring and an actuator that follows with 20 ms, from a noisy position
    alone: friction damps and the lag undamps, so that on average neither is there.
    """
    F = waves(rng, 0.35, 1.8, 7, 6.0)
    t = np.arange(600) * 0.025

    def rhs(t, s):
        x, v, f = s
        return [v, f - 45 * x - 1.0 * v - 0.4 * sign(v, 1e-3) - 14.0 * x**2, (F(t) - f) / 0.02]

    x = integrate(rhs, [0.0, 0.2, F(0.0)], t, jumps=True)[:, 0]
    return {"t": t, "x": noisy(rng, x, 0.01), "F": F(t)}


@build("off catalogue or several", 3304, {"x": "v", "v": "F - 26*x - 0.5*v"})
@asked("mechanical", "x", "F", "s m N")
@answers({UNKNOWN, PARTLY} | FOUND, right="maxwell-damper", harmless="viscous-damping linear-stiffness")
def rubber_mount(rng):
    """A rubber mount with three relaxation times over two decades: one Maxwell damper is part of the answer, but
    friction with memory, an absorber or drag lose energy in nearly the same way.
    """
    F = waves(rng, 0.08, 1.8, 8, 5.0)
    t = np.arange(600) * 0.05
    tau, k = np.array([0.04, 0.3, 2.5]), np.array([9.0, 7.0, 6.0])
    rhs = lambda t, s: [s[1], F(t) - 26 * s[0] - 0.5 * s[1] - s[2:].sum(), *(k * s[1] - s[2:] / tau)]
    x = integrate(rhs, [0.0] * 5, t)[:, 0]
    return {"t": t, "x": noisy(rng, x, 0.01), "F": F(t)}


@build("off catalogue or several", 3305, {"T": "4*P - 0.12*(T - 20)"})
@asked("all", "T", "P", "h - kW", interpolation="zoh")
@answers(
    {UNKNOWN, PARTLY, RECALIBRATE},
    harmless="linear-outflow linear-growth viscous-damping linear-stiffness ohmic-loss absorber maxwell-damper",
)
def wall_behind_the_air(rng):
    """A room's wall stores heat and gives it back: a second state that no catalogue has for a temperature; an integral
    over the past, which a lag of the heater, an inflow or a curved loss may stand in for.
    """
    t = np.arange(500) * 0.1
    P = switched(rng, t, 0.8, 5.0, [0.0, 1.0, 2.5, 4.0])
    rhs = lambda t, s, u: [4 * u - 0.12 * (s[0] - 20) - 0.5 * (s[0] - s[1]), 0.2 * (s[0] - s[1])]
    T = held(rhs, [45.0, 45.0], t, lambda i, x: P[i])[0][:, 0]
    return {"t": t, "T": T + 0.3 * rng.normal(size=len(t)), "P": P}
