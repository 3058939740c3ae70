"""Rows whose noise is correlated in time: a stationary Gaussian process plus white noise, by one Kalman filter.

    ε(t) = n(t) + e(t),   R_ij = (1 − w) k(|t_i − t_j| / τ) + w δ_ij,   one process a run,

with k exponential (Ornstein-Uhlenbeck: AR(1) on even samples, any spacing otherwise) or Matérn 3/2 (smooth). The
innovations of the filter are the whitened rows, the same gains for every column, in O(n) (Särkkä & Solin 2019, Applied
Stochastic Differential Equations, 12.3; de Jong 1989, Biometrika 76:663 for R⁻¹).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag
from scipy.signal import lfilter
from scipy.special import gammainc

from bayes_greybox.running.errors import InputError

from .protocol import RowNoise

PROCESSES = ("exponential", "matern32")  # rough like a sensor's noise, and smooth like the motion of a system
GAIN_SETTLED = 1e-13  # relative change of the gain below which whitening is a filter with fixed coefficients


class _Gains(NamedTuple):
    """Coefficients of the filter at each row; `fresh` marks the first row of each run."""

    advance: Float[np.ndarray, "n d d"]
    gain: Float[np.ndarray, "n d"]
    variance: Float[np.ndarray, " n"]
    fresh: np.ndarray


@dataclass(frozen=True, eq=False)
class StateSpaceNoise(RowNoise):
    """R of a process in time plus white noise."""

    kind: ClassVar[str] = "state space"
    times: tuple[Float[np.ndarray, " _"], ...]  # time stamps of each run, increasing
    process: str  # one of `PROCESSES`
    time_scale: float  # τ, in units of time
    white: float  # w, the share of the variance that is white, from 0 to 1
    scale: float = 1.0

    def __post_init__(self) -> None:
        if self.process not in PROCESSES:
            raise InputError(f"There is no process {self.process!r} of noise; there are {', '.join(PROCESSES)}.")
        if not (0 < self.time_scale < np.inf and 0 <= self.white <= 1):
            raise InputError(
                f"Correlated noise needs a time scale above 0 and a white share from 0 to 1, not {self.time_scale:g} "
                f"and {self.white:g}."
            )

    @property
    def run_lengths(self) -> tuple[int, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Rows of each run."""
        return tuple(len(t) for t in self.times)

    @cached_property
    def log_det(self) -> float:  # pyright: ignore[reportIncompatibleMethodOverride]
        """log|R| = Σ log S_t, S_t the variance of the innovations."""
        return float(np.sum(np.log(self._gains.variance)))

    def whiten(self, rows: Float[np.ndarray, "n_obs k"]) -> Float[np.ndarray, "n_obs k"]:
        """Return the innovations over their standard deviations."""
        g, white, start = self._gains, np.empty(rows.shape), 0
        for length in self.run_lengths:
            part = slice(start, start + length)
            white[part] = _innovations(rows[part], g.advance[part], g.gain[part], self._settled(start, length))
            start += length
        return white / np.sqrt(g.variance)[:, None]

    def whiten_transpose(self, rows: Float[np.ndarray, "n_white k"]) -> Float[np.ndarray, "n_obs k"]:
        """Run the adjoint of the filter backwards."""
        g, back = self._gains, np.empty(rows.shape)
        scaled = rows / np.sqrt(g.variance)[:, None]
        costate = np.zeros((g.gain.shape[1], rows.shape[1]))
        for t in range(len(rows) - 1, -1, -1):
            through = g.advance[t].T @ costate
            back[t] = scaled[t] + g.gain[t] @ through
            through[0] -= back[t]
            costate = np.zeros_like(through) if g.fresh[t] else through
        return back

    def precision_band(self, width: int) -> Float[np.ndarray, "n_obs width"]:
        """Return entries of R⁻¹ by the recursion N_{t-1} = hhᵀ/S_t + Lᵀ N_t L, L = A(I − K hᵀ).

        The diagonal is 1/S_t + kᵀ N_t k, k = A_t K_t.
        """
        g = self._gains
        n, d = g.gain.shape
        k = np.einsum("nij,nj->ni", g.advance, g.gain)
        L = g.advance - k[:, :, None] * np.eye(d)[0]
        behind = np.zeros((n, d, d))
        carry = np.zeros((d, d))
        for t in range(n - 1, -1, -1):
            behind[t] = carry
            carry = L[t].T @ carry @ L[t]
            carry[0, 0] += 1 / g.variance[t]
            if g.fresh[t]:
                carry = np.zeros((d, d))
        weighted = np.einsum("nij,nj->ni", behind, k)
        band = np.zeros((n, width))
        band[:, 0] = 1 / g.variance + np.sum(k * weighted, axis=1)
        run = np.cumsum(g.fresh)
        impulse = k
        for lag in range(1, min(width, n)):
            # impulse[t] is the state at t + lag that a unit at t leaves behind
            impulse = impulse[: n - lag]
            within = run[: n - lag] == run[lag:]
            on = np.einsum("nij,nj->ni", L[lag:], impulse)
            value = np.sum(on * weighted[lag:], axis=1) - impulse[:, 0] / g.variance[lag:]
            band[: n - lag, lag] = np.where(within, value, 0.0)
            impulse = on
        return band

    def covariance(self) -> Float[np.ndarray, "n_obs n_obs"]:
        """Return R as a dense matrix."""
        blocks = []
        for t in self.times:
            x = np.abs(t[:, None] - t) / self.time_scale
            k = np.exp(-x) if self.process == "exponential" else (1 + np.sqrt(3) * x) * np.exp(-np.sqrt(3) * x)
            blocks.append((1 - self.white) * k + self.white * np.eye(len(t)))
        return np.asarray(block_diag(*blocks))

    def correlated(self, white: Float[np.ndarray, "n_draw n_obs"]) -> Float[np.ndarray, "n_draw n_obs"]:
        """Run the filter forwards: each row is its prediction from the rows before it, plus an innovation."""
        g = self._gains
        innovations = white.T * np.sqrt(g.variance)[:, None]
        drawn = np.empty(innovations.shape)
        m = np.zeros((g.gain.shape[1], len(white)))
        for t in range(len(drawn)):
            if g.fresh[t]:
                m = np.zeros_like(m)
            drawn[t] = m[0] + innovations[t]
            m = g.advance[t] @ (m + g.gain[t][:, None] * innovations[t])
        return drawn.T

    def restrict(self, bounds: Sequence[tuple[int, int]]) -> "StateSpaceNoise":
        """Return the noise of contiguous rows of each run."""
        kept = zip(self.times, bounds, strict=True)
        return replace(self, times=tuple(t[start:stop] for t, (start, stop) in kept if stop > start))

    @cached_property
    def _gains(self) -> _Gains:
        steps = np.concatenate([np.diff(t, prepend=-np.inf) for t in self.times]) if self.times else np.zeros(0)
        fresh = ~np.isfinite(steps)
        step = np.append(steps[1:], np.inf)
        advance, noise, stationary = transition(self.process, np.where(np.isfinite(step), step, 0.0) / self.time_scale)
        n, d = len(steps), stationary.shape[0]
        gain, variance = np.empty((n, d)), np.empty(n)
        P = stationary * (1 - self.white)
        for t in range(n):
            if fresh[t]:
                P = stationary * (1 - self.white)
            variance[t] = P[0, 0] + self.white
            gain[t] = P[:, 0] / variance[t]
            # P₀₀ − P₀₀²/S = P₀₀ w/S, which is no difference of nearly equal numbers
            updated = P - np.outer(gain[t], P[0])
            updated[0] = updated[:, 0] = P[0] * self.white / variance[t]
            P = advance[t] @ updated @ advance[t].T + (1 - self.white) * noise[t]
        return _Gains(advance, gain, variance, fresh)

    def _settled(self, start: int, length: int) -> int:
        """Return the row of a run from which step and gain are constant."""
        g = self._gains
        gain, advance = g.gain[start : start + length], g.advance[start : start + length - 1]
        moving = np.any(np.abs(gain - gain[-1]) > GAIN_SETTLED * np.abs(gain[-1]), axis=1)
        if len(advance):
            uneven = np.any(np.abs(advance - advance[-1]) > 1e-9 * np.abs(advance[-1]) + 1e-300, axis=(1, 2))
            moving[:-1] |= uneven
        return int(np.flatnonzero(moving)[-1]) + 1 if moving.any() else 0


