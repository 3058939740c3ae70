"""48 records meant to fool a missing-effect study. NumPy, SciPy and pandas only; deterministic (explicit seeds).

    records()          -> list[Record], all 48 (ten seconds)
    record("name")     -> one of them
    names()            -> their names, in order
    python attack_records.py [name ...]   prints how large the gap is beside the noise (a check of the records)

`study_kwargs` has what a normal user would say, by these keys:
    states, inputs, derivatives, units, missing   for bg.read(table, time="t", ...)
    learn                                         the one equation in question: dictionary={learn: []}
    catalogue, roles, interpolation               for bg.find_missing_effects
`right`: slugs that are right, confusable twins included; `harmless`: not right, not absurd; any other name is wrong.
`verdicts_ok` has the words of docs/howto/study.md.
"""

import functools
import sys
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
    name: str
    kind: str
    table: pd.DataFrame
    equations: dict[str, str]
    study_kwargs: dict
    right: set[str]
    harmless: set[str]
    verdicts_ok: set[str]
    trap: str


_BUILDERS: dict[str, Callable[[], Record]] = {}


def build(kind):
    def register(function):
        def built():
            made = function()
            made.update(name=function.__name__, kind=kind)
            made.setdefault("harmless", set())
            made["right"], made["harmless"] = set(made["right"]), set(made["harmless"])
            return Record(**made)

        _BUILDERS[function.__name__] = built
        return function

    return register


def names() -> list[str]:
    return list(_BUILDERS)


@functools.cache
def record(name: str) -> Record:
    return _BUILDERS[name]()


def records() -> list[Record]:
    return [record(name) for name in _BUILDERS]


# ---------------------------------------------------------------------------------------------------------- helpers


def waves(rng, low, high, lines, rms):
    """A sum of sines between two frequencies (log-spaced, random phases) with this RMS, as a function of time."""
    f = np.geomspace(low, high, lines) * rng.uniform(0.97, 1.03, lines)
    phase = rng.uniform(0, 2 * np.pi, lines)
    size = rms * np.sqrt(2 / lines)

    def u(t):
        return (size * np.sin(2 * np.pi * np.multiply.outer(t, f) + phase)).sum(-1)

    return u


def integrate(rhs, start, t, jumps=False):
    """The states at t, (n, n_state). `jumps`: right-hand sides with near-discontinuities (friction)."""
    step = np.median(np.diff(t))
    found = solve_ivp(
        rhs,
        (t[0], t[-1]),
        np.atleast_1d(np.asarray(start, float)),
        method="LSODA" if jumps else "DOP853",
        t_eval=t,
        rtol=1e-9,
        atol=1e-11,
        max_step=step / 2 if jumps else 4 * step,
    )
    assert found.success and len(found.t) == len(t), found.message
    return found.y.T


def held(rhs, start, t, control, jumps=False):
    """rhs(t, x, u) with u = control(i, x) held from t[i] to t[i+1]: states (n, n_state), inputs (n, ...)."""
    x = np.atleast_1d(np.asarray(start, float))
    states, inputs = [], []
    for i in range(len(t)):
        u = control(i, x)
        states.append(x)
        inputs.append(u)
        if i + 1 < len(t):
            found = solve_ivp(
                rhs,
                (t[i], t[i + 1]),
                x,
                args=(u,),
                method="LSODA" if jumps else "DOP853",
                rtol=1e-9,
                atol=1e-11,
            )
            assert found.success, found.message
            x = found.y[:, -1]
    return np.array(states), np.array(inputs)


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


# ------------------------------------------------------------------------------ 1 three small unmodelled things at once


@build("three things")
def slide_with_three():
    rng = np.random.default_rng(1101)
    m, k, c = 1.2, 60.0, 1.5
    F = waves(rng, 0.3, 1.7, 6, 7.0)
    t = np.arange(600) * 0.025
    limit = 0.7 * np.abs(F(t)).max()

    def acc(t, x, v):
        return (np.clip(F(t), -limit, limit) - k * x - c * v - 0.35 * sign(v, 1e-4) - 9.0 * x**2) / m

    y = integrate(lambda t, s: [s[1], acc(t, *s)], [0.05, 0.3], t, jumps=True)
    a = acc(t, y[:, 0], y[:, 1])
    return dict(
        table=pd.DataFrame(
            {"t": t, "x": y[:, 0], "v": y[:, 1], "a": a + 0.02 * rms(a) * rng.normal(size=len(t)), "F": F(t)}
        ),
        equations={"x": "v", "v": "F/1.2 - 50*x - 1.25*v"},
        study_kwargs=dict(
            states=["x", "v"],
            inputs=["F"],
            derivatives={"v": "a"},
            catalogue="mechanical",
            units={"t": "s", "x": "m", "v": "m/s", "F": "N"},
        ),
        right=DRY | {"quadratic-stiffness", "input-saturation"},
        harmless=DRY_TOO | {"bilinear-stiffness", "cubic-input", "backlash", "input-gain", "velocity-squared"},
        verdicts_ok=FOUND,
        trap="Coulomb friction, a lopsided spring and a drive that clips, each a few per cent of the force, so that each "
        "hides in the residual of the other two.",
    )


@build("three things")
def valve_spool():
    rng = np.random.default_rng(1102)
    t = np.arange(900) * 0.002
    F = switched(rng, t, 0.008, 0.06, [-16.0, -8.0, 0.0, 8.0, 16.0])

    def rhs(t, s, u):
        x, v = s
        return [v, 5000 * u - 10000 * x - 20 * v - 30.0 * x**3 - 3.0 * abs(v) - 1500.0]

    y, _ = held(rhs, [0.0, 0.0], t, lambda i, x: F[i])
    x = y[:, 0]
    return dict(
        table=pd.DataFrame({"t": t, "x": x + 0.005 * x.std() * rng.normal(size=len(t)), "F": F}),
        equations={"x": "v", "v": "5000*F - 10000*x - 20*v"},
        study_kwargs=dict(
            states=["x"],
            inputs=["F"],
            catalogue="mechanical",
            units={"t": "s", "x": "mm", "F": "N"},
        ),
        right={"cubic-stiffness", "direction-dependent-friction", "constant-force"},
        harmless=HARDENING | {"velocity-squared", "quadratic-stiffness", "bilinear-stiffness"},
        verdicts_ok=FOUND | {UNKNOWN},
        trap="Hardening, a damper that differs by direction and a preload at once, under a coil current that is held "
        "between samples (not said); the preload is also what an offset of the sensor is.",
    )


@build("three things")
def two_carts():
    rng = np.random.default_rng(1103)
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
    return dict(
        table=pd.DataFrame(
            {
                "t": t,
                "x1": y[:, 0],
                "v1": y[:, 1],
                "x2": y[:, 2],
                "v2": y[:, 3],
                "a1": 1.03 * a1 + 0.02 * rms(a1) * rng.normal(size=len(t)),
                "a2": a2 + 0.02 * rms(a2) * rng.normal(size=len(t)),
                "F": F(t),
            }
        ),
        equations={
            "x1": "v1",
            "v1": "F - 40*x1 - 0.8*v1 - 25*(x1 - x2) - 0.3*(v1 - v2)",
            "x2": "v2",
            "v2": "-50*x2 - 0.8333333*v2 + 41.6666667*(x1 - x2) + 0.5*(v1 - v2)",
        },
        study_kwargs=dict(
            states=["x1", "v1", "x2", "v2"],
            inputs=["F"],
            derivatives={"v1": "a1", "v2": "a2"},
            catalogue="mechanical",
            units={"t": "s", "x1": "m", "x2": "m", "v1": "m/s", "v2": "m/s", "F": "N"},
        ),
        right={"cubic-coupling-stiffness", "quadratic-drag"},
        harmless={"cubic-damping", "cubic-stiffness", "coupling-stiffness", "input-gain"},
        verdicts_ok=FOUND | {INSTRUMENT},
        trap="A cubic spring between two carts shows in both equations, drag in one, and the other accelerometer reads "
        "3 % too much, which looks like wrong coefficients.",
    )


