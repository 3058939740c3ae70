"""48 records meant to fool a missing-effect study; 16 more are in `sampled_records`. NumPy, SciPy and pandas only; deterministic (explicit seeds).

`study_kwargs` has what a normal user would say, by these keys:
    states, inputs, derivatives, units, missing   for bg.read(table, time="t", ...)
    learn                                         the one equation in question: dictionary={learn: []}
    sampled                                       only samples of states were measured: rows=bg.TrajectoryRows()
    catalogue, roles, interpolation               for bg.find_missing_effects
`right`: slugs that are right, confusable twins included; `harmless`: not right, not absurd; any other name is wrong.
`verdicts` has the words of docs/howto/study.md.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

NO_GAP, INSTRUMENT, RECALIBRATE = "no gap", "instrument", "recalibrate"
NAMED, ONE_OF, PARTLY, UNKNOWN = "named", "one of", "partly named", "unknown"
FOUND = {NAMED, ONE_OF, PARTLY}

DRY = {"coulomb-friction", "smooth-friction"}
DRY_TOO = {"stribeck-friction", "exponential-stribeck-friction", "dahl-friction", "lugre-friction", "bouc-wen"}
HARDENING = {"quintic-stiffness", "signed-quadratic-stiffness", "dead-zone"}


@dataclass
class Record:
    """A record, the study that its owner would ask for, and the right answers."""

    name: str
    kind: str
    table: pd.DataFrame
    equations: dict[str, str]
    study_kwargs: dict
    right: set[str]
    harmless: set[str]
    verdicts: set[str]
    truth: str
    # Nobody wrote down which errors of sensors are right.
    errors: None = None


_BUILDERS: dict[str, Callable[[], Record]] = {}


def asked(catalogue, states, inputs, units, **more):
    """Give a record its `study_kwargs`; units are those of the time, the states and the inputs, "-" for none."""
    names = ["t", *states.split(), *inputs.split()]
    known = {name: unit for name, unit in zip(names, units.split(), strict=True) if unit != "-"}
    columns = {"states": states.split(), **({"inputs": inputs.split()} if inputs else {})}
    return _giving(study_kwargs={**columns, "catalogue": catalogue, "units": known, **more})


def answers(verdicts, right="", harmless=""):
    """Give a record its acceptable verdicts, and right and harmless names; these are sets, or words in a text."""
    right, harmless = (words(each) if isinstance(each, str) else each for each in (right, harmless))
    return _giving(verdicts=verdicts, right=right, harmless=harmless)


def words(text):
    """Return a set of words."""
    return set(text.split())


def build(kind, seed, equations):
    """Register the record of a function that draws the columns of its table, and whose docstring is the trap."""

    def register(columns):
        def built():
            table, truth = pd.DataFrame(columns(np.random.default_rng(seed))), " ".join(columns.__doc__.split())
            return Record(columns.__name__, kind, table, equations, truth=truth, **columns.given)

        _BUILDERS[columns.__name__] = built
        return columns

    return register


def _giving(**given):
    def give(columns):
        columns.given = {**getattr(columns, "given", {}), **given}
        return columns

    return give


def named(names, y):
    """Return columns by name."""
    return dict(zip(names.split(), y.T, strict=True))


def names() -> list[str]:
    """Return the names of all records, in order."""
    return list(_BUILDERS)


@functools.cache
def record(name: str) -> Record:
    """Make a record."""
    return _BUILDERS[name]()


def waves(rng, low, high, lines, rms):
    """A sum of sines between two frequencies (log-spaced, random phases) with this RMS, as a function of time."""
    f = np.geomspace(low, high, lines) * rng.uniform(0.97, 1.03, lines)
    phase = rng.uniform(0, 2 * np.pi, lines)
    size = rms * np.sqrt(2 / lines)
    return lambda t: (size * np.sin(2 * np.pi * np.multiply.outer(t, f) + phase)).sum(-1)


def integrate(rhs, start, t, jumps=False):
    """The states at t, (n, n_state). `jumps`: right-hand sides with near-discontinuities (friction)."""
    step = np.median(np.diff(t))
    return _solved(rhs, start, t, jumps, t_eval=t, max_step=step / 2 if jumps else 4 * step).T


def held(rhs, start, t, control, jumps=False):
    """rhs(t, x, u) with u = control(i, x) held from t[i] to t[i+1]: states (n, n_state), inputs (n, ...)."""
    x = np.atleast_1d(np.asarray(start, float))
    states, inputs = [], []
    for i in range(len(t)):
        u = control(i, x)
        states.append(x)
        inputs.append(u)
        if i + 1 < len(t):
            x = _solved(rhs, x, t[i : i + 2], jumps, args=(u,))[:, -1]
    return np.array(states), np.array(inputs)


def _solved(rhs, start, t, jumps, **settings):
    start, method = np.atleast_1d(np.asarray(start, float)), "LSODA" if jumps else "DOP853"
    found = solve_ivp(rhs, (t[0], t[-1]), start, method=method, rtol=1e-9, atol=1e-11, **settings)
    assert found.success, found.message
    return found.y


def switched(rng, t, shortest, longest, values):
    """A level from `values` at each time, which changes at random times; and not to itself."""
    out, i, last = np.empty(len(t)), 0, None
    step = t[1] - t[0]
    while i < len(t):
        n = max(1, int(rng.uniform(shortest, longest) / step))
        level = rng.choice([v for v in values if v != last])
        out[i : i + n], last = level, level
        i += n
    return out


def rounded(x, step):
    return np.round(x / step) * step


def sign(v, eps):
    return np.tanh(v / eps)


def rms(x):
    return float(np.sqrt(np.mean(np.square(x))))


def noisy(rng, x, share, size=np.std):
    """Add white noise whose standard deviation is a share of the size of the values."""
    return x + share * size(x) * rng.normal(size=len(x))


def oscillate(acceleration, start, t, jumps=False):
    """Position and speed at t of a mass with this acceleration(t, x, v)."""
    return integrate(lambda t, s: [s[1], acceleration(t, *s)], start, t, jumps)


@build("three things", 1101, {"x": "v", "v": "F/1.2 - 50*x - 1.25*v"})
@asked("mechanical", "x v", "F", "s m m/s N", derivatives={"v": "a"})
@answers(
    FOUND,
    right=DRY | words("quadratic-stiffness input-saturation"),
    harmless=DRY_TOO | words("bilinear-stiffness cubic-input backlash input-gain velocity-squared"),
)
def slide_with_three(rng):
    """Coulomb friction, a lopsided spring and a drive that clips, each a few per cent of the force, so that each hides
    in the residual of the other two.
    """
    m, k, c = 1.2, 60.0, 1.5
    F = waves(rng, 0.3, 1.7, 6, 7.0)
    t = np.arange(600) * 0.025
    limit = 0.7 * np.abs(F(t)).max()

    def acc(t, x, v):
        return (np.clip(F(t), -limit, limit) - k * x - c * v - 0.35 * sign(v, 1e-4) - 9.0 * x**2) / m

    y = oscillate(acc, [0.05, 0.3], t, jumps=True)
    a = acc(t, y[:, 0], y[:, 1])
    return {"t": t, **named("x v", y), "a": noisy(rng, a, 0.02, rms), "F": F(t)}


@build("three things", 1102, {"x": "v", "v": "5000*F - 10000*x - 20*v"})
@asked("mechanical", "x", "F", "s mm N")
@answers(
    FOUND | {UNKNOWN},
    right="cubic-stiffness direction-dependent-friction constant-force",
    harmless=HARDENING | words("velocity-squared quadratic-stiffness bilinear-stiffness"),
)
def valve_spool(rng):
    """Hardening, a damper that differs by direction and a preload at once, under a coil current that is held between
    samples (not said); the preload is also what an offset of the sensor is.
    """
    t = np.arange(900) * 0.002
    F = switched(rng, t, 0.008, 0.06, [-16.0, -8.0, 0.0, 8.0, 16.0])

    def rhs(t, s, u):
        x, v = s
        return [v, 5000 * u - 10000 * x - 20 * v - 30.0 * x**3 - 3.0 * abs(v) - 1500.0]

    y, _ = held(rhs, [0.0, 0.0], t, lambda i, x: F[i])
    x = y[:, 0]
    return {"t": t, "x": noisy(rng, x, 0.005), "F": F}


@build(
    "three things",
    1103,
    {
        "x1": "v1",
        "v1": "F - 40*x1 - 0.8*v1 - 25*(x1 - x2) - 0.3*(v1 - v2)",
        "x2": "v2",
        "v2": "-50*x2 - 0.8333333*v2 + 41.6666667*(x1 - x2) + 0.5*(v1 - v2)",
    },
)
@asked("mechanical", "x1 v1 x2 v2", "F", "s m m/s m m/s N", derivatives={"v1": "a1", "v2": "a2"})
@answers(
    FOUND | {INSTRUMENT},
    right="cubic-coupling-stiffness quadratic-drag",
    harmless="cubic-damping cubic-stiffness coupling-stiffness input-gain",
)
def two_carts(rng):
    """A cubic spring between two carts shows in both equations, drag in one, and the other accelerometer reads 3 % too
    much, which looks like wrong coefficients.
    """
    F = waves(rng, 0.5, 2.6, 7, 12.0)
    t = np.arange(500) * 0.012

    def acc(t, x1, v1, x2, v2):
        d, w = x1 - x2, v1 - v2
        a1 = F(t) - 40 * x1 - 0.8 * v1 - 25 * d - 0.3 * w - 35.0 * d**3
        a2 = (-30 * x2 - 0.5 * v2 + 25 * d + 0.3 * w + 35.0 * d**3 - 0.25 * v2 * abs(v2)) / 0.6
        return a1, a2

    def rhs(t, s):
        a1, a2 = acc(t, s[0], s[1], s[2], s[3])
        return [s[1], a1, s[3], a2]

    y = integrate(rhs, [0.1, 0, -0.1, 0], t)
    a1, a2 = acc(t, *y.T)
    return {
        "t": t,
        **named("x1 v1 x2 v2", y),
        "a1": 1.03 * a1 + 0.02 * rms(a1) * rng.normal(size=len(t)),
        "a2": noisy(rng, a2, 0.02, rms),
        "F": F(t),
    }


@build("three things", 1104, {"i": "20*u - 40*i"})
@asked("electrical", "i", "u", "s A V")
@answers(FOUND | {UNKNOWN}, right="brush-drop cubic-resistor constant-source", harmless="ohmic-loss inductance-drop")
def coil_with_contacts(rng):
    """A contact drop, a heated wire's cube and an amplifier's offset: the first two are curves of one current that look
    like one law, or like a wrong resistance, the third like an offset of a channel.
    """
    L, R = 0.05, 2.0
    u = waves(rng, 1.0, 12.0, 6, 6.0)
    t = np.arange(700) * 0.002
    rhs = lambda t, s: (u(t) - R * s - 0.35 * sign(s, 1e-4) - 0.02 * s**3 - 0.25) / L
    i = integrate(rhs, [0.0], t, jumps=True)[:, 0]
    return {"t": t, "i": noisy(rng, i, 0.004), "u": u(t)}


@build("quantised", 1201, {"x": "v", "v": "F - 2*x - 0.35*v"})
@asked("mechanical", "x", "F", "s m N")
@answers({NO_GAP, INSTRUMENT})
def hoist_coarse_encoder(rng):
    """Nothing is missing; the encoder has 22 steps over its range and no other noise, so that residuals are sawteeth of
    the position, constant while it hardly moves.
    """
    F = waves(rng, 0.05, 0.32, 5, 3.0)
    t = np.arange(700) * 0.1
    y = integrate(lambda t, s: [s[1], F(t) - 2.0 * s[0] - 0.35 * s[1]], [0.5, 0.0], t)
    x = y[:, 0]
    q = (x.max() - x.min()) / 22
    return {"t": t, "x": rounded(x, q), "F": F(t)}


@build("quantised", 1202, {"x": "v", "v": "F - 60*x - 0.9*v"})
@asked("mechanical", "x v", "F", "s m m/s N", derivatives={"v": "a"})
@answers(FOUND, right="cubic-stiffness", harmless=HARDENING | words("pendulum-restoring"))
def spring_coarse_position(rng):
    """A cubic spring behind a position of 20 steps: the error of a step times the stiffness is as large as part of the
    effect, depends on x alone, and flattens the middle like a dead zone.
    """
    F = waves(rng, 0.4, 2.2, 6, 9.0)
    t = np.arange(800) * 0.015
    acc = lambda t, x, v: F(t) - 60 * x - 0.9 * v - 260.0 * x**3
    y = oscillate(acc, [0.0, 0.5], t)
    x, v = y.T
    a = acc(t, x, v)
    q = (x.max() - x.min()) / 20
    return {"t": t, "x": rounded(x, q), "v": noisy(rng, v, 0.003), "a": noisy(rng, a, 0.01, rms), "F": F(t)}


@build("quantised", 1203, {"x": "v", "v": "F/1.5 - 30*x - 0.6666667*v"})
@asked("mechanical", "x v", "F", "s m m/s N", derivatives={"v": "a"})
@answers(FOUND, right=DRY, harmless=DRY_TOO | words("viscous-damping"))
def tacho_eight_bits(rng):
    """Dry friction where the speed has 20 steps and the acceleration 32: a whole step of speed reads exactly zero, so
    sign(v) is zero on a band and friction looks like backlash or a dead zone in speed.
    """
    F = waves(rng, 0.25, 1.5, 5, 5.0)
    t = np.arange(650) * 0.02
    acc = lambda t, x, v: (F(t) - 45 * x - 1.0 * v - 0.5 * sign(v, 1e-4)) / 1.5
    y = oscillate(acc, [0.0, 0.4], t, jumps=True)
    x, v = y.T
    a = acc(t, x, v)
    return {
        "t": t,
        "x": x,
        "v": rounded(v, (v.max() - v.min()) / 20),
        "a": rounded(a, (a.max() - a.min()) / 32),
        "F": F(t),
    }


@build("quantised", 1204, {"h": "0.5*q - 0.07*sqrt(max(h,0))"})
@asked("fluid", "h", "q", "s cm L/s")
@answers(FOUND, right="weir-overflow overflow", harmless="linear-outflow cubic-input")
def basin_with_float_switches(rng):
    """Above the weir the level moves by a few steps of the sensor only (1.5 cm), where it stays at the same number for
    a long time as a saturated sensor does.
    """
    t = np.arange(500) * 4.0
    q = switched(rng, t, 60, 240, [0.3, 0.6, 0.9, 1.4])
    crest = 33.0

    def rhs(t, s, u):
        h = max(s[0], 0.0)
        return [0.5 * u - 0.07 * np.sqrt(h) - 0.016 * max(h - crest, 0.0) ** 1.5]

    h = held(rhs, [15.0], t, lambda i, x: q[i], jumps=True)[0][:, 0]
    return {"t": t, "h": rounded(h, 1.5), "q": q}


@build(
    "drift",
    1301,
    {
        "xs": "vs",
        "vs": "-60*(xs - xu) - 4.6666667*(vs - vu)",
        "xu": "vu",
        "vu": "450*(xs - xu) + 35*(vs - vu) - 4000*(xu - road)",
    },
)
@asked("mechanical", "xs vs xu vu", "road", "s m m/s m m/s m", derivatives={"vs": "as", "vu": "au"})
@answers({UNKNOWN, RECALIBRATE, PARTLY}, harmless="coupling-damping viscous-damping")
def damper_heats_up(rng):
    """A quarter car whose damper loses 40 % as it warms up: no law of the states, but on average a wrong coefficient."""
    z = waves(rng, 0.7, 9.0, 12, 0.012)
    t = np.arange(1400) * 0.005
    ms, mu, ks, kt = 300.0, 40.0, 18000.0, 160000.0
    c = lambda t: 1400 * (1 - 0.4 * (1 - np.exp(-t / 3.0)))

    def acc(t, xs, vs, xu, vu):
        f = ks * (xs - xu) + c(t) * (vs - vu)
        return -f / ms, (f - kt * (xu - z(t))) / mu

    def rhs(t, s):
        a1, a2 = acc(t, *s)
        return [s[1], a1, s[3], a2]

    y = integrate(rhs, [0, 0, 0, 0], t)
    a1, a2 = acc(t, *y.T)
    return {
        "t": t,
        **named("xs vs xu vu", y),
        "as": noisy(rng, a1, 0.02, rms),
        "au": noisy(rng, a2, 0.02, rms),
        "road": z(t),
    }


@build("drift", 1302, {"x": "v", "v": "F - 30*x - 0.7*v"})
@asked("mechanical", "x", "F", "s m N")
@answers({INSTRUMENT, NO_GAP, UNKNOWN}, harmless="constant-force")
def sensor_zero_warms_up(rng):
    """Nothing is missing; the sensor's zero creeps by half the motion's spread along an exponential, which is not a
    line, and a creeping preload would look the same.
    """
    F = waves(rng, 0.35, 1.4, 6, 4.0)
    t = np.arange(800) * 0.03
    x = integrate(lambda t, s: [s[1], F(t) - 30 * s[0] - 0.7 * s[1]], [0.1, 0.0], t)[:, 0]
    zero = 0.5 * x.std() * (1 - np.exp(-t / 7.0))
    return {"t": t, "x": x + zero + 0.02 * x.std() * rng.normal(size=len(t)), "F": F(t)}


@build("drift", 1303, {"w": "3*u - 0.6*w"})
@asked("mechanical", "w", "u", "s rad/s V", derivatives={"w": "alpha"})
@answers({UNKNOWN, RECALIBRATE, PARTLY, INSTRUMENT}, harmless="input-gain actuator-lag")
def battery_runs_down(rng):
    """The drive's gain falls by 28 % over the record as the battery empties; the held-out end lies beyond what was
    seen.
    """
    u = waves(rng, 0.05, 0.9, 7, 4.0)
    t = np.arange(420) * 0.1
    rate = lambda t, w: 3.0 * (1 - 0.28 * t / 42.0) * u(t) - 0.6 * w
    w = integrate(lambda t, s: [rate(t, s[0])], [2.0], t)[:, 0]
    a = rate(t, w)
    return {"t": t, "w": w, "alpha": noisy(rng, a, 0.03, rms), "u": u(t)}


@build("drift", 1304, {"h": "0.5*q - 0.09*sqrt(max(h,0))"})
@asked("fluid", "h", "q", "s cm L/s", interpolation="zoh")
@answers({UNKNOWN, RECALIBRATE, PARTLY}, harmless="linear-outflow constant-inflow torricelli-outflow")
def outlet_clogs(rng):
    """An outlet loses 35 % of its opening along the record while levels rise: time and level go together."""
    t = np.arange(600) * 5.0
    q = switched(rng, t, 90, 300, [0.2, 0.5, 0.8, 1.0])
    k = lambda t: 0.09 * (1 - 0.35 * t / 3000.0)
    rhs = lambda t, s, u: [0.5 * u - k(t) * np.sqrt(max(s[0], 0.0))]
    h = held(rhs, [9.0], t, lambda i, x: q[i])[0][:, 0]
    return {"t": t, "h": h + 0.1 * rng.normal(size=len(t)), "q": q}


@build("closed loop", 1401, {"x": "v", "v": "u/8 - 0.25*v"})
@asked("mechanical", "x v", "u", "s m m/s N", derivatives={"v": "a"}, interpolation="zoh")
@answers(FOUND, right="quadratic-drag", harmless="cubic-damping viscous-damping")
def thruster_under_pd(rng):
    """The controller feeds the sensors' noise back, so that the force depends on position, speed and their noise."""
    t = np.arange(900) * 0.05
    target = switched(rng, t, 2.0, 5.0, [-1.0, -0.3, 0.4, 1.2])
    nx, nv = 0.004 * rng.normal(size=len(t)), 0.008 * rng.normal(size=len(t))
    acc = lambda x, v, u: (u - 2.0 * v - 6.0 * v * np.abs(v)) / 8.0

    def control(i, s):
        return np.clip(14.0 * (target[i] - s[0] - nx[i]) - 9.0 * (s[1] + nv[i]), -12, 12)

    y, u = held(lambda t, s, u: [s[1], acc(s[0], s[1], u)], [0.0, 0.0], t, control)
    a = acc(y[:, 0], y[:, 1], u)
    return {"t": t, "x": y[:, 0] + nx, "v": y[:, 1] + nv, "a": noisy(rng, a, 0.03, rms), "u": u}