def transition(
    process: str, step: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n d d"], Float[np.ndarray, "n d d"], Float[np.ndarray, "d d"]]:
    """Return A, Q and the stationary covariance of a process of unit variance over steps in units of τ."""
    if process == "exponential":
        phi = np.exp(-step)
        return phi[:, None, None], -np.expm1(-2 * step)[:, None, None], np.eye(1)
    x = np.sqrt(3) * step
    fade = np.exp(-x)
    # In units of τ/√3, so that both components have unit variance
    advance = np.stack([np.stack([1 + x, x], -1), np.stack([-x, 1 - x], -1)], -2) * fade[:, None, None]
    # Q = I − A Aᵀ without cancellation, which rows much closer than τ would suffer: Q₀₀ ~ 4x³/3
    first, cross = gammainc(3.0, 2 * x), 2 * x**2 * fade**2
    noise = np.stack([np.stack([first, cross], -1), np.stack([cross, first + 4 * x * fade**2], -1)], -2)
    return advance, noise, np.eye(2)


def _innovations(y: np.ndarray, advance: np.ndarray, gain: np.ndarray, settled: int) -> np.ndarray:
    """Return each row of one run less its prediction from the rows before it."""
    n, d = gain.shape
    e = np.empty(y.shape)
    m = np.zeros((d, y.shape[1]))
    # The filter with constant coefficients is started from the last two rows, so it must hold for them already.
    first = min(n, settled + 2)
    for t in range(first):
        e[t] = y[t] - m[0]
        m = advance[t] @ (m + gain[t][:, None] * e[t])
    if first < n:
        # Constant from here on: e/y = det(zI − A) / det(zI − A(I − K hᵀ))
        A = advance[-2]
        F = A - np.outer(A @ gain[-1], np.eye(d)[0])
        b, a = _polynomial(A), _polynomial(F)
        past_y, past_e = y[[first - 1, first - 2]], e[[first - 1, first - 2]]
        state = [b[1] * past_y[0] - a[1] * past_e[0]]
        if d == 2:
            state[0] = state[0] + b[2] * past_y[1] - a[2] * past_e[1]
            state.append(b[2] * past_y[0] - a[2] * past_e[0])
        e[first:] = lfilter(b, a, y[first:], axis=0, zi=np.stack(state))[0]
    return e


def _polynomial(A: np.ndarray) -> list[float]:
    """Return the coefficients of det(zI − A), highest power first."""
    if len(A) == 1:
        return [1.0, -float(A[0, 0])]
    return [1.0, -float(np.trace(A)), float(A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0])]
