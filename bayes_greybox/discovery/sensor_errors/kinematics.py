"""Errors of a state, or of the state that is its rate, by their samples alone and without any model.

A position is the integral of its speed. Within a window of length T its departure is x(t + T) − x(t) − ∫ v dt. If the
position is d late, that is −d times the change of the speed over the window; if its sensor bends, the change of
a (x − c)² + b (x − c)³; if the speed's does, minus the integral of its own bend. The rate of the speed may hardly tell
such an error from a wrong damping, or from a spring that hardens; these samples do. A departure that neither explains,
as by the play of a follower, is weighed with the model, as an error of the position or of the speed.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, combinations
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.stats import chi2

from bayes_greybox.data.runs.resampling import running_integral
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.grid.sets import SURELY_WRONG
from bayes_greybox.physics.simulation.protocol import Simulation

from . import channels
from .bends import BEND_POWERS
from .channels import ChannelSuspect, Sizes
from .samples import LARGEST_NOISE

WINDOW_STEPS = 10
"""Length of a window in steps. Noise of the state enters at its two ends alone, noise of the rate at every step."""

FURTHEST, FEWEST_WINDOWS = 3.0, 5
"""Largest error that is looked for, in prior standard deviations, and least number of windows that say anything."""

FIT_STEPS, NUDGE = 4, 1e-4
"""Steps of the fit of an error's size, and the nudge that its slopes are taken by, in prior standard deviations."""

Item = TypeVar("Item")


@dataclass(frozen=True)
class KnownError:
    """Size of a sensor's error with its standard deviation, and the p-value of the samples as they came."""

    suspect: ChannelSuspect
    size: float
    sd: float
    p: float


def known_errors(
    data: Trajectories, simulation: Simulation, noise: Mapping[str, float]
) -> dict[ChannelSuspect, KnownError]:
    """Return the sensor errors whose removal makes a state agree with the integral of its rate, if it did not before.

    Of a delay of the state and bends of either, each beside gains and an offset of the rate or without, it is the one
    of the largest evidence. Bends are not looked for where a filter computed the rates, which have the same bend.
    """
    found: dict[ChannelSuspect, KnownError] = {}
    rates = {pair.state: pair.rate for pair in _pairs(data, simulation, noise)}

    def depth(state: str) -> int:
        count = 0
        # Two states may be the rate of each other.
        while state in rates and count < len(rates):
            state, count = rates[state], count + 1
        return count

    # A speed is right before the position that it is the rate of is judged.
    for name in sorted(rates, key=depth):
        for pair in _pairs(free_of(data, sizes_of(found)), simulation, noise):
            if pair.state == name and pair.reason is not None:
                before = pair.p(pair.as_shown)
                each = zip(pair.reason.errors, pair.reason.sizes, pair.reason.sds, strict=True)
                found |= {error: KnownError(error, size, sd, before) for error, size, sd in each}
    return found


def free_of(data: Trajectories, sizes: Sizes) -> Trajectories:
    """Return the data without delays and bends of states."""
    late = channels.delays_of(sizes)
    data = channels.shifted(data, late) if late else data
    bent = {error.channel for error in sizes if error.kind in BEND_POWERS}
    return channels.with_columns(
        data, {name: channels.curve_of(sizes, name).measured(data.column(name)) for name in bent}
    )


def departing(
    data: Trajectories, simulation: Simulation, noise: Mapping[str, float]
) -> dict[ChannelSuspect, Float[np.ndarray, " n_obs"]]:
    """Return, for each state that disagrees with its pair for no known reason, the values that the other one implies.

    The prior standard deviation is the RMS of the departure; one too large for a sensor is left out.
    """
    found: dict[str, tuple[ChannelSuspect, np.ndarray]] = {}
    for pair in _pairs(data, simulation, noise):
        for name, better in ((pair.state, _followed), (pair.rate, _sloped)) if pair.reason is None else ():
            values, right = data.states[name], better(data, pair.state, pair.rate)
            size = float(np.sqrt(np.mean((right - values) ** 2)))
            if size < LARGEST_NOISE * np.std(values):
                found.setdefault(name, (ChannelSuspect(channels.DEPARTURE, name, size), right))
    return dict(found.values())


