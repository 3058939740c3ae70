"""The mean that terms go through: what a filter makes of a rate, up to half the sampling rate if it is band-limited."""

import numpy as np
import pytest

from bayes_greybox.data.rates.filters import filter_taps
from bayes_greybox.data.rates.smoothing import smoothing_taps


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize(
    "settings", [{"method": "savgol", "window": 21, "polyorder": 4}, {"method": "bandlimited", "band": 0.1}]
)
def test_a_filtered_rate_is_the_mean_of_the_true_one(order, settings):
    taps = filter_taps(order, **settings)
    weights = smoothing_taps(taps, order, settings["method"])
    assert len(weights) == len(taps) and weights.sum() == pytest.approx(1, abs=1e-6)
    omega, k = 0.15, np.arange(len(taps))
    wave, rate = np.sin(omega * k + 0.3), omega**order * np.sin(omega * k + 0.3 + order * np.pi / 2)
    # Where the derivative is no cubic between samples: 11/720 ω⁴ and less
    assert taps @ wave == pytest.approx(weights @ rate, abs=2e-5 * omega**order)
    cubic = (k - 3.0) ** (3 + order)
    factor = np.prod(np.arange(4, 4 + order))
    assert taps @ cubic == pytest.approx(factor * weights @ (k - 3.0) ** 3, rel=1e-7)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("band", [0.1, 0.2, 0.3, 0.4])
def test_a_band_limited_filter_treats_rates_and_terms_alike_at_every_frequency(order, band):
    taps = filter_taps(order, "bandlimited", band=band)
    weights = smoothing_taps(taps, order, "bandlimited")
    omega, k = np.linspace(0.01, 3.1, 200), np.arange(len(taps)) - len(taps) // 2
    waves = np.exp(1j * np.outer(omega, k))
    # The taps are exact to 80 dB, and the weights' to as much.
    np.testing.assert_allclose(waves @ weights, waves @ taps / (1j * omega) ** order, atol=2e-4)
