"""The channels of a measurement as suspects: a delay, a gain or an offset of the rate, of states and of inputs.

A channel that is late by d, has a gain 1 + κ or an offset o is, to first order, a column beside the effects:

    rate late      −d · dG/dt              states late    d · Σ_k ∂G/∂x_k ẋ_k         input late   d · ∂G/∂u u̇
    rate gain       κ · G                  state, input gain   −κ · ∂G/∂x_k x_k
    rate offset     o                      state offset        −o · ∂G/∂x_k
    rate drift      o · (t − t̄) / range

with G the whole modelled rate, what was found missing so far included; it is followed by central differences along the
measured path, so any simulation serves. A delay that was found is undone in the data and its column taken anew there,
until it moves no more: what is reported is not first order.

A rate that a filter computed has no sensor of its own. It is late, and reads too large, with the samples that it is of
and with the states S that are of them too; a constant in them is none in it:

    sensor late   −d · (Σ ∂G/∂z ż + ∂G/∂t), z all states and inputs but S        gain   κ · (G − Σ_S ∂G/∂x_k x_k)

The slope of a state is that rate, noise and all: were such a state to be late alone, the rate would explain itself.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import CubicSpline

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.integrate import between_samples

from . import bends

DELAY, GAIN, OFFSET, DRIFT = ("delay", "gain", "offset", "drift")

KINDS = (DELAY, GAIN, OFFSET, DRIFT, *bends.KINDS)
"""What a channel may be suspected of."""

LAG = "lag"
"""What the only sensor of a machine may do in the place of its actuator; no column of its own, see `mirrored`."""

STATES = "states"
"""Channel that stands for all states together."""

DELAY_STEPS = 2.0
"""Prior standard deviation of a delay, in sampling steps."""

GAIN_SD = 0.03
"""Prior standard deviation of a relative gain error."""

OFFSET_SD = 0.03
"""Prior standard deviation of an offset or drift of a rate, over its RMS."""

ZERO_SD = 0.1
"""Prior standard deviation of the zero of a state's or an input's sensor, over the RMS of its channel."""

Rate = Callable[[Trajectories], Float[np.ndarray, " n_obs"]]
"""The whole modelled rate G on the rows of some data."""


@dataclass(frozen=True)
class ChannelSuspect:
    """One suspect about one channel.

    Attributes:
        kind: One of `KINDS`.
        channel: Name of the rate ("d(x)/dt"), of a state, an input or an output, or `STATES`.
        sd: Prior standard deviation of its size, in `unit`'s unit.
        step: Sampling step, for a delay.
        center: What a bend is about, see `bends`.
    """

    kind: str
    channel: str
    sd: float
    step: float = 1.0
    center: float = 0.0

    @property
    def key(self) -> str:
        """Name for tables."""
        return f"{self.kind} of {self.channel}"


def is_fault(name: str) -> bool:
    """Whether what could stand in an effect's place is the fault of a sensor; effects stand there by their slugs.

    Args:
        name: A suspect's key ("offset of y"), or a slug, which has no spaces.
    """
    return bool(fault_kind(name))


def fault_kind(name: str) -> str:
    """Return the kind of a sensor error, one of `KINDS` or `LAG`, from its key; "" for the slug of an effect."""
    kind, _, channel = name.partition(" of ")
    return kind if channel and kind in (*KINDS, LAG) else ""


def suspect_columns(
    data: Trajectories, equation: str, rate: Rate
) -> list[tuple[ChannelSuspect, Float[np.ndarray, " n_obs"]]]:
    """Every suspect with its column: what the measured rate gains per unit of its size.

    Args:
        data: Measurements, as corrected so far.
        equation: The studied state or output.
        rate: The whole modelled rate, or the modelled output.
    """
    inside = np.diff(data.time)[np.diff(data.run) == 0]
    step = float(np.median(inside)) if len(inside) else 1.0
    own, shift = data.target_label(equation), step / 4
    states, inputs, one = data.state_names, data.input_names, _one_sensor(data, equation)
    apart = tuple(name for name in states if name not in one)

    def along(names: tuple[str, ...], clock: bool = False) -> np.ndarray:
        """DG/dd for channels taken d later, and the clock where time itself is in G."""
        ahead, behind = (
            rate(shifted(data, {name: side * shift for name in names}, side * shift if clock else 0.0))
            for side in (1, -1)
        )
        return (ahead - behind) / (2 * shift)

    def slope(name: str, direction: np.ndarray) -> np.ndarray:
        return slope_along(data, rate, name, direction)

    def late(channel: str, column: np.ndarray) -> tuple[ChannelSuspect, np.ndarray]:
        return ChannelSuspect(DELAY, channel, DELAY_STEPS * step, step), column

    G, ones = rate(data), np.ones(data.n_obs)
    if one:
        found = [*(late(u, along((u,))) for u in inputs), late(STATES, -along(inputs, clock=True))]
        if apart:
            found.append(late(one[0], -along((*apart, *inputs), clock=True)))
        found.append((ChannelSuspect(GAIN, one[0], GAIN_SD), G - sum(slope(x, data.column(x)) for x in one)))
        found.append((_zero(data, one[0]), -slope(one[0], ones)))
    else:
        found = [late(own, -along((*states, *inputs), clock=True))]
        if inputs:
            found += [late(STATES, along(states)), *(late(u, along((u,))) for u in inputs)]
        found.append((ChannelSuspect(GAIN, own, GAIN_SD), G))
        size, span = float(np.sqrt(np.mean(G**2))), float(np.ptp(data.time))
        found.append((ChannelSuspect(OFFSET, own, OFFSET_SD * size), ones))
        if span > 0:
            found.append((ChannelSuspect(DRIFT, own, OFFSET_SD * size), (data.time - np.mean(data.time)) / span))
    for name in (*apart, *inputs):
        found.append((ChannelSuspect(GAIN, name, GAIN_SD), -slope(name, data.column(name))))
        found.append((_zero(data, name), -slope(name, ones)))
    if len(states) > 1:
        # Last: of suspects with one and the same column the first stands, and this is the oddest one.
        found += [late(x, along((x,))) for x in apart]
    return [(suspect, column) for suspect, column in found if np.all(np.isfinite(column)) and np.any(column != 0)]


def slope_along(
    data: Trajectories, rate: Rate, name: str, direction: Float[np.ndarray, " n_obs"]
) -> Float[np.ndarray, " n_obs"]:
    """∂G/∂name along a direction, by central differences.

    Args:
        data: Where.
        rate: G.
        name: A state or an input.
        direction: How far it moves at each row, per unit.
    """
    size = float(np.sqrt(np.mean(data.column(name) ** 2)))
    largest = float(np.max(np.abs(direction)))
    h = 1e-4 * size / largest if size > 0 and largest > 0 else 1e-4
    up, down = (rate(_moved(data, name, side * h * direction)) for side in (1, -1))
    return (up - down) / (2 * h)


def undone(data: Trajectories, equation: str, delays: Mapping[str, float]) -> Trajectories:
    """The data with delays of channels undone: states and inputs at the times that the measured rate belongs to.

    Args:
        data: Measurements as they came.
        equation: The studied state.
        delays: By channel; positive is late.
    """
    if not any(delays.values()):
        return data
    one = _one_sensor(data, equation)
    late = {one[0], STATES} if one else {data.target_label(equation)}
    return shifted(data, _later_by(data, equation, delays), -sum(delays.get(name, 0.0) for name in late))


def within(data: Trajectories, equation: str, delays: Mapping[str, float]) -> Bool[np.ndarray, " n_obs"]:
    """Rows whose states and inputs are inside their run once delays are undone: beyond it nothing was measured.

    Args:
        data: Measurements as they came.
        equation: The studied state.
        delays: By channel.
    """
    return measured_at(data, set(_later_by(data, equation, delays).values()))


def measured_at(data: Trajectories, later: Collection[float]) -> Bool[np.ndarray, " n_obs"]:
    """Rows that are inside their run so much later, too.

    Args:
        data: Measurements.
        later: Times.
    """
    inside = np.ones(data.n_obs, bool)
    for by in set(later) - {0.0}:
        for r in dict.fromkeys(data.run.tolist()):
            own = data.run == r
            time = data.time[own]
            inside[own] &= (time + by >= time[0]) & (time + by <= time[-1])
    return inside


def calibrated(
    data: Trajectories, equation: str, sizes: Mapping[ChannelSuspect, float], clock: Trajectories
) -> Trajectories:
    """The data with gains, offsets and drifts of channels taken out: x = (measured − o)/(1 + κ), and rates alike.

    Of a sensor that bends it is the x that it shows so, see `bends`.

    Args:
        data: Measurements with delays undone.
        equation: The studied state.
        sizes: By suspect, as found; delays are left alone.
        clock: Data that drifts were found on: their centre and span of time.
    """
    gains, offsets = {}, {}
    for suspect, size in sizes.items():
        if suspect.kind == GAIN:
            gains[suspect.channel] = size
        elif suspect.kind == OFFSET:
            offsets[suspect.channel] = offsets.get(suspect.channel, 0.0) + size
        elif suspect.kind == DRIFT:
            slope = size * (data.time - np.mean(clock.time)) / np.ptp(clock.time)
            offsets[suspect.channel] = offsets.get(suspect.channel, 0.0) + slope

    def part(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        # What was computed from samples is as much too large as they are, and has none of their offset.
        return {
            name: curve_of(sizes, _sensor(data, name), name).measured(x - offsets.get(name, 0.0))
            for name, x in columns.items()
        }

    if not any(suspect.kind != DELAY for suspect in sizes):
        return data
    own, one = data.target_label(equation), _one_sensor(data, equation)
    rates = {}
    for name, x in data.derivatives.items():
        gain = gains.get(one[0] if one else own, 0.0) if name == equation else 0.0
        rates[name] = (x - (offsets.get(own, 0.0) if name == equation else 0.0)) / (1.0 + gain)
    return replace(data, states=part(data.states), inputs=part(data.inputs), derivatives=rates)


def as_shown(
    paths: Float[np.ndarray, "n_draw n_obs"], name: str, data: Trajectories, sizes: Mapping[ChannelSuspect, float],
    clock: Trajectories,
) -> Float[np.ndarray, "n_draw n_obs"]:  # fmt: skip
    """What a state's sensor shows of paths, its curve at t − d, + o + drift: the inverse of `calibrated`.

    Args:
        paths: At the rows of the data; NaN where a path failed.
        name: Of the state.
        data: Rows.
        sizes: By suspect, as found.
        clock: Data that drifts were found on.
    """
    sensor = _sensor(data, name)
    own = {suspect.kind: size for suspect, size in sizes.items() if suspect.channel == sensor}
    if sensor != name:
        own = {GAIN: own.get(GAIN, 0.0)}
    late = late_by(data, sizes).get(name, 0.0)
    if late:
        paths = paths.copy()
        for r in dict.fromkeys(data.run.tolist()):
            rows = data.run == r
            for path in paths:
                if np.all(np.isfinite(path[rows])):
                    path[rows] = _later(data.time[rows], path[rows], -late)
    slope = own.get(DRIFT, 0.0) / np.ptp(clock.time) if DRIFT in own else 0.0
    shown = curve_of(sizes, sensor, name).shown(paths)
    return shown + own.get(OFFSET, 0.0) + slope * (data.time - np.mean(clock.time))


def curve_of(sizes: Mapping[ChannelSuspect, float], sensor: str, state: str = "") -> bends.Curve:
    """What a sensor shows of what it measures, beyond its offset.

    Args:
        sizes: By suspect, as found.
        sensor: State whose sensor it is: what was computed from samples has its gain.
        state: State that is shown; it alone bends.
    """
    gain = sum(size for suspect, size in sizes.items() if (suspect.kind, suspect.channel) == (GAIN, sensor))
    bending = [suspect for suspect in sizes if suspect.kind in bends.POWERS and suspect.channel == (state or sensor)]
    errors = {bends.POWERS[suspect.kind]: sizes[suspect] for suspect in bending}
    return bends.Curve(errors, bending[0].center if bending else 0.0, 1.0 + gain)


def late_by(data: Trajectories, sizes: Mapping[ChannelSuspect, float]) -> dict[str, float]:
    """How late each state and input is shown.

    Args:
        data: Measurements.
        sizes: By suspect, as found.
    """
    late = {suspect.channel: size for suspect, size in sizes.items() if suspect.kind == DELAY}
    found = {name: late.get(_sensor(data, name), 0.0) + late.get(STATES, 0.0) for name in data.state_names}
    found |= {name: late.get(name, 0.0) for name in data.input_names}
    return {name: by for name, by in found.items() if by}


def shifted(data: Trajectories, later: Mapping[str, float], clock: float = 0.0) -> Trajectories:
    """States and inputs as they are so much later, by cubic splines through the samples of each run.

    Args:
        data: Measurements.
        later: By state or input.
        clock: How much later it is then, for rates that depend on time.
    """
    columns: dict[str, np.ndarray] = {}
    for name, by in later.items():
        if by == 0.0:
            continue
        values = data.column(name)
        columns[name] = np.concatenate(
            [_later(data.time[data.run == r], values[data.run == r], by) for r in dict.fromkeys(data.run.tolist())]
        )
    return replace(
        data,
        time=data.time + clock,
        states={name: columns.get(name, x) for name, x in data.states.items()},
        inputs={name: columns.get(name, x) for name, x in data.inputs.items()},
    )


def driven_later(data: Trajectories, later: Mapping[str, float]) -> Trajectories:
    """Inputs as they are so much later, between their samples as a path takes them; before and after a run they hold.

    Args:
        data: Measurements.
        later: By input.
    """
    inputs = dict(data.inputs)
    for name, by in later.items():
        moved = inputs[name].copy()
        for r in dict.fromkeys(data.run.tolist()):
            own = data.run == r
            t, u = data.time[own], inputs[name][own]
            at = np.clip(t + by, t[0], t[-1])
            (kind,) = between_samples(t, u[:, None])
            moved[own] = CubicSpline(t, u)(at) if kind == "cubic" else np.interp(at, t, u)
        inputs[name] = moved
    return replace(data, inputs=inputs)


def _later_by(data: Trajectories, equation: str, delays: Mapping[str, float]) -> dict[str, float]:
    """How much later each state and input has to be taken."""
    one, states = _one_sensor(data, equation), delays.get(STATES, 0.0)
    own = delays.get(one[0] if one else data.target_label(equation), 0.0)
    if one:
        # The rate is late with its samples: what others show is taken earlier.
        later = {name: 0.0 if name in one else delays.get(name, 0.0) - own for name in data.state_names}
        return later | {name: delays.get(name, 0.0) - own - states for name in data.input_names}
    later = {name: states + delays.get(name, 0.0) - own for name in data.state_names}
    return later | {name: delays.get(name, 0.0) - own for name in data.input_names}


def _one_sensor(data: Trajectories, equation: str) -> tuple[str, ...]:
    """States of the samples that the rate was computed from, see `RateFilter.one_sensor`."""
    return data.filter.one_sensor(equation) if data.filter is not None else ()


def _sensor(data: Trajectories, state: str) -> str:
    """The state whose samples one is of."""
    return data.filter.source(state) if data.filter is not None else state


def _zero(data: Trajectories, name: str) -> ChannelSuspect:
    """An offset of the sensor of a state or an input."""
    return ChannelSuspect(OFFSET, name, ZERO_SD * float(np.sqrt(np.mean(data.column(name) ** 2))))


def _later(time: np.ndarray, values: np.ndarray, by: float) -> np.ndarray:
    if len(time) < 4:
        return values
    return CubicSpline(time, values)(time + by)


def _moved(data: Trajectories, name: str, by: np.ndarray) -> Trajectories:
    def part(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {k: x + by if k == name else x for k, x in columns.items()}

    return replace(data, states=part(data.states), inputs=part(data.inputs))
