"""Weights s that write a filtered rate as a mean of the true one at the samples.

Σ_k c_k x_{n+k} = Σ_k s_k x⁽ᵐ⁾_{n+k} at unit spacing, with c the taps of a differentiator of order m.
"""

import math

import numpy as np
from jaxtyping import Float

BETWEEN = np.array([-1.0, 13.0, 13.0, -1.0]) / 24  # mean between the two inner ones of four samples, exact for cubics
AT_END = np.array([5.0, 8.0, -1.0]) / 12  # mean between the first two of three samples, exact for quadratics
HAT = np.array([1.0, 10.0, 1.0]) / 12  # mean under a hat of one sample on either side, exact for cubics (Numerov)
FFT_PADDING = 16  # length of a transform over the number of taps: what wraps around is as small as what is cut off


def smoothing_taps(taps: Float[np.ndarray, " n_tap"], order: int, method: str) -> Float[np.ndarray, " n_tap"]:
    """Return the weights s of a filter's taps c; order m is 0, 1 or 2, and a cubic x⁽ᵐ⁾ is exact.

    A Savitzky–Golay filter passes slow signals only, which are cubics between samples. A band-limited one may pass
    nearly all up to half the sampling rate, where a cubic is 15 % off; its taps fall to zero at their ends, so that s
    is computed from its transfer function.
    """
    if order == 0:
        return taps
    return _by_transfer(taps, order) if method == "bandlimited" else _by_parts(taps, order)


def _by_parts(taps: np.ndarray, order: int) -> np.ndarray:
    """Return s by summation by parts, x⁽ᵐ⁾ locally cubic.

    Σ c_k x_{n+k} = Σ_j C_j (x_{j+1} − x_j) with C the cumulative sums of −c, each difference the integral of ẋ
    between two samples; of the second order twice, x_{j+1} − 2 x_j + x_{j−1} being the integral of ẍ under a hat.
    """
    if order == 2:
        # Σ_k c_k x_k = Σ_j K_j (x_{j+1} − 2 x_j + x_{j−1})
        return np.convolve(np.cumsum(np.cumsum(taps))[:-2], HAT)
    between = -np.cumsum(taps)[:-1]
    weights = np.convolve(between[1:-1], BETWEEN)
    weights[:3] += between[0] * AT_END
    weights[-3:] += between[-1] * AT_END[::-1]
    return weights


def _by_transfer(taps: np.ndarray, order: int) -> np.ndarray:
    """Return s_k = (1/π) ∫_0^π C(ω) / (iω)^m cos(ω k) dω, C(ω) = Σ_k c_k exp(iωk), with the moments of cubics exact.

    What lies beyond the window is left out: 1e-5 of a rate, 2e-4 where the transition ends at half the sampling rate.
    """
    half = len(taps) // 2
    k = np.arange(-half, half + 1)
    degrees = np.arange(4)
    # Of x = (k / half)^(p + m), whose derivative is (p + m)! / p! (k / half)^p / half^m
    factors = np.array([math.perm(p + order, order) for p in degrees]) / half**order
    moments = taps @ (k / half)[:, None] ** (degrees + order) / factors
    n = FFT_PADDING * len(taps)
    omega = 2.0 * np.pi * np.arange(n // 2 + 1) / n
    # The transform has the opposite sign of ω, hence the conjugate; the roll puts the centre tap first.
    transfer = np.conj(np.fft.rfft(np.roll(np.pad(taps, (0, n - len(taps))), -half)))
    response = np.concatenate([moments[:1], np.real(transfer[1:] / (1j * omega[1:]) ** order)])
    mean = np.fft.irfft(response, n)[k]
    powers = (k / half)[:, None] ** degrees
    return mean + powers @ np.linalg.solve(powers.T @ powers, moments - powers.T @ mean)