@build("closed loop", 1402, {"T": "3.2*P - 0.16*(T - 22)"})
@asked("all", "T", "P", "min - kW")
@answers({NO_GAP, INSTRUMENT})
def oven_under_pi(rng):
    """Nothing is missing; PI control makes the power a copy of the sensor's own noise and holds the temperature at
    three values, where any two laws agree.
    """
    t = np.arange(520) * 0.25
    target = np.select([t < 40, t < 85], [120.0, 150.0], 105.0)
    noise, total = 0.25 * rng.normal(size=len(t)), 0.0

    def control(i, s):
        nonlocal total
        e = target[i] - s[0] - noise[i]
        if 0 < 0.6 * e + 0.05 * total < 12:
            total += e * 0.25
        return float(np.clip(0.6 * e + 0.05 * total, 0, 12))

    y, P = held(lambda t, s, u: [3.2 * u - 0.16 * (s[0] - 22.0)], [60.0], t, control)
    return {"t": t, "T": y[:, 0] + noise, "P": P}


@build("closed loop", 1403, {"th": "w", "w": "12*th - 0.3*w + 4*T"})
@asked("mechanical", "th", "T", "s rad N*m", interpolation="zoh")
@answers(FOUND | {RECALIBRATE}, right="cubic-stiffness pendulum-restoring", harmless=HARDENING)
def balanced_pole(rng):
    """Gravity was linearised about the upright: unstable without the controller, whose torque is a filtered copy of
    angle and noise; 12 (sin th - th) is a cube that hardens as far as signs go.
    """
    t = np.arange(700) * 0.02
    r = waves(rng, 0.1, 0.7, 4, 0.35)
    noise = 0.002 * rng.normal(size=len(t))
    last = [0.0, 0.0]

    def control(i, s):
        th = s[0] + noise[i]
        rate = 0.6 * last[1] + 0.4 * (th - last[0]) / 0.02 if i else 0.0
        last[:] = th, rate
        return 9.0 * (r(t[i]) - th) - 1.6 * rate

    y, u = held(lambda t, s, u: [s[1], 12 * np.sin(s[0]) - 0.3 * s[1] + 4 * u], [0.0, 0.0], t, control)
    return {"t": t, "th": y[:, 0] + noise, "T": u}


