"""The smoother against the dense Gaussian posterior of a path."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bayes_greybox.physics.sensitivity import Grid, respond
from bayes_greybox.physics.smoothing import Observed, filtered, linearised, smooth


def linear(t, x, u, args):
    return jnp.stack([x[1], u[0] - 2 * x[0] - 0.3 * x[1]])


def problem(n_step=40, every=2, missing=(), sd=(3.0, 2.0), seed=0, segments=1):
    rng = np.random.default_rng(seed)
    nodes = np.tile(np.linspace(0, 4, 2 * n_step + 1), (segments, 1))
    grid = Grid(jnp.asarray(nodes), jnp.asarray(np.sin(nodes)[..., None]))
    values = np.full((segments, n_step + 1, 1), np.nan)
    values[:, ::every, 0] = rng.standard_normal((segments, n_step // every + 1))
    for k in missing:
        values[:, k] = np.nan
    mean = np.array([[0.3, -0.1]] * segments)
    return grid, Observed(jnp.asarray(values), jnp.array([0.4]), jnp.asarray(mean), jnp.array(sd))


def path_of(grid, observed, ratio, outputs=(0,), around=None):
    ends = jnp.zeros((*observed.values.shape[:2], 2)) if around is None else around
    return smooth(linearised(linear, grid, ends, 1, None), observed, outputs, jnp.asarray(ratio))


def dense(grid, observed, ratio):
    """Posterior mean of the ends of steps, and log likelihood with σ² profiled out, from the joint covariance."""
    zero = np.zeros((1, grid.time.shape[1], 2))
    response = respond(linear, grid, jnp.asarray(zero), 1, None)
    M, b = np.asarray(response.M)[0], np.asarray(response.b)[0]
    h = np.diff(np.asarray(grid.time)[0, ::2])
    u = np.asarray(grid.inputs)[0, :, 0]
    n = len(h) + 1
    mean, root = [np.asarray(observed.mean)[0]], [np.hstack([np.diag(observed.sd), np.zeros((2, n - 1))])]
    for k in range(n - 1):
        mean.append(M[k] @ mean[-1] + b[k] @ u[2 * k : 2 * k + 3])
        shock = np.zeros((2, n + 1))
        shock[:, 2 + k] = b[k].sum(axis=1) * np.sqrt(ratio / h[k])
        root.append(M[k] @ root[-1] + shock)
    mean, root = np.concatenate(mean), np.concatenate(root)
    y = np.asarray(observed.values)[0, :, 0]
    seen = np.flatnonzero(np.isfinite(y))
    H = np.eye(2 * n)[2 * seen]
    K = root @ root.T
    S = H @ K @ H.T + 0.4 * np.eye(len(seen))
    v = y[seen] - H @ mean
    path = mean + K @ H.T @ np.linalg.solve(S, v)
    sigma2 = v @ np.linalg.solve(S, v) / len(seen)
    log = -0.5 * (len(seen) * np.log(sigma2) + np.linalg.slogdet(S)[1])
    return path.reshape(n, 2), log, np.sqrt(sigma2)


@pytest.mark.parametrize("ratio", [1e-6, 0.1, 30.0])
@pytest.mark.parametrize("missing", [(), (0, 4, 10, 12)])
def test_the_smoothed_path_is_the_posterior_mean(ratio, missing):
    grid, observed = problem(missing=missing)
    found = path_of(grid, observed, ratio)
    path, log, sigma = dense(grid, observed, ratio)
    np.testing.assert_allclose(np.asarray(found.ends)[0], path, atol=1e-9)
    assert float(found.log_likelihood) == pytest.approx(log, abs=1e-8) and float(found.sigma) == pytest.approx(sigma)


def test_of_a_linear_system_one_pass_is_enough():
    grid, observed = problem()
    once = path_of(grid, observed, 0.1)
    again = path_of(grid, observed, 0.1, around=5 + once.ends)
    np.testing.assert_allclose(np.asarray(again.ends), np.asarray(once.ends), atol=1e-9)


def test_segments_are_smoothed_by_themselves():
    grid, observed = problem(segments=2)
    found = np.asarray(path_of(grid, observed, 0.1).ends)
    for k in range(2):
        part = Grid(*(x[k : k + 1] for x in grid))
        own = observed._replace(values=observed.values[k : k + 1], mean=observed.mean[k : k + 1])
        np.testing.assert_allclose(found[k], np.asarray(path_of(part, own, 0.1).ends)[0], atol=1e-10)


def test_two_sensors_count_by_their_noise():
    grid, observed = problem()
    values = np.concatenate([np.asarray(observed.values), np.asarray(observed.values)], axis=-1)
    both = observed._replace(values=jnp.asarray(values), variances=jnp.array([0.8, 0.8]))
    one, two = path_of(grid, observed, 0.1), path_of(grid, both, 0.1, outputs=(0, 0))
    np.testing.assert_allclose(np.asarray(two.ends), np.asarray(one.ends), atol=1e-9)


def test_the_filter_ends_where_the_smoother_does():
    grid, observed = problem()
    found = np.asarray(filtered(linear, grid, observed, (0,), 1, jnp.asarray(0.1), None))
    np.testing.assert_allclose(found[0, -1], np.asarray(path_of(grid, observed, 0.1).ends)[0, -1], atol=1e-9)


def test_steps_of_no_length_keep_the_state():
    grid, observed = problem()
    time = jnp.concatenate([grid.time, jnp.repeat(grid.time[:, -1:], 4, axis=1)], axis=1)
    inputs = jnp.concatenate([grid.inputs, jnp.repeat(grid.inputs[:, -1:], 4, axis=1)], axis=1)
    values = jnp.concatenate([observed.values, jnp.full((1, 2, 1), jnp.nan)], axis=1)
    longer = np.asarray(path_of(Grid(time, inputs), observed._replace(values=values), 0.1).ends)
    shorter = np.asarray(path_of(grid, observed, 0.1).ends)
    np.testing.assert_allclose(longer[:, :-2], shorter, atol=1e-10)
    np.testing.assert_allclose(longer[:, -2:], np.repeat(shorter[:, -1:], 2, axis=1), atol=1e-10)


def cubic(t, x, u, args):
    return jnp.stack([x[1], u[0] - 2 * x[0] - 0.3 * x[1] - x[0] ** 3])


def test_steps_lead_where_the_equation_leads():
    nodes = np.linspace(0, 4, 161)
    path = solve_ivp(
        lambda t, x: [x[1], np.sin(t) - 2 * x[0] - 0.3 * x[1] - x[0] ** 3], (0, 4), [0.7, -0.2], t_eval=nodes[::2],
        rtol=1e-11, atol=1e-11,
    ).y.T  # fmt: skip
    steps = linearised(cubic, Grid(jnp.asarray(nodes[None]), jnp.sin(nodes)[None, :, None]), path[None], 1, None)
    after = np.einsum("nij,nj->ni", np.asarray(steps.M)[0], path[:-1]) + np.asarray(steps.c)[0]
    np.testing.assert_allclose(after, path[1:], atol=1e-6)
