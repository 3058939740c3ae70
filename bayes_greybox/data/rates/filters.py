"""Filters that differentiate evenly spaced samples: Savitzky–Golay, windowed sinc, Fourier."""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.signal import savgol_coeffs
from scipy.signal.windows import kaiser
from scipy.special import ive

from bayes_greybox.running.errors import InputError

METHODS = ("savgol", "bandlimited", "spectral")
ATTENUATION_DB = 80.0  # stop-band attenuation of the band-limited filter
# A step this many times the usual one is a gap, in which interpolation would invent samples. Stamps that must be even
# have no such step by chance. Where they may be uneven, a run goes on across it, and begins anew after a longer one.
GAP_STEPS = 4.0
STEP_TOLERANCE = 1e-3  # largest relative deviation from the mean spacing, beside the rounding of the stamps
UNDERSMOOTHING = 0.75  # factor on the window that cross-validation finds, see `savgol_window`


def step_slack(time: Float[np.ndarray, " n"], step: float) -> float:
    """Return the largest deviation of steps from an even step h that still counts as even, ε h + 2 ulp(max |t|).

    Stamps that count from far away, as seconds since 1970 do, are rounded to parts of a step that matter.
    """
    return STEP_TOLERANCE * step + 2.0 * float(np.spacing(np.max(np.abs(time), initial=0.0)))


def filter_taps(
    order: int, method: str = "savgol", *, window: int | None = None, polyorder: int | None = None,
    band: float | None = None,
) -> Float[np.ndarray, " n_tap"]:  # fmt: skip
    """Return taps c of a finite impulse response differentiator for unit sample spacing.

    The filtered row is d_n = Σ_k c_k x_{n+k}, k = −w/2 … w/2; divide by step^order for other spacings.

    "savgol" is the derivative at the centre of the least-squares polynomial through the window (Savitzky &
    Golay 1964, Anal. Chem. 36:1627). "bandlimited" is the inverse transform of (iω)^order over the pass band,
    under a Kaiser window, with the lowest moments corrected so that cubics are differentiated exactly.
    The window is an odd number of taps, chosen from the band for "bandlimited"; polyorder is 3 by default (order 0
    and 1) or 4, and band the edge of the pass band in cycles per sample, below 0.5.
    """
    if method == "savgol":
        degree = polyorder if polyorder is not None else (3 if order < 2 else 4)
        if window is None:
            raise InputError("Savitzky–Golay taps need a window.")
        if degree < order:
            raise InputError(f"polyorder {degree} cannot give derivative {order}; use {order + 2} or more.")
        if window % 2 == 0 or window <= degree:
            raise InputError(f"The window must be odd and above polyorder {degree}, not {window}.")
        return np.asarray(savgol_coeffs(window, degree, deriv=order, use="dot"), dtype=float)
    if order not in (0, 1, 2):
        raise InputError(f"Band-limited filters give derivatives of order 0, 1 and 2, not {order}.")
    if band is None or not 0.0 < band < 0.5:
        raise InputError(f"band must lie between 0 and half the sampling rate, not {band} cycles per sample.")
    if window is None:
        # The odd number of taps for the attenuation and transition (Oppenheim & Schafer 2010, eq. 7.76).
        window = math.ceil((ATTENUATION_DB - 8.0) / (2.285 * 2.0 * np.pi * _transition(band)) / 2.0) * 2 + 1
    return _kaiser_taps(order, window, band)