@build("closed loop", 1404, {"w": "2*u - 0.5*w"})
@asked("mechanical", "w", "u", "s rad/s V", derivatives={"w": "alpha"}, interpolation="zoh")
@answers(FOUND, right="input-saturation", harmless="cubic-input input-gain backlash")
def speed_loop_saturates(rng):
    """The log has the command before the amplifier clips it. It clips just after a change of target, when the speed
    is far from it, so that the lost torque also goes with the speed.
    """
    t = np.arange(600) * 0.04
    target = switched(rng, t, 0.8, 2.4, [-14.0, -7.0, 4.0, 10.0, 16.0])
    noise, total = 0.05 * rng.normal(size=len(t)), 0.0
    rate = lambda w, u: 2.0 * np.clip(u, -6, 6) - 0.5 * w

    def control(i, s):
        nonlocal total
        e = target[i] - s[0] - noise[i]
        total = np.clip(total + e * 0.04, -5, 5)
        return 0.4 * e + 0.35 * total

    y, u = held(lambda t, s, u: [rate(s[0], u)], [0.0], t, control)
    a = rate(y[:, 0], u)
    return {"t": t, "w": y[:, 0] + noise, "alpha": noisy(rng, a, 0.03, rms), "u": u}


@build("short", 1501, {"v": "-0.03*v"})
@asked("mechanical", "v", "", "s m/s")
@answers(
    FOUND | {UNKNOWN, RECALIBRATE},
    right="quadratic-drag velocity-squared",
    harmless="cubic-damping coulomb-friction constant-force direction-dependent-friction smooth-friction",
)
def trolley_coasts(rng):
    """Sixty samples of one coast-down, never backwards: v|v| and v*v are one curve, and the end of the record is slower
    than anything it was learned from.
    """
    t = np.arange(60) * 0.5
    v = integrate(lambda t, s: [-0.03 * s[0] - 0.012 * s[0] * abs(s[0])], [12.0], t)[:, 0]
    return {"t": t, "v": v + 0.04 * rng.normal(size=len(t))}