def disagreeing(data: Trajectories, simulation: Simulation, noise: Mapping[str, float]) -> dict[str, ChannelSuspect]:
    """Return, by their keys, errors of which one at least is there: gains of a state and of its rate that do not agree.

    x₁ − x₀ = (1 + γ) ∫ v dt + o T: the state's gain is γ, or the rate's 1/(1 + γ) − 1; the rate has the offset
    −o/(1 + γ), or the state drifts by o times the time. The samples cannot tell which. A gain or an offset is sure if
    every reason without it is at least a million times less likely. Rates that a filter computed have the same gain.
    """
    found: dict[str, ChannelSuspect] = {}
    span = float(np.ptp(data.time))
    for pair in _pairs(data, simulation, noise) if data.filter is None else ():
        sizes, errors = pair.plain_sizes, []
        ratio, offset = 1.0 + sizes.get(channels.GAIN, 0.0), sizes.get(channels.OFFSET, 0.0)
        # One that does not move with the other has no gain.
        if not chi2.sf(ratio**2 / pair.ratio_variance, 1) < SURELY_WRONG:
            continue
        if channels.GAIN in sizes:
            errors += [(channels.GAIN, pair.state, ratio - 1.0), (channels.GAIN, pair.rate, 1.0 / ratio - 1.0)]
        if channels.OFFSET in sizes:
            errors += [(channels.OFFSET, pair.rate, -offset / ratio), (channels.DRIFT, pair.state, offset * span)]
        for kind, name, size in errors:
            sure = f"{channels.GAIN if kind == channels.GAIN else channels.OFFSET} of {pair.state} and {pair.rate}"
            sd = max(abs(size), channels.GAIN_SD if kind == channels.GAIN else 0.0)
            error = ChannelSuspect(kind, name, sd, expected=size, sure=sure)
            found.setdefault(error.key, error)
    return found


def without_departures(data: Trajectories, simulation: Simulation, sizes: Sizes) -> Trajectories:
    """Return states nearer to what the other of their pair says, by as large a share as on the training data."""

    def better(error: ChannelSuspect) -> np.ndarray:
        state, rate = pair_of(simulation, error.channel, data.state_names)
        return (_followed if error.channel == state else _sloped)(data, state, rate)

    return channels.nearer(data, sizes, channels.DEPARTURE, better)


def pair_of(simulation: Simulation, name: str, states: Sequence[str]) -> tuple[str, str]:
    """Return the state and the rate of a channel's pair; of two pairs, that in which it is the state."""
    rates = {each: simulation.rate_name(each) for each in (name, *states)}
    state = next(each for each, rate in rates.items() if rate in states and name in (each, rate))
    return state, str(rates[state])


def _followed(data: Trajectories, state: str, rate: str) -> Float[np.ndarray, " n_obs"]:
    """Return a state as the integral of its rate, whose start and whose offset fit its samples best."""
    parts = []
    for rows in channels.run_slices(data.run):
        time, x = data.time[rows], data.states[state][rows]
        if len(time) > 1:
            departure = x - running_integral(time, data.states[rate][rows])
            x = x - departure + np.polynomial.Polynomial.fit(time, departure, 1)(time)
        parts.append(x)
    return np.concatenate(parts)


def _sloped(data: Trajectories, state: str, rate: str) -> Float[np.ndarray, " n_obs"]:
    """Return a rate as the slope of its state, by the cubic spline through the samples."""
    parts = [
        (data.time[rows], data.states[state][rows], data.states[rate][rows]) for rows in channels.run_slices(data.run)
    ]
    return np.concatenate([CubicSpline(t, x)(t, 1) if len(t) > 1 else v for t, x, v in parts])


def sizes_of(errors: Mapping[ChannelSuspect, KnownError]) -> dict[ChannelSuspect, float]:
    """Return the sizes of errors that are known."""
    return {suspect: error.size for suspect, error in errors.items()}


def in_step(data: Trajectories, simulation: Simulation, noise: Mapping[str, float]) -> dict[str, float]:
    """Return, by name, the standard deviation of the delay between a state and its rate, for pairs that agree."""
    spreads: dict[str, float] = {}
    for pair in _pairs(data, simulation, noise):
        if pair.gained > 0 and pair.p(pair.as_shown) >= SURELY_WRONG:
            sd = float(np.sqrt(pair.variance / pair.gained))
            spreads |= {each: min(sd, spreads.get(each, sd)) for each in (pair.state, pair.rate)}
    return spreads


