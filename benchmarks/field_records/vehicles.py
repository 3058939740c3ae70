"""Cars on hills under a driver or a cruise control, and their speedometer."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from .record import INSTRUMENT, NAMED, NO_GAP, ONE_OF, PARTLY, RECALIBRATE, UNKNOWN, FieldRecord, Measured
from .signals import levels, rounded, wandering

MASS, DRAG, ROLLING, GRAVITY = 1200.0, 4e-4, 0.12, 9.81
"""Mass, kg, drag, 1/m, and rolling resistance, m/s², as they are written down; gravity, m/s²."""

BRAKE, SHIFTING, KMH = 9000.0, 0.6, 0.1 / 3.6
"""Hardest braking, N; time of a gear shift, s; steps of the speedometer, m/s."""

TIMES = np.arange(700) * 0.5
"""Sampling times of most drives, s."""


@dataclass(frozen=True)
class Car:
    """v' = F/m − rolling sign(v) − drag (v + wind)|v + wind| − g sin(slope); SI.

    Attributes:
        mass: Mass of the car.
        wind: Mean and standard deviation of a head wind, with gusts of 8 s.
        drive: Function from the force that is asked for to the one that is given.
        lag: Lag of the drive.
        shifts: If true, a gear shift interrupts the drive.
        cruise: If true, a cruise control drives.
        gain: Reading of the speedometer over the speed.
        noise: Noise of the speedometer.
        lacks: Part that the simulation lacks: "slope", "drag" or "".
    """

    mass: float = MASS
    wind: tuple[float, float] = (0.0, 0.0)
    drive: Callable[[float], float] = float
    lag: float = 0.0
    shifts: bool = False
    cruise: bool = False
    gain: float = 1.0
    noise: float = 0.03
    lacks: str = ""


@dataclass(frozen=True)
class Road:
    """Times, head wind, slope, speeds that the cruise control aims at, and what a driver does."""

    t: np.ndarray
    wind: np.ndarray
    slope: np.ndarray
    target: np.ndarray
    mode: np.ndarray


def road(rng: np.random.Generator, car: Car, t: np.ndarray) -> Road:
    """Draw the road of a car."""
    n, (mean, sd) = len(t), car.wind
    wind = mean + wandering(rng, n, 0.5, 8.0, sd) if sd else np.full(n, mean)
    slope = np.arctan(0.03 * np.sin(2 * np.pi * t / 140) + 0.015 * np.sin(2 * np.pi * t / 47 + 1))
    target = levels(rng, n, [12.0, 18.0, 22.0, 26.0], 40, 120)
    return Road(t, wind, slope, target, levels(rng, n, [0, 1, 2], 6, 40))


def pedals(rng: np.random.Generator, mode: int, v: float) -> float:
    """Return the force that a driver asks for, who rolls, drives or brakes."""
    force = (300.0, 2600.0, -2500.0)[mode] + 250 * rng.standard_normal()
    if v > 30 and force > 0:
        force = -800.0
    if v < 8 and force < 0:
        force = 3000.0
    if mode == 2 and v > 16 and rng.random() < 0.5:
        force = -BRAKE * rng.uniform(0.5, 1.0)
    return force


def after(car: Car, on: Road, k: int, x: np.ndarray, asked: tuple[float, float]) -> np.ndarray:
    """Return speed and force of the drive one sample after sample k.

    Args:
        car: The car.
        on: Its road.
        k: Number of the sample.
        x: Speed and force of the drive there.
        asked: Force that is asked for, and the time at which a gear shift ends.
    """
    t, slope, (force, shift_end) = on.t, on.slope, asked
    step = t[k + 1] - t[k]

    def rates(time: float, y: np.ndarray) -> list[float]:
        wanted = car.drive(0.0 if time < shift_end and force > 0 else force)
        given, air = y[1] if car.lag else wanted, y[0] + on.wind[k]
        angle = slope[k] + (slope[k + 1] - slope[k]) * (time - t[k]) / step
        rate = given / car.mass - ROLLING * np.sign(y[0]) - DRAG * air * abs(air) - GRAVITY * np.sin(angle)
        return [rate, (wanted - y[1]) / car.lag if car.lag else 0.0]

    return solve_ivp(rates, (t[k], t[k + 1]), x, rtol=1e-7, atol=1e-9, max_step=0.2).y[:, -1]


def measured(rng: np.random.Generator, car: Car, t: np.ndarray = TIMES) -> Measured:
    """Return speed, force that is asked for and slope of a drive."""
    on = road(rng, car, t)
    x, integral, shift_end, gear = np.array([15.0, 0.0]), 0.0, -1.0, 2
    speeds, forces = [], []
    for k in range(len(t)):
        v = float(x[0])
        reading = rounded(car.gain * v + car.noise * rng.standard_normal(), KMH)
        if car.cruise:
            error = on.target[k] - reading
            integral = float(np.clip(integral + error * 0.5, -20, 20))
            force = float(np.clip(900 * error + 60 * integral, -4000, 4000))
        else:
            force = pedals(rng, int(on.mode[k]), v)
        speeds.append(reading)
        forces.append(force)
        if car.shifts and k and int(v / 7) != gear:
            gear, shift_end = int(v / 7), t[k] + SHIFTING
        if k + 1 < len(t):
            x = after(car, on, k, x, (force, shift_end))
    return _written(car, on, np.array(speeds), np.array(forces))


def _written(car: Car, on: Road, speed: np.ndarray, force: np.ndarray) -> Measured:
    drag, slope = car.lacks != "drag", car.lacks != "slope"
    formula = f"F/m - {ROLLING}*sign(v)" + " - cd*v*abs(v)" * drag + f" - {GRAVITY}*sin(slope)" * slope
    return Measured(
        on.t,
        {"F": force, **({"slope": on.slope} if slope else {})},
        {"t": "s", "v": "m/s", "F": "N", **({"slope": "rad"} if slope else {})},
        {"v": formula},
        {"m": MASS, **({"cd": DRAG} if drag else {})},
        states={"v": speed},
        roles={"grade": "slope"} if slope else {},
        split=0.7,
    )


def _uneven(rng: np.random.Generator) -> Measured:
    t = np.cumsum(rng.choice([0.3, 0.5, 0.7, 1.0], 600))
    t[250:] += 8.0
    t[430:] += 8.0
    return measured(rng, Car(), np.round(t - t[0], 3))


def _slipping(force: float) -> float:
    return force if force > -5000 else -5000 + 0.5 * (-force - 5000)


def _record(name: str, seed: int, truth: str, car: Car, verdicts: set[str], **right: set[str]) -> FieldRecord:
    return FieldRecord(name, "vehicle", seed, truth, lambda rng: measured(rng, car), verdicts, **right)


RECORDS = (
    _record("quiet_car", 401, "Nothing; the speed in steps of 0.1 km/h without noise.", Car(noise=0.0), {NO_GAP}),
    _record(
        "cruise_control", 402, "Nothing; a cruise control closes the loop, on steps of 0.1 km/h.",
        Car(noise=0.0, cruise=True), {NO_GAP},
    ),
    FieldRecord(
        "uneven_car", "vehicle", 403, "Nothing; uneven times, two gaps of 8 s, steps of 0.1 km/h, noise of 0.03 m/s.",
        _uneven, {NO_GAP},
    ),
    _record(
        "gusty_wind", 404, "A head wind of 6 m/s with gusts of 2.5 m/s is not measured.",
        Car(wind=(6, 2.5), noise=0.0), {UNKNOWN, ONE_OF},
    ),
    _record("unmeasured_hills", 405, "Hills of 3 % are not measured.", Car(noise=0.0, lacks="slope"), {UNKNOWN}),
    _record(
        "slipping_wheels", 406, "Wheels slip: the force falls again beyond 5 kN of braking.",
        Car(drive=_slipping), {PARTLY, UNKNOWN}, right={"input-saturation"},
    ),
    _record("gear_shifts", 407, "Each gear shift interrupts the drive for 0.6 s.", Car(shifts=True), {UNKNOWN}),
    _record(
        "weak_brakes", 408, "The brakes give no more than 2 kN, and the drive all that is asked for.",
        # The saturation of the catalogue is the same both ways, and this one is a part of it.
        Car(drive=lambda force: max(force, -2000.0)), {UNKNOWN, PARTLY}, right={"input-saturation"},
    ),
    _record(
        "heavy_car", 409, "The car is 8 % heavier than it is written down.",
        Car(mass=1296.0), {RECALIBRATE, ONE_OF}, harmless={"input-gain"},
    ),
    _record(
        "drag_under_cruise_control", 410, "Drag of the air, under a cruise control.",
        Car(cruise=True, lacks="drag"), {NAMED, ONE_OF, UNKNOWN}, right={"aerodynamic-drag"},
    ),
    _record(
        "three_small_in_a_car", 411, "A steady head wind of 2 m/s, a car 3 % heavier and a drive that lags by 0.3 s.",
        Car(wind=(2.0, 0.0), mass=1236.0, lag=0.3), {NAMED, PARTLY, UNKNOWN},
        right={"drive-lag"}, harmless={"input-gain"},
    ),
    _record(
        "worn_tyres", 412, "The speedometer reads 3 % too much.",
        Car(gain=1.03), {INSTRUMENT, RECALIBRATE, UNKNOWN}, errors={"gain of v"},
    ),
)  # fmt: skip
"""Records of vehicles."""