@build("short", 1502, {"x": "v", "v": "10*u - 16*x - 1.1*v"})
@asked("mechanical", "x v", "u", "s m m/s V", derivatives={"v": "a"})
@answers({NO_GAP, INSTRUMENT})
def step_test_45_rows(rng):
    """Nothing is missing: 45 rows of a step with 8 % noise; the input is one but for its first row, so input, constant
    and cubed input are the same column and the held-out part has no change of input at all.
    """
    t = np.arange(45) * 0.06
    acc = lambda x, v: 10.0 - 16 * x - 1.1 * v
    y = integrate(lambda t, s: [s[1], acc(*s)], [0.0, 0.0], t)
    a = acc(*y.T)
    u = np.where(t >= 0, 1.0, 0.0)
    u[0] = 0.0
    a[0] = 0.0
    return {"t": t, **named("x v", y), "a": noisy(rng, a, 0.08, rms), "u": u}


@build("short", 1503, {"v": "2*u - 2*v"})
@asked("electrical", "v", "u", "ms V V", interpolation="zoh")
@answers(
    FOUND | {UNKNOWN}, right="diode diode-pair", harmless="cubic-resistor saturating-inductor cubic-input cubic-storage"
)
def clamped_charging(rng):
    """A leaky protection diode, seen for two plateaus: one point of the curve twice, and an input that bends would
    reach the same plateaus.
    """
    t = np.arange(110) * 0.05
    u = np.select([t < 0.4, t < 2.2, t < 3.2], [0.0, 1.6, 0.2], 2.2)
    rhs = lambda t, s, u: [(u - s[0]) / 0.5 - 0.02 * np.expm1(s[0] / 0.26)]
    v = held(rhs, [0.0], t, lambda i, x: u[i], jumps=True)[0][:, 0]
    return {"t": t, "v": v + 0.006 * rng.normal(size=len(t)), "u": u}


@build("short", 1504, {"x": "v", "v": "-30*x - 0.9*v"})
@asked("mechanical", "x v", "", "s m m/s", derivatives={"v": "a"})
@answers(
    FOUND | {RECALIBRATE}, right="bilinear-stiffness", harmless="quadratic-stiffness linear-stiffness constant-force"
)
def slack_cable_drop(rng):
    """Ninety rows of a free decay: half of the missing spring is a wrong stiffness, a third of the rest is a square,
    and the held-out part is small.
    """
    t = np.arange(90) * 0.04
    acc = lambda x, v: -30 * x - 0.9 * v - 14.0 * np.maximum(x, 0)
    y = integrate(lambda t, s: [s[1], acc(*s)], [0.4, 0.0], t)
    a = acc(*y.T)
    return {"t": t, **named("x v", y), "a": noisy(rng, a, 0.04, rms)}


@build("units", 1601, {"x": "v", "v": "F - 40*x - 0.8*v"})
@asked("mechanical", "x v", "F", "s m m/s N", derivatives={"v": "a"})
@answers({RECALIBRATE, INSTRUMENT, UNKNOWN}, harmless="linear-stiffness")
def millimetres_as_metres(rng):
    """The position is in mm under a heading of m: the simulation's spring is a thousand times too stiff and no spring
    of the catalogue is missing.
    """
    F = waves(rng, 0.3, 1.8, 6, 5.0)
    t = np.arange(500) * 0.02
    acc = lambda t, x, v: F(t) - 40 * x - 0.8 * v
    y = oscillate(acc, [0.0, 0.2], t)
    a = acc(t, *y.T)
    return {"t": t, "x": 1000 * y[:, 0], "v": y[:, 1], "a": noisy(rng, a, 0.03, rms), "F": F(t)}


