"""Dense matrices of the differentiators, which their fast paths and their noise are held against."""

import numpy as np

from bayes_greybox.data.rates.filters import band_per_sample, check_settings, filter_taps, kept_frequencies


def differentiation_matrix(
    n: int,
    step: float,
    order: int,
    method: str = "savgol",
    *,
    window: int | None = None,
    polyorder: int | None = None,
    band: float | None = None,
):
    """Dense matrix G of a differentiator for one run, so that the derivative rows are G x.

    Args:
        n: samples of the run.
        step: sample spacing.
        order: order of the derivative, 0 for the smoothing filter.
        method: "savgol", "bandlimited" or "spectral".
        window: as in `filter_taps`.
        polyorder: as in `filter_taps`.
        band: edge of the pass band in cycles per unit of time.

    Returns:
        G with one row for each row that is not an edge, (n_row, n).

    Raises:
        InputError: if the settings do not fit each other.
    """
    check_settings(method, window, polyorder, band)
    if method == "spectral":
        kept = kept_frequencies(n, step, band, "0")
        omega = 2.0 * np.pi * np.arange(1, kept + 1) / (n * step)
        lag = (np.arange(n)[:, None] - np.arange(n)[None, :]) * step
        # G_ij = (2/n) Σ_k ω_k^m cos(ω_k (t_i − t_j) + m π/2), and the mean for m = 0
        phase = lag[:, :, None] * omega + order * np.pi / 2.0
        return 2.0 / n * np.cos(phase) @ omega**order + (1.0 / n if order == 0 else 0.0)
    if method == "bandlimited":
        band = band_per_sample(band, [step], ["0"])
    taps = filter_taps(order, method, window=window, polyorder=polyorder, band=band) / step**order
    matrix = np.zeros((n - len(taps) + 1, n))
    for row in range(len(matrix)):
        matrix[row, row : row + len(taps)] = taps
    return matrix
