"""What the samples of a state say of themselves: their own noise, and whether the sensor was at its end.

Noise on states that terms are evaluated at is a spurious force, E[e | x measured] = s² ∇log p(x), which more rows make
surer. Where the samples show white noise of their own, terms are evaluated at smoothed states instead.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import make_smoothing_spline

from bayes_greybox.data.rates.filters import STEP_TOLERANCE
from bayes_greybox.data.rates.integral import running_integral
from bayes_greybox.data.samples.sample_noise import sample_noise
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.simulation.protocol import Simulation

LARGEST = 0.3
"""Noise above this share of a state's standard deviation is none: rows in no order in time look like nothing else."""

BORNE_OUT, NORMAL_MEDIAN = 0.65, 0.6745
"""Least share of √2 s that steps depart from their rate by, and the median of |z| of a standard normal number."""

FEWEST = 30
"""Samples of a run below which nothing is smoothed."""

CUTOFFS, SLOWEST = 24, 2.0
"""Cut-off frequencies that a smoother chooses from, and the lowest of them in periods of a run."""

TRACE, SQUARE = 0.441942, 0.345275
"""tr(H) and tr(HHᵀ) of a smoother over its number of samples, per ω₀h: ∫(2g − g²)dω/π and ∫(2g − g²)²dω/π at ω₀ = 1."""


@dataclass(frozen=True)
class SampleNoise:
    """White noise found on one state.

    Attributes:
        sd: Of the samples, user's units.
        left: Of the smoothed samples.
    """

    sd: float
    left: float


LEAP, FOLLOWED = 6.0, 0.3
"""Leaps that the rate lacks are none of the signal's beyond so many of their usual size; and the share of what a leap
should do to the rate below which it was only the sensor's."""

WIDTHS = (1, 2)
"""A slip is of so many samples."""

TURNS = 10
"""How often slips are looked for again once the largest are mended."""


class Smoother:
    """Frees states of white noise on their samples, in the training data and in other data of the same sensors.

    A cubic smoothing spline, applied twice, in runs with a step of their own. What looks like white noise may be a fast
    motion sampled coarsely: noise of standard deviation s makes a step from sample to sample depart from the integral
    of the rate by √2 s, and a motion does not. States whose rate does not bear the noise out stay as they are.

    Args:
        train: Training data.
        rates: Rates of states at the samples, measured or known; states without one are believed.

    Attributes:
        noise: By state; empty where no state shows any, or where nothing can be smoothed.
    """

    def __init__(self, train: Trajectories, rates: Mapping[str, Float[np.ndarray, " n_obs"]]) -> None:
        self._train = train
        self._sd = _noise_of(train, rates)
        self._smooth, self.noise = self._smoothed(train)

    def __call__(self, data: Trajectories) -> Trajectories:
        """The data with smoothed states; the very data where no state showed noise.

        Args:
            data: Data of the same sensors.
        """
        return self._smooth if data is self._train else self._smoothed(data)[0]

    def _smoothed(self, data: Trajectories) -> tuple[Trajectories, dict[str, SampleNoise]]:
        if not self._sd or not _even(data):
            return data, {}
        states, noise = dict(data.states), {}
        runs = [data.run == r for r in dict.fromkeys(data.run.tolist())]
        for name, s in self._sd.items():
            parts = [_smooth(data.time[own], data.states[name][own], s) for own in runs]
            states[name] = np.concatenate([path for path, _ in parts])
            noise[name] = SampleNoise(s, s * math.sqrt(float(np.mean([share for _, share in parts]))))
        return replace(data, states=states), noise


def known_rates(simulation: Simulation, data: Trajectories) -> dict[str, Float[np.ndarray, " n_obs"]]:
    """Rates of states that are measured, or that another state is.

    Args:
        simulation: What is known of the rates.
        data: Measurements.
    """
    kinematic = {name: simulation.on(data, name) for name in data.state_names if simulation.kinematic(name)}
    return {**kinematic, **data.derivatives}