@build("units", 1602, {"th": "w", "w": "50*T - 110*th - 1.8*w"})
@asked("mechanical", "th", "T", "s rad N*m")
@answers({RECALIBRATE, INSTRUMENT, NAMED, ONE_OF, PARTLY}, right="input-gain")
def degrees_as_radians(rng):
    """The angle is in degrees under a heading of rad: on a linear rig the torque acts 57 times as strongly and nothing
    else differs; no nonlinearity of the torque or the angle is missing.
    """
    T = waves(rng, 0.5, 2.4, 6, 0.5)
    t = np.arange(700) * 0.015
    th = integrate(lambda t, s: [s[1], 50 * T(t) - 110 * s[0] - 1.8 * s[1]], [0.0, 0.0], t)[:, 0]
    shown = np.degrees(th)
    return {"t": t, "th": noisy(rng, shown, 0.02), "T": T(t)}


@build("units", 1603, {"x": "v", "v": "F/1.4 - 50*x - 1.1428571*v - 85.7142857*x**3"})
@asked("mechanical", "x v", "F", "s m m/s N", derivatives={"v": "a"})
@answers({RECALIBRATE, INSTRUMENT, NAMED, ONE_OF, PARTLY}, right="input-gain")
def force_with_wrong_sign(rng):
    """The load cell is mounted the wrong way round: every other coefficient is right, the correction is minus twice the
    coefficient (beyond six prior standard deviations), and anything that goes with the force is tempted to stand in.
    """
    F = waves(rng, 0.4, 2.0, 6, 6.0)
    t = np.arange(450) * 0.02
    acc = lambda t, x, v: (F(t) - 70 * x - 1.6 * v - 120 * x**3) / 1.4
    y = oscillate(acc, [0.1, 0.0], t)
    a = acc(t, *y.T)
    return {"t": t, **named("x v", y), "a": noisy(rng, a, 0.03, rms), "F": -F(t)}


@build("units", 1604, {"h": "0.02*q - 0.016*sqrt(max(h,0))"})
@asked("fluid", "h", "q", "s m L/s", interpolation="zoh")
@answers(
    {RECALIBRATE, INSTRUMENT, UNKNOWN, PARTLY},
    right="input-gain torricelli-outflow",
    harmless="linear-outflow constant-inflow",
)
def centimetres_as_metres_tank(rng):
    """The level is in cm under a heading of m: the inflow is 100 and the outlet 10 times too small, so the ratio of two
    terms is wrong as well, and an outlet seems to be missing.
    """
    t = np.arange(450) * 4.0
    q = switched(rng, t, 60, 260, [0.15, 0.35, 0.55, 0.75])
    rhs = lambda t, s, u: [0.02 * u - 0.016 * np.sqrt(max(s[0], 0.0))]
    h = held(rhs, [0.25], t, lambda i, x: q[i])[0][:, 0]
    shown = 100 * h
    return {"t": t, "h": noisy(rng, shown, 0.01), "q": q}


@build("off catalogue", 1701, {"th": "w", "w": "8*u - 0.8*w"})
@asked("mechanical", "th w", "u", "s rad rad/s V", derivatives={"w": "alpha"})
@answers({UNKNOWN})
def cogging_motor(rng):
    """Cogging, sin(7 th + 0.4), over several turns: on average zero, finer than a law of th can follow, and like
    coloured noise whose pitch goes with the speed.
    """
    u = waves(rng, 0.08, 0.8, 6, 0.9)
    t = np.arange(1000) * 0.012
    rate = lambda t, th, w: 8 * u(t) - 0.8 * w - 3.0 * np.sin(7 * th + 0.4)
    y = oscillate(rate, [0.0, 0.0], t)
    a = rate(t, *y.T)
    return {"t": t, **named("th w", y), "alpha": noisy(rng, a, 0.02, rms), "u": u(t)}


@build("off catalogue", 1702, {"x": "v", "v": "F - 39.5*x - 1.6*v"})
@asked("mechanical", "x", "F", "ms um -")
@answers(
    {UNKNOWN, PARTLY, ONE_OF},
    harmless="constant-force quadratic-stiffness cubic-stiffness bilinear-stiffness linear-stiffness",
)
def electrostatic_mirror(rng):
    """The pull of a biased electrode, 110/(4 - x)^2: its Taylor series is a constant, a softer spring, a square and a
    cube, all of which the catalogue has.
    """
    F = waves(rng, 0.25, 1.3, 6, 15.0)
    t = np.arange(800) * 0.03
    rhs = lambda t, s: [s[1], F(t) - 39.5 * s[0] - 1.6 * s[1] + 110.0 / (4.0 - s[0]) ** 2]
    x = integrate(rhs, [0.0, 0.0], t)[:, 0]
    assert x.max() < 3.2
    return {"t": t, "x": noisy(rng, x, 0.01), "F": F(t)}


@build("off catalogue", 1703, {"N": "0.8*N - D*N"})
@asked("population", "N", "D", "h g/L 1/h", interpolation="zoh")
@answers({UNKNOWN, PARTLY, ONE_OF}, harmless="logistic-crowding cubic-crowding linear-growth constant-harvest allee")
def gompertz_culture(rng):
    """Growth after Gompertz, -N ln N beyond the simulation's exponential: close to logistic crowding with another rate,
    and a cube beside it closes the gap.
    """
    t = np.arange(160) * 0.25
    D = switched(rng, t, 2.0, 6.0, [0.0, 0.15, 0.35, 0.6])
    rhs = lambda t, s, u: [0.45 * s[0] * np.log(4.0 / s[0]) - u * s[0]]
    N = held(rhs, [0.1], t, lambda i, x: D[i])[0][:, 0]
    return {"t": t, "N": N * (1 + 0.01 * rng.normal(size=len(t))), "D": D}


@build("off catalogue", 1704, {"v": "1.5*u - 0.3*v*abs(v)"})
@asked("mechanical", "v", "u", "s m/s -", derivatives={"v": "a"})
@answers({UNKNOWN, PARTLY}, harmless="viscous-damping input-gain")
def propeller_slips(rng):
    """A propeller loses thrust with the inflow, -|u| v: an input times a state, which on average is viscous damping
    and, as v follows u, a drive that saturates.
    """
    u = waves(rng, 0.02, 0.35, 6, 1.0)
    t = np.arange(500) * 0.15
    rate = lambda t, v: 1.5 * u(t) - 0.3 * v * np.abs(v) - 0.35 * np.abs(u(t)) * v
    v = integrate(lambda t, s: [rate(t, s[0])], [0.0], t)[:, 0]
    a = rate(t, v)
    return {"t": t, "v": v, "a": noisy(rng, a, 0.03, rms), "u": u(t)}


@build("nothing, awkward", 1801, {"x": "v", "v": "F - 55*x - v"})
@asked("mechanical", "x v", "F", "s m m/s N", derivatives={"v": "a"})
@answers({NO_GAP, INSTRUMENT})
def loose_connector(rng):
    """Nothing is missing; a loose connector adds spikes, and half of the hardest jolts read zero, so that outliers all
    point inwards at large displacements, as a softening spring does.
    """
    F = waves(rng, 0.4, 2.1, 6, 8.0)
    t = np.arange(600) * 0.02
    acc = lambda t, x, v: F(t) - 55 * x - 1.0 * v
    y = oscillate(acc, [0.0, 0.3], t)
    a = acc(t, *y.T)
    shown = noisy(rng, a, 0.02, rms)
    hit = rng.random(len(t)) < 0.03
    shown[hit] += rms(a) * rng.normal(size=hit.sum()) * 1.5
    shown[np.abs(a) > 2.1 * rms(a)] *= np.where(rng.random((np.abs(a) > 2.1 * rms(a)).sum()) < 0.5, 0.0, 1.0)
    return {"t": t, **named("x v", y), "a": shown, "F": F(t)}


