"""Noise of rows that an unknown force moves, against the dense covariance of the path."""

import numpy as np
import pytest

from bayes_greybox.data.noise.files import noise_from_dict
from bayes_greybox.data.noise.starts_noise import ForcedNoise, Motion, StartsNoise
from bayes_greybox.data.noise.weighted import WeightedNoise, WhiteNoise
from bayes_greybox.running.errors import InputError


def noise(outputs=(0,), n=(7, 5), intensity=0.3, seed=0):
    rng, total = np.random.default_rng(seed), sum(n)
    M = np.eye(2) + 0.3 * rng.standard_normal((total, 2, 2))
    root = rng.standard_normal((total, 2, 2))
    fresh = np.isin(np.arange(total), np.cumsum((0, *n))[:-1])
    motion = Motion(M, root @ root.swapaxes(1, 2), fresh, outputs, np.array([2.0, 3.0]), np.array([0.1, 1.0]))
    sensor = WeightedNoise(WhiteNoise(n * len(outputs)), rng.uniform(0.5, 1.5, total * len(outputs)))
    return ForcedNoise(sensor, motion, starts_of(motion), intensity)


def starts_of(motion):
    """Rows' answer to one prior standard deviation of each start of each segment."""
    columns, segment = [], np.cumsum(motion.fresh) - 1
    for s in range(segment[-1] + 1):
        for k in range(2):
            states = np.zeros((len(motion.M), 2))
            for i in np.flatnonzero(segment == s):
                # A segment may begin before its first sample.
                before = np.eye(2)[k] * motion.start_sd[k] if motion.fresh[i] else states[i - 1]
                states[i] = motion.M[i] @ before
            columns.append(np.concatenate([states[:, output] for output in motion.outputs]))
    return np.column_stack(columns)


def dense(noise):
    """R from the path's joint covariance, built forwards."""
    motion, n = noise.motion, len(noise.motion.M)
    P = np.zeros((n, n, 2, 2))
    for i in range(n):
        if motion.fresh[i]:
            P[i, i] = motion.M[i] @ np.diag(motion.start_sd**2) @ motion.M[i].T + noise.intensity * motion.G[i]
            continue
        for j in range(i):
            P[i, j] = motion.M[i] @ P[i - 1, j]
            P[j, i] = P[i, j].T
        P[i, i] = motion.M[i] @ P[i - 1, i - 1] @ motion.M[i].T + noise.intensity * motion.G[i]
    blocks = [[P[:, :, a, b] for b in motion.outputs] for a in motion.outputs]
    return np.block(blocks) + noise.sensor.covariance()


@pytest.mark.parametrize("outputs", [(0,), (1, 0)])
def test_whitened_rows_have_the_identity_for_covariance(outputs):
    found = noise(outputs)
    R = dense(found)
    W = found.whiten(np.eye(found.n_obs))
    np.testing.assert_allclose(W @ R @ W.T, np.eye(found.n_obs), atol=1e-9)
    np.testing.assert_allclose(found.covariance(), R, atol=1e-9)
    assert found.log_det == pytest.approx(np.linalg.slogdet(R)[1])
    np.testing.assert_allclose(found.whiten_transpose(np.eye(found.n_obs)), W.T, atol=1e-12)


@pytest.mark.parametrize("outputs", [(0,), (1, 0)])
def test_entries_of_the_precision(outputs):
    found = noise(outputs)
    inverse = np.linalg.inv(dense(found))
    np.testing.assert_allclose(found.precision_diagonal(), np.diag(inverse), rtol=1e-9)
    band, run = found.precision_band(3), np.repeat(np.arange(len(found.run_lengths)), found.run_lengths)
    for i in range(found.n_obs):
        for k in range(3):
            inside = i + k < found.n_obs and run[i] == run[i + k]
            assert band[i, k] == pytest.approx(inverse[i, i + k] if inside else 0.0, abs=1e-9)


def test_without_a_force_it_is_the_noise_of_starts():
    found = noise(intensity=0.0)
    plain = StartsNoise(found.sensor, found.starts, lambda: found.motion)
    np.testing.assert_allclose(found.covariance(), plain.covariance(), rtol=1e-8)
    assert plain.log_det == pytest.approx(found.log_det)
    rows = np.random.default_rng(1).standard_normal((12, 2))
    np.testing.assert_allclose(found.without_starts(rows), plain.without_starts(rows), atol=1e-8)
    forced = plain.forced(0.3)
    np.testing.assert_allclose(forced.covariance(), dense(noise()), rtol=1e-8)
    np.testing.assert_array_equal(plain.intensities, found.motion.intensities)


def test_it_survives_as_plain_values_and_is_not_parted():
    found = noise((1, 0))
    again = noise_from_dict(found.to_dict())
    np.testing.assert_allclose(again.whiten(np.eye(24)), found.whiten(np.eye(24)))
    with pytest.raises(InputError, match="cannot be parted"):
        found.restrict([(0, 3), (0, 5), (0, 3), (0, 5)])