@build("three things")
def coil_with_contacts():
    rng = np.random.default_rng(1104)
    L, R = 0.05, 2.0
    u = waves(rng, 1.0, 12.0, 6, 6.0)
    t = np.arange(700) * 0.002
    rhs = lambda t, s: (u(t) - R * s - 0.35 * sign(s, 1e-4) - 0.02 * s**3 - 0.25) / L
    i = integrate(rhs, [0.0], t, jumps=True)[:, 0]
    return dict(
        table=pd.DataFrame({"t": t, "i": i + 0.004 * i.std() * rng.normal(size=len(t)), "u": u(t)}),
        equations={"i": "20*u - 40*i"},
        study_kwargs=dict(states=["i"], inputs=["u"], catalogue="electrical", units={"t": "s", "i": "A", "u": "V"}),
        right={"brush-drop", "cubic-resistor", "constant-source"},
        harmless={"ohmic-loss", "inductance-drop"},
        verdicts_ok=FOUND | {UNKNOWN},
        trap="A contact drop, a heated wire's cube and an amplifier's offset: the first two are curves of one current "
        "that look like one law, or like a wrong resistance, the third like an offset of a channel.",
    )


# ------------------------------------------------------------------------------------------- 2 coarsely quantised sensors


@build("quantised")
def hoist_coarse_encoder():
    rng = np.random.default_rng(1201)
    F = waves(rng, 0.05, 0.32, 5, 3.0)
    t = np.arange(700) * 0.1
    y = integrate(lambda t, s: [s[1], F(t) - 2.0 * s[0] - 0.35 * s[1]], [0.5, 0.0], t)
    x = y[:, 0]
    q = (x.max() - x.min()) / 22
    return dict(
        table=pd.DataFrame({"t": t, "x": rounded(x, q), "F": F(t)}),
        equations={"x": "v", "v": "F - 2*x - 0.35*v"},
        study_kwargs=dict(states=["x"], inputs=["F"], catalogue="mechanical", units={"t": "s", "x": "m", "F": "N"}),
        right=set(),
        verdicts_ok={NO_GAP, INSTRUMENT},
        trap="Nothing is missing; the encoder has 22 steps over its range and no other noise, so that residuals are sawteeth "
        "of the position, constant while it hardly moves.",
    )


@build("quantised")
def spring_coarse_position():
    rng = np.random.default_rng(1202)
    F = waves(rng, 0.4, 2.2, 6, 9.0)
    t = np.arange(800) * 0.015
    acc = lambda t, x, v: F(t) - 60 * x - 0.9 * v - 260.0 * x**3
    y = integrate(lambda t, s: [s[1], acc(t, *s)], [0.0, 0.5], t)
    x, v = y.T
    a = acc(t, x, v)
    q = (x.max() - x.min()) / 20
    return dict(
        table=pd.DataFrame(
            {
                "t": t,
                "x": rounded(x, q),
                "v": v + 0.003 * v.std() * rng.normal(size=len(t)),
                "a": a + 0.01 * rms(a) * rng.normal(size=len(t)),
                "F": F(t),
            }
        ),
        equations={"x": "v", "v": "F - 60*x - 0.9*v"},
        study_kwargs=dict(
            states=["x", "v"],
            inputs=["F"],
            derivatives={"v": "a"},
            catalogue="mechanical",
            units={"t": "s", "x": "m", "v": "m/s", "F": "N"},
        ),
        right={"cubic-stiffness"},
        harmless=HARDENING | {"pendulum-restoring"},
        verdicts_ok=FOUND,
        trap="A cubic spring behind a position of 20 steps: the error of a step times the stiffness is as large as part of the "
        "effect, depends on x alone, and flattens the middle like a dead zone.",
    )


@build("quantised")
def tacho_eight_bits():
    rng = np.random.default_rng(1203)
    F = waves(rng, 0.25, 1.5, 5, 5.0)
    t = np.arange(650) * 0.02
    acc = lambda t, x, v: (F(t) - 45 * x - 1.0 * v - 0.5 * sign(v, 1e-4)) / 1.5
    y = integrate(lambda t, s: [s[1], acc(t, *s)], [0.0, 0.4], t, jumps=True)
    x, v = y.T
    a = acc(t, x, v)
    return dict(
        table=pd.DataFrame(
            {
                "t": t,
                "x": x,
                "v": rounded(v, (v.max() - v.min()) / 20),
                "a": rounded(a, (a.max() - a.min()) / 32),
                "F": F(t),
            }
        ),
        equations={"x": "v", "v": "F/1.5 - 30*x - 0.6666667*v"},
        study_kwargs=dict(
            states=["x", "v"],
            inputs=["F"],
            derivatives={"v": "a"},
            catalogue="mechanical",
            units={"t": "s", "x": "m", "v": "m/s", "F": "N"},
        ),
        right=DRY,
        harmless=DRY_TOO | {"viscous-damping"},
        verdicts_ok=FOUND,
        trap="Dry friction where the speed has 20 steps and the acceleration 32: a whole step of speed reads exactly zero, so "
        "sign(v) is zero on a band and friction looks like backlash or a dead zone in speed.",
    )


@build("quantised")
def basin_with_float_switches():
    rng = np.random.default_rng(1204)
    t = np.arange(500) * 4.0
    q = switched(rng, t, 60, 240, [0.3, 0.6, 0.9, 1.4])
    crest = 33.0

    def rhs(t, s, u):
        h = max(s[0], 0.0)
        return [0.5 * u - 0.07 * np.sqrt(h) - 0.016 * max(h - crest, 0.0) ** 1.5]

    h = held(rhs, [15.0], t, lambda i, x: q[i], jumps=True)[0][:, 0]
    return dict(
        table=pd.DataFrame({"t": t, "h": rounded(h, 1.5), "q": q}),
        equations={"h": "0.5*q - 0.07*sqrt(max(h,0))"},
        study_kwargs=dict(states=["h"], inputs=["q"], catalogue="fluid", units={"t": "s", "h": "cm", "q": "L/s"}),
        right={"weir-overflow", "overflow"},
        harmless={"linear-outflow", "cubic-input"},
        verdicts_ok=FOUND,
        trap="Above the weir the level moves by a few steps of the sensor only (1.5 cm), where it stays at the same number for a "
        "long time as a saturated sensor does.",
    )


# ------------------------------------------------------------------------------------------------------- 3 slow drifts


@build("drift")
def damper_heats_up():
    rng = np.random.default_rng(1301)
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
    return dict(
        table=pd.DataFrame(
            {
                "t": t,
                "xs": y[:, 0],
                "vs": y[:, 1],
                "xu": y[:, 2],
                "vu": y[:, 3],
                "as": a1 + 0.02 * rms(a1) * rng.normal(size=len(t)),
                "au": a2 + 0.02 * rms(a2) * rng.normal(size=len(t)),
                "road": z(t),
            }
        ),
        equations={
            "xs": "vs",
            "vs": "-60*(xs - xu) - 4.6666667*(vs - vu)",
            "xu": "vu",
            "vu": "450*(xs - xu) + 35*(vs - vu) - 4000*(xu - road)",
        },
        study_kwargs=dict(
            states=["xs", "vs", "xu", "vu"],
            inputs=["road"],
            derivatives={"vs": "as", "vu": "au"},
            catalogue="mechanical",
            units={"t": "s", "xs": "m", "xu": "m", "vs": "m/s", "vu": "m/s", "road": "m"},
        ),
        right=set(),
        harmless={"coupling-damping", "viscous-damping"},
        verdicts_ok={UNKNOWN, RECALIBRATE, PARTLY},
        trap="A quarter car whose damper loses 40 % as it warms up: no law of the states, but on average a wrong coefficient.",
    )


@build("drift")
def sensor_zero_warms_up():
    rng = np.random.default_rng(1302)
    F = waves(rng, 0.35, 1.4, 6, 4.0)
    t = np.arange(800) * 0.03
    x = integrate(lambda t, s: [s[1], F(t) - 30 * s[0] - 0.7 * s[1]], [0.1, 0.0], t)[:, 0]
    zero = 0.5 * x.std() * (1 - np.exp(-t / 7.0))
    return dict(
        table=pd.DataFrame({"t": t, "x": x + zero + 0.02 * x.std() * rng.normal(size=len(t)), "F": F(t)}),
        equations={"x": "v", "v": "F - 30*x - 0.7*v"},
        study_kwargs=dict(states=["x"], inputs=["F"], catalogue="mechanical", units={"t": "s", "x": "m", "F": "N"}),
        right=set(),
        harmless={"constant-force"},
        verdicts_ok={INSTRUMENT, NO_GAP, UNKNOWN},
        trap="Nothing is missing; the sensor's zero creeps by half the motion's spread along an exponential, which is not a line, "
        "and a creeping preload would look the same.",
    )