@build("nothing, awkward", 1802, {"x": "v", "v": "F - 0.9*x - 0.22*v"})
@asked("mechanical", "x", "F", "s m N", missing="drop")
@answers({NO_GAP})
def radio_logger(rng):
    """Nothing is missing; steps between samples are random (0.15 s to 2 s and more, of a period of 6.6 s), 15 % are
    lost, and one gap is 14 s long; between samples the force is anybody's guess.
    """
    F = waves(rng, 0.03, 0.22, 5, 1.0)
    t = np.cumsum(0.15 + rng.exponential(0.35, size=560))
    t = np.where(t > 150, t + 14.0, t)
    x = integrate(lambda t, s: [s[1], F(t) - 0.9 * s[0] - 0.22 * s[1]], [0.4, 0.0], t)[:, 0]
    shown = noisy(rng, x, 0.03)
    shown[rng.random(len(t)) < 0.15] = np.nan
    return {"t": t, "x": shown, "F": F(t)}


@build("nothing, awkward", 1803, {"x": "v", "v": "F - 28*x - 1.2*v"})
@asked("mechanical", "x v", "F", "s m m/s N", derivatives={"v": "a"})
@answers({NO_GAP, INSTRUMENT})
def gearbox_rumble(rng):
    """Nothing is missing; noise grows with the square of the speed, hangs together and has heavy tails, all three at
    once, so that a few bursts at high speed decide any law of v.
    """
    F = waves(rng, 0.3, 1.5, 6, 6.0)
    t = np.arange(900) * 0.02
    acc = lambda t, x, v: F(t) - 28 * x - 1.2 * v
    y = oscillate(acc, [0.0, 0.3], t)
    x, v = y.T
    a = acc(t, x, v)
    e = rng.standard_t(3, size=len(t))
    for i in range(1, len(t)):
        e[i] += 0.6 * e[i - 1]
    return {
        "t": t,
        "x": x,
        "v": v,
        "a": a + rms(a) * (0.005 + 0.12 * (v / v.std()) ** 2) * e / np.std(e) * 0.5,
        "F": F(t),
    }


@build(
    "nothing, awkward",
    1804,
    {"h1": "0.5*q - 0.08*sqrt(max(h1,0))", "h2": "0.08*sqrt(max(h1,0)) - 0.07*sqrt(max(h2,0))"},
)
@asked("fluid", "h2", "q", "s cm L/s", learn="h2", interpolation="zoh")
@answers({NO_GAP, INSTRUMENT})
def slow_bus_lower_tank(rng):
    """Nothing is missing; only the lower tank is seen, every fifth number repeats the one before (a slow bus), which is
    a delay now and then, and noise has infinite kurtosis.
    """
    t = np.arange(480) * 5.0
    q = switched(rng, t, 80, 320, [0.2, 0.5, 0.9])

    def rhs(t, s, u):
        h1, h2 = np.maximum(s, 0)
        return [0.5 * u - 0.08 * np.sqrt(h1), 0.08 * np.sqrt(h1) - 0.07 * np.sqrt(h2)]

    h = held(rhs, [9.0, 9.0], t, lambda i, x: q[i])[0][:, 1]
    shown = h + 0.06 * rng.standard_t(2.2, size=len(t))
    for i in range(1, len(t)):
        if rng.random() < 0.2:
            shown[i] = shown[i - 1]
    return {"t": t, "h2": shown, "q": q}


@build("coefficient and a little", 1901, {"x": "v", "v": "F - 50*x - 0.9*v"})
@asked("mechanical", "x v", "F", "s m m/s N", derivatives={"v": "a"})
@answers(FOUND | {RECALIBRATE}, right="quadratic-drag", harmless="cubic-damping")
def soft_spring_some_drag(rng):
    """The spring is 12 % too stiff and there is a little drag, which a wrong damping would explain nearly as well."""
    F = waves(rng, 0.3, 1.9, 6, 6.0)
    t = np.arange(550) * 0.02
    acc = lambda t, x, v: F(t) - 44 * x - 0.9 * v - 0.3 * v * np.abs(v)
    y = oscillate(acc, [0.2, 0.0], t)
    a = acc(t, *y.T)
    return {"t": t, **named("x v", y), "a": noisy(rng, a, 0.03, rms), "F": F(t)}


@build(
    "coefficient and a little",
    1902,
    {
        "th1": "w1",
        "w1": "u - 0.5*w1 - 200*(th1 - th2) - 0.6*(w1 - w2)",
        "th2": "w2",
        "w2": "90.9090909*(th1 - th2) + 0.2727273*(w1 - w2) - 22.7272727*th2 - 0.3636364*w2",
    },
)
@asked("mechanical", "th1 th2", "u", "s rad rad N*m", learn="w2")
@answers(
    FOUND | {RECALIBRATE},
    right=DRY,
    harmless=DRY_TOO | words("viscous-damping coupling-stiffness linear-stiffness pendulum-restoring"),
)
def drive_train_load(rng):
    """The load's inertia is 10 % off, which is all four coefficients of its equation by the same factor, and its
    bearing has a little dry friction; neither speed is measured.
    """
    u = waves(rng, 0.3, 3.2, 7, 12.0)
    t = np.arange(900) * 0.01
    J2 = 2.0

    def rhs(t, s):
        th1, w1, th2, w2 = s
        f = 200 * (th1 - th2) + 0.6 * (w1 - w2)
        return [w1, u(t) - 0.5 * w1 - f, w2, (f - 50 * th2 - 0.8 * w2 - 0.7 * sign(w2, 1e-4)) / J2]

    y = integrate(rhs, [0.1, 0, 0.1, 0.5], t, jumps=True)
    th1, th2 = y[:, 0], y[:, 2]
    return {"t": t, "th1": noisy(rng, th1, 0.005), "th2": noisy(rng, th2, 0.005), "u": u(t)}


@build("coefficient and a little", 1903, {"h": "0.5*q - 0.09*sqrt(max(h,0))"})
@asked("fluid", "h", "q", "s cm L/s", interpolation="zoh")
@answers(FOUND | {RECALIBRATE, INSTRUMENT}, right="constant-inflow", harmless="linear-outflow")
def outlet_and_leak(rng):
    """The outlet is 20 % too large in the simulation and a small steady leak nearly makes up for it; a root, a line and
    a constant are nearly one over the levels that occur.
    """
    t = np.arange(400) * 5.0
    q = switched(rng, t, 80, 260, [0.25, 0.5, 0.8, 1.1])
    rhs = lambda t, s, u: [0.5 * u - 0.075 * np.sqrt(max(s[0], 0.0)) - 0.035]
    h = held(rhs, [12.0], t, lambda i, x: q[i])[0][:, 0]
    assert h.min() > 0.5
    return {"t": t, "h": h + 0.08 * rng.normal(size=len(t)), "q": q}


