"""Noise on the samples of inputs: which inputs show some, and the column of what the machine does not feel."""

import numpy as np
import pytest

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.sensor_errors.channels import with_columns
from bayes_greybox.discovery.sensor_errors.noisy_inputs import noise_columns, noisy_inputs, without_noise

N, NOISE_SD = 400, 0.05
T = 0.5 * np.arange(N)
SWITCHED = np.repeat(np.random.default_rng(1).choice([-1.5, 0.0, 0.8, 2.5, 4.0], N // 20), 20)
SMOOTH = 2 * np.sin(2 * np.pi * T / 80)
E = NOISE_SD * np.random.default_rng(2).standard_normal(N)


def data_of(**inputs):
    return Trajectories.from_arrays(T, states={"x": np.sin(0.1 * T)}, inputs=inputs)


def rate(data):
    return -3.0 * data.inputs["i"] ** 2 - data.states["x"]


def quiet(data):
    (values,) = noisy_inputs(data).values()
    return values


def columns_of(data):
    errors = noisy_inputs(data)
    without = with_columns(data, {error.channel: x for error, x in errors.items()})
    return noise_columns(data, without, errors, rate)


@pytest.mark.parametrize("true", [SWITCHED, SMOOTH], ids=["switched", "smooth"])
def test_noise_is_taken_off_between_leaps(true):
    """A mean of 20 samples between leaps leaves the noise over √20, a smooth slow wave less."""
    left = quiet(data_of(i=true + E)) - true
    assert np.sqrt(np.mean(left**2)) < 1.6 * NOISE_SD / np.sqrt(20)


def test_the_steps_of_a_wave_are_no_leaps_though_they_are_larger_than_the_noise():
    """40 samples a period, and steps of up to 16 standard deviations of the noise."""
    true = np.sin(2 * np.pi * np.arange(N) / 40)
    left = quiet(data_of(i=true + 0.2 * E)) - true
    assert np.sqrt(np.mean(left**2)) < 0.7 * 0.2 * NOISE_SD


def test_what_shows_no_noise_is_not_smoothed():
    """Switches, waves, and what is another value at every sample, which nobody can tell from noise."""
    random = np.random.default_rng(3).standard_normal(N)
    assert not noisy_inputs(data_of(i=SWITCHED, s=SMOOTH, r=random))


def test_the_column_is_the_rate_that_the_machine_does_not_feel_per_unit_of_noise():
    measured = data_of(i=SMOOTH + E)
    ((error, column),) = columns_of(measured)
    assert error.key == "noise of i" and error.sd == pytest.approx(NOISE_SD, rel=0.1)
    away = rate(data_of(i=SMOOTH)) - rate(measured)
    # The column is the tangent: squares of the noise are left, and what smoothing leaves.
    assert np.corrcoef(error.sd * column, away)[0, 1] > 0.98
    assert np.sqrt(np.mean((error.sd * column - away) ** 2)) < 0.25 * np.sqrt(np.mean(away**2))


def test_as_much_is_taken_off_as_was_found():
    measured = data_of(i=SMOOTH + E)
    ((error, smooth),) = noisy_inputs(measured).items()
    for share, taken in ((1.0, 1.0), (0.5, 0.5), (-2.0, 0.0), (4.0, 1.0)):
        found = without_noise(measured, {error: share * error.sd}).inputs["i"]
        wanted = measured.inputs["i"] + taken * (smooth - measured.inputs["i"])
        # It is smoothed as noise of the size that was taken off is, a little less than all of it.
        np.testing.assert_allclose(found, wanted, atol=0.1 * NOISE_SD)
    assert without_noise(measured, {}) is measured
    # The same sensor has its noise beside one level, too, where nothing else shows what noise is.
    level = without_noise(data_of(i=1.0 + E), {error: error.sd}).inputs["i"]
    assert np.sqrt(np.mean((level - 1.0) ** 2)) < 0.3 * NOISE_SD