@build("drift")
def battery_runs_down():
    rng = np.random.default_rng(1303)
    u = waves(rng, 0.05, 0.9, 7, 4.0)
    t = np.arange(420) * 0.1
    rate = lambda t, w: 3.0 * (1 - 0.28 * t / 42.0) * u(t) - 0.6 * w
    w = integrate(lambda t, s: [rate(t, s[0])], [2.0], t)[:, 0]
    a = rate(t, w)
    return dict(
        table=pd.DataFrame({"t": t, "w": w, "alpha": a + 0.03 * rms(a) * rng.normal(size=len(t)), "u": u(t)}),
        equations={"w": "3*u - 0.6*w"},
        study_kwargs=dict(
            states=["w"],
            inputs=["u"],
            derivatives={"w": "alpha"},
            catalogue="mechanical",
            units={"t": "s", "w": "rad/s", "u": "V"},
        ),
        right=set(),
        harmless={"input-gain", "actuator-lag"},
        verdicts_ok={UNKNOWN, RECALIBRATE, PARTLY, INSTRUMENT},
        trap="The drive's gain falls by 28 % over the record as the battery empties; the held-out end lies beyond what was seen.",
    )


@build("drift")
def outlet_clogs():
    rng = np.random.default_rng(1304)
    t = np.arange(600) * 5.0
    q = switched(rng, t, 90, 300, [0.2, 0.5, 0.8, 1.0])
    k = lambda t: 0.09 * (1 - 0.35 * t / 3000.0)
    rhs = lambda t, s, u: [0.5 * u - k(t) * np.sqrt(max(s[0], 0.0))]
    h = held(rhs, [9.0], t, lambda i, x: q[i])[0][:, 0]
    return dict(
        table=pd.DataFrame({"t": t, "h": h + 0.1 * rng.normal(size=len(t)), "q": q}),
        equations={"h": "0.5*q - 0.09*sqrt(max(h,0))"},
        study_kwargs=dict(
            states=["h"],
            inputs=["q"],
            catalogue="fluid",
            units={"t": "s", "h": "cm", "q": "L/s"},
            interpolation="zoh",
        ),
        right=set(),
        harmless={"linear-outflow", "constant-inflow", "torricelli-outflow"},
        verdicts_ok={UNKNOWN, RECALIBRATE, PARTLY},
        trap="An outlet loses 35 % of its opening along the record while levels rise: time and level go together.",
    )


# --------------------------------------------------------------------------------------------------------- 4 closed loop


@build("closed loop")
def thruster_under_pd():
    rng = np.random.default_rng(1401)
    t = np.arange(900) * 0.05
    target = switched(rng, t, 2.0, 5.0, [-1.0, -0.3, 0.4, 1.2])
    nx, nv = 0.004 * rng.normal(size=len(t)), 0.008 * rng.normal(size=len(t))
    acc = lambda x, v, u: (u - 2.0 * v - 6.0 * v * np.abs(v)) / 8.0

    def control(i, s):
        return np.clip(14.0 * (target[i] - s[0] - nx[i]) - 9.0 * (s[1] + nv[i]), -12, 12)

    y, u = held(lambda t, s, u: [s[1], acc(s[0], s[1], u)], [0.0, 0.0], t, control)
    a = acc(y[:, 0], y[:, 1], u)
    return dict(
        table=pd.DataFrame(
            {"t": t, "x": y[:, 0] + nx, "v": y[:, 1] + nv, "a": a + 0.03 * rms(a) * rng.normal(size=len(t)), "u": u}
        ),
        equations={"x": "v", "v": "u/8 - 0.25*v"},
        study_kwargs=dict(
            states=["x", "v"],
            inputs=["u"],
            derivatives={"v": "a"},
            catalogue="mechanical",
            units={"t": "s", "x": "m", "v": "m/s", "u": "N"},
            interpolation="zoh",
        ),
        right={"quadratic-drag"},
        harmless={"cubic-damping", "viscous-damping"},
        verdicts_ok=FOUND,
        trap="The controller feeds the sensors' noise back, so that the force depends on position, speed and their noise.",
    )


@build("closed loop")
def oven_under_pi():
    rng = np.random.default_rng(1402)
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
    return dict(
        table=pd.DataFrame({"t": t, "T": y[:, 0] + noise, "P": P}),
        equations={"T": "3.2*P - 0.16*(T - 22)"},
        study_kwargs=dict(states=["T"], inputs=["P"], catalogue="all", units={"t": "min", "P": "kW"}),
        right=set(),
        verdicts_ok={NO_GAP, INSTRUMENT},
        trap="Nothing is missing; PI control makes the power a copy of the sensor's own noise and holds the temperature at three "
        "values, where any two laws agree.",
    )


@build("closed loop")
def balanced_pole():
    rng = np.random.default_rng(1403)
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
    return dict(
        table=pd.DataFrame({"t": t, "th": y[:, 0] + noise, "T": u}),
        equations={"th": "w", "w": "12*th - 0.3*w + 4*T"},
        study_kwargs=dict(
            states=["th"],
            inputs=["T"],
            catalogue="mechanical",
            units={"t": "s", "th": "rad", "T": "N*m"},
            interpolation="zoh",
        ),
        right={"cubic-stiffness", "pendulum-restoring"},
        harmless=HARDENING,
        verdicts_ok=FOUND | {RECALIBRATE},
        trap="Gravity was linearised about the upright: unstable without the controller, whose torque is a filtered copy of angle "
        "and noise; 12 (sin th - th) is a cube that hardens as far as signs go.",
    )


@build("closed loop")
def speed_loop_saturates():
    rng = np.random.default_rng(1404)
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
    return dict(
        table=pd.DataFrame(
            {"t": t, "w": y[:, 0] + noise, "alpha": a + 0.03 * rms(a) * rng.normal(size=len(t)), "u": u}
        ),
        equations={"w": "2*u - 0.5*w"},
        study_kwargs=dict(
            states=["w"],
            inputs=["u"],
            derivatives={"w": "alpha"},
            catalogue="mechanical",
            units={"t": "s", "w": "rad/s", "u": "V"},
            interpolation="zoh",
        ),
        right={"input-saturation"},
        harmless={"cubic-input", "input-gain", "backlash"},
        verdicts_ok=FOUND,
        trap="What was logged is the command before the amplifier clips it; it clips just after a change of target, when speed is "
        "far from it, so that the lost torque also goes with the speed.",
    )


# ------------------------------------------------------------------------------------ 5 start-up transients, short records


@build("short")
def trolley_coasts():
    rng = np.random.default_rng(1501)
    t = np.arange(60) * 0.5
    v = integrate(lambda t, s: [-0.03 * s[0] - 0.012 * s[0] * abs(s[0])], [12.0], t)[:, 0]
    return dict(
        table=pd.DataFrame({"t": t, "v": v + 0.04 * rng.normal(size=len(t))}),
        equations={"v": "-0.03*v"},
        study_kwargs=dict(states=["v"], catalogue="mechanical", units={"t": "s", "v": "m/s"}),
        right={"quadratic-drag", "velocity-squared"},
        harmless={
            "cubic-damping",
            "coulomb-friction",
            "constant-force",
            "direction-dependent-friction",
            "smooth-friction",
        },
        verdicts_ok=FOUND | {UNKNOWN, RECALIBRATE},
        trap="Sixty samples of one coast-down, never backwards: v|v| and v*v are one curve, and the end of the record is slower than "
        "anything it was learned from.",
    )


@build("short")
def step_test_45_rows():
    rng = np.random.default_rng(1502)
    t = np.arange(45) * 0.06
    acc = lambda x, v: 10.0 - 16 * x - 1.1 * v
    y = integrate(lambda t, s: [s[1], acc(*s)], [0.0, 0.0], t)
    a = acc(*y.T)
    u = np.where(t >= 0, 1.0, 0.0)
    u[0] = 0.0
    a[0] = 0.0
    return dict(
        table=pd.DataFrame(
            {"t": t, "x": y[:, 0], "v": y[:, 1], "a": a + 0.08 * rms(a) * rng.normal(size=len(t)), "u": u}
        ),
        equations={"x": "v", "v": "10*u - 16*x - 1.1*v"},
        study_kwargs=dict(
            states=["x", "v"],
            inputs=["u"],
            derivatives={"v": "a"},
            catalogue="mechanical",
            units={"t": "s", "x": "m", "v": "m/s", "u": "V"},
        ),
        right=set(),
        verdicts_ok={NO_GAP, INSTRUMENT},
        trap="Nothing is missing: 45 rows of a step with 8 % noise; the input is one but for its first row, so input, constant and "
        "cubed input are the same column and the held-out part has no change of input at all.",
    )


