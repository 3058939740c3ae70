"""Paths and their derivatives on given steps, against SciPy's integrator and differences."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from bayes_greybox.physics.integration.adaptive_steps import curvature_of
from bayes_greybox.physics.integration.fixed_steps import follow, follow_with_slopes, intervals_of

T = np.concatenate([0.2 * np.arange(30), 5.8 + 0.3 * np.arange(1, 20)])


def rate(t, x, u, p):
    return jnp.stack([x[1], u[0] - p[0] * x[0] - p[1] * x[1] - p[2] * x[0] ** 3 + 0.1 * jnp.sin(t)])


P, START = np.array([2.0, 0.15, 0.4]), np.array([0.4, -0.2])


def inputs(kind):
    u = np.sin(1.3 * T)[:, None]
    curvature = np.zeros_like(u) if kind == "zoh" else curvature_of(T, u, kind)[1]
    return u, curvature


def by_scipy(kind, p=P, start=START):
    u = inputs(kind)[0][:, 0]
    between = {
        "cubic": CubicSpline(T, u),
        "linear": lambda t: np.interp(t, T, u),
        "zoh": lambda t: u[np.clip(np.searchsorted(T, t, side="right") - 1, 0, len(T) - 1)],
    }[kind]
    found = [np.asarray(start)]
    for a, b in zip(T[:-1], T[1:], strict=True):
        # Held inputs are those of the interval, also at its end.
        at = (lambda t, a=a: between(a)) if kind == "zoh" else between
        motion = lambda t, x, at=at: [  # noqa: E731
            x[1], at(t) - p[0] * x[0] - p[1] * x[1] - p[2] * x[0] ** 3 + 0.1 * np.sin(t)
        ]  # fmt: skip
        found.append(solve_ivp(motion, (a, b), found[-1], rtol=1e-12, atol=1e-13, method="DOP853").y[:, -1])
    return np.array(found)


@pytest.mark.parametrize("kind", ["linear", "zoh", "cubic"])
def test_paths_are_those_of_scipy_and_gain_five_orders_from_shorter_steps(kind):
    truth = by_scipy(kind)
    grid = intervals_of(T, *inputs(kind), [kind == "zoh"], len(T) - 1)
    errors = []
    for n in (1, 4):
        found = follow(rate, jnp.asarray(START), jnp.asarray(P), grid, jnp.full(len(T) - 1, n))
        errors.append(np.max(np.abs(np.asarray(found) - truth)))
    # A method of order 5 leaves a thirty-second of a thirty-second; its next order may hinder by a factor of four.
    assert errors[1] < errors[0] / 16**2 and errors[1] < 1e-6


def test_derivatives_are_those_of_the_path_as_it_is_computed():
    grid, steps = intervals_of(T, *inputs("cubic"), [False], len(T) - 1), jnp.full(len(T) - 1, 2)
    path, slopes = follow_with_slopes(rate, jnp.asarray(START), jnp.asarray(P), grid, steps)
    np.testing.assert_allclose(path, follow(rate, jnp.asarray(START), jnp.asarray(P), grid, steps), rtol=1e-12)
    both, h = np.concatenate([P, START]), 1e-5
    for k, unit in enumerate(np.eye(5)):
        ahead, behind = (
            np.asarray(follow(rate, jnp.asarray(v[3:]), jnp.asarray(v[:3]), grid, steps))
            for v in (both + h * unit, both - h * unit)
        )
        # Central differences leave h² times a third derivative, and rounding over h.
        np.testing.assert_allclose(slopes[:, k], (ahead - behind) / (2 * h), atol=1e-7)


def test_each_input_is_held_or_goes_on():
    (u, curvature), none = inputs("cubic"), np.zeros((len(T), 1))
    rate = lambda t, x, u, p: jnp.array([u[0] + 2 * u[1]])  # noqa: E731
    steps, start, n = jnp.full(len(T) - 1, 2), jnp.zeros(1), len(T) - 1
    both = intervals_of(T, np.hstack([u, u]), np.hstack([curvature, none]), [False, True], n)
    goes_on, held = (
        intervals_of(T, np.hstack([u, 0 * u]), np.hstack([bend, none]), [stays, False], n)
        for bend, stays in ((curvature, False), (none, True))
    )
    each = [np.asarray(follow(rate, start, jnp.zeros(0), grid, steps)) for grid in (both, goes_on, held)]
    np.testing.assert_allclose(each[0], each[1] + 2 * each[2], atol=1e-12)
    assert np.max(np.abs(each[1] - each[2])) > 0.01


def test_intervals_of_no_length_change_nothing():
    u, curvature = inputs("cubic")
    grid = intervals_of(T, u, curvature, [False], len(T) + 6)
    found, slopes = follow_with_slopes(rate, jnp.asarray(START), jnp.asarray(P), grid, jnp.full(len(T) + 6, 1))
    assert found.shape == (len(T) + 7, 2)
    np.testing.assert_array_equal(found[len(T) :], np.broadcast_to(found[len(T) - 1], (7, 2)))
    assert np.all(np.isfinite(slopes))
