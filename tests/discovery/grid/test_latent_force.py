"""A latent force on rows of rates, and any process that sensors show, against dense covariance matrices."""

import numpy as np
import pytest

from bayes_greybox.discovery.grid.kalman import Process, innovations, smoothed
from bayes_greybox.discovery.grid.latent_force import ForcedRates, rough_noise

RNG = np.random.default_rng(0)
N, TAU, R = 60, 0.8, 2.5
TIME, RUN = np.sort(RNG.uniform(0, 10, N)), np.repeat([0, 1], [35, 25])
SPREAD = np.exp(0.3 * RNG.standard_normal(N))
TABLE = RNG.standard_normal((N, 3))
RATES = ForcedRates(TIME, RUN, 1.0, SPREAD, 1.0)


def covariance(r, sensor=False):
    """Matérn-3/2 for a force, exponential for noise of a sensor; runs know nothing of each other."""
    x = np.abs(TIME[:, None] - TIME) / TAU
    kernel = np.exp(-x) if sensor else (1 + np.sqrt(3) * x) * np.exp(-np.sqrt(3) * x)
    return np.where(RUN[:, None] == RUN, r**2 * kernel, 0.0)


def agree(white, logs, K, noise, table=TABLE):
    """The products and the determinant are those of R = K + noise."""
    whole = K + np.diag(noise)
    np.testing.assert_allclose(white.T @ white, table.T @ np.linalg.solve(whole, table), rtol=1e-9, atol=1e-9)
    assert np.sum(logs) == pytest.approx(np.linalg.slogdet(whole)[1], abs=1e-8)


@pytest.mark.parametrize("sensor", [False, True])
def test_innovations_whiten_rows_at_irregular_times_in_two_runs(sensor):
    white, logs = RATES.whiten(TABLE, TAU, np.array([R, 0.4]), sensor)
    for k, r in enumerate((R, 0.4)):
        agree(white[:, k], logs[:, k], covariance(r, sensor), SPREAD**2)


def test_without_a_force_rows_are_divided_by_their_noise():
    white, logs = RATES.whiten(TABLE, TAU, np.zeros(2))
    np.testing.assert_allclose(white, np.repeat((TABLE / SPREAD[:, None])[:, None], 2, axis=1))
    np.testing.assert_allclose(logs[:, 0], 2 * np.log(SPREAD))
    # As one intensity among others a filter runs, and finds the same.
    again, more = RATES.whiten(TABLE, TAU, np.array([0.0, 1.0]))
    np.testing.assert_allclose(again[:, 0], white[:, 0], rtol=1e-12)
    np.testing.assert_allclose(more[:, 0], logs[:, 0], atol=1e-12)


def test_weights_are_factors_of_the_noise():
    factor = np.linspace(0.5, 3.0, N)
    white, logs = RATES.weighted(factor).whiten(TABLE, TAU, np.array([R]))
    agree(white[:, 0], logs[:, 0], covariance(R), (factor * SPREAD) ** 2)


def test_the_smoothed_force_is_that_of_dense_regression():
    K = covariance(R)
    gain = K @ np.linalg.inv(K + np.diag(SPREAD**2))
    mean, variance = RATES.smooth(TABLE, TAU, R)
    np.testing.assert_allclose(mean, gain @ TABLE, atol=1e-9)
    np.testing.assert_allclose(variance, np.diag(K - gain @ K), atol=1e-9)


def test_the_usual_step_is_within_runs():
    assert ForcedRates(np.array([0.0, 0.1, 0.2, 9.0, 9.1]), np.array([0, 0, 0, 1, 1]), 1.0, np.ones(5), 1.0).step == (
        pytest.approx(0.1)
    )
    assert ForcedRates(np.array([3.0]), np.array([0]), 1.0, np.ones(1), 1.0).step == 1.0


def random_process(n=9, d=3, p=2, seed=3):
    """A process of any form, with a stretch that begins in the middle."""
    rng = np.random.default_rng(seed)
    F = 0.5 * rng.standard_normal((n, d, d))
    root = rng.standard_normal((n, d, d))
    fresh = np.arange(n) % 5 == 0
    start, started = np.diag(rng.uniform(0.5, 2, d)), np.diag(rng.uniform(0.5, 2, d))
    H, noise = rng.standard_normal((p, d)), rng.uniform(0.2, 2, (n, p))
    return Process(F, root @ root.swapaxes(1, 2), H, noise, fresh, start, started)


def joint(process, r):
    """Covariance of all states, by what each adds to the one before."""
    n, d = process.F.shape[:2]
    found = np.zeros((n, d, n, d))
    for k in range(n):
        F, fresh = process.F[k], process.fresh[k]
        before = process.start + r**2 * process.started if fresh else found[k - 1, :, k - 1]
        found[k, :, k] = F @ before @ F.T + r**2 * process.Q[k]
        for j in range(k if not fresh else 0):
            found[k, :, j] = F @ found[k - 1, :, j]
            found[j, :, k] = found[k, :, j].T
    return found.reshape(n * d, n * d)


@pytest.mark.parametrize("r", [0.0, 0.7, 30.0])
def test_any_process_with_two_sensors_is_whitened_and_smoothed(r):
    process = random_process()
    n, d, p = *process.F.shape[:2], len(process.H)
    z = np.random.default_rng(4).standard_normal((n, p, 2))
    states = joint(process, r)
    H = np.kron(np.eye(n), process.H)
    # The first stretch tells nothing of the second.
    whole = H @ states @ H.T + np.diag(process.noise.ravel())
    white, logs = innovations(process, np.array([r]), z)
    flat = z.reshape(n * p, 2)
    np.testing.assert_allclose(
        np.tensordot(white[:, :, 0], white[:, :, 0], ([0, 1], [0, 1])), flat.T @ np.linalg.solve(whole, flat), rtol=1e-8
    )
    assert logs.sum() == pytest.approx(np.linalg.slogdet(whole)[1], abs=1e-8)
    mean, variance = smoothed(process, r, z, 1)
    gain = states @ H.T @ np.linalg.inv(whole)
    np.testing.assert_allclose(mean, (gain @ flat).reshape(n, d, 2)[:, 1], atol=1e-8)
    np.testing.assert_allclose(variance, np.diag(states - gain @ H @ states).reshape(n, d)[:, 1], atol=1e-7)


def test_a_table_of_many_columns_is_whitened_as_each_column_is():
    wide = np.random.default_rng(5).standard_normal((N, 40))
    white, _ = RATES.whiten(wide, TAU, np.array([R]))
    alone, _ = RATES.whiten(wide[:, 37:38], TAU, np.array([R]))
    np.testing.assert_allclose(white[:, :, 37:38], alone, atol=1e-12)


def test_a_first_guess_of_the_noise_is_that_of_what_is_rough():
    t, rng = np.arange(2000) * 0.05, np.random.default_rng(1)
    # The median of 2000 correlated differences is known to 3 %; four of them.
    assert rough_noise(np.sin(t) + 0.02 * rng.standard_normal(2000)) == pytest.approx(0.02 / np.sqrt(0.5), rel=0.12)
    assert rough_noise(np.sin(t)) < 2e-3
    assert rough_noise(np.zeros(9)) == 1.0 and rough_noise(np.ones(2)) == 1.0
