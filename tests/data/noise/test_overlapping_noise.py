"""Noise of overlapping rows against dense algebra."""

import numpy as np
import pytest

from bayes_greybox.data.noise.banded import LEAST_PIVOT_SHARE, OverlappingNoise, independent_rows, overlapping
from bayes_greybox.data.noise.files import noise_from_dict


def banded(n, width, seed):
    """A covariance of so many neighbours in lower banded form."""
    L = np.random.default_rng(seed).normal(size=(n, n + width))
    i, j = np.indices(L.shape)
    L[(j < i) | (j > i + width)] = 0.0
    R = L @ L.T
    return np.array([np.append(np.diag(R, -k), np.zeros(k)) for k in range(width + 1)])


@pytest.fixture
def noise():
    return overlapping([banded(17, 4, 0), banded(9, 4, 1)], 3.0)


def test_whitening_is_that_of_the_dense_covariance(noise):
    R = noise.covariance()
    assert noise.n_white == noise.n_obs == 26 and noise.square and noise.derived
    assert np.mean(np.diag(R)) == pytest.approx(1.0)
    assert np.all(R[:17, 17:] == 0)
    W = noise.whiten(np.eye(26))
    np.testing.assert_allclose(W @ R @ W.T, np.eye(26), atol=1e-9)
    np.testing.assert_allclose(noise.whiten_transpose(np.eye(26)), W.T, atol=1e-9)
    assert noise.log_det == pytest.approx(np.linalg.slogdet(R)[1], abs=1e-9)


def test_entries_of_the_precision(noise):
    P = np.linalg.inv(noise.covariance())
    scale = np.abs(P).max()
    np.testing.assert_allclose(noise.precision_diagonal(), np.diag(P), atol=1e-9 * scale)
    band = noise.precision_band(6)
    for k in range(6):
        inside = [i for i in range(26 - k) if (i < 17) == (i + k < 17)]
        np.testing.assert_allclose(band[inside, k], P[inside, np.array(inside) + k], atol=1e-9 * scale)
    assert np.all(band[16, 1:] == 0) and np.all(band[25, 1:] == 0)


def test_draws_have_the_covariance(noise):
    white = np.eye(26)
    drawn = noise.correlated(white)
    np.testing.assert_allclose(drawn.T @ drawn, noise.covariance(), atol=1e-12)


def test_parts_and_files_keep_the_covariance(noise):
    part = noise.restrict([(3, 11), (0, 0)])
    assert part.run_lengths == (8,)
    whole = noise.scale**2 * noise.covariance()
    np.testing.assert_allclose(part.scale**2 * part.covariance(), whole[3:11, 3:11], rtol=1e-12, atol=1e-12)
    again = noise_from_dict(noise.to_dict())
    assert isinstance(again, OverlappingNoise) and again.scale == noise.scale
    np.testing.assert_array_equal(again.covariance(), noise.covariance())


def test_rows_that_others_tell_do_not_count():
    rng = np.random.default_rng(0)
    L = np.zeros((12, 20))
    for i in range(12):
        L[i, i : i + 5] = rng.normal(size=5)
    # Two rows are sums of their neighbours.
    L[4], L[9] = L[3] - 2 * L[2], L[8]
    R = L @ L.T
    width = max(k for k in range(12) if np.any(np.abs(np.diag(R, -k)) > 0)) + 1
    band = np.array([np.append(np.diag(R, -k), np.zeros(k)) for k in range(width)])
    kept = independent_rows(band)
    assert np.sum(kept) == np.linalg.matrix_rank(R, tol=LEAST_PIVOT_SHARE) == 10
    assert not kept[4] and not kept[9]
    assert np.linalg.cond(R[np.ix_(kept, kept)]) < 1e8
