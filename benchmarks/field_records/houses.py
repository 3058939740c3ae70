"""Houses that are heated in weather, and their thermometer."""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from .record import INSTRUMENT, NAMED, NO_GAP, ONE_OF, PARTLY, RECALIBRATE, UNKNOWN, FieldRecord, Measured
from .signals import levels, rounded, wandering

HOURS, STEP, LOSS = 120.0, 0.25, 0.15
"""Duration and time between samples, hours; loss as it is written down, 1/h."""


@dataclass(frozen=True)
class House:
    """T' = loss (T_out − T) + gain heater + sun + exchange (T_walls − T) of the air; hours and K.

    Attributes:
        loss: Loss of the air, 1/h.
        gain: Share of the heater that arrives.
        power: Size of the heater, K/h.
        thermostat: Readings at which the heater is switched on and off; a plan switches it where there are none.
        walls: Exchange with the walls, 1/h, and their time, h; None is a house of one mass.
        lag: Lag of the thermometer, h.
        sun: Heat of a full sun, K/h.
        windows: Number of window openings.
        delay: Samples by which the heater's heat arrives late.
        steady: If true, the weather is constant but for one step.
        noise: Noise of the thermometer, K.
        step: Steps of the thermometer, K.
    """

    loss: float = LOSS
    gain: float = 1.0
    power: float = 3.0
    thermostat: tuple[float, float] | None = None
    walls: tuple[float, float] | None = None
    lag: float = 0.0
    sun: float = 0.0
    windows: int = 0
    delay: int = 0
    steady: bool = False
    noise: float = 0.05
    step: float = 0.1


@dataclass(frozen=True)
class Surroundings:
    """Temperature outside, its change to the next sample, sunshine, loss through windows and the plan of the heater."""

    outside: np.ndarray
    sunshine: np.ndarray
    windows: np.ndarray
    plan: np.ndarray


def surroundings(rng: np.random.Generator, house: House, t: np.ndarray) -> Surroundings:
    """Draw the surroundings of a house at the times t."""
    n = len(t)
    outside = 4 + 4 * np.sin(2 * np.pi * (t - 9) / 24) + wandering(rng, n, STEP, 20.0, 1.5)
    if house.steady:
        outside = np.where(t < 0.6 * t[-1], 5.0, 4.0)
    cloud = np.clip(0.5 + wandering(rng, n, STEP, 2.0, 0.4), 0, 1)
    day = np.clip(np.sin(2 * np.pi * (t - 7) / 24), 0, None) ** 1.5
    windows = np.zeros(n)
    for _ in range(house.windows):
        first = int(rng.integers(0, n - 8))
        windows[first : first + int(rng.integers(1, 6))] = rng.uniform(0.2, 0.6)
    plan = levels(rng, n, [0.0, 0.0, house.power * 0.6, house.power, house.power * 1.3], 2, 24)
    # The sun keeps its size apart: the order of the products fixes the last digit.
    return Surroundings(outside, house.sun * day * cloud, windows, plan)


def after(house: House, around: Surroundings, k: int, x: np.ndarray, arrives: float) -> np.ndarray:
    """Return the temperatures of air, walls and thermometer one sample after sample k."""
    now = around.outside[k]
    then = now if house.steady else around.outside[min(k + 1, len(around.outside) - 1)]

    def rates(time: float, y: np.ndarray) -> list[float]:
        outside = now + (then - now) * (time / STEP)
        air = (house.loss + around.windows[k]) * (outside - y[0]) + house.gain * arrives + around.sunshine[k]
        walls = 0.0
        if house.walls:
            air += house.walls[0] * (y[1] - y[0])
            walls = (y[0] - y[1]) / house.walls[1]
        return [air, walls, (y[0] - y[2]) / house.lag if house.lag else 0.0]

    return solve_ivp(rates, (0, STEP), x, rtol=1e-7, atol=1e-9).y[:, -1]