@build("short")
def clamped_charging():
    rng = np.random.default_rng(1503)
    t = np.arange(110) * 0.05
    u = np.select([t < 0.4, t < 2.2, t < 3.2], [0.0, 1.6, 0.2], 2.2)
    rhs = lambda t, s, u: [(u - s[0]) / 0.5 - 0.02 * np.expm1(s[0] / 0.26)]
    v = held(rhs, [0.0], t, lambda i, x: u[i], jumps=True)[0][:, 0]
    return dict(
        table=pd.DataFrame({"t": t, "v": v + 0.006 * rng.normal(size=len(t)), "u": u}),
        equations={"v": "2*u - 2*v"},
        study_kwargs=dict(
            states=["v"],
            inputs=["u"],
            catalogue="electrical",
            units={"t": "ms", "v": "V", "u": "V"},
            interpolation="zoh",
        ),
        right={"diode", "diode-pair"},
        harmless={"cubic-resistor", "saturating-inductor", "cubic-input", "cubic-storage"},
        verdicts_ok=FOUND | {UNKNOWN},
        trap="A leaky protection diode, seen for two plateaus: one point of the curve twice, and an input that bends would reach the same "
        "plateaus.",
    )


@build("short")
def slack_cable_drop():
    rng = np.random.default_rng(1504)
    t = np.arange(90) * 0.04
    acc = lambda x, v: -30 * x - 0.9 * v - 14.0 * np.maximum(x, 0)
    y = integrate(lambda t, s: [s[1], acc(*s)], [0.4, 0.0], t)
    a = acc(*y.T)
    return dict(
        table=pd.DataFrame({"t": t, "x": y[:, 0], "v": y[:, 1], "a": a + 0.04 * rms(a) * rng.normal(size=len(t))}),
        equations={"x": "v", "v": "-30*x - 0.9*v"},
        study_kwargs=dict(
            states=["x", "v"],
            derivatives={"v": "a"},
            catalogue="mechanical",
            units={"t": "s", "x": "m", "v": "m/s"},
        ),
        right={"bilinear-stiffness"},
        harmless={"quadratic-stiffness", "linear-stiffness", "constant-force"},
        verdicts_ok=FOUND | {RECALIBRATE},
        trap="Ninety rows of a free decay: half of the missing spring is a wrong stiffness, a third of the rest is a square, and the held-out "
        "part is small.",
    )


# --------------------------------------------------------------------------------------------------- 6 wrong units or scale


@build("units")
def millimetres_as_metres():
    rng = np.random.default_rng(1601)
    F = waves(rng, 0.3, 1.8, 6, 5.0)
    t = np.arange(500) * 0.02
    acc = lambda t, x, v: F(t) - 40 * x - 0.8 * v
    y = integrate(lambda t, s: [s[1], acc(t, *s)], [0.0, 0.2], t)
    a = acc(t, *y.T)
    return dict(
        table=pd.DataFrame(
            {"t": t, "x": 1000 * y[:, 0], "v": y[:, 1], "a": a + 0.03 * rms(a) * rng.normal(size=len(t)), "F": F(t)}
        ),
        equations={"x": "v", "v": "F - 40*x - 0.8*v"},
        study_kwargs=dict(
            states=["x", "v"],
            inputs=["F"],
            derivatives={"v": "a"},
            catalogue="mechanical",
            units={"t": "s", "x": "m", "v": "m/s", "F": "N"},
        ),
        right=set(),
        harmless={"linear-stiffness"},
        verdicts_ok={RECALIBRATE, INSTRUMENT, UNKNOWN},
        trap="The position is in mm under a heading of m: the simulation's spring is a thousand times too stiff and no spring of the "
        "catalogue is missing.",
    )


@build("units")
def degrees_as_radians():
    rng = np.random.default_rng(1602)
    T = waves(rng, 0.5, 2.4, 6, 0.5)
    t = np.arange(700) * 0.015
    th = integrate(lambda t, s: [s[1], 50 * T(t) - 110 * s[0] - 1.8 * s[1]], [0.0, 0.0], t)[:, 0]
    shown = np.degrees(th)
    return dict(
        table=pd.DataFrame({"t": t, "th": shown + 0.02 * shown.std() * rng.normal(size=len(t)), "T": T(t)}),
        equations={"th": "w", "w": "50*T - 110*th - 1.8*w"},
        study_kwargs=dict(
            states=["th"], inputs=["T"], catalogue="mechanical", units={"t": "s", "th": "rad", "T": "N*m"}
        ),
        right={"input-gain"},
        verdicts_ok={RECALIBRATE, INSTRUMENT, NAMED, ONE_OF, PARTLY},
        trap="The angle is in degrees under a heading of rad: on a linear rig the torque acts 57 times as strongly and nothing else "
        "differs; no nonlinearity of the torque or the angle is missing.",
    )


@build("units")
def force_with_wrong_sign():
    rng = np.random.default_rng(1603)
    F = waves(rng, 0.4, 2.0, 6, 6.0)
    t = np.arange(450) * 0.02
    acc = lambda t, x, v: (F(t) - 70 * x - 1.6 * v - 120 * x**3) / 1.4
    y = integrate(lambda t, s: [s[1], acc(t, *s)], [0.1, 0.0], t)
    a = acc(t, *y.T)
    return dict(
        table=pd.DataFrame(
            {"t": t, "x": y[:, 0], "v": y[:, 1], "a": a + 0.03 * rms(a) * rng.normal(size=len(t)), "F": -F(t)}
        ),
        equations={"x": "v", "v": "F/1.4 - 50*x - 1.1428571*v - 85.7142857*x**3"},
        study_kwargs=dict(
            states=["x", "v"],
            inputs=["F"],
            derivatives={"v": "a"},
            catalogue="mechanical",
            units={"t": "s", "x": "m", "v": "m/s", "F": "N"},
        ),
        right={"input-gain"},
        verdicts_ok={RECALIBRATE, INSTRUMENT, NAMED, ONE_OF, PARTLY},
        trap="The load cell is mounted the wrong way round: every other coefficient is right, the correction is minus twice the coefficient "
        "(beyond six prior standard deviations), and anything that goes with the force is tempted to stand in.",
    )


@build("units")
def centimetres_as_metres_tank():
    rng = np.random.default_rng(1604)
    t = np.arange(450) * 4.0
    q = switched(rng, t, 60, 260, [0.15, 0.35, 0.55, 0.75])
    rhs = lambda t, s, u: [0.02 * u - 0.016 * np.sqrt(max(s[0], 0.0))]
    h = held(rhs, [0.25], t, lambda i, x: q[i])[0][:, 0]
    shown = 100 * h
    return dict(
        table=pd.DataFrame({"t": t, "h": shown + 0.01 * shown.std() * rng.normal(size=len(t)), "q": q}),
        equations={"h": "0.02*q - 0.016*sqrt(max(h,0))"},
        study_kwargs=dict(
            states=["h"],
            inputs=["q"],
            catalogue="fluid",
            units={"t": "s", "h": "m", "q": "L/s"},
            interpolation="zoh",
        ),
        right={"input-gain", "torricelli-outflow"},
        harmless={"linear-outflow", "constant-inflow"},
        verdicts_ok={RECALIBRATE, INSTRUMENT, UNKNOWN, PARTLY},
        trap="The level is in cm under a heading of m: the inflow is 100 and the outlet 10 times too small, so the ratio of two terms is "
        "wrong as well, and an outlet seems to be missing.",
    )


# --------------------------------------------------------------------------------------------------- 7 not in the catalogue


@build("off catalogue")
def cogging_motor():
    rng = np.random.default_rng(1701)
    u = waves(rng, 0.08, 0.8, 6, 0.9)
    t = np.arange(1000) * 0.012
    rate = lambda t, th, w: 8 * u(t) - 0.8 * w - 3.0 * np.sin(7 * th + 0.4)
    y = integrate(lambda t, s: [s[1], rate(t, *s)], [0.0, 0.0], t)
    a = rate(t, *y.T)
    return dict(
        table=pd.DataFrame(
            {"t": t, "th": y[:, 0], "w": y[:, 1], "alpha": a + 0.02 * rms(a) * rng.normal(size=len(t)), "u": u(t)}
        ),
        equations={"th": "w", "w": "8*u - 0.8*w"},
        study_kwargs=dict(
            states=["th", "w"],
            inputs=["u"],
            derivatives={"w": "alpha"},
            catalogue="mechanical",
            units={"t": "s", "th": "rad", "w": "rad/s", "u": "V"},
        ),
        right=set(),
        verdicts_ok={UNKNOWN},
        trap="Cogging, sin(7 th + 0.4), over several turns: on average zero, finer than a law of th can follow, and like coloured noise "
        "whose pitch goes with the speed.",
    )


