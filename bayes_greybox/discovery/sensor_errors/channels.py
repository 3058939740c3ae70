"""Errors of the channels of a measurement: a delay, a gain or an offset of the rate, of states and of inputs.

A channel that is late by d, has a gain 1 + κ or an offset o is, to first order, a column beside the effects:

    rate late      −d · dG/dt              states late    d · Σ_k ∂G/∂x_k ẋ_k         input late   d · ∂G/∂u u̇
    rate gain       κ · G                  state, input gain   −κ · ∂G/∂x_k x_k
    rate offset     o                      state offset        −o · ∂G/∂x_k
    rate drift      o · (t − t̄) / range

with G the whole modelled rate, the terms found missing so far included. G is followed by central differences along the
measured path, one-sided beside a leap of an input, so that any simulation serves. A delay is undone in the
data and its column taken anew there, until it moves no more: the delay that is reported is not first order.

A rate that a filter computed has no sensor of its own. It is late, and reads too large, together with the samples that
it was computed from and with all states S of the same sensor; a constant in the samples leaves the rate as it is:

    sensor late   −d · (Σ ∂G/∂z ż + ∂G/∂t), z all states and inputs but S        gain   κ · (G − Σ_S ∂G/∂x_k x_k)

The slope of such a state is that very rate, noise and all: were the state late alone, the rate would explain itself.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import CubicSpline

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.integration.adaptive_steps import between_samples

from .bends import BEND_ERRORS, BEND_POWERS, BEND_SD, Curve
from .leaps import beside_leaps

DELAY, GAIN, OFFSET, DRIFT, NOISE = ("delay", "gain", "offset", "drift", "noise")

DEPARTURE = "departure"
"""Whatever a state's samples have that the integral of its rate, or the slope of its position, does not."""

ERRORS = (DELAY, GAIN, OFFSET, DRIFT, NOISE, DEPARTURE, *BEND_ERRORS)
"""Kinds of errors of a channel."""

STATES = "states"
"""Channel that stands for all states together."""

DELAY_STEPS, GAIN_SD, OFFSET_SD, ZERO_SD = 2.0, 0.03, 0.03, 0.1
"""Prior standard deviations of a delay, in sampling steps; of a relative gain error; of an offset or drift of a rate,
over its RMS; of the zero of a state's or an input's sensor, over the RMS of its channel."""

AtRows = Float[np.ndarray, " n_obs"]

Rate = Callable[[Trajectories], AtRows]
"""The whole modelled rate G on the rows of some data."""


@dataclass(frozen=True)
class ChannelSuspect:
    """One error of one channel: the rate ("d(x)/dt"), a state, an input or an output, or `STATES`.

    `sd` is the prior standard deviation of its size, `center` the middle of a bend, see `bends`, `expected` its
    size if it is there, and `sure` a name that it shares with other errors, of which one at least is there.
    """

    kind: str
    channel: str
    sd: float
    step: float = 1.0
    center: float = 0.0
    expected: float = 0.0
    sure: str = ""

    @property
    def key(self) -> str:
        """Return the name for tables."""
        return f"{self.kind} of {self.channel}"


Sizes = Mapping[ChannelSuspect, float]
"""Sizes of errors; a delay is positive where its channel is late."""

ErrorColumns = list[tuple[ChannelSuspect, Float[np.ndarray, " n"]]]
"""Errors with their columns per unit of their size."""


def fault_kind(name: str) -> str:
    """Return the kind of a sensor error, one of `ERRORS`, from its key ("offset of y"); "" for a slug."""
    kind, _, channel = name.partition(" of ")
    return kind if channel and kind in ERRORS else ""


def run_slices(run: np.ndarray) -> list[slice]:
    """Return the rows of each run, which stand one after the other."""
    edges = [0, *(np.flatnonzero(np.diff(run)) + 1).tolist(), len(run)]
    return [slice(start, end) for start, end in pairwise(edges)]


