"""Leaps of an input: those of a switch, none of noise or of a steep slope."""

import numpy as np
import pytest

from bayes_greybox.discovery.sensor_errors.leaps import beside_leaps, leaps

N = 400
RNG = np.random.default_rng(0)
LEVELS = np.repeat(RNG.permutation(20) * 1.0, 20)


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_a_switch_leaps_also_under_noise(noise):
    found = np.flatnonzero(leaps(LEVELS + noise * RNG.standard_normal(N)))
    # Noise alone differs by five times its usual difference once in two million steps.
    np.testing.assert_array_equal(found, np.arange(19, N - 1, 20))


def test_a_wave_a_ramp_noise_and_what_always_leaps_do_not():
    t = np.arange(N)
    for values in (np.sin(2 * np.pi * t / 25), 0.3 * t, RNG.standard_normal(N), np.resize([0.0, 1.0], N), np.zeros(3)):
        assert not leaps(values).any()


def test_both_samples_of_a_leap_are_beside_it():
    np.testing.assert_array_equal(np.flatnonzero(beside_leaps(np.repeat([0.0, 2.0], 8))), [7, 8])
