"""Errors of a state, or of the state that is its rate, by their samples alone and without any model.

A position is the integral of its speed. One that is shown d later departs from it, x(t + T) − x(t) − ∫ v dt, by the
speed's gain within T times d; one whose sensor bends by a (x − c)² + b (x − c)³ departs by the change of that, and a
bent speed by the integral of its own. The rate of the speed may hardly tell such an error from a wrong damping, or from
a spring that hardens; these samples do. What has no such reason, as the play of a follower, is an error of the position
where the rate of the speed moves with it; its shape is known, x − ∫ v dt less a straight line.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.stats import chi2

from bayes_greybox.data.runs.resampling import running_integral
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.simulation.protocol import Simulation

from .channels import (
    DELAY_STEPS,
    DEPARTURE,
    ChannelSuspect,
    Sizes,
    bend_errors,
    curve_of,
    delay_error,
    delays_of,
    run_slices,
)

WINDOW_STEPS = 10
"""Steps of a window: noise on samples counts twice in it, whatever its length, and the rate counts for all of it."""

AGREEING = 0.01
"""Sensors that are right agree to within this share of the RMS of a state's changes."""

FURTHEST, FEWEST_WINDOWS = 3.0, 5
"""Largest error that is looked for, in prior standard deviations, and least number of windows that say anything."""

SURELY_WRONG = 1e-6
"""p-value below which departures need a reason. An error is that reason if it brings the p-value back above."""


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
    """Return the errors without which the samples of states follow those of their rates, as they did not as they came.

    Of the reasons that suffice, a delay of the state and a bend of either, the one of the largest evidence.
    """
    found: dict[ChannelSuspect, KnownError] = {}
    for pair in _measured_pairs(data, simulation, noise):
        found |= {error.suspect: error for error in pair.reason()}
    return found


def departing(
    data: Trajectories, simulation: Simulation, noise: Mapping[str, float]
) -> dict[ChannelSuspect, Float[np.ndarray, " n_obs"]]:
    """Return the states that depart from the integral of their rates without a known reason, as that integral has them.

    The prior standard deviation of such an error is the RMS of the departure.
    """
    found = {}
    for pair in _measured_pairs(data, simulation, noise):
        if pair.p(pair.departures({})) < SURELY_WRONG:
            followed = _followed(data, pair.state, pair.rate)
            size = float(np.sqrt(np.mean((followed - data.states[pair.state]) ** 2)))
            found[ChannelSuspect(DEPARTURE, pair.state, size)] = followed
    return found


def without_departures(data: Trajectories, simulation: Simulation, sizes: Sizes) -> Trajectories:
    """Return states nearer to the integral of their rates, by as large a share as was found on the training data."""
    states = dict(data.states)
    for error, size in sizes.items():
        rate = simulation.rate_name(error.channel) if error.kind == DEPARTURE else None
        if rate is not None:
            share = np.clip(size / error.sd, 0.0, 1.0)
            values = states[error.channel]
            states[error.channel] = values + share * (_followed(data, error.channel, rate) - values)
    return replace(data, states=states)


def _followed(data: Trajectories, state: str, rate: str) -> Float[np.ndarray, " n_obs"]:
    """Return a state as the integral of its rate, whose start and whose offset fit its samples best."""
    parts = []
    for rows in run_slices(data.run):
        time = data.time[rows]
        if len(time) < 2:
            parts.append(data.states[state][rows])
            continue
        departure = data.states[state][rows] - running_integral(time, data.states[rate][rows])
        line = np.polynomial.Polynomial.fit(time, departure, 1)
        parts.append(data.states[state][rows] - departure + line(time))
    return np.concatenate(parts)


def sizes_of(errors: Mapping[ChannelSuspect, KnownError]) -> dict[ChannelSuspect, float]:
    """Return the sizes of errors that are known."""
    return {suspect: error.size for suspect, error in errors.items()}


def in_step(data: Trajectories, simulation: Simulation, noise: Mapping[str, float]) -> dict[str, float]:
    """Return standard deviations of the delay between a state and its rate whose samples agree, for both by name."""
    spreads: dict[str, float] = {}
    for pair in _pairs(data, simulation, noise):
        if pair.gained > 0 and pair.p(pair.departures({})) >= SURELY_WRONG:
            sd = float(np.sqrt(pair.variance / pair.gained))
            spreads |= {each: min(sd, spreads.get(each, sd)) for each in (pair.state, pair.rate)}
    return spreads


def _pairs(data: Trajectories, simulation: Simulation, noise: Mapping[str, float]) -> Iterator["_Pair"]:
    for name in data.state_names:
        rate = simulation.rate_name(name)
        if rate is None or rate not in data.state_names:
            continue
        runs = [rows for rows in (data.run == r for r in range(data.n_run)) if np.sum(rows) > 3 * WINDOW_STEPS]
        paths = [_Path(data.time[rows], data.states[name][rows], data.states[rate][rows]) for rows in runs]
        if sum(len(path.start) for path in paths) >= FEWEST_WINDOWS:
            yield _Pair(name, rate, paths, noise.get(name, 0.0), noise.get(rate, 0.0))


