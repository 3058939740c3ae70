"""Samples of a state by themselves: their noise, and slips of the sensor.

Noise on states that terms are evaluated at is a spurious force, E[e | x measured] = s² ∇log p(x), which more rows make
surer. Where the samples show white noise of their own, terms are evaluated at smoothed states instead.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import make_smoothing_spline

from bayes_greybox.data.rates.filters import STEP_TOLERANCE
from bayes_greybox.data.runs.resampling import running_integral
from bayes_greybox.data.samples.sample_noise import sample_noise
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.grid.latent_force import MEDIAN_ABSOLUTE_NORMAL
from bayes_greybox.physics.simulation.protocol import Simulation

from .channels import run_slices

LARGEST_NOISE, BORNE_OUT, FEWEST_SMOOTHED = 0.3, 0.65, 30
"""Largest noise over a state's standard deviation; least departure of steps from their rate, over what noise s makes of
them, that bears it out; least samples of a run that is smoothed."""

INTEGRAL_GAIN, SUMMED = 0.811476, 0.1
"""Norm of a cubic spline's weights in its integral over an interval, in steps; departure from the running sum of a
noisy rate, over the noise, below which a state was computed from it: measured ones depart by 1/√2."""

CUTOFFS, LOWEST_CUTOFF = 24, 2.0
"""Number of cut-off frequencies that a smoother chooses from, and the lowest of them in periods of a run."""

SMOOTHER_TRACE, SMOOTHER_SQUARE = 0.441942, 0.345275
"""tr(H) and tr(HHᵀ) of a smoother over its number of samples, per ω₀h: ∫(2g − g²)dω/π and ∫(2g − g²)²dω/π at ω₀ = 1."""

SLIP_LEAP, SLIP_FOLLOWED = 6.0, 0.3
"""Size of a slip over the usual leap that the rate lacks, and largest leap of the rate over the expected one."""

SLIP_WIDTHS, MOST_MENDINGS = (1, 2), 10
"""Numbers of samples that a slip may have; most searches for slips, each after the largest are mended."""


@dataclass(frozen=True)
class SampleNoise:
    """Standard deviations of white noise on the samples of a state, and left on the smoothed ones, user's units."""

    sd: float
    left: float


class Smoother:
    """Frees states of white noise on their samples, in the training data and in other data of the same sensors.

    A cubic smoothing spline, applied twice, in runs of even step. A fast motion that is sampled coarsely, or with
    kinks, may look like white noise: noise of standard deviation s makes a step depart from the integral of the rate
    (of `rates`) by √2 s, and the state that it is the rate of (by `rate_of`) from its integral by `INTEGRAL_GAIN` h s,
    with h the step. States whose noise is not borne out so stay as they are.
    """

    def __init__(
        self,
        train: Trajectories,
        rates: Mapping[str, Float[np.ndarray, " n_obs"]],
        rate_of: Mapping[str, str] | None = None,
    ) -> None:
        self._train = train
        self._sd = _noise_of(train, rates, rate_of or {})
        self._smooth, self.noise = self._smoothed(train)

    def __call__(self, data: Trajectories) -> Trajectories:
        """Return the data with smoothed states; the very data where no state showed noise."""
        return self._smooth if data is self._train else self._smoothed(data)[0]

    def _smoothed(self, data: Trajectories) -> tuple[Trajectories, dict[str, SampleNoise]]:
        if not self._sd or not _even(data):
            return data, {}
        states, noise = dict(data.states), {}
        for name, s in self._sd.items():
            parts = [smooth(data.time[rows], data.states[name][rows], s) for rows in run_slices(data.run)]
            states[name] = np.concatenate([part.path for part in parts])
            noise[name] = SampleNoise(s, s * math.sqrt(float(np.mean([part.left for part in parts]))))
        return replace(data, states=states), noise


def known_rates(simulation: Simulation, data: Trajectories) -> dict[str, Float[np.ndarray, " n_obs"]]:
    """Return the rates of states that are measured, or that are another state."""
    kinematic = {name: simulation.on(data, name) for name in data.state_names if simulation.kinematic(name)}
    return {**kinematic, **data.derivatives}


def integrated(simulation: Simulation, data: Trajectories) -> dict[str, str]:
    """Return, for each state that is the rate of another, that other: the position of a speed."""
    return {rate: name for name in data.state_names if (rate := simulation.rate_name(name)) is not None}


