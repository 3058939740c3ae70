"""How a path answers a small force, against integration of the whole equation."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bayes_greybox.physics.integration.sensitivity import Response, carried, forces, hermite, respond, triples


def plain(t, x, push=0.0, k=-0.4):
    return [x[1], np.sin(1.3 * t) - 2 * x[0] - 0.3 * x[1] + k * x[0] ** 3 + push * np.cos(2 * t)]


def exact(times, start=(0.7, -0.2), push=0.0):
    return solve_ivp(plain, (0, times[-1]), start, t_eval=times, args=(push,), rtol=1e-12, atol=1e-12).y.T


def jacobian(path):
    A = np.zeros((*path.shape, 2))
    A[..., 0, 1], A[..., 1, 0], A[..., 1, 1] = 1.0, -2 - 1.2 * path[..., 0] ** 2, -0.3
    return A


def along(n_step):
    """The nodes, the exact path on them, and the steps of the linear equation along it."""
    nodes = np.linspace(0, 8.0, 2 * n_step + 1)
    path = exact(nodes)
    return nodes, path, respond(nodes[None], jacobian(path)[None])


def moved_by(response, force, start=None):
    """δ at the ends of steps by a force on the second state's rate, given at nodes [n_node, k]."""
    jump = np.einsum("snit,sntk->snik", response.b[..., 1], triples(force[None]))
    return carried(response.M, np.zeros((1, 2, force.shape[1])) if start is None else start, jump)[0]


def test_a_small_force_moves_the_path_as_the_whole_equation_says():
    nodes, _, response = along(200)
    moved = moved_by(response, np.cos(2 * nodes)[:, None])[..., 0]
    h = 1e-4
    truth = (exact(nodes[::2], push=h) - exact(nodes[::2], push=-h)) / (2 * h)
    np.testing.assert_allclose(moved, truth, atol=2e-6)


def test_a_change_of_the_start_moves_the_path_as_the_whole_equation_says():
    nodes, _, response = along(200)
    h = 1e-4
    for k in range(2):
        unit = np.eye(2)[k]
        moved = moved_by(response, np.zeros((len(nodes), 1)), unit[None, :, None])[..., 0]
        up, down = (exact(nodes[::2], np.array([0.7, -0.2]) + side * h * unit) for side in (1, -1))
        np.testing.assert_allclose(moved, (up - down) / (2 * h), atol=2e-6)


def test_the_error_falls_with_the_fourth_power_of_the_step():
    def end(n_step):
        nodes, _, response = along(n_step)
        return moved_by(response, np.cos(2 * nodes)[:, None])[-1, 0, 0]

    errors = [abs(end(n) - end(1000)) for n in (20, 40, 80)]
    assert errors[0] > 10 * errors[1] > 100 * errors[2]


def test_a_path_through_ends_with_their_rates():
    nodes, path, _ = along(100)
    rates = np.array([plain(t, x) for t, x in zip(nodes[::2], path[::2], strict=True)])
    whole, slope = hermite(nodes[None], path[None, ::2], rates[None])
    np.testing.assert_allclose(whole[0], path, atol=5e-6)
    np.testing.assert_allclose(slope[0], [plain(t, x) for t, x in zip(nodes, path, strict=True)], atol=5e-5)


def test_forces_add_up_and_stretches_join():
    nodes, _, response = along(60)
    force = np.random.default_rng(0).standard_normal((len(nodes), 3))
    whole = moved_by(response, force)
    summed = moved_by(response, force.sum(axis=1, keepdims=True))
    np.testing.assert_allclose(whole.sum(axis=-1, keepdims=True), summed, atol=1e-12)
    first = moved_by(Response(*(s[:, :25] for s in response)), force[:51])
    second = moved_by(Response(*(s[:, 25:] for s in response)), force[50:], first[None, -1])
    np.testing.assert_allclose(second[-1], whole[-1], atol=1e-12)


@pytest.mark.parametrize("n_step", [0, 1, 2, 7, 50])
def test_steps_side_by_side_are_steps_one_after_the_other(n_step):
    rng = np.random.default_rng(n_step)
    M, jump = rng.standard_normal((3, n_step, 2, 2)), rng.standard_normal((3, n_step, 2, 4))
    ends = [rng.standard_normal((3, 2, 4))]
    for k in range(n_step):
        ends.append(M[:, k] @ ends[-1] + jump[:, k])
    found, exact = carried(M, ends[0], jump), np.stack(ends, axis=1)
    np.testing.assert_allclose(found, exact, rtol=1e-9, atol=1e-12 * np.max(np.abs(exact)))


def test_what_grows_beyond_all_bounds_is_not_finite_and_no_warning():
    grown = carried(np.full((1, 400, 1, 1), 10.0), np.ones((1, 1, 1)), np.zeros((1, 400, 1, 1)))[0, :, 0, 0]
    np.testing.assert_allclose(grown[:300], 10.0 ** np.arange(300), rtol=1e-12)
    assert not np.isfinite(grown[-1])


def test_steps_of_no_length_do_nothing():
    time = np.array([[0.0, 0.05, 0.1, 0.1, 0.1]])
    response = respond(time, jacobian(np.ones((1, 5, 2))))
    np.testing.assert_array_equal(response.M[0, 1], np.eye(2))
    np.testing.assert_array_equal(response.b[0, 1], np.zeros((2, 3, 2)))


@pytest.mark.parametrize("place", [0.03, 0.21, 0.37, 0.5])
def test_a_force_that_jumps_within_a_step_counts_by_its_integral(place):
    time = np.array([[0.0, 0.25, 0.5]])
    still = respond(time, np.zeros((1, 3, 1, 1)))

    def impulse(evaluate):
        return float(still.jumps(forces(evaluate, time[..., None]))[0, 0, 0])

    assert impulse(lambda t: np.sign(t - place)) == pytest.approx(0.5 - 2 * place, abs=0.5 / 64)
    smooth = impulse(lambda t: 1 + 0.3 * t - 0.2 * t**2)
    assert smooth == pytest.approx(0.5 + 0.15 * 0.25 - 0.2 / 3 * 0.125, rel=1e-12)


def test_forces_that_are_smooth_are_evaluated_at_nodes_alone():
    asked = []

    def evaluate(t):
        asked.append(len(t))
        return np.cos(t)

    forces(evaluate, np.linspace(0, 8, 201)[None, :, None])
    assert asked == [201]