def measured(rng: np.random.Generator, house: House) -> Measured:
    """Return what the thermometers of a house read, and its heater."""
    t = np.arange(int(HOURS / STEP)) * STEP
    around = surroundings(rng, house, t)
    x, on, under_way = np.array([18.0, 18.0, 18.0]), True, [0.0] * house.delay
    readings, heater = [], []
    for k in range(len(t)):
        reading = rounded((x[2] if house.lag else x[0]) + house.noise * rng.standard_normal(), house.step)
        heat = around.plan[k]
        if house.thermostat:
            on = reading < house.thermostat[1] if on else reading < house.thermostat[0]
            heat = house.power if on else 0.0
        readings.append(reading)
        heater.append(heat)
        under_way.append(heat)
        x = after(house, around, k, x, under_way.pop(0))
    return Measured(
        t,
        {"heater": np.array(heater), "outside": rounded(around.outside, 0.1)},
        {"t": "h", "T": "degC", "outside": "degC", "heater": "K/h"},
        {"T": "loss*(outside - T) + heater"},
        {"loss": LOSS},
        states={"T": np.array(readings)},
        split=0.7,
    )


def _record(name: str, seed: int, truth: str, house: House, verdicts: set[str], **right: set[str]) -> FieldRecord:
    return FieldRecord(name, "thermal", seed, truth, lambda rng: measured(rng, house), verdicts, **right)


RECORDS = (
    _record("quiet_house", 201, "Nothing; a thermometer of 0.1 K with noise of 0.05 K.", House(), {NO_GAP}),
    _record(
        "thermostat", 202, "Nothing; a thermostat closes the loop on a thermometer of 0.1 K.",
        House(thermostat=(19.7, 20.4)), {NO_GAP},
    ),
    _record(
        "coarse_thermostat", 203, "Nothing; a thermostat on a thermometer of 0.5 K without other noise.",
        House(thermostat=(19.4, 20.6), noise=0.0, step=0.5), {NO_GAP},
    ),
    _record(
        "steady_weather", 204, "Nothing; the weather is constant for three days, then one degree less.",
        House(steady=True), {NO_GAP},
    ),
    _record(
        "unmeasured_sun", 205, "The sun heats by up to 1.2 K/h through clouds, and is not measured.",
        House(sun=1.2), {UNKNOWN},
    ),
    _record(
        "open_windows", 206, "Windows are opened twenty times at random.",
        House(windows=20), {UNKNOWN, PARTLY}, right={"heat-loss"},
    ),
    _record(
        "walls_and_thermostat", 207, "Walls store heat behind a thermostat that closes the loop.",
        House(thermostat=(19.7, 20.4), walls=(0.3, 8.0), power=5.0), {NAMED}, right={"second-mass"},
    ),
    _record(
        "walls_and_slow_thermometer", 208, "Walls store heat, and the thermometer lags by 0.5 h.",
        # A thermometer that lags does to a linear house what a heater does that lags.
        House(walls=(0.3, 8.0), lag=0.5, power=5.0), {NAMED, PARTLY, ONE_OF, UNKNOWN},
        right={"second-mass", "actuator-lag"},
    ),
    _record(
        "walls_in_steady_weather", 209, "Walls store heat, and the weather is constant but for one step.",
        House(walls=(0.3, 8.0), steady=True, power=5.0), {NAMED}, right={"second-mass"},
    ),
    _record(
        "three_small_in_a_house", 210, "A sun of 0.3 K/h, walls that store a little, and a heater 5 % too weak.",
        House(sun=0.3, walls=(0.08, 6.0), gain=0.95), {PARTLY, UNKNOWN},
        right={"second-mass", "input-gain"}, errors={"gain of heater"},
    ),
    _record(
        "larger_loss", 211, "The loss is 10 % larger than it is written down.",
        House(loss=0.165), {RECALIBRATE}, harmless={"heat-loss"},
    ),
    _record(
        "late_hot_water", 212, "Hot water arrives 0.75 h late.",
        House(delay=3), {INSTRUMENT, ONE_OF}, harmless={"actuator-lag"}, errors={"delay of heater"},
    ),
)  # fmt: skip
"""Records of houses."""
