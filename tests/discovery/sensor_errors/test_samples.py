"""Noise on samples of states: found where it is, never where it is not; slips of sensors."""

import numpy as np
import pytest
from sampled_paths import STEP, paths

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.sensor_errors.samples import Smoother, misread
from bayes_greybox.physics.experiments.systems import duffing


def smoothed(data, rates=None):
    """The data as a study smooths them, and the noise that it found."""
    smooth = Smoother(data, rates or {})
    return smooth(data), smooth.noise


@pytest.mark.parametrize("share", [0.005, 0.01, 0.03, 0.1])
@pytest.mark.parametrize("name", ["forced", "decaying", "bouncing"])
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_noise_is_found_and_smoothing_takes_it_away(name, share, seed):
    x = paths()[name]
    sd = share * np.std(x)
    measured = x + sd * np.random.default_rng(seed).standard_normal(len(x))
    data = Trajectories.from_arrays(np.arange(len(x)) * STEP, states={"x": measured})
    better, noise = smoothed(data)
    assert noise["x"].sd == pytest.approx(sd, rel=0.25)
    before, after = np.sqrt(np.mean((measured - x) ** 2)), np.sqrt(np.mean((better.states["x"] - x) ** 2))
    # A spline is no better than the samples at kinks that these show.
    assert after < ({0.005: 1.1, 0.01: 0.95}.get(share, 0.9) if name == "bouncing" else 0.9) * before
    # What is said to be left is about what is left.
    assert 0.3 * after < noise["x"].left < 2 * after + 0.2 * sd


def test_only_the_noisy_state_is_smoothed_and_each_run_by_itself():
    rng, n = np.random.default_rng(0), 400
    t = np.arange(n) * STEP
    exact = [np.sin(t), np.cos(2 * t)]
    noisy = [x + 0.02 * rng.standard_normal(n) for x in ([5 + np.cos(t), np.sin(t) - 5])]
    data = Trajectories.from_arrays([t, t], states={"x": exact, "y": noisy})
    better, noise = smoothed(data)
    assert set(noise) == {"y"} and better.states["x"] is data.states["x"]
    one, _ = smoothed(data.take(1))
    np.testing.assert_allclose(better.states["y"][n:], one.states["y"], atol=0.02)
    clean = Trajectories.from_arrays([t, t], states={"x": exact})
    same, none = smoothed(clean)
    assert same is clean and none == {}


def test_kinks_of_a_speed_that_its_position_does_not_bear_out_are_no_noise():
    # A trolley that rubs: its acceleration leaps where it turns, and its accelerometer is too noisy to tell.
    rng, n, fine = np.random.default_rng(0), 800, 50
    x, v, rows = 0.0, 0.0, []
    for i in range(n * fine):
        t = i * STEP / fine
        a = 3 * np.sin(2.1 * t) + 2 * np.sin(5.3 * t + 1) - 15 * x - 0.4 * v - 0.6 * np.tanh(v / 0.02)
        if i % fine == 0:
            rows.append((t, x, v, a))
        # To second order: what is integrated to first order is late by half a step.
        x += STEP / fine * (v + 0.5 * a * STEP / fine)
        half = v + 0.5 * a * STEP / fine
        after = 3 * np.sin(2.1 * (t + STEP / fine)) + 2 * np.sin(5.3 * (t + STEP / fine) + 1) - 15 * x
        v = half + 0.5 * STEP / fine * (after - 0.4 * half - 0.6 * np.tanh(half / 0.02))
    t, x, v, a = np.array(rows).T
    rates = {"x": v, "v": a + 0.1 * rng.standard_normal(n)}
    data = Trajectories.from_arrays(t, states={"x": x, "v": v})
    assert "v" in Smoother(data, rates).noise
    assert Smoother(data, rates, {"v": "x"}).noise == {}
    # A rate of the position that was measured by itself says nothing of the speed's samples.
    noisy = v + 0.01 * rng.standard_normal(n)
    apart = Trajectories.from_arrays(t, states={"x": x, "v": noisy})
    assert "v" in Smoother(apart, rates, {"v": "x"}).noise
    # Nor does a position that was summed up from the noisy speed.
    summed = np.append(0.0, np.cumsum(STEP * (noisy[1:] + noisy[:-1]) / 2))
    added = Trajectories.from_arrays(t, states={"x": summed, "v": noisy})
    assert "v" in Smoother(added, {"x": noisy, "v": rates["v"]}, {"v": "x"}).noise
    found = Smoother(Trajectories.from_arrays(t, states={"x": x, "v": noisy}), rates | {"x": noisy}, {"v": "x"}).noise
    assert found["v"].sd == pytest.approx(0.01, rel=0.25)


