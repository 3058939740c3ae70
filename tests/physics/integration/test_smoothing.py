"""The smoother against the dense Gaussian posterior of a path."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bayes_greybox.physics.integration.sensitivity import Grid, forces, hermite, respond, triples
from bayes_greybox.physics.integration.smoothing import Observed, filtered, log_likelihoods, smooth, steps_along

FORCED = np.array([[0.0], [1.0]])
"""The unknown force acts on the second state's rate."""


def linear(t, x, u, args):
    return jnp.stack([x[1], u[0] - 2 * x[0] - 0.3 * x[1]])


def rates(points, stiffening=0.0):
    t, y, v, u = np.moveaxis(points, -1, 0)
    return np.stack([v, u - 2 * y - 0.3 * v - stiffening * y**3], axis=-1)


def steps_of(grid, ends, stiffening=0.0):
    """Steps near a path of the oscillator."""
    at_ends = np.concatenate([grid.time[:, ::2, None], ends, grid.inputs[:, ::2]], axis=-1)
    path, slope = hermite(grid.time, ends, rates(at_ends, stiffening))
    points = np.concatenate([grid.time[..., None], path, grid.inputs], axis=-1)
    A = np.zeros((*path.shape, 2))
    A[..., 0, 1], A[..., 1, 0], A[..., 1, 1] = 1.0, -2 - 3 * stiffening * path[..., 0] ** 2, -0.3
    departure = forces(lambda at: rates(at, stiffening), points) - triples(slope)
    return steps_along(grid.time, ends, respond(grid.time, A), departure, FORCED)


