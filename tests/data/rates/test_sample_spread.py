"""What smoothed samples stand for: means over jumps, values where terms are smooth."""

import numpy as np
import pytest
from scipy.stats import norm

from bayes_greybox.data.rates.sample_spread import SampleSpread


def spread_of(v, noise, **more):
    return SampleSpread.of({"v": v, **more}, (len(v),), noise)


def test_a_jump_is_its_mean_over_the_noise():
    # Neighbours so close that only the noise counts.
    v = np.linspace(-1e-3, 1e-3, 4001)
    spread = spread_of(v, {"v": 3e-4})
    found = spread.mean(lambda c: np.sign(c["v"])[:, None], spread.beside({"v": v}))[:, 0]
    assert np.abs(found - (2 * norm.cdf(v / 3e-4) - 1)).max() < 2 / 64


@pytest.mark.parametrize("noise", [{}, {"v": 0.02}, {"v": 0.1}])
def test_falling_crossings_are_as_rising_ones(noise):
    v = 0.1 * (np.arange(-10, 11) - 0.3)
    rising, falling = (
        spread.mean(lambda c: np.sign(c["v"])[:, None], spread.beside({"v": own}))
        for own in (v, -v)
        for spread in (spread_of(own, noise),)
    )
    assert np.abs(rising[7:13]).min() < 0.9
    # 64 points of a plane leave a discrepancy of about log 64 / 64 of an area.
    assert np.abs(rising + falling).max() < 2 * np.log(64) / 64


def test_a_jump_is_the_share_of_the_step_on_either_side():
    v = 0.1 * (np.arange(-10, 11) - 0.3)
    spread = spread_of(v, {})
    found = spread.mean(lambda c: np.sign(c["v"])[:, None], spread.beside({"v": v}))[:, 0]
    # From -0.08 to 0.02 crosses zero after four fifths of a step; the sample at -0.03 stands for -0.08 to 0.02.
    expected = np.clip(2 * v / 0.1, -1, 1)
    assert np.abs(found - expected).max() < 2 / 64
    assert abs(found[10] + 0.6) < 2 / 64


def test_a_stepped_input_takes_no_values_that_it_never_had():
    u = np.repeat([1.0, -1.0, 1.0, -1.0], 5)
    spread = spread_of(u, {})
    found = spread.mean(lambda c: np.heaviside(c["v"] - 1.2, 0.5)[:, None], spread.beside({"v": u}))
    assert not found.any()


def test_away_from_jumps_values_are_untouched():
    t = np.linspace(0, 20, 2001)
    v, y = np.cos(3 * t), np.sin(3 * t) / 3
    spread = spread_of(v, {"v": 2e-3, "y": 1e-3}, y=y)

    def evaluate(c):
        return np.stack([1 + np.sign(c["v"] + 2), c["y"] * np.abs(c["y"]) + 1], axis=1)

    columns = {"v": v, "y": y}
    assert np.array_equal(spread.mean(evaluate, spread.beside(columns)), evaluate(columns))


def test_a_jump_in_a_difference_of_noisy_states_is_seen():
    # Their difference is zero within the noise, and a move of both at once shows nothing of it.
    y = np.linspace(-1, 1, 501)
    spread = spread_of(y + 1e-4, {"v": 1e-2, "y": 1e-2}, y=y)
    columns = {"v": y + 1e-4, "y": y}
    found = spread.mean(lambda c: np.sign(c["v"] - c["y"])[:, None], spread.beside(columns))[:, 0]
    # 64 points of a plane leave a discrepancy of about (log 64)² / 64 of an area.
    assert np.abs(found - (2 * norm.cdf(1e-4 / (np.sqrt(2) * 1e-2)) - 1)).max() < 2 * np.log(64) ** 2 / 64


def test_runs_do_not_reach_into_each_other():
    v = np.array([1.0, 1.1, 1.2, -5.0, -5.1, -5.2, 7.0])
    spread = SampleSpread.of({"v": v}, (3, 3, 1), {"v": np.inf})
    assert np.allclose(spread.ahead["v"], [0.1, 0.1, 0.0, -0.1, -0.1, 0.0, 0.0])
    assert np.allclose(spread.behind["v"], [0.0, 0.1, 0.1, 0.0, -0.1, -0.1, 0.0])
    assert not spread.noise


def test_a_term_that_ends_nearby_keeps_its_value():
    v = np.linspace(1e-3, 1, 300)
    spread = spread_of(v, {"v": 5e-2})
    found = spread.mean(lambda c: np.sqrt(c["v"])[:, None], spread.beside({"v": v}))[:, 0]
    assert np.allclose(found[:3], np.sqrt(v[:3])) and np.all(np.isfinite(found))