def spectral_derivative(values: Float[np.ndarray, " n"], step: float, order: int, kept: int) -> Float[np.ndarray, " n"]:
    """Differentiate whole periods of even samples by (iω)^order in Fourier space; the first `kept` frequencies stay."""
    n = len(values)
    spectrum = np.fft.rfft(values)
    spectrum[kept + 1 :] = 0.0
    omega = 2.0 * np.pi * np.arange(n // 2 + 1) / (n * step)
    return np.fft.irfft((1j * omega) ** order * spectrum, n=n)


def savgol_window(series: Sequence[Sequence[Float[np.ndarray, " _"]]], polyorder: int) -> int:
    """Choose the window of the Savitzky–Golay smoother by generalised cross-validation, shortened by a quarter.

    Cross-validation minimises Σ_columns log [ mean(r²) / (1 − c_0)² ], r the residual of the smoothed
    samples and c_0 the centre tap (the trace of the smoother per row), over rows that every
    candidate can filter (Craven & Wahba 1979, Numer. Math. 31:377). For a local polynomial this is leave-one-out
    prediction of the centre sample. It assumes noise that is white from sample to sample.

    That window balances noise against truncation error. The covariance of the rows accounts for noise only, so the
    window returned is UNDERSMOOTHING times as long: the truncation error of a second derivative falls by two thirds,
    its noise doubles and is known. It is odd, at most a third of the shortest run and 401; a run too short for any is
    refused. `series` has the runs of each column.
    """
    smallest = polyorder + 2 + (polyorder + 1) % 2
    shortest = min(len(values) for runs in series for values in runs)
    largest = min(max(shortest // 3, smallest), 401)
    if shortest < smallest + 2:
        raise InputError(
            f"The shortest run has {shortest} rows, too few to choose a window (at least {smallest + 2} for "
            f"polyorder {polyorder}); leave the run out (in a file leave_out) or lower polyorder."
        )
    grid = np.unique(np.round(np.geomspace(smallest, largest, 32)).astype(int) // 2 * 2 + 1)
    candidates = [int(w) for w in grid if smallest <= w <= max(largest, smallest)]
    half = candidates[-1] // 2
    scores = []
    for candidate in candidates:
        taps = filter_taps(0, "savgol", window=candidate, polyorder=polyorder)
        trim, score = half - candidate // 2, 0.0
        # A column of zeros has no information on the window.
        for runs in (runs for runs in series if any(np.any(values) for values in runs)):
            smooth = [np.correlate(values, taps, "valid") for values in runs]
            pairs = zip(runs, smooth, strict=True)
            residual = np.concatenate([x[half : len(x) - half] - y[trim : len(y) - trim] for x, y in pairs])
            # The floor keeps noise-free data, whose residual is rounding error, from a log of zero.
            floor = np.finfo(float).eps ** 2 * float(np.mean(np.concatenate(list(runs)) ** 2))
            square = max(float(np.mean(residual**2)) + floor, np.finfo(float).tiny)
            score += math.log(square / (1.0 - taps[candidate // 2]) ** 2)
        scores.append(score)
    return max(smallest, round(UNDERSMOOTHING * candidates[int(np.argmin(scores))]) // 2 * 2 + 1)


def check_settings(method: str, window: int | None, polyorder: int | None, band: float | None) -> None:
    """Refuse settings that the method does not have."""
    if method not in METHODS:
        raise InputError(f"There is no differentiator {method!r}; there are {', '.join(METHODS)}.")
    if method == "savgol" and band is not None:
        raise InputError("band does not apply to method='savgol'; give window, or use method='bandlimited'.")
    if method != "savgol" and polyorder is not None:
        raise InputError(f"polyorder does not apply to method={method!r}; leave it out.")
    if method == "spectral" and window is not None:
        raise InputError("window does not apply to method='spectral', which uses the whole record; leave it out.")
    if band is not None and not band > 0.0:
        raise InputError(f"band must be positive, not {band}.")


def kept_frequencies(n: int, step: float, band: float | None, name: str) -> int:
    """Return the number of kept frequencies; the Nyquist frequency, whose odd derivatives vanish, is never kept."""
    below_nyquist = (n - 1) // 2
    kept = below_nyquist if band is None else min(math.floor(band * n * step * (1.0 + 1e-12)), below_nyquist)
    if kept < 1:
        raise InputError(
            f'No frequency of run "{name}" lies below band = {band}; its lowest is {1.0 / (n * step):.4g} '
            "cycles per unit of time."
        )
    return kept


def band_per_sample(band: float | None, steps: Sequence[float], run_names: Sequence[str]) -> float:
    """Return the pass band in cycles per sample, the same in every run."""
    if band is None:
        raise InputError("method='bandlimited' needs band, the edge of the pass band in cycles per unit of time.")
    for step, name in zip(steps, run_names, strict=True):
        if abs(step - steps[0]) > STEP_TOLERANCE * steps[0]:
            raise InputError(
                f'Run "{name}" has the step {step:.6g} but run "{run_names[0]}" has {steps[0]:.6g}; '
                "method='bandlimited' needs one sample spacing, use method='savgol'."
            )
    if band * steps[0] >= 0.5:
        raise InputError(
            f"band = {band:g} is not below half the sampling rate, {0.5 / steps[0]:.6g} cycles per unit of time."
        )
    return band * steps[0]


def _transition(band: float) -> float:
    """Return the width of the transition, cycles per sample: half the band, but ending below the Nyquist frequency."""
    return min(0.5 * band, 0.5 - band)


def _kaiser_taps(order: int, window: int, band: float) -> np.ndarray:
    if window % 2 == 0 or window < order + 5:
        raise InputError(f"The window must be odd and at least {order + 5}, not {window}.")
    half = window // 2
    k = np.arange(-half, half + 1)
    cutoff = 2.0 * np.pi * (band + 0.5 * _transition(band))
    # Gauss's rule integrates a cosine of phase p with p/2 nodes and a few more: milliseconds, even for a narrow band
    # with thousands of taps.
    nodes, weights = np.polynomial.legendre.leggauss(math.ceil(0.5 * cutoff * half) + 32)
    omega, weight = 0.5 * cutoff * (nodes + 1.0), 0.5 * cutoff * weights
    # The Kaiser parameter for this attenuation (Oppenheim & Schafer 2010, eq. 7.75).
    beta = 0.1102 * (ATTENUATION_DB - 8.7)
    shape = kaiser(window, beta)
    response = omega**order
    if order == 2:
        # Multiplying the taps by the window adds the second moment of the window's transform to ω².
        response = response - beta * ive(1, beta) / ive(0, beta) / half**2
    # h_k = (1/π) ∫_0^ω_c ω^m cos(ω k − m π/2) dω, indexed so that d_n = Σ h_k x_{n+k}
    ideal = np.cos(np.outer(k, omega) - order * np.pi / 2.0) @ (weight * response) / np.pi
    taps = ideal * shape
    powers = (k / half)[:, None] ** np.arange(4)
    target = np.zeros(4)
    target[order] = math.factorial(order) / half**order
    correction = np.linalg.solve(powers.T @ (shape[:, None] * powers), target - powers.T @ taps)
    return taps + shape * (powers @ correction)