def test_uneven_and_short_records_are_left_alone():
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.01, 0.1, 300))
    uneven = Trajectories.from_arrays(t, states={"x": np.sin(t) + 0.1 * rng.standard_normal(300)})
    assert smoothed(uneven)[0] is uneven
    t = np.arange(20) * STEP
    short = Trajectories.from_arrays(t, states={"x": np.sin(t) + 0.1 * rng.standard_normal(20)})
    assert smoothed(short)[0] is short
    # In no order in time: nothing that smoothing could find.
    t = np.arange(300) * STEP
    mixed = Trajectories.from_arrays(t, states={"x": rng.standard_normal(300)})
    assert smoothed(mixed)[0] is mixed


def test_a_fast_motion_sampled_coarsely_is_no_noise_where_its_rate_is_known():
    # Six samples a period, and harmonics that fold: exact, and as rough as noise.
    data = duffing(k3=40.0).simulate(np.linspace(0, 60, 201), noise=0.05, seed=1)
    assert set(smoothed(data)[1]) == {"y", "ydot"}
    better, noise = smoothed(data, {"y": data.states["ydot"], **data.derivatives})
    assert better is data and noise == {}


def test_noise_is_borne_out_by_the_rate():
    t = STEP * np.arange(600)
    for seed in range(5):
        noisy = np.sin(t) + 0.02 * np.random.default_rng(seed).standard_normal(600)
        data = Trajectories.from_arrays(t, states={"x": noisy})
        assert set(smoothed(data, {"x": np.cos(t)})[1]) == {"x"}


def test_other_data_of_a_noisy_sensor_are_smoothed_as_its_training_data_were():
    t, rng = STEP * np.arange(400), np.random.default_rng(0)
    x = np.sin(t) + 0.3 * np.cos(2.1 * t)
    data = Trajectories.from_arrays(t, states={"x": x + 0.05 * rng.standard_normal(400), "v": np.cos(t)})
    smooth = Smoother(data, {})
    assert smooth(data) is smooth(data) and set(smooth.noise) == {"x"}
    other = Trajectories.from_arrays(t, states={"x": x + 0.05 * rng.standard_normal(400), "v": np.cos(t)})
    after = np.sqrt(np.mean((smooth(other).states["x"] - x) ** 2))
    assert after < 0.6 * 0.05 and smooth(other).states["v"] is other.states["v"]


def pushed(n=400, seed=0, noise=0.02):
    """A force, and the rate that it makes; twice as large, with noise."""
    t = STEP * np.arange(n)
    force = np.sin(t) + 0.4 * np.sign(np.sin(0.31 * t)) + 0.3 * np.cos(2.3 * t)
    return force, 2 * force + noise * np.random.default_rng(seed).standard_normal(n), np.zeros(n, int)


def test_slips_of_a_sensor_are_found_and_mended():
    force, rate, run = pushed()
    shown = force.copy()
    for k, by in [(50, 2.0), (120, -1.0), (121, -1.1), (200, 1.0), (205, -1.5), (399, 3.0)]:
        shown[k] += by
    out, better = misread(shown, run, rate, np.full(400, 2.0))
    # Those near the end of a run have no neighbours to tell.
    assert np.flatnonzero(out).tolist() == [50, 120, 121, 200, 205]
    np.testing.assert_allclose(better[out], force[out], atol=0.02)
    np.testing.assert_array_equal(better[~out], shown[~out])


def test_what_the_rate_follows_is_no_slip():
    force, _, run = pushed()
    force[[60, 180, 300]] += 5.0  # blows
    rate = 2 * force + 0.02 * np.random.default_rng(1).standard_normal(400)
    assert not misread(force, run, rate, np.full(400, 2.0))[0].any()


@pytest.mark.parametrize("seed", range(5))
def test_noise_and_edges_are_no_slips(seed):
    force, rate, run = pushed(seed=seed)
    noisy = force + 0.05 * np.random.default_rng(10 + seed).standard_normal(400)
    assert misread(noisy, run, rate, np.full(400, 2.0))[0].sum() <= 1
    edges = np.sign(np.sin(STEP * np.arange(400)))
    assert not misread(edges, run, np.zeros(400), np.full(400, 2.0))[0].any()


def test_slips_are_looked_for_within_runs():
    force, rate, _ = pushed()
    run = np.arange(400) // 4
    shown = force + np.where(np.arange(400) == 50, 3.0, 0.0)
    assert not misread(shown, run, rate, np.full(400, 2.0))[0].any()