def _measured_pairs(data: Trajectories, simulation: Simulation, noise: Mapping[str, float]) -> Iterator["_Pair"]:
    """Yield the pairs with a sensor each: a rate that a filter computed, or what follows from a start, has none."""
    for pair in _pairs(data, simulation, noise):
        computed = data.filter is not None and data.filter.source(pair.rate) == data.filter.source(pair.state)
        if not computed and not {pair.state, pair.rate} & {*data.computed}:
            yield pair


class _Path:
    """The windows of one run, without those at its ends, which a shift would leave."""

    def __init__(self, time: np.ndarray, x: np.ndarray, v: np.ndarray) -> None:
        self.time, self.x, self.v = time, x, v
        margin = int(np.ceil(FURTHEST * DELAY_STEPS)) + 1
        self.start = np.arange(margin, len(time) - WINDOW_STEPS - margin, WINDOW_STEPS)
        self.end = self.start + WINDOW_STEPS
        self.gained = v[self.end] - v[self.start]

    def changes(self, x: Float[np.ndarray, " n"], by: float = 0.0) -> Float[np.ndarray, " n_window"]:
        """Return the change of a state within each window, so much later."""
        spline = CubicSpline(self.time, x)
        return spline(self.time[self.end] + by) - spline(self.time[self.start] + by)

    def predicted(self, v: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n_window"]:
        """Return the integral of the rate over each window."""
        integral = running_integral(self.time, v)
        return integral[self.end] - integral[self.start]


class _Pair:
    """Pair of a state and the state that is its rate, with the windows of their runs."""

    def __init__(self, state: str, rate: str, paths: list[_Path], noise: float, rate_noise: float) -> None:
        self.state, self.rate, self.paths = state, rate, paths
        self.step = float(np.median(np.concatenate([np.diff(path.time) for path in paths])))
        changes = np.concatenate([path.changes(path.x) for path in paths])
        shown = 2 * noise**2 + WINDOW_STEPS * (rate_noise * self.step) ** 2
        # Variance of a departure.
        self.variance = shown + AGREEING**2 * float(np.mean(changes**2)) + np.finfo(float).tiny
        self.gained = float(sum(np.sum(path.gained**2) for path in paths))

    def departures(self, sizes: Sizes) -> Float[np.ndarray, " n"]:
        """Return the departures of samples that are free of errors of some sizes."""
        by = delays_of(sizes).get(self.state, 0.0)
        of_state, of_rate = (curve_of(sizes, name) for name in (self.state, self.rate))
        return np.concatenate(
            [p.changes(of_state.measured(p.x), by) - p.predicted(of_rate.measured(p.v)) for p in self.paths]
        )

    def p(self, departures: Float[np.ndarray, " n"], fitted: int = 0) -> float:
        """Return the p-value of departures after so many numbers were fitted to them."""
        return float(chi2.sf(np.sum(departures**2) / self.variance, max(len(departures) - fitted, 1)))

    def reason(self) -> list[KnownError]:
        """Return the errors that explain the departures, if these need a reason; none where nothing explains them."""
        before = self.p(self.departures({}))
        if before >= SURELY_WRONG:
            return []
        reasons = [reason for errors in self._candidates() if (reason := self._fitted(errors, before))]
        return min(reasons, key=lambda each: each[0], default=(0.0, []))[1]

    def _candidates(self) -> Iterator[Sequence[ChannelSuspect]]:
        yield (delay_error(self.state, self.step),)
        x, v = (np.concatenate([getattr(path, name) for path in self.paths]) for name in ("x", "v"))
        for name, values in ((self.state, x), (self.rate, v)):
            bends = bend_errors(name, values)
            for count in range(1, len(bends) + 1):
                yield from combinations(bends, count)

    def _fitted(self, errors: Sequence[ChannelSuspect], before: float) -> tuple[float, list[KnownError]] | None:
        """Return −2 log evidence up to a constant (Schwarz 1978), and the errors; None where they do not suffice."""
        scale = np.array([error.sd for error in errors])

        def left(z: np.ndarray) -> np.ndarray:
            return self.departures(dict(zip(errors, z * scale, strict=True))) / np.sqrt(self.variance)

        found = least_squares(left, np.zeros(len(errors)), bounds=(-FURTHEST, FURTHEST), x_scale=0.1, xtol=1e-6)
        residual, k = found.fun, len(errors)
        if np.any(np.abs(found.x) > 0.95 * FURTHEST) or self.p(residual * np.sqrt(self.variance), k) < SURELY_WRONG:
            return None
        # The residual is no white noise where samples are exact: sensors agree to within what they are trusted to.
        excess = max(float(np.sum(residual**2)) / max(len(residual) - k, 1), 1.0)
        covariance = np.linalg.pinv(found.jac.T @ found.jac) * excess
        sds = np.sqrt(np.diag(covariance)) * scale
        known = [
            KnownError(*each, before) for each in zip(errors, (found.x * scale).tolist(), sds.tolist(), strict=True)
        ]
        return float(np.sum(residual**2)) + k * np.log(len(residual)), known
