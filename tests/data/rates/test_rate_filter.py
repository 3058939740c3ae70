"""What a filter makes of the true rate: the mean that terms must go through, and rows thinned to its bandwidth."""

import numpy as np
import pytest

from bayes_greybox.data.noise.banded import fir_noise
from bayes_greybox.data.rates.filters import filter_taps
from bayes_greybox.data.rates.rate_filter import RateFilter, RowOperator
from bayes_greybox.data.trajectories import Trajectories, with_filter_of
from bayes_greybox.running.errors import InputError


def test_rows_are_windows_every_so_many_samples():
    weights = np.random.default_rng(0).standard_normal(5)
    operator = RowOperator(weights, 3, (17, 4, 5, 11))
    table = np.random.default_rng(1).standard_normal((37, 2))
    centres = np.array([2, 5, 8, 11, 14, 23, 28, 31, 34])
    assert operator.row_lengths == (5, 0, 1, 3)
    np.testing.assert_array_equal(operator.sample, centres)
    expected = np.array([weights @ table[c - 2 : c + 3] for c in centres])
    np.testing.assert_allclose(operator(table), expected, atol=1e-13)
    for most in (1, 8, 11):
        parts = [operator.smooth(table[piece]) for piece in operator.pieces(most)]
        np.testing.assert_allclose(np.concatenate(parts), expected, atol=1e-13)


def test_the_noise_of_the_rows_is_that_of_every_so_many():
    taps = filter_taps(2, "savgol", window=9, polyorder=4)
    noise, operator = fir_noise(taps, 2, [30, 6, 25], [0.1, 0.1, 0.1]), RowOperator(taps, 2, (30, 6, 25))
    thinned = operator.noise(noise)
    whole = noise.covariance()[np.ix_(operator.sample, operator.sample)]
    np.testing.assert_allclose(thinned.scale**2 * thinned.covariance(), noise.scale**2 * whole, rtol=1e-12)
    assert thinned.run_lengths == (11, 9)


def sampled(n=400, step=0.01, seed=0):
    t = step * np.arange(n)
    y = np.sin(3 * t) + 0.001 * np.random.default_rng(seed).standard_normal(n)
    return Trajectories.from_arrays(t, states={"y": y})


def test_rows_are_so_far_apart_that_their_noise_has_lost_its_correlation():
    data = sampled().differentiate(window=41, rates={"y": "v"})
    correlation = data.noise["v"].autocorrelation
    assert correlation[data.filter.every] <= np.exp(-1) < correlation[data.filter.every - 1]


def test_held_out_data_take_the_filter_of_the_training_data():
    train, test = sampled().differentiate(rates={"y": "v"}), sampled(seed=1, n=250)
    filtered = test.differentiate(like=train)
    assert filtered.filter == train.filter and set(filtered.derivatives) == {"y", "v"}
    np.testing.assert_array_equal(with_filter_of(test, train).states["v"], filtered.states["v"])
    assert with_filter_of(filtered, train) is filtered
    with pytest.raises(InputError, match="one filter for both"):
        with_filter_of(test.differentiate(rates={"y": "v"}, window=7), train)
    with pytest.raises(InputError, match="leave the others out"):
        test.differentiate(like=train, window=7)
    with pytest.raises(InputError, match="were not differentiated"):
        test.differentiate(like=test)
    with pytest.raises(InputError, match="the filter was made for"):
        sampled(step=0.02).differentiate(like=train)
    again = Trajectories.from_frame(train.to_frame(), **train.metadata())
    assert again.filter == train.filter == RateFilter.from_dict(train.filter.to_dict())


def test_the_noise_of_rates_does_not_depend_on_the_order_of_runs():
    parts = [sampled(), sampled(step=0.04, seed=1)]

    def noise(parts):
        data = Trajectories.from_arrays(
            [part.time for part in parts], states={"y": [part.states["y"] for part in parts]}
        ).differentiate(window=11, rates={"y": "v"})
        return data.filter.noise_of_states(data.row_steps)["v"], data.filter.noise_of_rate("v", data.row_steps)

    first, other = noise(parts), noise(parts[::-1])
    np.testing.assert_allclose(first, other, rtol=1e-6)
    # Half of the rows are four times as noisy, sixteen times for the second derivative.
    fine, coarse = (noise([part, part]) for part in parts)
    for both, own, less, power in zip(first, fine, coarse, (1, 2), strict=True):
        assert both / own == pytest.approx(np.sqrt((1 + 16.0**-power) / 2), rel=0.15) and less < 0.5 * own