def suspect_columns(data: Trajectories, equation: str, rate: Rate) -> ErrorColumns:
    """Return every error with its column: the change of the measured rate per unit of its size."""
    inside = np.diff(data.time)[np.diff(data.run) == 0]
    step = float(np.median(inside)) if len(inside) else 1.0
    label, shift = data.target_label(equation), step / 4
    states, inputs, same_sensor = data.state_names, data.input_names, _one_sensor(data, equation)
    apart = tuple(name for name in states if name not in same_sensor)

    def delay(channel: str, names: tuple[str, ...], early: bool = False) -> tuple[ChannelSuspect, np.ndarray]:
        """Return a delay with its column: other channels are taken later or, if `early`, earlier with the clock of G.

        An input that leaps goes in straight lines, with a kink at each sample: beside a leap the column of a delay
        above zero is not that of one below. It is whichever explains more of what G lacks.
        """
        ahead, behind = (rate(shifted(data, dict.fromkeys(names, by), by if early else 0.0)) for by in (shift, -shift))
        bent = np.any([kinks[name] for name in names if name in kinks], axis=0)
        both = (ahead - behind) / (2 * shift)
        above, below = np.where(bent, (ahead - G) / shift, both), np.where(bent, (G - behind) / shift, both)
        late, soon = (-below, -above) if early else (above, below)
        lacking = data.rate(equation) - G
        gains = [max(float(lacking @ each), 0.0) ** 2 / max(float(each @ each), 1e-300) for each in (late, -soon)]
        return delay_error(channel, step), late if gains[0] >= gains[1] else soon

    def slope(name: str, direction: np.ndarray) -> np.ndarray:
        return slope_along(data, rate, name, direction)

    def zero(name: str) -> tuple[ChannelSuspect, np.ndarray]:
        return zero_error(data, name), -slope(name, ones)

    G, ones, kinks = rate(data), np.ones(data.n_obs), {name: _kinks(data, name) for name in inputs}
    if same_sensor:
        sensor = same_sensor[0]
        columns = [*(delay(u, (u,)) for u in inputs), delay(STATES, inputs, early=True)]
        if apart:
            columns.append(delay(sensor, (*apart, *inputs), early=True))
        gained = G - sum(slope(x, data.column(x)) for x in same_sensor)
        columns += [(gain_error(sensor), gained), zero(sensor)]
    else:
        columns = [delay(label, (*states, *inputs), early=True)]
        if inputs:
            columns += [delay(STATES, states), *(delay(u, (u,)) for u in inputs)]
        size, span = float(np.sqrt(np.mean(G**2))), float(np.ptp(data.time))
        offset = ChannelSuspect(OFFSET, label, OFFSET_SD * size)
        columns += [(gain_error(label), G), (offset, ones)]
        if span > 0:
            columns.append((replace(offset, kind=DRIFT), (data.time - np.mean(data.time)) / span))
    for name in (*apart, *inputs):
        columns += [(gain_error(name), -slope(name, data.column(name))), zero(name)]
    if len(states) > 1:
        # Last: of errors with one and the same column the first stands, and this is the oddest one.
        columns += [delay(x, (x,)) for x in apart]
    return with_column(columns)


def with_column(columns: ErrorColumns) -> ErrorColumns:
    """Return the errors whose columns are finite and not zero."""
    return [(error, column) for error, column in columns if np.all(np.isfinite(column)) and np.any(column != 0)]


def delay_error(channel: str, step: float) -> ChannelSuspect:
    """Return the delay of a channel that is sampled at a step."""
    return ChannelSuspect(DELAY, channel, DELAY_STEPS * step, step)


def gain_error(channel: str) -> ChannelSuspect:
    """Return the gain of a channel."""
    return ChannelSuspect(GAIN, channel, GAIN_SD)


def zero_error(data: Trajectories, name: str) -> ChannelSuspect:
    """Return the offset of the sensor of a state or an input."""
    return ChannelSuspect(OFFSET, name, ZERO_SD * float(np.sqrt(np.mean(data.column(name) ** 2))))


def bend_errors(name: str, values: AtRows) -> list[ChannelSuspect]:
    """Return the bends of a sensor over the range of its values; none if that is a point."""
    low, high = float(np.min(values)), float(np.max(values))
    # A tank that starts empty passes zero as well, whatever the noise says.
    margin = 0.2 * (high - low)
    center = 0.0 if low < margin and high > -margin else 0.5 * (low + high)
    furthest = max(high - center, center - low)
    if not high > low:
        return []
    return [
        ChannelSuspect(kind, name, BEND_SD / furthest ** (power - 1), center=center)
        for kind, power in BEND_POWERS.items()
    ]


def slope_along(data: Trajectories, rate: Rate, name: str, direction: AtRows) -> AtRows:
    """Return ∂G/∂name along a direction, its move at each row per unit, by central differences."""
    values = data.column(name)
    size, largest = float(np.sqrt(np.mean(values**2))), float(np.max(np.abs(direction)))
    h = 1e-4 * size / largest if size > 0 and largest > 0 else 1e-4
    up, down = (rate(with_columns(data, {name: values + side * h * direction})) for side in (1, -1))
    return (up - down) / (2 * h)


