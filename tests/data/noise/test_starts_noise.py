"""Noise of rows whose path starts anywhere, against dense matrices."""

import json

import numpy as np
import pytest

from bayes_greybox.data.noise.files import noise_from_dict
from bayes_greybox.data.noise.starts_noise import StartsNoise
from bayes_greybox.data.noise.weighted import WeightedNoise, WhiteNoise


@pytest.fixture
def noise():
    rng = np.random.default_rng(0)
    starts = rng.standard_normal((12, 3)) * [100.0, 1.0, 0.01]
    return StartsNoise(WeightedNoise(WhiteNoise((7, 5)), rng.uniform(0.5, 2, 12)), starts)


def test_whitening_makes_the_covariance_the_identity(noise):
    W, R = noise.whiten(np.eye(12)), noise.covariance()
    np.testing.assert_allclose(W @ R @ W.T, np.eye(12), atol=1e-9)
    assert noise.log_det == pytest.approx(np.linalg.slogdet(R)[1], rel=1e-10)
    np.testing.assert_allclose(noise.whiten_transpose(W), np.linalg.inv(R), atol=1e-9)


def test_the_precision_is_that_of_the_dense_matrix(noise):
    inverse = np.linalg.inv(noise.covariance())
    np.testing.assert_allclose(noise.precision_diagonal(), np.diag(inverse), atol=1e-10)
    band = noise.precision_band(3)
    for i in range(12):
        for k in range(3):
            same = i + k < 12 and (i < 7) == (i + k < 7)
            assert band[i, k] == pytest.approx(inverse[i, i + k] if same else 0.0, abs=1e-10)


def test_residuals_without_starts_are_those_of_the_best_start(noise):
    rows = np.random.default_rng(1).standard_normal((12, 2))
    root = 1 / noise.inner.whiten(np.ones((12, 1)))
    weighted = noise.starts / root
    best = np.linalg.solve(weighted.T @ weighted + np.eye(3), weighted.T @ (rows / root))
    np.testing.assert_allclose(noise.without_starts(rows), rows - noise.starts @ best, atol=1e-9)


def test_a_part_has_the_rows_of_the_whole(noise):
    part = noise.restrict([(2, 7), (0, 3)])
    rows = [*range(2, 7), *range(7, 10)]
    np.testing.assert_allclose(part.covariance(), noise.covariance()[np.ix_(rows, rows)])


def test_it_survives_a_file(noise):
    again = noise_from_dict(json.loads(json.dumps(noise.to_dict())))
    np.testing.assert_allclose(again.covariance(), noise.covariance())


def test_rows_of_rates_have_no_starts():
    rows = np.ones((3, 1))
    assert WhiteNoise((3,)).without_starts(rows) is rows