@build("off catalogue")
def electrostatic_mirror():
    rng = np.random.default_rng(1702)
    F = waves(rng, 0.25, 1.3, 6, 15.0)
    t = np.arange(800) * 0.03
    rhs = lambda t, s: [s[1], F(t) - 39.5 * s[0] - 1.6 * s[1] + 110.0 / (4.0 - s[0]) ** 2]
    x = integrate(rhs, [0.0, 0.0], t)[:, 0]
    assert x.max() < 3.2
    return dict(
        table=pd.DataFrame({"t": t, "x": x + 0.01 * x.std() * rng.normal(size=len(t)), "F": F(t)}),
        equations={"x": "v", "v": "F - 39.5*x - 1.6*v"},
        study_kwargs=dict(states=["x"], inputs=["F"], catalogue="mechanical", units={"t": "ms", "x": "um"}),
        right=set(),
        harmless={"constant-force", "quadratic-stiffness", "cubic-stiffness", "bilinear-stiffness", "linear-stiffness"},
        verdicts_ok={UNKNOWN, PARTLY, ONE_OF},
        trap="The pull of a biased electrode, 110/(4 - x)^2: its Taylor series is a constant, a softer spring, a square and a cube, all of "
        "which the catalogue has.",
    )


@build("off catalogue")
def gompertz_culture():
    rng = np.random.default_rng(1703)
    t = np.arange(160) * 0.25
    D = switched(rng, t, 2.0, 6.0, [0.0, 0.15, 0.35, 0.6])
    rhs = lambda t, s, u: [0.45 * s[0] * np.log(4.0 / s[0]) - u * s[0]]
    N = held(rhs, [0.1], t, lambda i, x: D[i])[0][:, 0]
    return dict(
        table=pd.DataFrame({"t": t, "N": N * (1 + 0.01 * rng.normal(size=len(t))), "D": D}),
        equations={"N": "0.8*N - D*N"},
        study_kwargs=dict(
            states=["N"],
            inputs=["D"],
            catalogue="population",
            units={"t": "h", "N": "g/L", "D": "1/h"},
            interpolation="zoh",
        ),
        right=set(),
        harmless={"logistic-crowding", "cubic-crowding", "linear-growth", "constant-harvest", "allee"},
        verdicts_ok={UNKNOWN, PARTLY, ONE_OF},
        trap="Growth after Gompertz, -N ln N beyond the simulation's exponential: close to logistic crowding with another rate, and a "
        "cube beside it closes the gap.",
    )


@build("off catalogue")
def propeller_slips():
    rng = np.random.default_rng(1704)
    u = waves(rng, 0.02, 0.35, 6, 1.0)
    t = np.arange(500) * 0.15
    rate = lambda t, v: 1.5 * u(t) - 0.3 * v * np.abs(v) - 0.35 * np.abs(u(t)) * v
    v = integrate(lambda t, s: [rate(t, s[0])], [0.0], t)[:, 0]
    a = rate(t, v)
    return dict(
        table=pd.DataFrame({"t": t, "v": v, "a": a + 0.03 * rms(a) * rng.normal(size=len(t)), "u": u(t)}),
        equations={"v": "1.5*u - 0.3*v*abs(v)"},
        study_kwargs=dict(
            states=["v"],
            inputs=["u"],
            derivatives={"v": "a"},
            catalogue="mechanical",
            units={"t": "s", "v": "m/s"},
        ),
        right=set(),
        harmless={"viscous-damping", "input-gain"},
        verdicts_ok={UNKNOWN, PARTLY},
        trap="A propeller loses thrust with the inflow, -|u| v: an input times a state, which on average is viscous damping and, as v "
        "follows u, a drive that saturates.",
    )


# ----------------------------------------------------------------------------------------------- 8 nothing missing, but awkward


@build("nothing, awkward")
def loose_connector():
    rng = np.random.default_rng(1801)
    F = waves(rng, 0.4, 2.1, 6, 8.0)
    t = np.arange(600) * 0.02
    acc = lambda t, x, v: F(t) - 55 * x - 1.0 * v
    y = integrate(lambda t, s: [s[1], acc(t, *s)], [0.0, 0.3], t)
    a = acc(t, *y.T)
    shown = a + 0.02 * rms(a) * rng.normal(size=len(t))
    hit = rng.random(len(t)) < 0.03
    shown[hit] += rms(a) * rng.normal(size=hit.sum()) * 1.5
    shown[np.abs(a) > 2.1 * rms(a)] *= np.where(rng.random((np.abs(a) > 2.1 * rms(a)).sum()) < 0.5, 0.0, 1.0)
    return dict(
        table=pd.DataFrame({"t": t, "x": y[:, 0], "v": y[:, 1], "a": shown, "F": F(t)}),
        equations={"x": "v", "v": "F - 55*x - v"},
        study_kwargs=dict(
            states=["x", "v"],
            inputs=["F"],
            derivatives={"v": "a"},
            catalogue="mechanical",
            units={"t": "s", "x": "m", "v": "m/s", "F": "N"},
        ),
        right=set(),
        verdicts_ok={NO_GAP, INSTRUMENT},
        trap="Nothing is missing; a loose connector adds spikes, and half of the hardest jolts read zero, so that outliers all point inwards "
        "at large displacements, as a softening spring does.",
    )


@build("nothing, awkward")
def radio_logger():
    rng = np.random.default_rng(1802)
    F = waves(rng, 0.03, 0.22, 5, 1.0)
    t = np.cumsum(0.15 + rng.exponential(0.35, size=560))
    t = np.where(t > 150, t + 14.0, t)
    x = integrate(lambda t, s: [s[1], F(t) - 0.9 * s[0] - 0.22 * s[1]], [0.4, 0.0], t)[:, 0]
    shown = x + 0.03 * x.std() * rng.normal(size=len(t))
    shown[rng.random(len(t)) < 0.15] = np.nan
    return dict(
        table=pd.DataFrame({"t": t, "x": shown, "F": F(t)}),
        equations={"x": "v", "v": "F - 0.9*x - 0.22*v"},
        study_kwargs=dict(
            states=["x"],
            inputs=["F"],
            catalogue="mechanical",
            units={"t": "s", "x": "m", "F": "N"},
            missing="drop",
        ),
        right=set(),
        verdicts_ok={NO_GAP},
        trap="Nothing is missing; steps between samples are random (0.15 s to 2 s and more, of a period of 6.6 s), 15 % are lost, and one "
        "gap is 14 s long; between samples the force is anybody's guess.",
    )


@build("nothing, awkward")
def gearbox_rumble():
    rng = np.random.default_rng(1803)
    F = waves(rng, 0.3, 1.5, 6, 6.0)
    t = np.arange(900) * 0.02
    acc = lambda t, x, v: F(t) - 28 * x - 1.2 * v
    y = integrate(lambda t, s: [s[1], acc(t, *s)], [0.0, 0.3], t)
    x, v = y.T
    a = acc(t, x, v)
    e = rng.standard_t(3, size=len(t))
    for i in range(1, len(t)):
        e[i] += 0.6 * e[i - 1]
    return dict(
        table=pd.DataFrame(
            {
                "t": t,
                "x": x,
                "v": v,
                "a": a + rms(a) * (0.005 + 0.12 * (v / v.std()) ** 2) * e / np.std(e) * 0.5,
                "F": F(t),
            }
        ),
        equations={"x": "v", "v": "F - 28*x - 1.2*v"},
        study_kwargs=dict(
            states=["x", "v"],
            inputs=["F"],
            derivatives={"v": "a"},
            catalogue="mechanical",
            units={"t": "s", "x": "m", "v": "m/s", "F": "N"},
        ),
        right=set(),
        verdicts_ok={NO_GAP, INSTRUMENT},
        trap="Nothing is missing; noise grows with the square of the speed, hangs together and has heavy tails, all three at once, so that "
        "a few bursts at high speed decide any law of v.",
    )


@build("nothing, awkward")
def slow_bus_lower_tank():
    rng = np.random.default_rng(1804)
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
    return dict(
        table=pd.DataFrame({"t": t, "h2": shown, "q": q}),
        equations={"h1": "0.5*q - 0.08*sqrt(max(h1,0))", "h2": "0.08*sqrt(max(h1,0)) - 0.07*sqrt(max(h2,0))"},
        study_kwargs=dict(
            states=["h2"],
            inputs=["q"],
            learn="h2",
            catalogue="fluid",
            units={"t": "s", "h2": "cm", "q": "L/s"},
            interpolation="zoh",
        ),
        right=set(),
        verdicts_ok={NO_GAP, INSTRUMENT},
        trap="Nothing is missing; only the lower tank is seen, every fifth number repeats the one before (a slow bus), which is a delay "
        "now and then, and noise has infinite kurtosis.",
    )


