"""Samples at the end of a sensor's range: found, told from coarse ones and from rest, and no rows."""

from dataclasses import replace

import numpy as np
import pytest
from sampled_oscillator import SIMULATION, sampled

import bayes_greybox as bg
from bayes_greybox.data.samples.clipping import clipped, clipped_states, seen_samples
from bayes_greybox.discovery.linearise.path_sensors import freed
from bayes_greybox.discovery.sensor_errors.channels import DRIFT, ChannelSuspect

STEP = 0.1


def test_clipped_rows_are_those_at_the_sensors_ends():
    t = np.arange(400) * STEP
    x, run = np.sin(t) + 0.3 * np.sin(2.7 * t), np.zeros(400, int)
    at_end = clipped({"x": np.clip(x, -0.8, 0.9)}, run)
    np.testing.assert_array_equal(at_end["x"], (x > 0.9) | (x < -0.8))
    unclipped = {"x": x, "constant": np.ones(400), "step": np.where(t > 10, 1.0, 0.0), "ramp": np.clip(t - 5, 0, 1)}
    assert set(clipped(unclipped, run)) <= {"ramp"}


def test_a_quantised_sensor_is_not_clipped():
    t = np.arange(2000) * 0.01
    rng = np.random.default_rng(0)
    for step in (0.02, 0.05):
        smooth = np.sin(t)
        # At a turning point a slow quantised path stays on its last level.
        noisy = smooth + 0.5 * step * rng.standard_normal(len(t))
        found = clipped({"x": np.round(noisy / step) * step}, np.zeros(len(t), int))
        assert found == {}


def test_ends_of_runs_do_not_join():
    x = np.array([0.0, 0.5, 1.0, 1.0, 1.0, 0.2, 0.1, 0.0])
    run = np.array([0, 0, 0, 0, 1, 1, 1, 1])
    assert clipped({"x": x}, run) == {}


def test_a_noiseless_state_at_rest_is_not_clipped_and_a_noisy_one_at_its_end_is():
    t, rng = np.arange(600) * STEP, np.random.default_rng(0)
    resting = bg.Trajectories.from_arrays(t, states={"x": np.maximum(np.sin(0.3 * t), 0.0)})
    assert clipped_states(resting) == {} and np.all(seen_samples(resting))
    noisy = np.sin(0.3 * t) + 0.02 * rng.standard_normal(600)
    both = bg.Trajectories.from_arrays(t, states={"x": np.minimum(noisy, 0.8), "z": np.cos(0.3 * t)})
    assert set(clipped_states(both)) == {"x"}
    np.testing.assert_array_equal(seen_samples(both), noisy < 0.8)


def clipped_above(share, **given):
    """Samples of the oscillator whose sensor ends at this quantile of what it would show."""
    data = sampled(noise=0.01, **given)
    return replace(data, states={"y": np.minimum(data.states["y"], np.quantile(data.states["y"], share))})


def cubic(y, v):
    return -0.5 * y**3


@pytest.mark.parametrize("runs", [1, 2])
def test_clipped_samples_are_no_rows_and_their_inputs_drive_the_path(runs):
    data = clipped_above(0.8, runs=runs)
    model = bg.GreyBox({"v": ["y"]}, simulation=SIMULATION, rows=bg.TrajectoryRows())
    rows = model.equation_rows(data, "v")
    (said,) = model.rows.left_out(data)
    assert said == f"y is clipped at {np.sum(data.states['y'] == data.states['y'].max())} samples, which are left out"
    assert rows.n_row == np.sum(data.states["y"] < data.states["y"].max()) == sum(rows.noise.run_lengths)
    np.testing.assert_array_equal(rows.time, data.time[seen_samples(data)])
    truth = sampled(noise=0.0, runs=runs).states["y"]
    path = model.complete(data)
    # Where nothing is missing the path goes on to where the sensor could not, to within what noise leaves of it.
    assert np.max(np.abs(path.states["y"] - truth)) < 0.03 * np.std(truth)


def test_coefficients_are_those_of_samples_that_were_never_clipped():
    model = bg.GreyBox(
        {"v": ["y**3"]}, simulation=SIMULATION, rows=bg.TrajectoryRows(), prior=bg.Normal(1.0), discrepancy=None
    )
    data = clipped_above(0.8, hidden=cubic)
    ((_, mean),) = model.near(data)[0].assemble(data)["v"].ridge()
    assert mean == pytest.approx(-0.5, abs=0.02)
    # What a clipped sensor shows, taken at its word, is another spring.
    coarse = replace(data, states={"y": data.states["y"] + 1e-9 * np.arange(data.n_obs)})
    ((_, believed),) = model.near(coarse)[0].assemble(coarse)["v"].ridge()
    assert abs(believed + 0.5) > 5 * abs(mean + 0.5)


def test_noise_that_moves_the_path_knows_how_long_a_sensor_was_at_its_end():
    data = clipped_above(0.8)
    first = replace(data, states={"y": np.maximum(data.states["y"], np.quantile(data.states["y"], 0.3))})
    model = bg.GreyBox({"v": ["y"]}, simulation=SIMULATION, rows=bg.TrajectoryRows())
    for each in (data, first):
        noise = model.equation_rows(each, "v").noise
        forced, starts = noise.forced(1e-12), noise.covariance()
        # A force of no intensity leaves the starts, whatever samples are missing.
        np.testing.assert_allclose(forced.covariance(), starts, rtol=1e-6, atol=1e-6 * np.max(starts))


def test_samples_put_right_remember_where_their_sensor_was_at_its_end():
    data = clipped_above(0.8)
    drift = {ChannelSuspect(DRIFT, "y", 1.0): 0.2}
    right = freed(data, "v", drift, data)
    assert clipped_states(right) == {}
    np.testing.assert_array_equal(seen_samples(right), seen_samples(data))
    some = right.keep(np.arange(data.n_obs) % 3 > 0)
    np.testing.assert_array_equal(seen_samples(some), seen_samples(data)[np.arange(data.n_obs) % 3 > 0])
    again = bg.Trajectories.from_frame(right.to_frame(), **right.metadata())
    np.testing.assert_array_equal(seen_samples(again), seen_samples(data))


def test_a_run_that_is_nearly_all_clipped_is_refused():
    data = sampled(noise=0.01, runs=3)
    y = data.states["y"].copy()
    y[data.run == 1] = np.max(y)
    model = bg.GreyBox({"v": ["y"]}, simulation=SIMULATION, rows=bg.TrajectoryRows())
    with pytest.raises(bg.InputError, match="has 0 samples that no sensor clipped"):
        model.complete(replace(data, states={"y": y}))
