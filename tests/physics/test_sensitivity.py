"""How a path answers a small force, against integration of the whole equation."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bayes_greybox.physics.sensitivity import Grid, carried, middles, respond, runge_kutta, triples


def rate(t, x, u, args):
    """A hardening oscillator, forced."""
    return jnp.stack([x[1], u[0] - 2 * x[0] - 0.3 * x[1] + args[0] * x[0] ** 3])


def plain(t, x, push=0.0, k=-0.4):
    return [x[1], np.sin(1.3 * t) - 2 * x[0] - 0.3 * x[1] + k * x[0] ** 3 + push * np.cos(2 * t)]


def grid_of(n_step, end=8.0):
    nodes = np.linspace(0, end, 2 * n_step + 1)
    return Grid(jnp.asarray(nodes[None]), jnp.asarray(np.sin(1.3 * nodes)[None, :, None]))


def exact(times, start=(0.7, -0.2), push=0.0):
    return solve_ivp(plain, (0, times[-1]), start, t_eval=times, args=(push,), rtol=1e-12, atol=1e-12).y.T


def along(n_step):
    """The exact path on the nodes, and the steps of the linear equation along it."""
    grid, args = grid_of(n_step), jnp.array([-0.4])
    path = exact(np.asarray(grid.time[0]))
    return grid, path, respond(rate, grid, jnp.asarray(path[None]), 1, args), args


def test_a_small_force_moves_the_path_as_the_whole_equation_says():
    grid, _, response, _ = along(200)
    nodes = np.asarray(grid.time[0])
    force = jnp.asarray(np.cos(2 * nodes)[None, :, None])
    moved = np.asarray(carried(response, jnp.zeros((1, 2, 1)), force))[0, :, :, 0]
    h = 1e-4
    truth = (exact(nodes[::2], push=h) - exact(nodes[::2], push=-h)) / (2 * h)
    np.testing.assert_allclose(moved, truth, atol=2e-6)


def test_a_change_of_the_start_moves_the_path_as_the_whole_equation_says():
    grid, _, response, _ = along(200)
    nodes, h = np.asarray(grid.time[0]), 1e-4
    for k in range(2):
        unit = np.eye(2)[k]
        moved = np.asarray(carried(response, jnp.asarray(unit[None, :, None]), jnp.zeros((1, len(nodes), 1))))[
            0, :, :, 0
        ]
        up, down = (exact(nodes[::2], np.array([0.7, -0.2]) + side * h * unit) for side in (1, -1))
        np.testing.assert_allclose(moved, (up - down) / (2 * h), atol=2e-6)


def test_the_error_falls_with_the_fourth_power_of_the_step():
    errors = []
    for n_step in (20, 40, 80):
        grid, _, response, _ = along(n_step)
        nodes = np.asarray(grid.time[0])
        force = jnp.asarray(np.cos(2 * nodes)[None, :, None])
        moved = np.asarray(carried(response, jnp.zeros((1, 2, 1)), force))[0, -1, 0, 0]
        fine = along(1000)
        at = np.asarray(fine[0].time[0])
        truth = np.asarray(carried(fine[2], jnp.zeros((1, 2, 1)), jnp.asarray(np.cos(2 * at)[None, :, None])))
        errors.append(abs(moved - truth[0, -1, 0, 0]))
    assert errors[0] > 10 * errors[1] > 100 * errors[2]


def test_middles_lie_on_the_path():
    grid, path, _, args = along(100)
    ends = jnp.asarray(path[None, ::2])
    np.testing.assert_allclose(np.asarray(middles(rate, grid, ends, args))[0], path[1::2], atol=5e-6)


def test_forces_add_up_and_stretches_join():
    grid, _, response, _ = along(60)
    force = jnp.asarray(np.random.default_rng(0).standard_normal((1, 121, 3)))
    whole = np.asarray(carried(response, jnp.zeros((1, 2, 3)), force))
    summed = np.asarray(carried(response, jnp.zeros((1, 2, 1)), force.sum(axis=-1, keepdims=True)))
    np.testing.assert_allclose(whole.sum(axis=-1, keepdims=True), summed, atol=1e-12)
    first = carried(type(response)(*(s[:, :25] for s in response)), jnp.zeros((1, 2, 3)), force[:, :51])
    second = carried(type(response)(*(s[:, 25:] for s in response)), first[:, -1], force[:, 50:])
    np.testing.assert_allclose(np.asarray(second)[:, -1], whole[:, -1], atol=1e-12)


def test_steps_of_no_length_do_nothing():
    time = jnp.array([[0.0, 0.05, 0.1, 0.1, 0.1]])
    grid = Grid(time, jnp.zeros((1, 5, 1)))
    response = respond(rate, grid, jnp.ones((1, 5, 2)), 1, jnp.array([-0.4]))
    np.testing.assert_array_equal(np.asarray(response.M)[0, 1], np.eye(2))
    np.testing.assert_array_equal(np.asarray(response.b)[0, 1], np.zeros((2, 3)))


@pytest.mark.parametrize("force", [0.0, 0.7])
def test_a_step_with_a_constant_force_is_a_step_of_the_forced_equation(force):
    time, inputs = triples(jnp.array([[0.0, 0.05, 0.1]]))[0, 0], jnp.full((3, 1), 0.3)
    x = jnp.array([0.5, -0.1])
    pushed = runge_kutta(rate, time, inputs, x, jnp.array([0.0, force]), jnp.array([-0.4]))
    other = runge_kutta(rate, time, inputs + force, x, jnp.zeros(2), jnp.array([-0.4]))
    np.testing.assert_allclose(np.asarray(pushed), np.asarray(other), rtol=1e-12)