# ---------------------------------------------------------------------------------- 9 a wrong coefficient and a little of something


@build("coefficient and a little")
def soft_spring_some_drag():
    rng = np.random.default_rng(1901)
    F = waves(rng, 0.3, 1.9, 6, 6.0)
    t = np.arange(550) * 0.02
    acc = lambda t, x, v: F(t) - 44 * x - 0.9 * v - 0.3 * v * np.abs(v)
    y = integrate(lambda t, s: [s[1], acc(t, *s)], [0.2, 0.0], t)
    a = acc(t, *y.T)
    return dict(
        table=pd.DataFrame(
            {"t": t, "x": y[:, 0], "v": y[:, 1], "a": a + 0.03 * rms(a) * rng.normal(size=len(t)), "F": F(t)}
        ),
        equations={"x": "v", "v": "F - 50*x - 0.9*v"},
        study_kwargs=dict(
            states=["x", "v"],
            inputs=["F"],
            derivatives={"v": "a"},
            catalogue="mechanical",
            units={"t": "s", "x": "m", "v": "m/s", "F": "N"},
        ),
        right={"quadratic-drag"},
        harmless={"cubic-damping"},
        verdicts_ok=FOUND | {RECALIBRATE},
        trap="The spring is 12 % too stiff and there is a little drag, which a wrong damping would explain nearly as well.",
    )


@build("coefficient and a little")
def drive_train_load():
    rng = np.random.default_rng(1902)
    u = waves(rng, 0.3, 3.2, 7, 12.0)
    t = np.arange(900) * 0.01
    J2, Jb = 2.0, 2.2

    def rhs(t, s):
        th1, w1, th2, w2 = s
        f = 200 * (th1 - th2) + 0.6 * (w1 - w2)
        return [w1, u(t) - 0.5 * w1 - f, w2, (f - 50 * th2 - 0.8 * w2 - 0.7 * sign(w2, 1e-4)) / J2]

    y = integrate(rhs, [0.1, 0, 0.1, 0.5], t, jumps=True)
    th1, th2 = y[:, 0], y[:, 2]
    return dict(
        table=pd.DataFrame(
            {
                "t": t,
                "th1": th1 + 0.005 * th1.std() * rng.normal(size=len(t)),
                "th2": th2 + 0.005 * th2.std() * rng.normal(size=len(t)),
                "u": u(t),
            }
        ),
        equations={
            "th1": "w1",
            "w1": "u - 0.5*w1 - 200*(th1 - th2) - 0.6*(w1 - w2)",
            "th2": "w2",
            "w2": f"{200 / Jb:.7f}*(th1 - th2) + {0.6 / Jb:.7f}*(w1 - w2) - {50 / Jb:.7f}*th2 - {0.8 / Jb:.7f}*w2",
        },
        study_kwargs=dict(
            states=["th1", "th2"],
            inputs=["u"],
            learn="w2",
            catalogue="mechanical",
            units={"t": "s", "th1": "rad", "th2": "rad", "u": "N*m"},
        ),
        right=DRY,
        harmless=DRY_TOO | {"viscous-damping", "coupling-stiffness", "linear-stiffness", "pendulum-restoring"},
        verdicts_ok=FOUND | {RECALIBRATE},
        trap="The load's inertia is 10 % off, which is all four coefficients of its equation by the same factor, and its bearing has a little "
        "dry friction; neither speed is measured.",
    )


@build("coefficient and a little")
def outlet_and_leak():
    rng = np.random.default_rng(1903)
    t = np.arange(400) * 5.0
    q = switched(rng, t, 80, 260, [0.25, 0.5, 0.8, 1.1])
    rhs = lambda t, s, u: [0.5 * u - 0.075 * np.sqrt(max(s[0], 0.0)) - 0.035]
    h = held(rhs, [12.0], t, lambda i, x: q[i])[0][:, 0]
    assert h.min() > 0.5
    return dict(
        table=pd.DataFrame({"t": t, "h": h + 0.08 * rng.normal(size=len(t)), "q": q}),
        equations={"h": "0.5*q - 0.09*sqrt(max(h,0))"},
        study_kwargs=dict(
            states=["h"],
            inputs=["q"],
            catalogue="fluid",
            units={"t": "s", "h": "cm", "q": "L/s"},
            interpolation="zoh",
        ),
        right={"constant-inflow"},
        harmless={"linear-outflow"},
        verdicts_ok=FOUND | {RECALIBRATE, INSTRUMENT},
        trap="The outlet is 20 % too large in the simulation and a small steady leak nearly makes up for it; a root, a line and a constant "
        "are nearly one over the levels that occur.",
    )


@build("coefficient and a little")
def series_resonance_offset():
    rng = np.random.default_rng(1904)
    u = waves(rng, 0.25, 1.6, 6, 2.0)
    t = np.arange(500) * 0.025
    rate = lambda t, q, i: u(t) + 0.12 - 0.46 * i - 25 * q
    y = integrate(lambda t, s: [s[1], rate(t, *s)], [0.0, 0.0], t)
    r = rate(t, *y.T)
    return dict(
        table=pd.DataFrame(
            {"t": t, "q": y[:, 0], "i": y[:, 1], "di": r + 0.03 * rms(r) * rng.normal(size=len(t)), "u": u(t)}
        ),
        equations={"q": "i", "i": "u - 0.4*i - 25*q"},
        study_kwargs=dict(
            states=["q", "i"],
            inputs=["u"],
            derivatives={"i": "di"},
            catalogue="electrical",
            units={"t": "ms", "q": "mC", "i": "A", "u": "V"},
        ),
        right={"constant-source"},
        harmless={"ohmic-loss"},
        verdicts_ok=FOUND | {RECALIBRATE, INSTRUMENT},
        trap="The resistance is 15 % off and the generator has an offset of 6 % of its RMS, less than the noise of the rate; the offset is also "
        "what an offset of any channel is.",
    )


# ------------------------------------------------------------------------------------------------- 10 unmeasured disturbances


@build("disturbance")
def pump_pulsation():
    rng = np.random.default_rng(2001)
    F = waves(rng, 0.3, 2.2, 7, 5.0)
    t = np.arange(700) * 0.02
    acc = lambda t, x, v: (
        F(t) - 88 * x - 0.9 * v + 1.4 * np.sin(2 * np.pi * 1.72 * t + 0.8) + 0.5 * np.sin(2 * np.pi * 3.44 * t)
    )
    y = integrate(lambda t, s: [s[1], acc(t, *s)], [0.0, 0.0], t)
    a = acc(t, *y.T)
    return dict(
        table=pd.DataFrame(
            {"t": t, "x": y[:, 0], "v": y[:, 1], "a": a + 0.02 * rms(a) * rng.normal(size=len(t)), "F": F(t)}
        ),
        equations={"x": "v", "v": "F - 88*x - 0.9*v"},
        study_kwargs=dict(
            states=["x", "v"],
            inputs=["F"],
            derivatives={"v": "a"},
            catalogue="mechanical",
            units={"t": "s", "x": "m", "v": "m/s", "F": "N"},
        ),
        right=set(),
        verdicts_ok={UNKNOWN, INSTRUMENT},
        trap="A pump next door shakes the rig at 1.72 and 3.44 Hz, beside the resonance at 1.49 Hz: what it does goes with x and v, as their "
        "own response does.",
    )


@build("disturbance")
def conveyor_loads():
    rng = np.random.default_rng(2002)
    t = np.arange(700) * 0.08
    u = switched(rng, t, 1.0, 4.0, [6.0, 9.0, 12.0])
    load = switched(rng, t, 3.0, 9.0, [0.0, 2.5, 5.0])
    rhs = lambda t, s, u: [1.2 * u[0] - 0.9 * s[0] - u[1]]
    w = held(rhs, [8.0], t, lambda i, x: np.array([u[i], load[i]]))[0][:, 0]
    return dict(
        table=pd.DataFrame({"t": t, "w": w + 0.08 * rng.normal(size=len(t)), "u": u}),
        equations={"w": "1.2*u - 0.9*w"},
        study_kwargs=dict(
            states=["w"],
            inputs=["u"],
            catalogue="mechanical",
            units={"t": "s", "w": "rad/s", "u": "V"},
            interpolation="zoh",
        ),
        right=set(),
        harmless={"constant-force", "coulomb-friction", "smooth-friction"},
        verdicts_ok={UNKNOWN, PARTLY, ONE_OF},
        trap="Parcels come and go, a torque in steps that nobody measured; the belt never turns round, so its mean is a constant force and "
        "dry friction alike.",
    )


