"""Noise that is correlated in time, weighed on residuals by a Kalman filter.

Two kinds of processes are: a rough one is what sensors have (correlated noise); a smooth one moves as systems move, and
is something that the model lacks.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.data.noise.protocol import RowNoise
from bayes_greybox.data.noise.state_space import StateSpaceNoise
from bayes_greybox.data.noise.weighted import correlation_and_sd, with_sd
from bayes_greybox.model.estimate.evidence import log_white, log_white_each
from bayes_greybox.model.gp.hyper import NoisePrior

from .noise_model import CORRELATED, PROCESS, NoiseModel, Suspicion, weighed_on_grid

TIME_STEPS, TIME_SPREAD = 10.0, 1.5
"""τ ~ LogNormal: its median in sampling steps, and the standard deviation of its logarithm."""

PROCESS_WHITE_SHARES = {
    CORRELATED: (0.0, 0.05, 0.15, 0.3, 0.5, 0.7, 0.85, 0.95),
    PROCESS: (0.003, 0.01, 0.03, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.95, 0.98),
}
"""Grid of the white share of the variance, even prior weights. A process of a system needs some white noise beside it:
samples are never exact."""

SHORTEST_TIME = {CORRELATED: 1.0, PROCESS: 3.0}
"""Least τ in steps: the motion of a system is resolved by its samples, or nobody could model it."""


class Stamps(NamedTuple):
    """Times, increasing within a run, and run of each row."""

    time: Float[np.ndarray, " n_obs"]
    run: Int[np.ndarray, " n_obs"]


def in_time(
    residual: Float[np.ndarray, " n_obs"], current: NoiseModel, stamps: Stamps, prior: NoisePrior, name: str,
    time_scale: float | None = None, evidence: Callable[[RowNoise], float] | None = None,
) -> Suspicion | None:  # fmt: skip
    """Weigh a process in time, `CORRELATED` or `PROCESS`, σ² [(1 − w) k(·/τ) + w δ], τ and w on a grid.

    τ may be known. The mode is that of `evidence`, log p of the measurements under some noise, the explanation
    integrated out, or else of the residuals.
    """
    process = "exponential" if name == CORRELATED else "matern32"
    sd = correlation_and_sd(current.noise)[1]
    e = residual / sd
    time, run = stamps
    values, step, used = _stretches(e, stamps)
    within = step[np.isfinite(step) & used]
    if not len(within):
        return None
    typical, n = float(np.median(within)), len(e)
    stretches = values, step / typical, used
    longest = max(math.log(max(np.bincount(run - run.min()))), 1.0)
    taus = np.exp(np.arange(math.log(SHORTEST_TIME[name]), max(longest, 1.8) + 0.3, 0.55))
    if time_scale is not None:
        taus = np.array([time_scale / typical])
    shares = np.array(PROCESS_WHITE_SHARES[name])
    logs = _filtered(stretches, process, taus, shares, n, prior)
    # Once finer around the best, so that what is held is the mode.
    i, j = np.unravel_index(int(np.argmax(logs)), logs.shape)
    fine_tau = taus[i] * np.exp(np.linspace(-0.45, 0.45, 7)) if time_scale is None else taus
    low, high = shares[max(j - 1, 0)], shares[min(j + 1, len(shares) - 1)]
    fine_share = np.linspace(low, high, 7)
    fine = _filtered(stretches, process, fine_tau, fine_share, n, prior)
    k, m = map(int, np.unravel_index(int(np.argmax(fine)), fine.shape))
    runs = tuple(time[run == r] for r in dict.fromkeys(run.tolist()))

    def noise_of(k: int, m: int) -> RowNoise:
        tau, white = float(fine_tau[k] * typical), float(fine_share[m])
        return current.noise.with_error(with_sd(StateSpaceNoise(runs, process, tau, white), sd))

    if evidence is not None:
        # One after the other: they depend on each other by little.
        k = int(np.argmax([evidence(noise_of(at, m)) for at in range(len(fine_tau))]))
        m = int(np.argmax([evidence(noise_of(k, at)) for at in range(len(fine_share))]))
    # The prior of τ on the coarse grid; the fine one only moves the mode.
    z = (np.log(taus) - math.log(TIME_STEPS)) / TIME_SPREAD
    log_prior = (-0.5 * z**2 - np.logaddexp.reduce(-0.5 * z**2))[:, None] - math.log(len(shares)) + 0 * shares
    tau, white = float(fine_tau[k] * typical), float(fine_share[m])
    before = log_white(float(np.sum(e**2)), n, prior)
    neighbours = 1.0 if process == "exponential" else 1 + math.sqrt(3) * typical / tau
    neighbours *= math.exp(-typical / tau * (1.0 if process == "exponential" else math.sqrt(3)))
    about = {"time_scale": tau, "white": white, "share": 1 - white, "correlation": (1 - white) * neighbours}
    suspicion = weighed_on_grid(name, logs, log_prior, before, noise_of(k, m), current, about)
    lift = float(np.max(logs)) - float(fine[k, m])
    return replace(suspicion, model=replace(suspicion.model, constant=suspicion.model.constant + lift))


def _stretches(e: np.ndarray, stamps: Stamps) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cut a record side by side, as runs of their own: values, times since the rows before, and rows in use."""
    n = len(e)
    step = np.where(np.diff(stamps.run, prepend=-1) != 0, np.inf, np.diff(stamps.time, prepend=stamps.time[0]))
    width = min(2048, n)
    rows = np.arange(0, n, width)[:, None] + np.arange(width)
    used = rows < n
    rows = np.minimum(rows, n - 1)
    step = np.where(used, step[rows], np.inf)
    step[:, 0] = np.inf
    return np.where(used, e[rows], 0.0), step, used


