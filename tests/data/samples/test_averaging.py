"""Averages of neighbouring samples: what they keep, what they lose, and when they are taken."""

import numpy as np
import pytest

from bayes_greybox import Trajectories
from bayes_greybox.data.samples.averaging import ENOUGH, averaged, longest_block

T = np.linspace(0.0, 60.0, 6001)
"""A hundred samples a period of one second and sixty."""


def of(values, **more):
    return Trajectories.from_arrays(T, states={"x": values}, **more)


def wave(period, sd, seed=3):
    return np.sin(2 * np.pi * T / period) + sd * np.random.default_rng(seed).standard_normal(len(T))


def test_an_average_is_the_motion_at_its_mean_time_to_fourth_order():
    found = [averaged(of(wave(1.0, 0.0)), m) for m in (4, 8)]
    errors = [np.max(np.abs(d.states["x"] - np.sin(2 * np.pi * d.time))[2:-2]) for d in found]
    # The mean itself is off by (π m/100)²/6.
    assert errors[0] < 0.1 * (0.04 * np.pi) ** 2 / 6
    assert errors[1] / errors[0] == pytest.approx(16, rel=0.15)


def test_noise_of_averages_is_less_by_the_root_of_their_number():
    noise = averaged(of(wave(1.0, 0.05)), 5).states["x"] - averaged(of(wave(1.0, 0.0)), 5).states["x"]
    # Second differences put back (1 + 1/12)² + 2/24² of the variance.
    expected = 0.05 / np.sqrt(5) * np.sqrt((1 + (1 - 1 / 25) / 12) ** 2 + 2 * ((1 - 1 / 25) / 24) ** 2)
    assert np.std(noise) == pytest.approx(expected, rel=0.1)


def test_uneven_steps_are_averaged_at_their_mean_time():
    t = np.cumsum(np.random.default_rng(1).uniform(0.005, 0.015, 4000))
    found = averaged(Trajectories.from_arrays(t, states={"x": np.sin(2 * np.pi * t)}), 4)
    np.testing.assert_allclose(found.time, t.reshape(-1, 4).mean(axis=1))
    true = np.sin(2 * np.pi * found.time)
    plain = np.max(np.abs(np.sin(2 * np.pi * t).reshape(-1, 4).mean(axis=1) - true))
    # What uneven steps leave is of third order.
    assert np.max(np.abs(found.states["x"] - true)[2:-2]) < 0.2 * plain


def test_a_slow_noisy_motion_is_averaged_and_enough_is_left():
    block = longest_block(of(wave(10.0, 0.05)))
    assert 3 <= block <= 6001 // ENOUGH
    assert averaged(of(wave(10.0, 0.05)), block).n_obs == 6001 // block


def test_blocks_are_short_against_what_moves():
    # Blocks of a tenth of a period lose 0.075 (π/10)⁴ of it, in the noise of a tenth of a per cent.
    assert longest_block(of(wave(0.2, 0.001))) == 1
    assert 1 < longest_block(of(wave(1.0, 0.001))) < 6001 // ENOUGH


def test_states_without_noise_are_not_averaged():
    assert longest_block(of(wave(10.0, 0.0))) == 1


@pytest.mark.parametrize(
    "u",
    [
        np.sin(T),
        np.random.default_rng(2).standard_normal(len(T)),
        np.where(np.arange(len(T)) % 2, 1.0, -1.0),
        np.repeat(np.random.default_rng(4).choice([-1.0, 1.0], len(T) // 5 + 1), 5)[: len(T)],
        (np.arange(len(T)) // 500 % 2).astype(float),
    ],
    ids=["slow", "white", "alternating", "held", "steps"],
)
def test_nothing_is_averaged_beside_an_input_that_changes(u):
    assert longest_block(of(wave(10.0, 0.05), inputs={"u": u})) == 1


def test_outliers_spoil_averages():
    hit = np.where(np.random.default_rng(5).random(len(T)) < 0.03, 1.0, 0.0)
    assert longest_block(of(wave(10.0, 0.05) + hit)) == 1


def test_no_block_reaches_over_a_gap():
    late = T + np.where(np.arange(len(T)) > 3001, 2.8, 0.0)
    data = Trajectories.from_arrays(late, states={"x": np.sin(0.2 * np.pi * late) + wave(10.0, 0.05) - wave(10.0, 0.0)})
    assert longest_block(data) == 1


def test_held_out_samples_lose_nothing_either():
    data, later = of(wave(10.0, 0.05)), wave(10.0, 0.05, seed=9)[:2000]
    alike = Trajectories.from_arrays(T[:2000], states={"x": later})
    assert longest_block(data, alike) == longest_block(data)
    sparse = Trajectories.from_arrays(T[::25], states={"x": wave(2.0, 0.05)[::25]})
    assert longest_block(data, sparse) == 1
    faster = Trajectories.from_arrays(T[:2000], states={"x": wave(0.1, 0.05)[:2000]})
    assert longest_block(data, faster) < longest_block(data)
    brief = Trajectories.from_arrays(T[:7], states={"x": later[:7]})
    assert longest_block(data, brief) == 1


def test_an_input_that_stays_is_no_obstacle():
    assert longest_block(of(wave(10.0, 0.05), inputs={"u": np.full(len(T), 2.0)}, constant="keep")) > 1


def test_a_sensor_at_its_end_is_not_averaged():
    assert longest_block(of(np.minimum(wave(10.0, 0.05), 0.8))) == 1


def test_short_records_and_measured_rates_stay_as_they_are():
    short = Trajectories.from_arrays(T[:1500], states={"x": wave(10.0, 0.05)[:1500]})
    assert longest_block(short) == 1
    assert longest_block(of(wave(10.0, 0.05), derivatives={"x": np.cos(T)})) == 1


def test_runs_are_averaged_each_by_itself():
    data = Trajectories.from_arrays(
        [T[:2003], T[:2002]], states={"x": [wave(10.0, 0.05)[:2003], 7 + wave(10.0, 0.05)[:2002]]}
    )
    found = averaged(data, 4)
    assert list(found.run_lengths) == [500, 500] and found.dropped == 3 + 2
    assert np.all(found.states["x"][found.run == 1] > 5)
    assert "averaged, 4 at a time" in found.remarks[-1]