@build("disturbance")
def wind_on_top_floor():
    rng = np.random.default_rng(2003)
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
    return dict(
        table=pd.DataFrame(
            {
                "t": t,
                "x1": y[:, 0] + 0.01 * y[:, 0].std() * rng.normal(size=len(t)),
                "x2": y[:, 2] + 0.01 * y[:, 2].std() * rng.normal(size=len(t)),
                "ground": g(t),
            }
        ),
        equations={
            "x1": "v1",
            "v1": "-ground - 160*x1 - 0.8*v1 - 150*(x1 - x2) - 0.7*(v1 - v2)",
            "x2": "v2",
            "v2": "-ground + 150*(x1 - x2) + 0.7*(v1 - v2)",
        },
        study_kwargs=dict(
            states=["x1", "x2"],
            inputs=["ground"],
            learn="v2",
            catalogue="mechanical",
            units={"t": "s", "x1": "m", "x2": "m", "ground": "m/s^2"},
        ),
        right=set(),
        verdicts_ok={UNKNOWN},
        trap="Gusts on the upper of two floors (coloured, 0.8 s, over half of the ground's push), which ring at the building's own pitch as a "
        "missing spring or damper would.",
    )


@build("disturbance")
def amplifier_third_harmonic():
    rng = np.random.default_rng(2004)
    t = np.arange(600) * 0.0006
    om = 2 * np.pi * 25.0
    F = lambda t: 40.0 * np.sin(om * t) + 8.0 * np.sin(0.37 * om * t + 0.5)
    acc = lambda t, x, v: 1000 * F(t) - 1.6e4 * x - 30 * v + 5000 * np.sin(3 * om * t + 2.2)
    start = integrate(lambda t, s: [s[1], acc(t, *s)], [0.0, 0.0], np.linspace(-0.4, 0, 200))[-1]
    y = integrate(lambda t, s: [s[1], acc(t, *s)], start, t)
    a = acc(t, *y.T)
    return dict(
        table=pd.DataFrame(
            {"t": t, "x": y[:, 0], "v": y[:, 1], "a": a + 0.02 * rms(a) * rng.normal(size=len(t)), "F": F(t)}
        ),
        equations={"x": "v", "v": "1000*F - 16000*x - 30*v"},
        study_kwargs=dict(
            states=["x", "v"],
            inputs=["F"],
            derivatives={"v": "a"},
            catalogue="mechanical",
            units={"t": "s", "x": "mm", "v": "mm/s", "F": "N"},
        ),
        right=set(),
        harmless={"cubic-input"},
        verdicts_ok={UNKNOWN, INSTRUMENT},
        trap="The shaker's amplifier adds a third harmonic, which no input has, to a drive that is nearly one sine: with a correction of a coefficient, "
        "cubes of position, speed and force have that harmonic too, at another phase.",
    )


# --------------------------------------------------------------------------------------- 11 delay, lag, finite differences


@build("delay, lag, differences")
def differences_of_speed():
    rng = np.random.default_rng(2101)
    F = waves(rng, 0.4, 2.3, 6, 7.0)
    t = np.arange(800) * 0.012
    y = integrate(lambda t, s: [s[1], F(t) - 65 * s[0] - 1.3 * s[1]], [0.1, 0.0], t)
    x = y[:, 0] + 0.003 * y[:, 0].std() * rng.normal(size=len(t))
    v = y[:, 1] + 0.006 * y[:, 1].std() * rng.normal(size=len(t))
    a = np.convolve(np.gradient(v, t), np.ones(5) / 5, mode="same")
    keep = slice(4, -4)
    return dict(
        table=pd.DataFrame({"t": t, "x": x, "v": v, "a": a, "F": F(t)})[keep].reset_index(drop=True),
        equations={"x": "v", "v": "F - 65*x - 1.3*v"},
        study_kwargs=dict(
            states=["x", "v"],
            inputs=["F"],
            derivatives={"v": "a"},
            catalogue="mechanical",
            units={"t": "s", "x": "m", "v": "m/s", "F": "N"},
        ),
        right=set(),
        verdicts_ok={NO_GAP, INSTRUMENT},
        trap="Nothing is missing; the column of accelerations is a central difference of noisy speeds under a moving mean of five, sold as "
        "measured: its noise is correlated, is shared with v, and peaks are cut by 2 %.",
    )


@build("delay, lag, differences")
def backward_differences_duffing():
    rng = np.random.default_rng(2102)
    F = waves(rng, 0.4, 2.0, 6, 9.0)
    t = np.arange(704) * 0.02
    y = integrate(lambda t, s: [s[1], F(t) - 50 * s[0] - 0.9 * s[1] - 130 * s[0] ** 3], [0.1, 0.0], t)
    x = y[:, 0] + 2e-4 * y[:, 0].std() * rng.normal(size=len(t))
    v = np.concatenate([[np.nan], np.diff(x) / 0.02])
    a = np.concatenate([[np.nan], np.diff(v) / 0.02])
    table = pd.DataFrame({"t": t, "x": x, "v": v, "a": a, "F": F(t)})[4:].reset_index(drop=True)
    return dict(
        table=table,
        equations={"x": "v", "v": "F - 50*x - 0.9*v"},
        study_kwargs=dict(
            states=["x", "v"],
            inputs=["F"],
            derivatives={"v": "a"},
            catalogue="mechanical",
            units={"t": "s", "x": "m", "v": "m/s", "F": "N"},
        ),
        right={"cubic-stiffness"},
        harmless=HARDENING,
        verdicts_ok=FOUND,
        trap="Speed is a backward difference (half a step late) and acceleration another on top (a whole step late), which adds a damping of "
        "the wrong sign and a cube of position times speed beside the cubic spring that is missing.",
    )


@build("delay, lag, differences")
def thermocouple_in_a_well():
    rng = np.random.default_rng(2103)
    t = np.arange(500) * 0.2
    P = switched(rng, t, 3.0, 14.0, [0.0, 2.0, 4.0, 7.0])
    rhs = lambda t, s, u: [6.0 * u - 0.12 * (s[0] - 20.0), (s[0] - s[1]) / 1.3]
    y = held(rhs, [80.0, 80.0], t, lambda i, x: P[i])[0]
    return dict(
        table=pd.DataFrame({"t": t, "T": y[:, 1] + 0.4 * rng.normal(size=len(t)), "P": P}),
        equations={"T": "6*P - 0.12*(T - 20)"},
        study_kwargs=dict(
            states=["T"], inputs=["P"], catalogue="all", units={"t": "min", "P": "kW"}, interpolation="zoh"
        ),
        right={"actuator-lag"},
        verdicts_ok={INSTRUMENT, ONE_OF, UNKNOWN, PARTLY},
        trap="The process is right, but the thermocouple in its well follows with 1.3 min: no law of the temperature or the heat is missing, "
        "and a slow heater would look the same.",
    )


@build("delay, lag, differences")
def two_clocks():
    rng = np.random.default_rng(2104)
    F = waves(rng, 0.25, 1.3, 6, 3.0)
    t = np.arange(1000) * 0.03
    x = integrate(lambda t, s: [s[1], F(t) - 24 * s[0] - 0.6 * s[1]], [0.0, 0.2], t)[:, 0]
    logged = F(t - 0.09 * t / t[-1])
    return dict(
        table=pd.DataFrame({"t": t, "x": x + 0.01 * x.std() * rng.normal(size=len(t)), "F": logged}),
        equations={"x": "v", "v": "F - 24*x - 0.6*v"},
        study_kwargs=dict(states=["x"], inputs=["F"], catalogue="mechanical", units={"t": "s", "x": "m", "F": "N"}),
        right=set(),
        harmless={"actuator-lag"},
        verdicts_ok={INSTRUMENT, UNKNOWN, PARTLY},
        trap="Nothing is missing; force and position have a logger each, whose clocks part by 0.3 % (three samples at the end): a delay that "
        "grows, and is largest where data are held out.",
    )


# ---------------------------------------------------------------------------------- 12 thermal, fluid, electrical, population


