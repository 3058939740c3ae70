"""A latent force along a path, against the exact covariance of an oscillator that it moves (Van Loan 1978)."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from bayes_greybox.discovery.grid.path_force import ForcedPath, PathSteps
from bayes_greybox.physics.integration.sensitivity import respond

A = np.array([[0.0, 1.0], [-4.0, -0.3]])
N, DT, SUB, START, S = 40, 0.1, 4, np.array([2.0, 1.5]), 1.2
OUTPUTS = pytest.mark.parametrize("outputs", [(0,), (0, 1)], ids=["one sensor", "two sensors"])
SCALES = pytest.mark.parametrize("tau", [0.06, 0.5, 5.0])


def forced_path(outputs, segments=1):
    """Four Runge–Kutta steps from each sample to the next."""
    n_step = (N // segments - 1) * SUB
    h = DT / SUB
    nodes = np.tile(np.linspace(0, n_step * h, 2 * n_step + 1), (segments, 1))
    response = respond(nodes, np.broadcast_to(A, (*nodes.shape, 2, 2)))
    end = np.array([(s, k * SUB) for s in range(segments) for k in range(N // segments)])
    steps = PathSteps(response.M, response.b[..., 1], np.full((segments, n_step), h), end)
    return ForcedPath(steps, outputs, START, np.full(N * len(outputs), S), 1.0, DT, 1.0)


def exact(tau, r, sensor=False, segments=1):
    """Covariance of (y, v, w) at all samples; w acts on v, or is noise of the sensors and moves nothing.

    Starts are uncertain in units of the whole noise, of which the sensors' w is a part.
    """
    flow = np.zeros((3, 3))
    flow[:2, :2], flow[1, 2], flow[2, 2] = A, float(not sensor), -1 / tau
    diffusion = np.diag([0.0, 0.0, 2 / tau])
    block = expm(np.block([[-flow, diffusion], [np.zeros((3, 3)), flow.T]]) * DT)
    step = block[3:, 3:].T
    added = r**2 * step @ block[:3, 3:]
    found = np.zeros((3 * N, 3 * N))
    for k in range(N):
        own = slice(3 * k, 3 * k + 3)
        if k % (N // segments) == 0:
            found[own, own] = np.diag([*(START**2 * (1 + sensor * r**2)), r**2])
            continue
        before = slice(3 * k - 3, 3 * k)
        found[own, : 3 * k] = step @ found[before, : 3 * k]
        found[: 3 * k, own] = found[own, : 3 * k].T
        found[own, own] = step @ found[before, before] @ step.T + added
    return found


def shown(outputs, sensor=False):
    """What the rows show of (y, v, w) at all samples, one sensor after the other."""
    H = np.zeros((len(outputs), N, N, 3))
    for a, output in enumerate(outputs):
        H[a, range(N), range(N), output] = 1.0
        H[a, range(N), range(N), 2] = float(sensor)
    return H.reshape(len(outputs) * N, 3 * N)


def close(found, expected, share):
    np.testing.assert_allclose(found, expected, atol=share * np.max(np.abs(expected)))


@OUTPUTS
@SCALES
@pytest.mark.parametrize("sensor", [False, True], ids=["force", "noise"])
def test_innovations_whiten_samples_along_a_path(outputs, tau, sensor):
    table = np.random.default_rng(0).standard_normal((N * len(outputs), 2))
    white, logs = forced_path(outputs).whiten(table, tau, np.array([3.0, 1.0]), sensor)
    # Within a step of a quarter of a sample a rough force is known at its middle and its end alone.
    share = 2e-3 if tau < DT else 1e-4
    H = shown(outputs, sensor)
    for k, r in enumerate((3.0, 1.0)):
        R = H @ exact(tau, r, sensor) @ H.T + S**2 * np.eye(len(H))
        close(white[:, k].T @ white[:, k], table.T @ np.linalg.solve(R, table), share)
        assert logs[:, k].sum() == pytest.approx(np.linalg.slogdet(R)[1], abs=len(H) * share)


def test_noise_correlated_over_far_less_than_a_step_is_white_noise_of_another_size():
    path = replace(forced_path((0,)), spread=np.ones(N))
    table, r = np.random.default_rng(2).standard_normal((N, 2)), 10.0
    white, logs = path.whiten(table, 1e-3 * DT, np.array([0.0, r]), sensor=True)
    # v integrated out: neither is likelier, nor are starts better known.
    close(white[:, 1] * np.sqrt(1 + r**2), white[:, 0], 1e-6)
    close(logs[:, 1] - np.log(1 + r**2), logs[:, 0], 1e-6)


@OUTPUTS
@SCALES
def test_the_smoothed_force_is_that_of_dense_regression(outputs, tau):
    table = np.random.default_rng(1).standard_normal((N * len(outputs), 2))
    mean, variance = forced_path(outputs).smooth(table, tau, 3.0)
    H, whole = shown(outputs), exact(tau, 3.0)
    gain = whole[2::3] @ H.T @ np.linalg.inv(H @ whole @ H.T + S**2 * np.eye(len(H)))
    share = 2e-2 if tau < DT else 1e-3
    close(mean, gain @ table, share)
    close(variance, np.diag(whole[2::3, 2::3] - gain @ H @ whole[:, 2::3]), share)


def test_without_a_force_the_free_starts_alone_are_integrated_out():
    table = np.random.default_rng(2).standard_normal((N, 1))
    path = forced_path((0,))
    white, logs = path.whiten(table, 0.5, np.zeros(3))
    H = shown((0,))
    R = H @ exact(0.5, 0.0) @ H.T + S**2 * np.eye(N)
    assert white.shape == (N, 3, 1) and logs.shape == (N, 3)
    for k in range(3):
        close(white[:, k].T @ white[:, k], table.T @ np.linalg.solve(R, table), 1e-6)


def test_segments_start_anew_and_weights_are_of_rows():
    factor = np.exp(np.random.default_rng(3).normal(0, 0.4, N))
    table = np.random.default_rng(4).standard_normal((N, 2))
    path = forced_path((0,), segments=2).weighted(factor)
    assert path.fresh.tolist() == [k % 20 == 0 for k in range(N)]
    white, logs = path.whiten(table, 0.5, np.array([3.0]))
    H = shown((0,))
    R = H @ exact(0.5, 3.0, segments=2) @ H.T + np.diag((S * factor) ** 2)
    close(white[:, 0].T @ white[:, 0], table.T @ np.linalg.solve(R, table), 1e-4)
    assert logs.sum() == pytest.approx(np.linalg.slogdet(R)[1], abs=1e-3)