@build("coefficient and a little", 1904, {"q": "i", "i": "u - 0.4*i - 25*q"})
@asked("electrical", "q i", "u", "ms mC A V", derivatives={"i": "di"})
@answers(FOUND | {RECALIBRATE, INSTRUMENT}, right="constant-source", harmless="ohmic-loss")
def series_resonance_offset(rng):
    """The resistance is 15 % off and the generator has an offset of 6 % of its RMS, less than the noise of the rate;
    the offset is also what an offset of any channel is.
    """
    u = waves(rng, 0.25, 1.6, 6, 2.0)
    t = np.arange(500) * 0.025
    rate = lambda t, q, i: u(t) + 0.12 - 0.46 * i - 25 * q
    y = oscillate(rate, [0.0, 0.0], t)
    r = rate(t, *y.T)
    return {"t": t, **named("q i", y), "di": noisy(rng, r, 0.03, rms), "u": u(t)}


@build("disturbance", 2001, {"x": "v", "v": "F - 88*x - 0.9*v"})
@asked("mechanical", "x v", "F", "s m m/s N", derivatives={"v": "a"})
@answers({UNKNOWN, INSTRUMENT})
def pump_pulsation(rng):
    """A pump next door shakes the rig at 1.72 and 3.44 Hz, beside the resonance at 1.49 Hz: what it does goes with x
    and v, as their own response does.
    """
    F = waves(rng, 0.3, 2.2, 7, 5.0)
    t = np.arange(700) * 0.02
    acc = lambda t, x, v: (
        F(t) - 88 * x - 0.9 * v + 1.4 * np.sin(2 * np.pi * 1.72 * t + 0.8) + 0.5 * np.sin(2 * np.pi * 3.44 * t)
    )
    y = oscillate(acc, [0.0, 0.0], t)
    a = acc(t, *y.T)
    return {"t": t, **named("x v", y), "a": noisy(rng, a, 0.02, rms), "F": F(t)}


@build("disturbance", 2002, {"w": "1.2*u - 0.9*w"})
@asked("mechanical", "w", "u", "s rad/s V", interpolation="zoh")
@answers({UNKNOWN, PARTLY, ONE_OF}, harmless="constant-force coulomb-friction smooth-friction")
def conveyor_loads(rng):
    """Parcels come and go, a torque in steps that nobody measured; the belt never turns round, so its mean is a
    constant force and dry friction alike.
    """
    t = np.arange(700) * 0.08
    u = switched(rng, t, 1.0, 4.0, [6.0, 9.0, 12.0])
    load = switched(rng, t, 3.0, 9.0, [0.0, 2.5, 5.0])
    rhs = lambda t, s, u: [1.2 * u[0] - 0.9 * s[0] - u[1]]
    w = held(rhs, [8.0], t, lambda i, x: np.array([u[i], load[i]]))[0][:, 0]
    return {"t": t, "w": w + 0.08 * rng.normal(size=len(t)), "u": u}


@build(
    "disturbance",
    2003,
    {
        "x1": "v1",
        "v1": "-ground - 160*x1 - 0.8*v1 - 150*(x1 - x2) - 0.7*(v1 - v2)",
        "x2": "v2",
        "v2": "-ground + 150*(x1 - x2) + 0.7*(v1 - v2)",
    },
)
@asked("mechanical", "x1 x2", "ground", "s m m m/s^2", learn="v2")
@answers({UNKNOWN})
def wind_on_top_floor(rng):
    """Gusts on the upper of two floors (coloured, 0.8 s, over half of the ground's push), which ring at the building's
    own pitch as a missing spring or damper would.
    """
    g = waves(rng, 0.4, 3.5, 8, 0.6)
    fine = np.arange(4 * 900) * 0.005
    wind = np.empty(len(fine))
    wind[0] = 0.0
    for i in range(1, len(fine)):
        wind[i] = wind[i - 1] * np.exp(-0.005 / 0.8) + rng.normal() * np.sqrt(1 - np.exp(-2 * 0.005 / 0.8))
    wind = 0.35 * wind

    def rhs(t, s, w):
        x1, v1, x2, v2 = s
        d = 150 * (x1 - x2) + 0.7 * (v1 - v2)
        return [v1, -g(t) - 160 * x1 - 0.8 * v1 - d, v2, -g(t) + d + w]

    y = held(rhs, [0, 0, 0, 0], fine, lambda i, x: wind[i])[0][::4]
    t = fine[::4]
    return {"t": t, "x1": noisy(rng, y[:, 0], 0.01), "x2": noisy(rng, y[:, 2], 0.01), "ground": g(t)}


@build("disturbance", 2004, {"x": "v", "v": "1000*F - 16000*x - 30*v"})
@asked("mechanical", "x v", "F", "s mm mm/s N", derivatives={"v": "a"})
@answers({UNKNOWN, INSTRUMENT}, harmless="cubic-input")
def amplifier_third_harmonic(rng):
    """The shaker's amplifier adds a third harmonic, which no input has, to a drive that is nearly one sine: with a
    correction of a coefficient, cubes of position, speed and force have that harmonic too, at another phase.
    """
    t = np.arange(600) * 0.0006
    om = 2 * np.pi * 25.0
    F = lambda t: 40.0 * np.sin(om * t) + 8.0 * np.sin(0.37 * om * t + 0.5)
    acc = lambda t, x, v: 1000 * F(t) - 1.6e4 * x - 30 * v + 5000 * np.sin(3 * om * t + 2.2)
    start = oscillate(acc, [0.0, 0.0], np.linspace(-0.4, 0, 200))[-1]
    y = oscillate(acc, start, t)
    a = acc(t, *y.T)
    return {"t": t, **named("x v", y), "a": noisy(rng, a, 0.02, rms), "F": F(t)}


@build("delay, lag, differences", 2101, {"x": "v", "v": "F - 65*x - 1.3*v"})
@asked("mechanical", "x v", "F", "s m m/s N", derivatives={"v": "a"})
@answers({NO_GAP, INSTRUMENT})
def differences_of_speed(rng):
    """Nothing is missing; the column of accelerations is a central difference of noisy speeds under a moving mean of
    five, sold as measured: its noise is correlated, is shared with v, and peaks are cut by 2 %.
    """
    F = waves(rng, 0.4, 2.3, 6, 7.0)
    t = np.arange(800) * 0.012
    y = integrate(lambda t, s: [s[1], F(t) - 65 * s[0] - 1.3 * s[1]], [0.1, 0.0], t)
    x = noisy(rng, y[:, 0], 0.003)
    v = noisy(rng, y[:, 1], 0.006)
    a = np.convolve(np.gradient(v, t), np.ones(5) / 5, mode="same")
    keep = slice(4, -4)
    return pd.DataFrame({"t": t, "x": x, "v": v, "a": a, "F": F(t)})[keep].reset_index(drop=True)


