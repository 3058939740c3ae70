"""Noise on the samples of inputs: which inputs show some, and the column of what the machine does not feel."""

import numpy as np
import pytest

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.sensor_errors.channels import NOISE, ChannelSuspect
from bayes_greybox.discovery.sensor_errors.noisy_inputs import noise_columns, quiet_inputs, without_noise

N, NOISE_SD = 400, 0.05
T = 0.5 * np.arange(N)
SWITCHED = np.repeat(np.random.default_rng(1).choice([-1.5, 0.0, 0.8, 2.5, 4.0], N // 20), 20)
SMOOTH = 2 * np.sin(2 * np.pi * T / 80)
E = NOISE_SD * np.random.default_rng(2).standard_normal(N)


def data_of(**inputs):
    return Trajectories.from_arrays(T, states={"x": np.sin(0.1 * T)}, inputs=inputs)


def rate(data):
    return -3.0 * data.inputs["i"] ** 2 - data.states["x"]


@pytest.mark.parametrize("true", [SWITCHED, SMOOTH], ids=["switched", "smooth"])
def test_noise_is_taken_off_between_leaps(true):
    """Of 20 samples between leaps a mean leaves the noise over √20; of a slow wave less is left."""
    left = quiet_inputs(data_of(i=true + E))["i"] - true
    assert np.sqrt(np.mean(left**2)) < 1.6 * NOISE_SD / np.sqrt(20)


def test_what_shows_no_noise_is_not_smoothed():
    """Switches, waves, and what is another value at every sample, which nobody can tell from noise."""
    random = np.random.default_rng(3).standard_normal(N)
    assert not quiet_inputs(data_of(i=SWITCHED, s=SMOOTH, r=random))
    assert not noise_columns(data_of(i=SWITCHED), rate)


def test_the_column_is_the_rate_that_the_machine_does_not_feel_per_unit_of_noise():
    measured = data_of(i=SMOOTH + E)
    ((error, column),) = noise_columns(measured, rate)
    assert error.key == "noise of i" and error.sd == pytest.approx(NOISE_SD, rel=0.1)
    away = rate(data_of(i=SMOOTH)) - rate(measured)
    # The column is the tangent: squares of the noise are left, and what smoothing leaves.
    assert np.corrcoef(error.sd * column, away)[0, 1] > 0.98
    assert np.sqrt(np.mean((error.sd * column - away) ** 2)) < 0.25 * np.sqrt(np.mean(away**2))


def test_as_much_is_taken_off_as_was_found():
    measured, quiet = data_of(i=SMOOTH + E), quiet_inputs(data_of(i=SMOOTH + E))["i"]
    for size, share in ((0.05, 1.0), (0.025, 0.5), (-0.1, 0.0), (0.2, 1.0)):
        found = without_noise(measured, {ChannelSuspect(NOISE, "i", 0.05): size}).inputs["i"]
        np.testing.assert_allclose(found, measured.inputs["i"] + share * (quiet - measured.inputs["i"]), atol=1e-12)
    assert without_noise(measured, {}) is measured
    # Other data of the same sensor may show none.
    exact = data_of(i=SWITCHED)
    np.testing.assert_array_equal(without_noise(exact, {ChannelSuspect(NOISE, "i", 0.05): 0.05}).inputs["i"], SWITCHED)