def misread(
    values: Float[np.ndarray, " n"], run: np.ndarray, rate: Float[np.ndarray, " n"], slope: Float[np.ndarray, " n"]
) -> tuple[Bool[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Samples of a channel that leap away and back, and that the measured rate knows nothing of.

    A blow leaps too, and moves the machine: the rate leaps with it, by ∂G/∂x times as much. A slip of the sensor does
    not.

    Args:
        values: Samples of a state or an input.
        run: Run of each.
        rate: Measured rate at the samples.
        slope: ∂G/∂x there.

    Returns:
        Which they are, and the samples with those on the cubic through their neighbours.
    """
    values, out = values.copy(), np.zeros(len(values), bool)
    for _ in range(TURNS):
        # Of slips side by side the larger one comes first, and shows the other.
        fresh = False
        for width in WIDTHS:
            rows = np.arange(max(len(values) - width - 3, 0))[:, None] + np.arange(width + 4)
            rows = rows[run[rows[:, 0]] == run[rows[:, -1]]]
            if not len(rows):
                continue
            leap, follows = _leaps(values[rows]), _leaps(rate[rows])
            expected = slope[rows[:, 2:-2]] * leap
            lacking = follows - expected
            large = np.abs(lacking) > LEAP * float(np.median(np.abs(lacking))) / NORMAL_MEDIAN
            unseen = np.abs(follows) < FOLLOWED * np.abs(expected)
            slip = np.all(large & unseen, axis=1) & _away(values[rows], leap)
            size = np.where(slip, np.min(np.abs(leap), axis=1), 0.0)
            # The largest of those that share samples with it.
            for k in np.flatnonzero(slip):
                inside = rows[k, 2:-2]
                if size[k] >= np.max(size[max(k - width - 1, 0) : k + width + 2]) and not np.any(out[inside]):
                    values[inside] -= leap[k]
                    out[inside] = fresh = True
        if not fresh:
            break
    return out, values


def _leaps(x: np.ndarray) -> np.ndarray:
    """Departure of samples from the cubic through two on either side of them, windows [n, width + 4]."""
    width = x.shape[1] - 4
    at, nodes = np.arange(width), np.array([-2, -1, width, width + 1])
    weights = [[np.prod([(t - m) / (n - m) for m in nodes if m != n]) for t in at] for n in nodes]
    return x[:, 2:-2] - x[:, [0, 1, -2, -1]] @ np.array(weights)


def _away(x: np.ndarray, leap: np.ndarray) -> np.ndarray:
    """Whether samples are away from both their neighbours to the same side: those of an edge are not."""
    before, after = x[:, 2] - x[:, 1], x[:, -3] - x[:, -2]
    side = np.sign(leap[:, 0])
    return (np.minimum(side * before, side * after) > 0.5 * np.max(np.abs(leap), axis=1)) & (
        np.min(side[:, None] * leap, axis=1) > 0
    )


def _noise_of(data: Trajectories, rates: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Standard deviation of the noise on the samples of each state that has some, and whose rate bears it out."""
    # A filter that computed the rates has smoothed the states too, and its rows know what it left.
    if data.filter is not None or data.n_obs < FEWEST:
        return {}
    found = sample_noise(data.time, data.matrix(data.state_names), data.run_lengths)
    runs = [data.run == r for r in dict.fromkeys(data.run.tolist()) if np.sum(data.run == r) > 3]
    believed = {}
    for (name, x), s in zip(data.states.items(), map(float, found), strict=True):
        if not 0 < s < LARGEST * np.std(x):
            continue
        if name in rates and runs:
            steps = [np.diff(x[own] - running_integral(data.time[own], rates[name][own])) for own in runs]
            if float(np.median(np.abs(np.concatenate(steps)))) / NORMAL_MEDIAN < BORNE_OUT * math.sqrt(2) * s:
                continue
        believed[name] = s
    return believed


def _smooth(time: np.ndarray, samples: np.ndarray, s: float) -> tuple[np.ndarray, float]:
    """Smoothed samples, and the share of the noise's variance that is left on them.

    A cubic smoothing spline of penalty λ is the filter g = 1/(1 + (ω/ω₀)⁴), ω₀ = (λh)^(−1/4) with h the step. It is
    applied to its own residuals once more (twicing, Tukey 1977), 1 − (1 − g)²: a spline alone flattens the turns of a
    path, which looks like a stiffening spring. ω₀ minimises the risk that is estimated without bias (Stein 1981),
    RSS/n + 2 s² tr(H)/n.
    """
    n = len(samples)
    if n < FEWEST:
        return samples, 1.0
    step = float(np.mean(np.diff(time)))
    best, found = math.inf, (samples, 1.0)
    for cutoff in np.geomspace(SLOWEST * 2 * math.pi / (n * step), math.pi / step, CUTOFFS):
        penalty = 1.0 / (step * cutoff**4)
        once = make_smoothing_spline(time, samples, lam=penalty)(time)
        path = once + make_smoothing_spline(time, samples - once, lam=penalty)(time)
        risk = float(np.mean((samples - path) ** 2)) + 2 * s**2 * min(TRACE * step * cutoff, 1.0)
        if risk < best:
            best, found = risk, (path, min(SQUARE * step * cutoff, 1.0))
    return found


def _even(data: Trajectories) -> bool:
    """Whether each run has a step of its own, up to the rounding of time stamps."""
    steps, run = np.diff(data.time), data.run
    within = np.diff(run) == 0
    typical = {r: np.median(steps[within & (run[1:] == r)]) for r in set(run[1:][within].tolist())}
    return bool(typical) and all(
        bool(np.all(np.abs(steps[within & (run[1:] == r)] - step) <= STEP_TOLERANCE * step))
        for r, step in typical.items()
    )