@build("delay, lag, differences", 2102, {"x": "v", "v": "F - 50*x - 0.9*v"})
@asked("mechanical", "x v", "F", "s m m/s N", derivatives={"v": "a"})
@answers(FOUND, right="cubic-stiffness", harmless=HARDENING)
def backward_differences_duffing(rng):
    """Speed is a backward difference (half a step late) and acceleration another on top (a whole step late), which adds
    a damping of the wrong sign and a cube of position times speed beside the cubic spring that is missing.
    """
    F = waves(rng, 0.4, 2.0, 6, 9.0)
    t = np.arange(704) * 0.02
    y = integrate(lambda t, s: [s[1], F(t) - 50 * s[0] - 0.9 * s[1] - 130 * s[0] ** 3], [0.1, 0.0], t)
    x = y[:, 0] + 2e-4 * y[:, 0].std() * rng.normal(size=len(t))
    v = np.concatenate([[np.nan], np.diff(x) / 0.02])
    a = np.concatenate([[np.nan], np.diff(v) / 0.02])
    table = pd.DataFrame({"t": t, "x": x, "v": v, "a": a, "F": F(t)})[4:].reset_index(drop=True)
    return table


@build("delay, lag, differences", 2103, {"T": "6*P - 0.12*(T - 20)"})
@asked("all", "T", "P", "min - kW", interpolation="zoh")
@answers({INSTRUMENT, ONE_OF, UNKNOWN, PARTLY}, right="actuator-lag")
def thermocouple_in_a_well(rng):
    """The process is right, but the thermocouple in its well follows with 1.3 min: no law of the temperature or the
    heat is missing, and a slow heater would look the same.
    """
    t = np.arange(500) * 0.2
    P = switched(rng, t, 3.0, 14.0, [0.0, 2.0, 4.0, 7.0])
    rhs = lambda t, s, u: [6.0 * u - 0.12 * (s[0] - 20.0), (s[0] - s[1]) / 1.3]
    y = held(rhs, [80.0, 80.0], t, lambda i, x: P[i])[0]
    return {"t": t, "T": y[:, 1] + 0.4 * rng.normal(size=len(t)), "P": P}


@build("delay, lag, differences", 2104, {"x": "v", "v": "F - 24*x - 0.6*v"})
@asked("mechanical", "x", "F", "s m N")
@answers({INSTRUMENT, UNKNOWN, PARTLY}, harmless="actuator-lag")
def two_clocks(rng):
    """Nothing is missing; force and position have a logger each, whose clocks part by 0.3 % (three samples at the end):
    a delay that grows, and is largest where data are held out.
    """
    F = waves(rng, 0.25, 1.3, 6, 3.0)
    t = np.arange(1000) * 0.03
    x = integrate(lambda t, s: [s[1], F(t) - 24 * s[0] - 0.6 * s[1]], [0.0, 0.2], t)[:, 0]
    logged = F(t - 0.09 * t / t[-1])
    return {"t": t, "x": noisy(rng, x, 0.01), "F": logged}


@build("other domains", 2201, {"T": "2.6*P - 0.03*(T - 25)"})
@asked("all", "T", "P", "min - kW", interpolation="zoh")
@answers(
    {UNKNOWN, PARTLY, ONE_OF},
    harmless="logistic-crowding cubic-crowding quadratic-drag velocity-squared cubic-damping "
    "cubic-resistor diode diode-pair weir-overflow overflow saturating-inductor cubic-storage "
    "allee",
)
def furnace_radiates(rng):
    """Radiation with the fourth power of T + 273, of a temperature in Celsius that is always positive: nearly a square,
    a cube, an exponential or a weir, each of which some domain of the catalogue has.
    """
    t = np.arange(360) * 1.0
    P = switched(rng, t, 8, 35, [0.0, 6.0, 14.0, 25.0])
    rhs = lambda t, s, u: [2.6 * u - 0.03 * (s[0] - 25) - 6.0e-11 * ((s[0] + 273.15) ** 4 - 298.15**4)]
    T = held(rhs, [150.0], t, lambda i, x: P[i])[0][:, 0]
    return {"t": t, "T": T + 1.5 * rng.normal(size=len(t)), "P": P}


@build("other domains", 2202, {"phi": "v", "v": "4*I - 0.6*v - 40*phi"})
@asked("electrical", "phi v", "I", "ms V*ms V A", derivatives={"v": "dv"})
@answers(FOUND, right="saturating-inductor", harmless="cubic-storage cubic-resistor")
def ferroresonant_coil(rng):
    """A core with a knee: flux is the integral of the voltage, and the bend is between a cube and a corner."""
    I = waves(rng, 0.35, 1.4, 6, 1.0)
    t = np.arange(600) * 0.025
    knee = 0.2

    def rate(t, phi, v):
        over = np.sign(phi) * np.maximum(np.abs(phi) - knee, 0)
        return (I(t) - 0.15 * v - 10.0 * phi - 13.0 * over) / 0.25

    y = oscillate(rate, [0.0, 0.0], t)
    r = rate(t, *y.T)
    return {"t": t, **named("phi v", y), "dv": noisy(rng, r, 0.04, rms), "I": I(t)}


@build("other domains", 2203, {"N": "1.3*N - 0.16*N**2 - E*N"})
@asked("population", "N", "E", "year kt 1/year", interpolation="zoh")
@answers(FOUND | {RECALIBRATE}, right="allee", harmless="constant-harvest cubic-crowding linear-growth")
def fishery_allee(rng):
    """An Allee effect over stocks at which it has nearly levelled off: close to a fixed harvest, and with a wrong rate
    of growth and crowding closer still; the error of a count goes with the stock.
    """
    t = np.arange(240) * 0.1
    E = switched(rng, t, 0.8, 2.6, [0.0, 0.3, 0.7, 1.1])
    rhs = lambda t, s, u: [1.3 * s[0] - 0.16 * s[0] ** 2 - u * s[0] - 0.9 * s[0] / (0.8 + s[0])]
    N = held(rhs, [2.0], t, lambda i, x: E[i])[0][:, 0]
    assert N.min() > 0.3
    return {"t": t, "N": N * (1 + 0.008 * rng.normal(size=len(t))), "E": E}


@build("other domains", 2204, {"h1": "0.5*q - 0.03*(h1 - h2)", "h2": "0.03*(h1 - h2) - 0.08*sqrt(max(h2,0))"})
@asked("fluid", "h1 h2", "q", "s cm cm L/s", derivatives={"h1": "r1", "h2": "r2"}, interpolation="zoh")
@answers(
    FOUND | {RECALIBRATE},
    right="connecting-pipe",
    harmless="linear-outflow linear-inflow torricelli-inflow torricelli-outflow constant-inflow",
)
def locks_with_a_pipe(rng):
    """The simulation has a laminar pipe where there is a turbulent one: the root of the difference of levels has to
    come in and the line has to go out altogether, in both equations, with opposite signs.
    """
    t = np.arange(520) * 4.0
    q = switched(rng, t, 60, 220, [0.1, 0.5, 0.9, 1.3])
    pipe = lambda h1, h2: 0.11 * np.sign(h1 - h2) * np.sqrt(np.abs(h1 - h2))

    def rates(h1, h2, u):
        return 0.5 * u - pipe(h1, h2), pipe(h1, h2) - 0.08 * np.sqrt(np.maximum(h2, 0))

    h = held(lambda t, s, u: list(rates(s[0], s[1], u)), [20.0, 14.0], t, lambda i, x: q[i], jumps=True)[0]
    r1, r2 = rates(h[:, 0], h[:, 1], q)
    return {
        "t": t,
        **named("h1 h2", h),
        "r1": noisy(rng, r1, 0.04, rms),
        "r2": r2 + 0.04 * rms(r1) * rng.normal(size=len(t)),
        "q": q,
    }