def _filtered(
    stretches: tuple[np.ndarray, ...], process: str, taus: np.ndarray, shares: np.ndarray, n: int, prior: NoisePrior
) -> Float[np.ndarray, "n_tau n_share"]:
    """Return log p(e | τ, w), σ integrated out, on a grid; all stretches and nodes go through the rows together."""
    e, step, used = stretches
    tau, w = (grid.ravel()[:, None] for grid in np.meshgrid(taus, shares, indexing="ij"))
    amplitude = 1 - w
    square, log_det = np.zeros((len(tau), 1)), np.zeros((len(tau), 1))
    shape = (len(tau), len(e))
    smooth = process == "matern32"
    m0, m1 = np.zeros(shape), np.zeros(shape)
    p00, p01, p11 = np.broadcast_to(amplitude, shape).copy(), np.zeros(shape), np.broadcast_to(amplitude, shape).copy()
    for t in range(e.shape[1]):
        fresh = ~np.isfinite(step[:, t])
        if t and not fresh.all():
            x = np.where(fresh, 0.0, step[:, t]) / tau
            if smooth:
                x = math.sqrt(3) * x
                fade = np.exp(-x)
                a, b, c, d = (1 + x) * fade, x * fade, -x * fade, (1 - x) * fade
                m0, m1 = a * m0 + b * m1, c * m0 + d * m1
                q = amplitude
                n00 = a * a * p00 + 2 * a * b * p01 + b * b * p11 + q * (1 - a * a - b * b)
                n01 = a * c * p00 + (a * d + b * c) * p01 + b * d * p11 - q * (a * c + b * d)
                n11 = c * c * p00 + 2 * c * d * p01 + d * d * p11 + q * (1 - c * c - d * d)
                p00, p01, p11 = n00, n01, n11
            else:
                a = np.exp(-x)
                m0, p00 = a * m0, a * a * p00 + amplitude * (1 - a * a)
        if fresh.any():
            m0, m1 = np.where(fresh, 0.0, m0), np.where(fresh, 0.0, m1)
            p00, p01 = np.where(fresh, amplitude, p00), np.where(fresh, 0.0, p01)
            p11 = np.where(fresh, amplitude, p11)
        S = p00 + w
        v = e[:, t] - m0
        on = used[:, t]
        square += np.sum(np.where(on, v * v / S, 0.0), axis=1, keepdims=True)
        log_det += np.sum(np.where(on, np.log(S), 0.0), axis=1, keepdims=True)
        k0 = p00 / S
        m0 = m0 + k0 * v
        if smooth:
            k1 = p01 / S
            m1 = m1 + k1 * v
            p11, p01, p00 = p11 - k1 * p01, p01 * (1 - k0), p00 * (1 - k0)
        else:
            p00 = p00 * (1 - k0)
    logs = log_white_each(square[:, 0], n, prior) - 0.5 * log_det[:, 0]
    return logs.reshape(len(taus), len(shares))