def with_columns(data: Trajectories, columns: Mapping[str, np.ndarray]) -> Trajectories:
    """Return the data with other values of some states and inputs."""
    return replace(
        data,
        states={name: columns.get(name, x) for name, x in data.states.items()},
        inputs={name: columns.get(name, x) for name, x in data.inputs.items()},
    )


def nearer(data: Trajectories, sizes: Sizes, kind: str, better: Callable[[ChannelSuspect], AtRows]) -> Trajectories:
    """Return channels with an error of a kind nearer to better values, by as large a share as on the training data."""
    moved = {}
    for error, size in sizes.items():
        if error.kind == kind:
            values = data.column(error.channel)
            moved[error.channel] = values + np.clip(size / error.sd, 0.0, 1.0) * (better(error) - values)
    return with_columns(data, moved) if moved else data


def undone(data: Trajectories, equation: str, delays: Mapping[str, float]) -> Trajectories:
    """Return the data with states and inputs at the times that the measured rate belongs to."""
    if not any(delays.values()):
        return data
    same_sensor = _one_sensor(data, equation)
    late = {same_sensor[0], STATES} if same_sensor else {data.target_label(equation)}
    return shifted(data, _later_by(data, equation, delays), -sum(delays.get(name, 0.0) for name in late))


def within(data: Trajectories, equation: str, delays: Mapping[str, float]) -> Bool[np.ndarray, " n_obs"]:
    """Return true for rows whose states and inputs are still inside their run once delays are undone."""
    return measured_at(data, set(_later_by(data, equation, delays).values()))


def measured_at(data: Trajectories, later: Collection[float]) -> Bool[np.ndarray, " n_obs"]:
    """Return true for rows that are inside their run at each of some later times, too."""
    inside = np.ones(data.n_obs, bool)
    for rows in run_slices(data.run):
        time = data.time[rows]
        for by in set(later) - {0.0}:
            inside[rows] &= (time + by >= time[0]) & (time + by <= time[-1])
    return inside


def calibrated(data: Trajectories, equation: str, sizes: Sizes, clock: Trajectories) -> Trajectories:
    """Return the data without gains, offsets, drifts and bends of channels, x = (measured − o)/(1 + κ); delays stay."""
    if all(error.kind == DELAY for error in sizes):
        return data
    gains, offsets = {}, {}
    for error, size in sizes.items():
        if error.kind == GAIN:
            gains[error.channel] = size
        elif error.kind in (OFFSET, DRIFT):
            slope = (data.time - np.mean(clock.time)) / np.ptp(clock.time) if error.kind == DRIFT else 1.0
            offsets[error.channel] = offsets.get(error.channel, 0.0) + size * slope
    # A state computed from samples has their gain, and none of their offset.
    curves = {name: curve_of(sizes, _sensor(data, name), name) for name in data.columns}
    columns = {name: curves[name].measured(x - offsets.get(name, 0.0)) for name, x in data.columns.items()}
    label, rates, same_sensor = data.target_label(equation), dict(data.derivatives), _one_sensor(data, equation)
    if equation in rates:
        gain = gains.get(same_sensor[0] if same_sensor else label, 0.0)
        rates[equation] = (rates[equation] - offsets.get(label, 0.0)) / (1.0 + gain)
    return replace(with_columns(data, columns), derivatives=rates)


def as_shown(
    paths: Float[np.ndarray, "n_draw n_obs"], name: str, data: Trajectories, sizes: Sizes, clock: Trajectories
) -> Float[np.ndarray, "n_draw n_obs"]:
    """Return a state's readings along paths, its sensor's curve at t − d, + o + drift: the inverse of `calibrated`."""
    sensor = _sensor(data, name)
    by_kind = {error.kind: size for error, size in sizes.items() if error.channel == sensor} if sensor == name else {}
    late = late_by(data, sizes).get(name, 0.0)
    if late:
        paths = paths.copy()
        for rows in run_slices(data.run):
            for path in paths:
                if np.all(np.isfinite(path[rows])):
                    path[rows] = _later(data.time[rows], path[rows], -late)
    slope = by_kind.get(DRIFT, 0.0) / np.ptp(clock.time) if DRIFT in by_kind else 0.0
    shown = curve_of(sizes, sensor, name).shown(paths)
    return shown + by_kind.get(OFFSET, 0.0) + slope * (data.time - np.mean(clock.time))