def misread(
    values: Float[np.ndarray, " n"], run: np.ndarray, rate: Float[np.ndarray, " n"], slope: Float[np.ndarray, " n"]
) -> tuple[Bool[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return true for samples that leap away and back without the measured rate, and the samples mended by cubics.

    A blow leaps too, and moves the machine: the rate leaps with it, by ∂G/∂x times as much. A slip moves nothing.
    """
    values, out = values.copy(), np.zeros(len(values), bool)
    for _ in range(MOST_MENDINGS):
        # Of slips side by side the larger one comes first, and shows the other.
        before = int(np.sum(out))
        for width in SLIP_WIDTHS:
            rows = np.arange(max(len(values) - width - 3, 0))[:, None] + np.arange(width + 4)
            rows = rows[run[rows[:, 0]] == run[rows[:, -1]]]
            if not len(rows):
                continue
            leap, rate_leap = _leaps(values[rows]), _leaps(rate[rows])
            expected = slope[rows[:, 2:-2]] * leap
            lacking = np.abs(rate_leap - expected)
            large = lacking > SLIP_LEAP * float(np.median(lacking)) / MEDIAN_ABSOLUTE_NORMAL
            unseen = np.abs(rate_leap) < SLIP_FOLLOWED * np.abs(expected)
            slip = np.all(large & unseen, axis=1) & _away(values[rows], leap)
            size = np.where(slip, np.min(np.abs(leap), axis=1), 0.0)
            # Mend the largest of those that share samples.
            for k in np.flatnonzero(slip):
                inside = rows[k, 2:-2]
                if size[k] >= np.max(size[max(k - width - 1, 0) : k + width + 2]) and not np.any(out[inside]):
                    values[inside] -= leap[k]
                    out[inside] = True
        if np.sum(out) == before:
            break
    return out, values


def _leaps(x: np.ndarray) -> np.ndarray:
    """Return the departure of samples from the cubic through two on either side of them, windows [n, width + 4]."""
    width = x.shape[1] - 4
    at, nodes = np.arange(width), np.array([-2, -1, width, width + 1])
    weights = [[np.prod([(t - m) / (n - m) for m in nodes if m != n]) for t in at] for n in nodes]
    return x[:, 2:-2] - x[:, [0, 1, -2, -1]] @ np.array(weights)


def _away(x: np.ndarray, leap: np.ndarray) -> np.ndarray:
    """Return true for samples that are away from both their neighbours to the same side, unlike those of an edge."""
    before, after = x[:, 2] - x[:, 1], x[:, -3] - x[:, -2]
    side = np.sign(leap[:, 0])
    away = np.minimum(side * before, side * after) > 0.5 * np.max(np.abs(leap), axis=1)
    return away & (np.min(side[:, None] * leap, axis=1) > 0)


def _noise_of(data: Trajectories, rates: Mapping[str, np.ndarray], rate_of: Mapping[str, str]) -> dict[str, float]:
    """Return the noise on the samples of each state that rates and integrals bear out; a filter smoothed before."""
    if data.filter is not None or data.n_obs < FEWEST_SMOOTHED:
        return {}
    sds = sample_noise(data.time, data.matrix(data.state_names), data.run_lengths)
    runs = [rows for rows in run_slices(data.run) if rows.stop - rows.start > 3]
    believed = {}
    for (name, x), s in zip(data.states.items(), map(float, sds), strict=True):
        # What follows from its start no sensor reads.
        if name in data.computed or not 0 < s < LARGEST_NOISE * np.std(x):
            continue
        if name in rates and runs:
            steps = [np.diff(x[rows] - running_integral(data.time[rows], rates[name][rows])) for rows in runs]
            if _usual(steps) < BORNE_OUT * math.sqrt(2) * s:
                continue
        above = rate_of.get(name)
        if above is not None and above not in data.computed and runs and _smoother(data, above, x, runs, s):
            continue
        believed[name] = s
    return believed


def _smoother(data: Trajectories, above: str, rate: np.ndarray, runs: list[slice], s: float) -> bool:
    """Return whether a state that was not summed up from its rate follows it more closely than noise allows."""
    departures, summed = [], []
    for rows in runs:
        x, r, h = data.states[above][rows], rate[rows], np.diff(data.time[rows])
        steps = np.diff(x) / h
        departures.append(steps - np.diff(running_integral(data.time[rows], r)) / h)
        summed.append([steps - each for each in ((r[:-1] + r[1:]) / 2, r[:-1], r[1:])])
    if min(map(_usual, zip(*summed, strict=True))) < SUMMED * s:
        return False
    return _usual(departures) < BORNE_OUT * INTEGRAL_GAIN * s


def _usual(parts: Iterable[np.ndarray]) -> float:
    """Return the usual size of values, robustly."""
    return float(np.median(np.abs(np.concatenate(list(parts))))) / MEDIAN_ABSOLUTE_NORMAL


class Smoothed(NamedTuple):
    """Smoothed samples, the share of the noise's variance that is left on them, and the estimate of their risk."""

    path: Float[np.ndarray, " n"]
    left: float
    risk: float


def smooth(time: Float[np.ndarray, " n"], samples: Float[np.ndarray, " n"], s: float) -> Smoothed:
    """Return samples freed of white noise of standard deviation s.

    A cubic smoothing spline of penalty λ is the filter g = 1/(1 + (ω/ω₀)⁴), ω₀ = (λh)^(−1/4) with h the step. It is
    applied to its own residuals once more (twicing, Tukey 1977), 1 − (1 − g)²: a spline alone flattens the turns of a
    path, which looks like a stiffening spring. ω₀ minimises the risk that is estimated without bias (Stein 1981),
    RSS/n + 2 s² tr(H)/n.
    """
    n = len(samples)
    best = Smoothed(samples, 1.0, 2 * s**2)
    if n < FEWEST_SMOOTHED:
        return best
    step = float(np.mean(np.diff(time)))
    for cutoff in np.geomspace(LOWEST_CUTOFF * 2 * math.pi / (n * step), math.pi / step, CUTOFFS):
        penalty = 1.0 / (step * cutoff**4)
        once = make_smoothing_spline(time, samples, lam=penalty)(time)
        path = once + make_smoothing_spline(time, samples - once, lam=penalty)(time)
        risk = float(np.mean((samples - path) ** 2)) + 2 * s**2 * min(SMOOTHER_TRACE * step * cutoff, 1.0)
        if risk < best.risk:
            best = Smoothed(path, min(SMOOTHER_SQUARE * step * cutoff, 1.0), risk)
    return best


def _even(data: Trajectories) -> bool:
    """Return true if each run has a step of its own, up to the rounding of time stamps."""
    steps = [np.diff(data.time[rows]) for rows in run_slices(data.run) if rows.stop - rows.start > 1]
    usual = [np.median(each) for each in steps]
    even = (np.abs(each - h) <= STEP_TOLERANCE * h for each, h in zip(steps, usual, strict=True))
    return bool(steps) and all(bool(np.all(each)) for each in even)
