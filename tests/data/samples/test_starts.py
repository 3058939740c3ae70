"""Starts from noisy samples: the noise of a state, and the value at the first sample with its error."""

import numpy as np
import pytest
from sampled_paths import noise_of, path, runs, steps

from bayes_greybox.data.samples.starts import Starts, estimate_starts
from bayes_greybox.data.trajectories import Trajectories


def errors(dt, noise, count=150, n=600, uneven=False):
    """(x̂₀ − x₀)/s₀ over records of other noise and phase, and the mean of s₀/s."""
    z, widths = [], []
    for seed in range(count):
        rng = np.random.default_rng(1000 + seed)
        t, phase = steps(n, dt, rng if uneven else None), rng.uniform(0, 2 * np.pi)
        found = estimate_starts(runs([t], noise, seed, phase=phase))
        z.append((found.mean[0, 0] - path(t, phase)[0]) / found.sd[0, 0])
        widths.append(found.sd[0, 0] / noise)
    return np.array(z), float(np.mean(widths))


# Starts


def test_exact_starts_are_the_measured_ones_to_the_last_bit():
    data = runs([steps(100, 0.1), 3 + steps(50, 0.1)])
    found = estimate_starts(data)
    np.testing.assert_array_equal(found.mean, [[data.states["x"][0]], [data.states["x"][100]]])
    assert found.exact and not found.sd.any()
    np.testing.assert_array_equal(found.draws(3, np.random.default_rng(0)), np.tile(found.mean, (3, 1, 1)))


@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize(("dt", "noise"), [(0.02, 0.1), (0.02, 1e-3), (0.1, 0.03), (0.4, 0.01)])
def test_starts_are_unbiased_and_their_intervals_cover(dt, noise, uneven):
    z, _ = errors(dt, noise, uneven=uneven)
    # The mean of 150 is within 0.33 at four standard errors; coverage of 90 % is 0.81 to 0.97 at three and a half.
    assert abs(z.mean()) < 0.33
    assert 0.81 < np.mean(np.abs(z) < 1.645) < 0.97


def test_a_path_that_is_slow_against_the_sampling_makes_a_start_surer():
    assert errors(0.005, 0.1, 20)[1] < 0.7
    assert 0.9 < errors(0.4, 1e-3, 20)[1] < 1.1


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_a_run_too_short_for_a_fit_starts_at_its_sample_with_the_noise_of_the_others(n):
    data = runs([steps(600, 0.05), 7 + steps(n, 0.05)], 0.05)
    found = estimate_starts(data)
    assert found.mean[1, 0] == data.states["x"][600]
    assert found.sd[1, 0] == noise_of(data)[0] > 0


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 9])
def test_short_runs_alone_start_at_their_sample(n):
    data = runs([steps(n, 0.1)], 0.1)
    found = estimate_starts(data)
    assert found.mean[0, 0] == data.states["x"][0] and found.exact


def test_five_rows_are_enough_for_a_fit():
    data = runs([steps(600, 0.01), 7 + steps(5, 0.01)], 0.05)
    found = estimate_starts(data)
    assert found.mean[1, 0] != data.states["x"][600]
    # The leverage of the first of five samples under a cubic is 69/70.
    assert found.sd[1, 0] == pytest.approx(np.sqrt(69 / 70) * noise_of(data)[0], rel=0.01)


def test_a_jolt_at_the_start_keeps_the_window_short():
    t = steps(600, 0.01)
    rng = np.random.default_rng(0)
    jolt = np.exp(-t / 0.03)
    data = Trajectories.from_arrays(t, states={"x": path(t) + jolt + 0.02 * rng.standard_normal(600)})
    found = estimate_starts(data)
    assert abs(found.mean[0, 0] - 1.0) < 4 * found.sd[0, 0]


def test_draws_have_the_mean_and_the_spread_they_say():
    starts = Starts(np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[0.1, 0.0], [0.3, 0.2]]))
    draws = starts.draws(20_000, np.random.default_rng(0))
    np.testing.assert_allclose(draws.mean(axis=0), starts.mean, atol=0.01)
    np.testing.assert_allclose(draws.std(axis=0), starts.sd, atol=0.005)
    assert np.all(draws[:, 0, 1] == 2.0)