def curve_of(sizes: Sizes, sensor: str, state: str = "") -> Curve:
    """Return the curve of a state's sensor beyond its offset; a state computed from its samples has the gain alone."""
    gain = sum(size for error, size in sizes.items() if (error.kind, error.channel) == (GAIN, sensor))
    bending = [error for error in sizes if error.kind in BEND_POWERS and error.channel == (state or sensor)]
    errors = {BEND_POWERS[error.kind]: sizes[error] for error in bending}
    return Curve(errors, bending[0].center if bending else 0.0, 1.0 + gain)


def delays_of(sizes: Sizes) -> dict[str, float]:
    """Return the delays among errors, by channel."""
    return {error.channel: size for error, size in sizes.items() if error.kind == DELAY}


def late_by(data: Trajectories, sizes: Sizes) -> dict[str, float]:
    """Return the delay of each state and input that is late."""
    late = delays_of(sizes)
    delays = {name: late.get(_sensor(data, name), 0.0) + late.get(STATES, 0.0) for name in data.state_names}
    delays |= {name: late.get(name, 0.0) for name in data.input_names}
    return {name: by for name, by in delays.items() if by}


def shifted(data: Trajectories, later: Mapping[str, float], clock: float = 0.0) -> Trajectories:
    """Return states and inputs at later times, and on beyond the ends of runs by splines.

    Inputs go as a path takes them between their samples, and keep their last value after a run, their first before it;
    but one that jumps has there the value of more than half of its samples, if that is nearer to zero and nothing was
    cut off.
    """
    columns, first = {}, data.before is None
    for name, by in later.items():
        parts = [(data.time[rows], data.column(name)[rows]) for rows in run_slices(data.run)]
        if by != 0.0 and name in data.inputs:
            columns[name] = np.concatenate([_driven_later(t, u, by, first) for t, u in parts])
        elif by != 0.0:
            columns[name] = np.concatenate([_later(t, x, by) for t, x in parts])
    return replace(with_columns(data, columns), time=data.time + clock)


def _later_by(data: Trajectories, equation: str, delays: Mapping[str, float]) -> dict[str, float]:
    same_sensor, states = _one_sensor(data, equation), delays.get(STATES, 0.0)
    rate_delay = delays.get(same_sensor[0] if same_sensor else data.target_label(equation), 0.0)
    later = {name: delays.get(name, 0.0) - rate_delay for name in (*data.state_names, *data.input_names)}
    # A rate that is late with its samples has all other channels taken earlier.
    moved = data.input_names if same_sensor else data.state_names
    later |= {name: later[name] + (-states if same_sensor else states) for name in moved}
    return later | dict.fromkeys(same_sensor, 0.0)


def _one_sensor(data: Trajectories, equation: str) -> tuple[str, ...]:
    """Return the states of the samples that the rate was computed from, see `RateFilter.one_sensor`."""
    return data.filter.one_sensor(equation) if data.filter is not None else ()


def _sensor(data: Trajectories, state: str) -> str:
    return data.filter.source(state) if data.filter is not None else state


def _kinks(data: Trajectories, name: str) -> Bool[np.ndarray, " n_obs"]:
    """Return true for samples beside a leap of an input, where that goes in lines."""
    parts = [(data.time[rows], data.inputs[name][rows]) for rows in run_slices(data.run)]
    return np.concatenate([beside_leaps(u) & (between_samples(t, u[:, None]) != ("cubic",)) for t, u in parts])


def _driven_later(time: np.ndarray, values: np.ndarray, by: float, first: bool) -> np.ndarray:
    at = time + by
    (kind,) = between_samples(time, values[:, None])
    if kind == "cubic":
        return CubicSpline(time, values)(np.clip(at, time[0], time[-1]))
    levels, count = np.unique(values, return_counts=True)
    common = levels[np.argmax(count)]
    # A pump that stands still for most of a run stood still before it, too; one that works may have begun with it.
    rests = first and 2 * np.max(count) > len(values) and abs(common) < abs(values[0])
    before = time[0] - np.median(np.diff(time)) if len(time) > 1 else time[0]
    return np.interp(at, [before, *time], [common if rests else values[0], *values])


def _later(time: np.ndarray, values: np.ndarray, by: float) -> np.ndarray:
    return CubicSpline(time, values)(time + by) if len(time) >= 4 else values
