"""Noise on samples: found without bias where it is, never where it is not."""

import numpy as np
import pytest
from sampled_paths import STEP, noise_of, path, paths, runs, steps

from bayes_greybox.data.samples.sample_noise import FEWEST_DIFFERENCES, NOISELESS_SHARE, sample_noise
from bayes_greybox.data.trajectories import Trajectories


@pytest.mark.parametrize("name", paths())
@pytest.mark.parametrize("rounded", [None, 1e-9])
def test_exact_paths_of_many_shapes_are_never_noisy(name, rounded):
    x = paths()[name]
    x = x if rounded is None else np.round(x / rounded) * rounded
    assert sample_noise(np.arange(len(x)) * STEP, x[:, None], [len(x)])[0] == 0.0


@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize(("dt", "noise"), [(0.02, 1e-4), (0.1, 0.01), (0.3, 0.1)])
def test_the_noise_of_samples_is_found_without_bias(dt, noise, uneven):
    found = []
    for seed in range(40):
        t = steps(600, dt, np.random.default_rng(seed) if uneven else None)
        found.append(noise_of(runs([t], noise, seed))[0])
    # One estimate is 5 % off at most; false failure of the mean of 40 beyond 3 %: 1e-4.
    assert np.mean(found) == pytest.approx(noise, rel=0.03)


@pytest.mark.parametrize("dt", [0.01, 0.1, 0.3])
@pytest.mark.parametrize("n", [30, 600])
def test_exact_states_have_no_noise(dt, n):
    assert noise_of(runs([steps(n, dt)]))[0] == 0.0


def test_rounding_is_no_noise_and_sizes_do_not_matter():
    t = steps(600, 0.05)
    for size in (1e-12, 1.0, 1e12):
        assert noise_of(runs([t], 0.1 * NOISELESS_SHARE, size=size))[0] == 0.0
        assert noise_of(runs([t], 0.01, size=size))[0] == pytest.approx(0.01 * size, rel=0.15)


def test_noise_is_that_of_all_runs_together_and_no_difference_spans_two():
    times = [steps(12, 0.1), 5 + steps(12, 0.1), 11 + steps(40, 0.1)]
    assert noise_of(runs(times))[0] == 0.0
    found = [noise_of(runs(times, 0.05, seed))[0] for seed in range(60)]
    assert np.mean(found) == pytest.approx(0.05, rel=0.06)


def test_each_state_has_its_own_noise():
    t = steps(600, 0.05)
    rng = np.random.default_rng(3)
    data = Trajectories.from_arrays(t, states={"x": path(t), "v": np.cos(t) + 0.02 * rng.standard_normal(600)})
    assert noise_of(data)[0] == 0.0
    assert noise_of(data)[1] == pytest.approx(0.02, rel=0.15)


def test_a_kink_of_an_exact_path_is_no_noise():
    t = steps(600, 0.05)
    x = np.sin(t) + 0.2 * np.abs(np.sin(0.3 * t))
    assert noise_of(Trajectories.from_arrays(t, states={"x": x}))[0] == 0.0


def test_too_few_samples_tell_no_noise():
    assert noise_of(runs([steps(FEWEST_DIFFERENCES, 0.1)], 0.1))[0] == 0.0


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_noise_is_seen_wherever_zero_lies_and_rounding_is_none_there(kind):
    t, rng = steps(600, 1.0), np.random.default_rng(4)
    swing, noise = 50 * np.sin(t / 50), 0.08 * rng.standard_normal(600)
    for level in (0.0, 101_325.0):
        noisy = (level + swing + noise).astype(kind).astype(float)
        exact = (level + swing).astype(kind).astype(float)
        assert sample_noise(t, noisy[:, None], [600])[0] == pytest.approx(0.08, rel=0.15)
        assert sample_noise(t, exact[:, None], [600])[0] == 0.0
    north = 5_328_000 + 2 * np.sin(t / 20) + 0.5 * rng.standard_normal(600)
    assert sample_noise(t, north[:, None], [600])[0] == pytest.approx(0.5, rel=0.15)