@build("other domains")
def furnace_radiates():
    rng = np.random.default_rng(2201)
    t = np.arange(360) * 1.0
    P = switched(rng, t, 8, 35, [0.0, 6.0, 14.0, 25.0])
    rhs = lambda t, s, u: [2.6 * u - 0.03 * (s[0] - 25) - 6.0e-11 * ((s[0] + 273.15) ** 4 - 298.15**4)]
    T = held(rhs, [150.0], t, lambda i, x: P[i])[0][:, 0]
    return dict(
        table=pd.DataFrame({"t": t, "T": T + 1.5 * rng.normal(size=len(t)), "P": P}),
        equations={"T": "2.6*P - 0.03*(T - 25)"},
        study_kwargs=dict(
            states=["T"], inputs=["P"], catalogue="all", units={"t": "min", "P": "kW"}, interpolation="zoh"
        ),
        right=set(),
        harmless={
            "logistic-crowding",
            "cubic-crowding",
            "quadratic-drag",
            "velocity-squared",
            "cubic-damping",
            "cubic-resistor",
            "diode",
            "diode-pair",
            "weir-overflow",
            "overflow",
            "saturating-inductor",
            "cubic-storage",
            "allee",
        },
        verdicts_ok={UNKNOWN, PARTLY, ONE_OF},
        trap="Radiation with the fourth power of T + 273, of a temperature in Celsius that is always positive: nearly a square, a cube, an exponential "
        "or a weir, each of which some domain of the catalogue has.",
    )


@build("other domains")
def ferroresonant_coil():
    rng = np.random.default_rng(2202)
    I = waves(rng, 0.35, 1.4, 6, 1.0)
    t = np.arange(600) * 0.025
    knee = 0.2

    def rate(t, phi, v):
        over = np.sign(phi) * np.maximum(np.abs(phi) - knee, 0)
        return (I(t) - 0.15 * v - 10.0 * phi - 13.0 * over) / 0.25

    y = integrate(lambda t, s: [s[1], rate(t, *s)], [0.0, 0.0], t)
    r = rate(t, *y.T)
    return dict(
        table=pd.DataFrame(
            {"t": t, "phi": y[:, 0], "v": y[:, 1], "dv": r + 0.04 * rms(r) * rng.normal(size=len(t)), "I": I(t)}
        ),
        equations={"phi": "v", "v": "4*I - 0.6*v - 40*phi"},
        study_kwargs=dict(
            states=["phi", "v"],
            inputs=["I"],
            derivatives={"v": "dv"},
            catalogue="electrical",
            units={"t": "ms", "phi": "V*ms", "v": "V", "I": "A"},
        ),
        right={"saturating-inductor"},
        harmless={"cubic-storage", "cubic-resistor"},
        verdicts_ok=FOUND,
        trap="A core with a knee: flux is the integral of the voltage, and the bend is between a cube and a corner.",
    )


@build("other domains")
def fishery_allee():
    rng = np.random.default_rng(2203)
    t = np.arange(240) * 0.1
    E = switched(rng, t, 0.8, 2.6, [0.0, 0.3, 0.7, 1.1])
    rhs = lambda t, s, u: [1.3 * s[0] - 0.16 * s[0] ** 2 - u * s[0] - 0.9 * s[0] / (0.8 + s[0])]
    N = held(rhs, [2.0], t, lambda i, x: E[i])[0][:, 0]
    assert N.min() > 0.3
    return dict(
        table=pd.DataFrame({"t": t, "N": N * (1 + 0.008 * rng.normal(size=len(t))), "E": E}),
        equations={"N": "1.3*N - 0.16*N**2 - E*N"},
        study_kwargs=dict(
            states=["N"],
            inputs=["E"],
            catalogue="population",
            units={"t": "year", "N": "kt", "E": "1/year"},
            interpolation="zoh",
        ),
        right={"allee"},
        harmless={"constant-harvest", "cubic-crowding", "linear-growth"},
        verdicts_ok=FOUND | {RECALIBRATE},
        trap="An Allee effect over stocks at which it has nearly levelled off: close to a fixed harvest, and with a wrong rate of growth and "
        "crowding closer still; the error of a count goes with the stock.",
    )


@build("other domains")
def locks_with_a_pipe():
    rng = np.random.default_rng(2204)
    t = np.arange(520) * 4.0
    q = switched(rng, t, 60, 220, [0.1, 0.5, 0.9, 1.3])
    pipe = lambda h1, h2: 0.11 * np.sign(h1 - h2) * np.sqrt(np.abs(h1 - h2))

    def rates(h1, h2, u):
        return 0.5 * u - pipe(h1, h2), pipe(h1, h2) - 0.08 * np.sqrt(np.maximum(h2, 0))

    h = held(lambda t, s, u: list(rates(s[0], s[1], u)), [20.0, 14.0], t, lambda i, x: q[i], jumps=True)[0]
    r1, r2 = rates(h[:, 0], h[:, 1], q)
    return dict(
        table=pd.DataFrame(
            {
                "t": t,
                "h1": h[:, 0],
                "h2": h[:, 1],
                "r1": r1 + 0.04 * rms(r1) * rng.normal(size=len(t)),
                "r2": r2 + 0.04 * rms(r1) * rng.normal(size=len(t)),
                "q": q,
            }
        ),
        equations={"h1": "0.5*q - 0.03*(h1 - h2)", "h2": "0.03*(h1 - h2) - 0.08*sqrt(max(h2,0))"},
        study_kwargs=dict(
            states=["h1", "h2"],
            inputs=["q"],
            derivatives={"h1": "r1", "h2": "r2"},
            catalogue="fluid",
            units={"t": "s", "h1": "cm", "h2": "cm", "q": "L/s"},
            interpolation="zoh",
        ),
        right={"connecting-pipe"},
        harmless={"linear-outflow", "linear-inflow", "torricelli-inflow", "torricelli-outflow", "constant-inflow"},
        verdicts_ok=FOUND | {RECALIBRATE},
        trap="The simulation has a laminar pipe where there is a turbulent one: the root of the difference of levels has to come in and the "
        "line has to go out altogether, in both equations, with opposite signs.",
    )


# ------------------------------------------------------------------------------------------------------------- check


def summary(r: Record) -> str:
    """Gap between simulation and table: its RMS over that of measured rates, else the NRMSE of a free run."""
    tab = r.table.dropna()
    space = {
        "abs": np.abs,
        "sqrt": np.sqrt,
        "sign": np.sign,
        "exp": np.exp,
        "max": np.maximum,
        "min": np.minimum,
        "sin": np.sin,
    }
    code = {k: compile(e, k, "eval") for k, e in r.equations.items()}
    kw = r.study_kwargs
    t, out = tab["t"].to_numpy(), []
    columns = {c: tab[c].to_numpy() for c in [*kw["states"], *kw.get("inputs", [])]}
    if kw.get("derivatives"):
        for state, column in kw["derivatives"].items():
            y = tab[column].to_numpy()
            gap = y - eval(code[state], space, dict(columns))
            rough = np.std(np.diff(gap, 2)) / np.sqrt(6)
            out.append(f"d{state}: gap {rms(gap) / rms(y):.3f} of rate, noise about {rough / rms(y):.3f}")
    else:
        free = list(r.equations)
        start = []
        for s in free:
            if s in columns:
                start.append(columns[s][0])
            else:
                of = [k for k, e in r.equations.items() if e == s]
                start.append(
                    (columns[of[0]][1] - columns[of[0]][0]) / (t[1] - t[0]) if of and of[0] in columns else 9.0
                )
        names_in = kw.get("inputs", [])
        zoh = kw.get("interpolation") == "zoh"

        def rhs(x, s):
            at = dict(zip(free, s))
            j = np.clip(np.searchsorted(t, x, side="right") - 1, 0, len(t) - 1)
            for n in names_in:
                at[n] = columns[n][j] if zoh else np.interp(x, t, columns[n])
            return [eval(code[k], space, at) for k in free]

        run = solve_ivp(rhs, (t[0], t[-1]), start, t_eval=t, rtol=1e-6, atol=1e-9, max_step=np.median(np.diff(t)))
        for s in kw["states"]:
            p = run.y[free.index(s)]
            y = columns[s][: len(p)]
            rough = np.std(np.diff(y, 3)) / np.sqrt(20)
            out.append(f"{s}: free run {rms(p - y) / np.std(y):.3f} of spread, noise below {rough / np.std(y):.3f}")
    return f"{r.name:28s} {len(r.table):5d} rows  " + "; ".join(out)


if __name__ == "__main__":
    for name in sys.argv[1:] or names():
        print(summary(record(name)), flush=True)
    if not sys.argv[1:]:
        kinds = [r.kind for r in records()]
        print(
            len(kinds),
            "records;",
            sum(bool(r.study_kwargs.get("derivatives")) for r in records()),
            "with rates;",
            {k: kinds.count(k) for k in dict.fromkeys(kinds)},
        )