def _pairs(data: Trajectories, simulation: Simulation, noise: Mapping[str, float]) -> Iterator["_Pair"]:
    """Yield the pairs of a state and its rate that have a sensor each; what was computed has none."""
    for name in data.state_names:
        rate = simulation.rate_name(name)
        if rate is None or rate not in data.state_names or {name, rate} & {*data.computed}:
            continue
        if data.filter is not None and data.filter.source(rate) == data.filter.source(name):
            continue
        runs = [rows for rows in channels.run_slices(data.run) if rows.stop - rows.start > 3 * WINDOW_STEPS]
        paths = [_Path(data.time[rows], data.states[name][rows], data.states[rate][rows]) for rows in runs]
        if sum(len(path.start) for path in paths) >= FEWEST_WINDOWS:
            yield _Pair(name, rate, paths, noise.get(name, 0.0), noise.get(rate, 0.0), data.filter is None)


class _Path:
    """Windows of one run, without those that a shift would move past its ends."""

    def __init__(self, time: np.ndarray, x: np.ndarray, v: np.ndarray) -> None:
        self.time, self.x, self.v = time, x, v
        margin = int(np.ceil(FURTHEST * channels.DELAY_STEPS)) + 1
        self.start = np.arange(margin, len(time) - WINDOW_STEPS - margin, WINDOW_STEPS)
        self.end = self.start + WINDOW_STEPS
        self.spline = CubicSpline(time, x)

    def change(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n_window"]:
        return values[self.end] - values[self.start]

    def integral(self, rate: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n_window"]:
        return self.change(running_integral(self.time, rate))


class _Pair:
    """Pair of a state and the state that is its rate, with the windows of their runs."""

    def __init__(self, state: str, rate: str, paths: list[_Path], noise: float, rate_noise: float, bends: bool) -> None:
        self.state, self.rate, self.paths, self._bends = state, rate, paths, bends
        self.step = float(np.median(np.concatenate([np.diff(path.time) for path in paths])))
        changes = np.concatenate([path.change(path.x) for path in paths])
        shown = 2 * noise**2 + WINDOW_STEPS * (rate_noise * self.step) ** 2
        # Variance of a departure.
        # Sensors that are right agree to within a hundredth of a state's changes.
        self.variance = shown + 0.01**2 * float(np.mean(changes**2)) + np.finfo(float).tiny
        self.gained = float(sum(np.sum(path.change(path.v) ** 2) for path in paths))
        # The gain of either, and the offset of the rate: they are weighed with the model.
        integral = np.concatenate([path.integral(path.v) for path in paths])
        self._plain = {
            channels.GAIN: integral,
            channels.OFFSET: np.concatenate([path.change(path.time) for path in paths]),
        }

    def departures(self, sizes: Sizes) -> Float[np.ndarray, " n"]:
        by = channels.delays_of(sizes).get(self.state, 0.0)
        of_state, of_rate = (channels.curve_of(sizes, name) for name in (self.state, self.rate))
        parts = []
        for path in self.paths:
            x = path.spline(path.time + by) if by else path.x
            ends = np.concatenate([path.start, path.end])
            start, end = np.split(of_state.measured(x[ends]), 2)
            parts.append(end - start - path.integral(of_rate.measured(path.v)))
        return np.concatenate(parts)

    @cached_property
    def as_shown(self) -> Float[np.ndarray, " n"]:
        return self.departures({})

    def p(self, departures: Float[np.ndarray, " n"], fitted: int = 0) -> float:
        """Return the p-value of departures after so many numbers were fitted to them."""
        return float(chi2.sf(np.sum(departures**2) / self.variance, max(len(departures) - fitted, 1)))

    @cached_property
    def reason(self) -> "_Reason | None":
        """Likeliest of the reasons that suffice for the departures, if these need one; None where none suffices."""
        # An error is known if its odds over gains and an offset alone are beyond one over that p-value.
        surely = min(each.cost for each in self._every if not each.errors) + 2 * np.log(SURELY_WRONG)
        enough = [each for each in self._every if each.p >= SURELY_WRONG and (not each.errors or each.cost < surely)]
        return min(enough, key=lambda each: each.cost, default=None)

    @property
    def ratio_variance(self) -> float:
        """Return the variance of the state's changes over the integrals of its rate."""
        return self.variance / max(float(np.sum(self._plain[channels.GAIN] ** 2)), np.finfo(float).tiny)

    @property
    def plain_sizes(self) -> dict[str, float]:
        """Return the gain and the offset that no reason does without, as the likeliest reason has them."""
        if self.reason is None or self.p(self.as_shown) >= SURELY_WRONG:
            return {}
        surely, sizes = self.reason.cost - 2 * np.log(SURELY_WRONG), {}
        for name, size in zip(self.reason.plain, self.reason.plain_sizes, strict=True):
            if min(each.cost for each in self._every if name not in each.plain) > surely:
                sizes[name] = size
        return sizes

    @cached_property
    def _every(self) -> list["_Reason"]:
        return [self._fitted(errors, plain) for errors in self._candidates() for plain in self._beside(errors)]

    def _candidates(self) -> Iterator[Sequence[ChannelSuspect]]:
        yield ()
        if self.p(self.as_shown) >= SURELY_WRONG:
            return
        yield (channels.delay_error(self.state, self.step),)
        x, v = (np.concatenate([getattr(path, name) for path in self.paths]) for name in ("x", "v"))
        for name, values in ((self.state, x), (self.rate, v)) if self._bends else ():
            yield from (bends for bends in _subsets(channels.bend_errors(name, values)) if bends)

    def _beside(self, errors: Sequence[ChannelSuspect]) -> Sequence[tuple[str, ...]]:
        """Return the sets of plain errors to fit errors beside: beside bends, which are nearly linear, the best one."""
        every = list(_subsets(self._plain))
        if not errors or errors[0].kind == channels.DELAY:
            return every
        residual = self.as_shown
        slopes = [(self.departures({error: NUDGE * error.sd}) - residual) / NUDGE for error in errors]

        def cost(plain: Sequence[str]) -> float:
            table = np.column_stack([*slopes, *(self._plain[name] for name in plain)])
            left = residual - table @ np.linalg.lstsq(table, residual, rcond=None)[0]
            return float(np.sum(left**2)) / self.variance + table.shape[1] * np.log(len(left))

        return [min(every, key=cost)]

    def _fitted(self, errors: Sequence[ChannelSuspect], plain: Sequence[str]) -> "_Reason":
        """Return errors with their sizes beside plain ones, by Gauss and Newton's steps."""
        scale, root = np.array([error.sd for error in errors]), np.sqrt(self.variance)
        beside = [self._plain[name] / root for name in plain]
        sizes, k = np.zeros(len(errors)), len(errors) + len(plain)

        def residual_at(z: np.ndarray) -> np.ndarray:
            return self.departures(dict(zip(errors, z * scale, strict=True))) / root

        def solved(z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            """Return the step of all sizes, what it leaves, and the slopes."""
            residual = residual_at(z)
            slopes = [(residual_at(z + h) - residual) / NUDGE for h in NUDGE * np.eye(len(errors))]
            table = np.column_stack([*slopes, *beside]) if k else np.zeros((len(residual), 0))
            step = -np.linalg.lstsq(table, residual, rcond=None)[0]
            return step, residual + table @ step, table

        for _ in range(FIT_STEPS if errors else 0):
            sizes = np.clip(sizes + solved(sizes)[0][: len(errors)], -FURTHEST, FURTHEST)
        step, residual, table = solved(sizes)
        covariance = np.linalg.pinv(table.T @ table)
        # At its limit no size is the right one.
        inside = bool(np.all(np.abs(sizes) < 0.95 * FURTHEST))
        square, n = float(np.sum(residual**2)), len(residual)
        # The residual is no white noise where samples are exact: sensors agree to within what they are trusted to.
        sds = scale * np.sqrt(np.diag(covariance)[: len(errors)] * max(square / max(n - k, 1), 1.0))
        p = self.p(residual * root, k) if inside else 0.0
        beside_sizes = (-step[len(errors) :]).tolist()
        cost = square + k * np.log(n)
        return _Reason(tuple(errors), (sizes * scale).tolist(), sds.tolist(), p, cost, tuple(plain), beside_sizes)


class _Reason(NamedTuple):
    """Errors of one sensor, with sizes, standard deviations, p-value, and −2 log evidence (Schwarz 1978) as cost.

    Beside them x₁ − x₀ = (1 + gain) ∫ v dt + offset T, whichever of the two is in `plain`, with `plain_sizes`.
    """

    errors: tuple[ChannelSuspect, ...]
    sizes: list[float]
    sds: list[float]
    p: float
    cost: float
    plain: tuple[str, ...] = ()
    plain_sizes: Sequence[float] = ()


def _subsets(items: Iterable[Item]) -> Iterator[tuple[Item, ...]]:
    every = tuple(items)
    return chain.from_iterable(combinations(every, count) for count in range(len(every) + 1))
