"""Starts of runs, with their uncertainty, from cubics through as many first samples as the curve of the path allows.

A free run that starts from one noisy sample would carry that sample's error along its whole path.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.trajectories import Trajectories

from .sample_noise import sample_noise, windows

WINDOWS = (5, 6, 8, 10, 13, 16, 20, 25, 32, 40, 50, 64, 80, 100)  # numbers of samples that a cubic is fitted to
TRUNCATION = 0.2  # largest truncation error of a cubic at its first sample, as a share of that value's standard error
PLACES = 200  # windows along the record, evenly spread, on which the truncation error is measured


@dataclass(frozen=True)
class Starts:
    """State of each run at its first sample."""

    # Its estimate, user's units; the measured sample itself where the states are exact.
    mean: Float[np.ndarray, "n_run n_state"]
    sd: Float[np.ndarray, "n_run n_state"]  # its standard deviation, zero where the states are exact

    @property
    def exact(self) -> bool:
        """True if no start is uncertain."""
        return not np.any(self.sd > 0)

    def draws(self, n_draw: int, rng: np.random.Generator) -> Float[np.ndarray, "n_draw n_run n_state"]:
        """Return independent draws x₀ ~ N(mean, sd²)."""
        return self.mean + self.sd * rng.standard_normal((n_draw, *self.mean.shape))


def estimate_starts(data: Trajectories) -> Starts:
    """Estimate the start of each run, of one row or more, with its uncertainty, x₀ ~ N(x̂₀, s₀²).

    x̂₀ is the value at the first sample of a cubic fitted to the first m, s₀² = s² h + b²: s is the noise of a sample
    (see `sample_noise`), h the leverage of the first sample, b the path's departure from a cubic there, estimated as
    the RMS along the whole record of the quartic's share less its noise. m is the largest of `WINDOWS` up to which b is
    below `TRUNCATION` of the error from noise and the first window's own residual is explained by the noise.
    """
    names = data.state_names
    values = data.matrix(names)
    noise = sample_noise(data.time, values, data.run_lengths)
    edges = np.concatenate([[0], np.cumsum(data.run_lengths)])
    mean, sd = values[edges[:-1]].copy(), np.tile(noise, (data.n_run, 1))
    noisy = np.flatnonzero(noise)
    if len(noisy):
        truncation = _truncation(data, values[:, noisy], noise[noisy])
        for run, (start, end) in enumerate(zip(edges[:-1], edges[1:], strict=True)):
            for k, state in enumerate(noisy):
                mean[run, state], sd[run, state] = _first_value(
                    data.time[start:end], values[start:end, state], noise[state], truncation[k]
                )
    return Starts(mean, sd)


def _first_value(
    time: Float[np.ndarray, " n"], x: Float[np.ndarray, " n"], noise: float, truncation: dict[int, float]
) -> tuple[float, float]:
    """Return the value at the first sample and its standard deviation, from the widest window the noise allows."""
    mean, sd = float(x[0]), float(noise)
    for m, b in truncation.items():
        if m > len(x):
            break
        Q = _orthonormal(time[None, :m])[0, :, :4]
        score = Q.T @ x[:m]
        chi_square, free = float(np.sum((x[:m] - Q @ score) ** 2)) / noise**2, m - 4
        if chi_square > free + 3 * np.sqrt(2 * free):
            break
        # s₀² = s² h + b²
        mean, sd = float(Q[0] @ score), float(np.sqrt(noise**2 * (Q[0] @ Q[0]) + b**2))
    return mean, sd


def _truncation(
    data: Trajectories, values: Float[np.ndarray, "n_obs n_state"], noise: Float[np.ndarray, " n_state"]
) -> list[dict[int, float]]:
    """Return the truncation error b of cubics by width, for each state; widths with too large a b are left out."""
    errors: list[dict[int, float]] = [{} for _ in noise]
    open_ = np.ones(len(noise), bool)
    for m in WINDOWS:
        rows = windows(data.run_lengths, m, PLACES)
        if not len(rows) or not open_.any():
            break
        Q = _orthonormal(data.time[rows])
        leverage = np.mean(np.sum(Q[:, 0, :4] ** 2, axis=1))
        for k in np.flatnonzero(open_):
            # Share of the quartic, the first that a cubic lacks, in the value at the first sample.
            share = Q[:, 0, 4] * np.sum(Q[:, :, 4] * values[rows, k], axis=1)
            square = max(float(np.mean(share**2) - noise[k] ** 2 * np.mean(Q[:, 0, 4] ** 2)), 0.0)
            open_[k] = square <= TRUNCATION**2 * leverage * noise[k] ** 2
            if open_[k]:
                errors[k][m] = float(np.sqrt(square))
    return errors


def _orthonormal(time: Float[np.ndarray, "n_window m"]) -> Float[np.ndarray, "n_window m 5"]:
    """Return orthonormal polynomials of degree 0 to 4 over the samples of each window."""
    inside = (time - time[:, :1]) / (time[:, -1:] - time[:, :1])
    return np.linalg.qr((2 * inside - 1)[:, :, None] ** np.arange(5))[0]
