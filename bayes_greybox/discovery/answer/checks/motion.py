"""Whether the samples of the states move as their rates say: what no noise of a measured rate can hide.

Over a window of a few samples a state changes by the integral of its rate, x(t + T) − x(t) = ∫ G dt, whatever noise is
on the measured rate. So the samples of a position and of a speed judge each other, and the samples of a speed judge the
rate of the amended model: a sensor that is bent, sticks or forgets, or a force that acts for a moment, shows here.

The departures D of windows that do not overlap have the covariance

    C = V + A Aᵀ

V diagonal: noise on the samples, errors of truncation, and sensors that agree to within `AGREE`; the columns of A are
what coefficients that are uncertain do to all windows at once. Then Dᵀ C⁻¹ D is χ² with a degree of freedom for each
window, and what the coefficients at their best leave of D is V C⁻¹ D.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from bayes_greybox.data.rates.integral import running_integral
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.suspects.late import AGREE, FEWEST, SAMPLES

from .adequacy import LEVEL, Check

MOTION = "motion"

FAINT_MODE = 1e-10
"""Share of the largest square of what coefficients do together, below which it is rounding."""

ROUGH = 0.5
"""Steps from sample to sample, over the spread of a state, from which on its samples tell no path."""


@dataclass(frozen=True)
class MotionCheck(Check):
    """Check of one state.

    Attributes:
        state: Its name.
        departure: RMS of the departures that coefficients at their best leave, V C⁻¹ D.
        span: Time of a window: an error of the rate of D over this would do it too.
    """

    state: str
    departure: float
    span: float


@dataclass(frozen=True)
class ModelledRate:
    """The rate of a state as modelled.

    Attributes:
        values: At the samples.
        sd: Of the noise on the states that it is evaluated at, taken as one error throughout a window.
        of: What it is, in words.
        draws: Of it, its coefficients' posterior; None: they are known.
        moved: What the draws of a sensor's error do to the samples of the state themselves; None: nothing.
    """

    values: Float[np.ndarray, " n_obs"]
    sd: float
    of: str
    draws: Float[np.ndarray, "n_draw n_obs"] | None = None
    moved: Float[np.ndarray, "n_draw n_obs"] | None = None

    @cached_property
    def modes(self) -> tuple[Float[np.ndarray, "n_obs n_mode"], Float[np.ndarray, "n_obs n_mode"]]:
        """Columns M whose M Mᵀ is the covariance of the draws, of the rate and of the samples; as few as there are."""
        if self.draws is None:
            return np.zeros((len(self.values), 0)), np.zeros((len(self.values), 0))
        # Where no sensor's error moves the samples, half of the columns would be zeros.
        both = self.draws if self.moved is None else np.hstack([self.draws, self.moved])
        apart = (both - both.mean(axis=0)) / np.sqrt(len(both))
        # Rows where a rate is no number have no part in any window.
        apart = np.where(np.all(np.isfinite(apart), axis=0), apart, 0.0)
        square, turned = np.linalg.eigh(apart @ apart.T)
        modes = apart.T @ turned[:, square > FAINT_MODE * square[-1]]
        if self.moved is None:
            return modes, np.zeros_like(modes)
        return modes[: len(self.values)], modes[len(self.values) :]


def check_motion(
    data: Trajectories, rates: Mapping[str, ModelledRate], noise: Mapping[str, float], unit: str = ""
) -> list[MotionCheck]:
    """One check for each rate.

    Args:
        data: Samples with delays undone.
        rates: By state.
        noise: Standard deviation of the noise on the samples of states that have any.
        unit: Of time, for the words.

    Returns:
        Checks by the name "motion of x", of those states whose runs have windows enough.
    """
    found = []
    for name, rate in rates.items():
        departures, changes, variances, spans, common = [], [], [], [], []
        for r in dict.fromkeys(data.run.tolist()):
            own = data.run == r
            time, x, g = data.time[own], data.column(name)[own], rate.values[own]
            dense = np.sqrt(np.mean(np.diff(x) ** 2)) < ROUGH * np.std(x) if len(time) >= 2 * SAMPLES else False
            if not dense or not np.all(np.isfinite(g)) or not np.isfinite(rate.sd):
                continue
            # No two windows share a sample and its noise.
            start = np.arange(0, len(time) - SAMPLES, SAMPLES + 1)
            end = start + SAMPLES
            integral, error = _integral_and_error(time, g)
            together = rate.modes[1][own] - running_integral(time, rate.modes[0][own])
            changes.append(x[end] - x[start])
            departures.append(changes[-1] - (integral[end] - integral[start]))
            common.append(together[end] - together[start])
            span = time[end] - time[start]
            truncation = np.hypot(error[end], error[start])
            variances.append(2 * noise.get(name, 0.0) ** 2 + truncation**2 + (span * rate.sd) ** 2)
            spans.append(span)
        if sum(map(len, departures)) < FEWEST:
            continue
        D, change, variance, A = (np.concatenate(parts) for parts in (departures, changes, variances, common))
        size = float(np.sqrt(np.mean(change**2)))
        left, square = _beside(D, variance + (AGREE * size) ** 2 + np.finfo(float).tiny, A)
        off, typical = float(np.sqrt(np.mean(left**2))), float(np.median(np.concatenate(spans)))
        p = float(chi2.sf(square, len(D)))
        text = ""
        if p < LEVEL:
            over, share = f"{typical:.2g} {unit}".rstrip(), 100 * off / size
            text = f"the samples of {name} do not move as {rate.of} says: over {over} they are {share:.2g}\u00a0% off"
        found.append(MotionCheck(f"{MOTION} of {name}", p, text, name, off, typical))
    return found


def _beside(D: np.ndarray, variance: np.ndarray, A: np.ndarray) -> tuple[np.ndarray, float]:
    """V C⁻¹ D and Dᵀ C⁻¹ D with C = V + A Aᵀ, by Woodbury's identity."""
    scaled = A / variance[:, None]
    left = D - A @ np.linalg.solve(np.eye(A.shape[1]) + A.T @ scaled, scaled.T @ D)
    return left, float(D @ (left / variance))


def _integral_and_error(time: np.ndarray, g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """∫ g dt up to each sample, by cubic splines; and its error, from splines through every other sample."""
    fine, coarse = running_integral(time, g), running_integral(time[::2], g[::2], time)
    return fine, np.abs(fine - coarse) / 4
