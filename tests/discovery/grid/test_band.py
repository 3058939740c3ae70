"""Share of what is left that is in the band of a force."""

import numpy as np
import pytest

from bayes_greybox.discovery.grid.residuals import Band

N = 1024
T = np.arange(N)
BLOCK = N // 30
"""Samples of a block: the record has the largest number of them."""


def in_band(left, forces):
    """Shares of each remainder in the band of each force by itself."""
    band, k = Band(forces, left), forces.shape[1]
    return np.array([band.share(h, range(k), np.eye(k)) for h in range(left.shape[1])])


def test_what_has_the_spectrum_of_a_force_is_all_in_its_band():
    force = np.sin(2 * np.pi * 4 * T / BLOCK)[:, None]
    shifted = 0.3 * np.cos(2 * np.pi * 4 * T / BLOCK + 0.7)[:, None]
    assert in_band(shifted, force) == pytest.approx(1.0, abs=0.02)


def test_what_is_elsewhere_cannot_be_mistaken_for_it():
    slow, fast = (np.sin(2 * np.pi * k * T / BLOCK)[:, None] for k in (2, 12))
    assert in_band(slow, fast)[0, 0] < 1e-6 and in_band(fast, slow)[0, 0] < 1e-6


def test_of_white_noise_a_force_has_as_much_as_its_share_of_the_frequencies():
    rng = np.random.default_rng(1)
    noise = rng.normal(size=(N, 200))
    line = np.sin(2 * np.pi * 8 * T / BLOCK)[:, None]
    # A line of a window of Hann is (1/4, 1, 1/4)/1.5 in square of three frequencies; white noise has 2/length in each.
    p = np.array([1 / 6, 2 / 3, 1 / 6])
    assert np.mean(in_band(noise, line)) == pytest.approx(2 / BLOCK / np.sum(p**2), rel=0.05)
    assert np.mean(in_band(line, noise)) < 1.0


def test_white_noise_is_all_in_the_band_of_white_noise_and_what_is_no_force_takes_all():
    rng = np.random.default_rng(2)
    found = in_band(rng.normal(size=(N, 1)), np.column_stack([rng.normal(size=N), np.zeros(N)]))
    assert found[0, 0] > 0.9 and found[0, 1] == 1.0


def test_of_a_force_beside_another_its_own_part_has_the_band():
    # The cube of a sine is three quarters of the sine and a quarter of its third harmonic.
    sine = np.sin(2 * np.pi * 3 * T / BLOCK)
    forces = np.column_stack([sine, sine**3])
    left = np.sin(2 * np.pi * 9 * T / BLOCK)[:, None]
    alone = np.array([[1.0, 0.0], [-0.75, 1.0]])
    band = Band(forces, left)
    assert band.share(0, [0, 1], alone) == pytest.approx([0.0, 1.0], abs=0.02)
    assert band.share(0, [0, 1], np.eye(2))[1] < 0.2


@pytest.mark.parametrize("n", [1, 5, 26, 200])
def test_short_records_have_shares_too(n):
    rng = np.random.default_rng(3)
    found = in_band(rng.normal(size=(n, 2)), rng.normal(size=(n, 3)))
    assert found.shape == (2, 3) and np.all((found >= 0) & (found <= 1))
