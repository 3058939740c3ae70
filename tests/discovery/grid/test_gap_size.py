"""Size of the gap as a force, of an oscillator's samples that are made with its exact transition."""

import numpy as np
import pytest
from scipy.linalg import expm

from bayes_greybox.discovery.grid.latent_force import gap_size
from bayes_greybox.discovery.grid.path_force import ForcedPath, PathSteps
from bayes_greybox.physics.integration.sensitivity import respond

A = np.array([[0.0, 1.0], [-4.0, -0.3]])
N, DT, NOISE, PERIOD = 600, 0.1, 1e-3, np.pi


def path(size):
    """An oscillator that a sine of an RMS and of the motion's period moves, at the samples."""
    # The force is two more states of the same linear equation.
    turn = 2 * np.pi / PERIOD
    flow = np.zeros((4, 4))
    flow[:2, :2], flow[1, 2], flow[2, 3], flow[3, 2] = A, 1.0, turn, -turn
    step, x, found = expm(flow * DT), np.array([0.3, 0.0, 0.0, size * np.sqrt(2)]), []
    for _ in range(N):
        found.append(x[0])
        x = step @ x
    return np.array(found)


def rows(size):
    """Its samples over their RMS, the rows of these, and that RMS."""
    n_step = N - 1
    response = respond(np.linspace(0, n_step * DT, 2 * n_step + 1)[None], np.broadcast_to(A, (1, 2 * n_step + 1, 2, 2)))
    steps = PathSteps(response.M, response.b[..., 1], np.full((1, n_step), DT), np.array([(0, k) for k in range(N)]))
    samples = path(size) + NOISE * np.random.default_rng(4).normal(size=N)
    scale = np.sqrt(np.mean(samples**2))
    start = np.full(2, 10.0) / NOISE
    return ForcedPath(steps, (0,), start, np.ones(N), PERIOD, DT, NOISE / scale), samples / scale, scale


@pytest.mark.parametrize("size", [0.03, 1.0, 30.0])
def test_it_is_the_rms_of_the_force_whatever_it_did_to_the_samples(size):
    force, target, scale = rows(size)
    assert gap_size(force, target, np.zeros((N, 0))) * scale == pytest.approx(size, rel=0.15)


def test_what_the_users_own_terms_explain_is_no_gap():
    force, target, scale = rows(1.0)
    # Their column is the path without noise: the free motion in it is a start.
    assert gap_size(force, target, path(1.0)[:, None]) * scale < 0.02


def test_where_nothing_is_missing_it_is_what_the_noise_may_hide():
    force, target, scale = rows(0.0)
    found = gap_size(force, target, np.zeros((N, 0))) * scale
    # A force that shows in no sample, and no more than one that moves the oscillator by its noise.
    assert 0 < found < 4 * NOISE * np.sqrt(4.0)
