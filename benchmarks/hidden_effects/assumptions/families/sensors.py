"""Sensors that are late, filtered, wrong or bent.

Bent ones compress, have play, have a zero that is off, or let slow motion decay. The zero alone is among the errors
that the study suspects, and all look like some effect: a position that is read too small at its ends like a spring that
is not linear, a speed like drag. The states still tell, for a bent displacement is not the integral of the speed, and a
bent speed not that of the acceleration.

Filtered rates come from a noisy displacement alone, measured fast. The package's own differentiator is the user's way
into the study and part of what is judged; the data before it are not its doing.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float
from scipy.signal import lfilter

from bayes_greybox.data.trajectories import Trajectories
from benchmarks.hidden_effects.assumptions.case import (
    SILENT,
    AssumptionCase,
    Family,
    Measured,
    Scene,
    Setting,
    Suspect,
    rate_channel,
    seen,
    white,
)
from benchmarks.hidden_effects.assumptions.hosts import FORCED

from .forces import either_friction

BACKWARD, FORWARD = "backward differences", "forward differences"
"""Breaches of rates that are half a step late, and half a step early."""


def _delays() -> Iterator[Setting]:
    # In sampling steps; noise of the rate over its RMS.
    steps, noises = (0.1, 0.25, 0.5, 1.0, 2.0), (0.01, 0.02, 0.05)
    # Two rates late, a state alone, the input: a delay of a tenth of a step is asked for only where it can be seen.
    turns = [
        *(("rate", late) for late in steps),
        *(("states", late) for late in steps),
        *(("position", late) for late in steps[1:]),
        *(("input", late) for late in steps[1:]),
    ]
    for turn, (breach, late) in enumerate(turns):
        yield Setting(breach, late, FORCED[turn % 3], noises[0] if late < 0.25 else noises[turn // 2 % 3])
    for turn, (breach, late) in enumerate(((BACKWARD, 0.5), (FORWARD, -0.5)) * 2):
        yield Setting(breach, late, FORCED[(turn // 2 + turn) % 2], noises[turn // 2 + 1])
    yield Setting("rate", 0.5, "tank", noises[0])
    yield Setting("input", 2.0, "tank", noises[0])
    yield Setting("input", 0.5, "series-rlc", noises[1])
    yield Setting("rate", 1.0, "series-rlc", noises[1])


def _with_delay(scene: Scene, part: str, rng: np.random.Generator) -> Measured:
    case, host = scene.case, scene.case.system
    now, late = seen(scene, part), seen(scene, part, case.size)
    columns, rate = dict(now.columns), now.rate
    if case.breach == "rate":
        rate = late.rate
    elif case.breach in (BACKWARD, FORWARD):
        there = seen(scene, part, np.sign(case.size)).columns[host.equation]
        rate = np.sign(case.size) * (columns[host.equation] - there) / scene.paths[part].step
    else:
        columns |= {name: late.columns[name] for name in _late(case)}
    return Measured(columns, rate + scene.sigma * rng.standard_normal(len(rate)))


def _late(case: AssumptionCase) -> tuple[str, ...]:
    host = case.system
    return {"states": host.states, "position": host.states[:1], "input": host.inputs}[case.breach]


def _delay_suspects(case: AssumptionCase) -> tuple[Suspect, ...]:
    either = not case.system.inputs
    if case.breach in ("rate", BACKWARD, FORWARD):
        return (Suspect("delay", rate_channel(case), case.size, either),)
    # All states late: any of them says so, as the first one's term is by far the largest.
    return (Suspect("delay", (case.breach, *_late(case)), case.size, either),)


DELAY = Family("delay", _delays, _with_delay, _delay_suspects)


def _displacements() -> Iterator[Setting]:
    # Noise of the displacement over its standard deviation, in hosts with enough rows for a filter.
    for level in (0.001, 0.002, 0.005, 0.01):
        for host in FORCED:
            yield Setting("displacement", level, f"fast-{host}", level)


def _with_noisy_displacement(scene: Scene, part: str, rng: np.random.Generator) -> Measured:
    clean = seen(scene, part)
    position = scene.case.system.states[0]
    noise = scene.case.size * scene.spread[position] * rng.standard_normal(len(clean.rate))
    return Measured({**clean.columns, position: clean.columns[position] + noise}, clean.rate)


def _differentiated(train: Trajectories, test: Trajectories) -> tuple[Trajectories, Trajectories]:
    """Differentiate as a user would: the window by the package's default, and the same for both parts."""
    position, velocity = train.state_names

    def bare(data: Trajectories) -> Trajectories:
        runs = [data.run == number for number in range(data.n_run)]
        return Trajectories.from_arrays(
            [data.time[rows] for rows in runs],
            states={position: [data.states[position][rows] for rows in runs]},
            inputs={name: [values[rows] for rows in runs] for name, values in data.inputs.items()},
            units={name: unit for name, unit in data.units.items() if name != velocity},
        )

    found = bare(train).differentiate("savgol", rates={position: velocity})
    window = found.dropped // found.n_run + 1
    return found, bare(test).differentiate("savgol", rates={position: velocity}, window=window)