def problem(n_step=40, every=2, missing=(), sd=(3.0, 2.0), seed=0, segments=1):
    rng = np.random.default_rng(seed)
    nodes = np.tile(np.linspace(0, 4, 2 * n_step + 1), (segments, 1))
    grid = Grid(nodes, np.sin(nodes)[..., None])
    values = np.full((segments, n_step + 1, 1), np.nan)
    values[:, ::every, 0] = rng.standard_normal((segments, n_step // every + 1))
    for k in missing:
        values[:, k] = np.nan
    mean = np.array([[0.3, -0.1]] * segments)
    return grid, Observed(values, np.array([0.4]), mean, np.array(sd))


def path_of(grid, observed, ratio, outputs=(0,), around=None):
    ends = np.zeros((*observed.values.shape[:2], 2)) if around is None else around
    return smooth(steps_of(grid, ends), observed, outputs, ratio)


def dense(steps, observed, ratio):
    """Posterior mean of the ends of steps, and log likelihood with σ² profiled out, from the joint covariance."""
    M, c, b, h = (np.asarray(x)[0] for x in steps)
    n = len(h) + 1
    mean, root = [np.asarray(observed.mean)[0]], [np.hstack([np.diag(observed.sd), np.zeros((2, n - 1))])]
    for k in range(n - 1):
        mean.append(M[k] @ mean[-1] + c[k])
        shock = np.zeros((2, n + 1))
        shock[:, 2 + k] = b[k, :, 0] * np.sqrt(ratio / h[k])
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
    return path.reshape(n, 2), -0.5 * (len(seen) * np.log(sigma2) + np.linalg.slogdet(S)[1])


@pytest.mark.parametrize("ratio", [1e-6, 0.1, 30.0])
@pytest.mark.parametrize("missing", [(), (0, 4, 10, 12)])
def test_the_smoothed_path_is_the_posterior_mean(ratio, missing):
    grid, observed = problem(missing=missing)
    found = path_of(grid, observed, ratio)
    path, log = dense(steps_of(grid, np.zeros((1, 41, 2))), observed, ratio)
    np.testing.assert_allclose(found[0], path, atol=1e-9)
    steps = steps_of(grid, np.zeros((1, 41, 2)))
    assert log_likelihoods(steps, observed, (0,), np.array([ratio]))[0] == pytest.approx(log, abs=1e-8)


def test_of_a_linear_system_one_pass_is_enough_but_for_the_steps():
    errors = []
    for n_step in (20, 40):
        grid, observed = problem(n_step, every=n_step // 5)
        observed = observed._replace(values=np.where(np.isfinite(observed.values), 0.5, np.nan))
        start = np.array([0.3, -0.1]) + np.stack([np.sin(grid.time[:, ::2]), np.cos(grid.time[:, ::2])], axis=-1)
        once, again = path_of(grid, observed, 1e-3), path_of(grid, observed, 1e-3, around=start)
        errors.append(np.abs(again - once).max())
    assert errors[0] < 5e-3 and errors[1] < errors[0] / 3.5


def test_segments_are_smoothed_by_themselves():
    grid, observed = problem(segments=2)
    found = path_of(grid, observed, 0.1)
    for k in range(2):
        part = Grid(*(x[k : k + 1] for x in grid))
        own = observed._replace(values=observed.values[k : k + 1], mean=observed.mean[k : k + 1])
        np.testing.assert_allclose(found[k], path_of(part, own, 0.1)[0], atol=1e-10)


def test_two_sensors_count_by_their_noise():
    grid, observed = problem()
    values = np.concatenate([np.asarray(observed.values), np.asarray(observed.values)], axis=-1)
    both = observed._replace(values=values, variances=np.array([0.8, 0.8]))
    one, two = path_of(grid, observed, 0.1), path_of(grid, both, 0.1, outputs=(0, 0))
    np.testing.assert_allclose(two, one, atol=1e-9)


def test_the_filter_ends_where_the_smoother_does():
    grid, observed = problem(n_step=200, every=10)
    found = np.asarray(filtered(linear, grid, observed, (0,), FORCED, 0.1, None))
    np.testing.assert_allclose(found[0, -1], path_of(grid, observed, 0.1)[0, -1], atol=5e-5)


def draining(t, x, u, args):
    """Two tanks: the first, unseen, drains into the second."""
    return jnp.stack([u[0] - jnp.sqrt(x[0]), jnp.sqrt(x[0]) - jnp.sqrt(x[1])])


def test_the_filter_stays_where_the_equations_are_defined():
    rng, nodes = np.random.default_rng(0), np.linspace(0, 20, 201)[None]
    grid = Grid(nodes, (0.6 + 0.5 * np.sin(nodes))[..., None])

    def whole(t, x):
        return [0.6 + 0.5 * np.sin(t) - np.sqrt(x[0]), np.sqrt(x[0]) - np.sqrt(x[1])]

    level = solve_ivp(whole, (0, 20), [0.5, 0.4], t_eval=nodes[0, ::2], rtol=1e-9).y
    shown = level[1] + 0.05 * rng.standard_normal(len(level[1]))
    # Far too high a start is drawn down by wide gains, below an empty tank if nothing stopped it.
    observed = Observed(shown[None, :, None], np.array([0.05**2]), np.array([[3.0, shown[0]]]), np.array([30.0, 3.0]))
    force = np.array([[0.0], [1.0]])
    ends = filtered(draining, grid, observed, (1,), force, 1e-4, ())
    assert np.all(np.isfinite(ends)) and np.min(ends) >= 0
    assert np.sqrt(np.mean((ends[0, 50:, 0] - level[0, 50:]) ** 2)) < 0.2


def test_forces_add_up_by_their_variances():
    grid, observed = problem()
    ends = np.zeros((1, 41, 2))
    found = []
    for E in (FORCED, np.hstack([FORCED, FORCED]) * np.sqrt(0.5)):
        points = np.concatenate([grid.time[..., None], np.zeros((1, 81, 2)), grid.inputs], axis=-1)
        A = np.broadcast_to([[0.0, 1.0], [-2.0, -0.3]], (1, 81, 2, 2))
        steps = steps_along(grid.time, ends, respond(grid.time, A), forces(rates, points), E)
        logs = log_likelihoods(steps, observed, (0,), np.array([1e-6, 0.1, 3.0]))
        found.append((smooth(steps, observed, (0,), 0.1), filtered(linear, grid, observed, (0,), E, 0.1, None), logs))
    for one, two in zip(*found, strict=True):
        np.testing.assert_allclose(two, one, atol=1e-8)


def test_steps_of_no_length_keep_the_state():
    grid, observed = problem()
    time = np.concatenate([grid.time, np.repeat(grid.time[:, -1:], 4, axis=1)], axis=1)
    inputs = np.concatenate([grid.inputs, np.repeat(grid.inputs[:, -1:], 4, axis=1)], axis=1)
    values = np.concatenate([observed.values, np.full((1, 2, 1), np.nan)], axis=1)
    longer = path_of(Grid(time, inputs), observed._replace(values=values), 0.1)
    shorter = path_of(grid, observed, 0.1)
    np.testing.assert_allclose(longer[:, :-2], shorter, atol=1e-10)
    np.testing.assert_allclose(longer[:, -2:], np.repeat(shorter[:, -1:], 2, axis=1), atol=1e-10)


def test_steps_lead_where_the_equation_leads():
    nodes = np.linspace(0, 4, 161)
    path = solve_ivp(
        lambda t, x: [x[1], np.sin(t) - 2 * x[0] - 0.3 * x[1] - x[0] ** 3], (0, 4), [0.7, -0.2], t_eval=nodes[::2],
        rtol=1e-11, atol=1e-11,
    ).y.T  # fmt: skip
    steps = steps_of(Grid(nodes[None], np.sin(nodes)[None, :, None]), path[None], stiffening=1.0)
    after = np.einsum("nij,nj->ni", steps.M[0], path[:-1]) + steps.c[0]
    np.testing.assert_allclose(after, path[1:], atol=1e-6)