def test_no_samples_and_no_columns():
    spread = spread_of(np.zeros(5), {"v": 0.1})
    assert spread.mean(lambda c: np.zeros((len(c["v"]), 0)), spread.beside({"v": np.zeros(5)})).shape == (5, 0)


def test_what_is_linear_does_not_bend():
    u, v = np.repeat([1.0, -1.0, 1.0, -1.0], 5), np.sin(np.arange(20.0))
    spread = spread_of(u, {"y": 0.3}, y=v)
    columns = {"v": u, "y": v}
    assert spread.bends(lambda c: (2 * c["v"] - c["y"])[:, None], columns).max() < 1e-14
    assert spread.bends(lambda c: np.sign(c["y"])[:, None], columns).max() > 0.9


@pytest.mark.parametrize("power", ["y**2", "y**3", "y*abs(y)"])
def test_what_is_smooth_does_not_bend_however_far_the_samples_are_apart(power):
    # Eleven samples a turn, as of a resonance near the end of a recorder's band.
    y = np.sin(2 * np.pi * np.arange(400) / 11.3)
    spread = spread_of(y, {"v": 0.01})
    columns = {"v": y}
    of = {"y**2": lambda y: y**2, "y**3": lambda y: y**3, "y*abs(y)": lambda y: y * np.abs(y)}[power]
    # Where a function is odd about the middle its second difference is next to none, and no measure of its parts.
    assert spread.bends(lambda c: of(c["v"])[:, None], columns).max() < 0.05
    bent = {"a kink": np.abs, "a jump": np.sign, "a dead zone": lambda y: np.sign(y) * np.maximum(np.abs(y) - 0.5, 0)}
    for each in bent.values():
        assert np.mean(spread.bends(lambda c, each=each: each(c["v"])[:, None], columns) > 0.05) > 0.1


def test_a_jump_is_found_beside_what_is_larger():
    v = 0.1 * (np.arange(-10, 11) - 0.3)
    spread = spread_of(v, {})
    columns = spread.beside({"v": v})
    both = spread.mean(lambda c: (np.sign(c["v"]) + 9)[:, None], columns, lambda c: np.sign(c["v"])[:, None])
    assert np.array_equal(both - 9, spread.mean(lambda c: np.sign(c["v"])[:, None], columns))


def test_what_is_linear_beside_a_kink_has_its_value_at_the_sample():
    # A rough input changes its sign within a step; a mean over that step would be another, smoother input.
    u = np.random.default_rng(0).standard_normal(400)
    spread, limit = spread_of(u, {}), 1e-3
    found = spread.mean(
        lambda c: (np.sign(c["v"]) * np.maximum(np.abs(c["v"]) - limit, 0))[:, None], spread.beside({"v": u})
    )
    inside = slice(1, -1)
    assert np.abs(found[inside, 0] - u[inside]).max() <= limit + 1e-12


@pytest.mark.parametrize("exponent", [0.5, 1.0, 1.5, 2.0, 2.98])
def test_a_power_has_its_value_at_the_sample_even_where_it_is_written_with_a_sign(exponent):
    y = np.sin(2 * np.pi * np.arange(400) / 11.3)
    spread, columns = spread_of(y, {"v": 0.01}), {"v": y}

    def power(c):
        return (np.sign(c["v"]) * np.abs(c["v"]) ** exponent)[:, None]

    assert np.array_equal(spread.mean(power, spread.beside(columns)), power(columns))


def test_a_jump_that_only_the_sample_itself_reaches_is_found():
    v = np.array([0.0, 1.0, 0.0, 0.0, 0.0])
    spread = spread_of(v, {})
    found = spread.mean(lambda c: np.heaviside(c["v"] - 0.95, 0.5)[:, None], spread.beside({"v": v}))[:, 0]
    # Points are 5/4 - |tau|, their mean the sample: above 0.95 are those with |tau| < 0.3.
    assert abs(found[1] - 0.6) < 2 / 64 and not found[2:].any()


@pytest.mark.parametrize("n_sum", [1, 2, 3])
def test_sums_are_means_where_any_of_their_parts_jumps(n_sum):
    v = 0.1 * (np.arange(-10, 11) - 0.3)
    spread = spread_of(v, {})

    def parts(c):
        return np.sign(np.stack([c["v"], c["v"] - 0.5, c["v"] + 4], axis=1))

    def sums(c):
        return np.tile(parts(c).sum(axis=1, keepdims=True), n_sum)

    columns = spread.beside({"v": v})
    found = spread.mean(sums, columns, parts)
    assert np.allclose(found, np.tile(spread.mean(parts, columns).sum(axis=1, keepdims=True), n_sum))