# Effects are sized by about the rest of the noise in the filtered acceleration, over its RMS.
FILTERED_RATES = Family(
    "filtered rates", _displacements, _with_noisy_displacement, level=lambda case: 0.03, finish=_differentiated
)


CONSTANTS = ("constant-force", "constant-inflow", "constant-source")
"""Effects that no data could tell from an offset."""

_FAULTS = (
    ("rate gain", 0.02),
    ("rate gain", -0.02),
    ("input gain", 0.02),
    ("rate offset", 0.05),
    ("position offset", 0.05),
    ("rate drift", 0.1),
    ("quantised rate", 40.0),
    ("quantised rate", 20.0),
    ("quantised position", 60.0),
    ("clipped rate", 0.02),
    ("clipped rate", 0.05),
)


def _ailing() -> Iterator[Setting]:
    for turn, (breach, size) in enumerate(_FAULTS * 2):
        # Coarse steps take the place of noise: with much of it they would only be more noise.
        noise = 0.01 if "quantised" in breach or turn < len(_FAULTS) else 0.02
        yield Setting(breach, size, FORCED[(turn + turn // len(_FAULTS)) % 3], noise)


def _with_fault(scene: Scene, part: str, rng: np.random.Generator) -> Measured:
    case, host = scene.case, scene.case.system
    clean, train = white(scene, part, rng), seen(scene, "train")
    columns, rate, size = dict(clean.columns), clean.rate, case.size
    channel, _, kind = case.breach.partition(" ")
    if kind == "gain" and channel == "rate":
        rate = (1.0 + size) * rate
    elif kind == "gain":
        columns[host.inputs[0]] = (1.0 + size) * columns[host.inputs[0]]
    elif kind == "offset" and channel == "rate":
        rate = rate + size * scene.rate
    elif kind == "offset":
        columns[host.states[0]] = columns[host.states[0]] + size * scene.spread[host.states[0]]
    elif kind == "drift":
        # From one side to the other over the longest a run lasts.
        stamps = scene.paths[part].at().columns["t"]
        rate = rate + size * scene.rate * (2.0 * stamps / host.stop - 1.0)
    elif case.breach == "quantised rate":
        rate = _quantised(rate, train.rate, size)
    elif case.breach == "quantised position":
        name = host.states[0]
        columns[name] = _quantised(columns[name], train.columns[name], size)
    else:
        end = float(np.quantile(np.abs(train.rate), 1.0 - size))
        rate = np.clip(rate, -end, end)
    return Measured(columns, rate)


def _quantised(values: np.ndarray, over: np.ndarray, levels: float) -> np.ndarray:
    """Round to so many levels over the range of other values."""
    step = float(np.ptp(over)) / levels
    return step * np.round(values / step)


def _fault_suspects(case: AssumptionCase) -> tuple[Suspect, ...]:
    host, rate = case.system, rate_channel(case)
    if case.breach == "rate drift":
        return (Suspect("offset", rate), Suspect("correlated noise"))
    return {
        # The whole equation scales: the rate read too large is all else read too small.
        "rate gain": (Suspect("gain"),),
        "input gain": (Suspect("gain", ("input", *host.inputs)),),
        "rate offset": (Suspect("offset"),),
        "position offset": (Suspect("offset"),),
    }.get(case.breach, ())


def _fault_silent(case: AssumptionCase) -> tuple[str, ...]:
    # Coefficients that are all off by the same say nothing else.
    return (*SILENT, "recalibrate") if case.breach.endswith("gain") else SILENT


SENSOR = Family(
    "sensor",
    _ailing,
    _with_fault,
    _fault_suspects,
    excused=lambda case: CONSTANTS if "offset" in case.breach or "drift" in case.breach else (),
    silent=_fault_silent,
)


POSITION_COMPRESSED, SPEED_COMPRESSED = "position compresses", "speed compresses"
"""Read too small by a cubic; the size is the share that is lost at the largest value of the training data."""

PLAY = "position play"
"""The size is half of the play, over the largest displacement of the training data."""

ZERO = "position zero"
"""On a spring that is not linear, where a zero that is off is no constant force; the size is over the RMS."""

COUPLED = "AC-coupled rate"
"""A first-order high-pass; the size is its corner over the natural frequency of the host's mass on its spring."""

_BENT_TRIED = (
    (POSITION_COMPRESSED, ((0.05, "machine", 0.02), (0.02, "swept-oscillator", 0.01))),
    # A speed acts through the damping that the simulation knows, so that there has to be some.
    (SPEED_COMPRESSED, ((0.1, "damped-machine", 0.01), (0.06, "damped-oscillator", 0.005))),
    (PLAY, ((0.04, "forced-oscillator", 0.02), (0.03, "machine", 0.01))),
    (ZERO, ((0.2, "hardening-machine", 0.02), (0.2, "hardening-oscillator", 0.05))),
    (COUPLED, ((0.15, "machine", 0.05), (0.15, "forced-oscillator", 0.02))),
)


def _bent() -> Iterator[Setting]:
    for breach, tried in _BENT_TRIED:
        for size, host, noise in tried:
            yield Setting(breach, size, host, noise)


def compressed(values: Float[np.ndarray, " n_obs"], largest: float, share: float) -> Float[np.ndarray, " n_obs"]:
    """Return values less a cubic, c y^3, that takes this share of the largest one."""
    return values - share * values**3 / largest**2


def with_play(values: Float[np.ndarray, "n_run n_time"], half: float) -> Float[np.ndarray, "n_run n_time"]:
    """Return the readings of a follower that only the ends of its play move; it starts in the middle of it."""
    shown = np.array(values)
    for run in shown:
        for row in range(1, len(run)):
            run[row] = np.clip(run[row - 1], run[row] - half, run[row] + half)
    return shown


def high_passed(
    values: Float[np.ndarray, "n_run n_time"], corner: float, step: float
) -> Float[np.ndarray, "n_run n_time"]:
    """Pass every run through a first-order high-pass, switched on at its first row; the corner is a frequency."""
    # Bilinear, exact at the corner.
    turn = np.tan(np.pi * corner * step)
    return np.asarray(lfilter([1.0, -1.0], [1.0 + turn, turn - 1.0], values, axis=1))


def natural_frequency(scene: Scene) -> float:
    """Return the frequency of the host's mass on its linear spring, in cycles per unit of time."""
    host = scene.paths["train"].visible
    return float(np.sqrt(-host.rates[host.equation][host.roles["position"]]) / (2.0 * np.pi))


def _bending(scene: Scene, part: str, rng: np.random.Generator) -> Measured:
    case, host = scene.case, scene.case.system
    clean, train = white(scene, part, rng), seen(scene, "train").columns
    columns, rate, size = dict(clean.columns), clean.rate, case.size
    position, speed = host.roles["position"], host.roles["velocity"]
    if case.breach in (POSITION_COMPRESSED, SPEED_COMPRESSED):
        name = position if case.breach == POSITION_COMPRESSED else speed
        columns[name] = compressed(columns[name], float(np.max(np.abs(train[name]))), size)
    elif case.breach == PLAY:
        half = size * float(np.max(np.abs(train[position])))
        columns[position] = with_play(columns[position].reshape(-1, host.samples), half).ravel()
    elif case.breach == ZERO:
        columns[position] = columns[position] + size * float(np.sqrt(np.mean(train[position] ** 2)))
    else:
        # What the electronics add comes after the filter.
        exact = seen(scene, part).rate
        passed = high_passed(
            exact.reshape(-1, host.samples), size * natural_frequency(scene), scene.paths[part].step
        ).ravel()
        rate = passed + (rate - exact)
    return Measured(columns, rate)


def _bent_suspects(case: AssumptionCase) -> tuple[Suspect, ...]:
    return (Suspect("offset", (case.system.roles["position"],)),) if case.breach == ZERO else ()


BENT_SENSORS = Family(
    "bent sensors",
    _bent,
    _bending,
    _bent_suspects,
    accepted=either_friction,
    # Most of these sensors' errors are not on the study's list: something is wrong, and it cannot say what.
    silent=lambda case: ("instrument", "unknown", "partly named"),
)
