"""Integration in time against closed forms, and blow-ups as results."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from bayes_greybox.data.errors import InputError
from bayes_greybox.physics.integrate import integrate, interpolant


def _harmonic(t, x, u, args):
    return jnp.stack([x[1], -(args**2) * x[0]])


def _square(t, x, u, args):
    return args * x**2


def test_harmonic_oscillator_to_1e_8():
    t = np.linspace(0.0, 20.0, 301)
    path = integrate(_harmonic, t, np.array([1.0, 0.0]), args=2.0, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(path.states, np.stack([np.cos(2 * t), -2 * np.sin(2 * t)], axis=1), atol=1e-8)
    assert np.isnan(path.failed_at)


def test_tolerance_does_not_depend_on_the_unit():
    t = np.linspace(0.0, 10.0, 101)
    runs = [integrate(_harmonic, t, np.array([size, 0.0]), args=1.0).states / size for size in (1e-9, 1.0, 1e9)]
    np.testing.assert_allclose(runs[0], runs[1], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(runs[2], runs[1], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("x0", [0.1, 0.37, 2.0])
def test_blow_up_reports_its_time(x0):
    # x' = x^2 from x0 is x0 / (1 - x0 t), which ends at t = 1 / x0.
    t = np.linspace(0.0, 20.0, 201)
    path = integrate(_square, t, np.array([x0]), args=1.0)
    assert float(path.failed_at) == pytest.approx(1.0 / x0, rel=1e-6)
    before = t < 1.0 / x0 - 1e-6
    np.testing.assert_allclose(path.states[before, 0], x0 / (1.0 - x0 * t[before]), rtol=1e-5)
    assert np.isnan(path.states[t > 1.0 / x0 + 1e-6]).all()


def test_undefined_right_hand_side_and_spent_budget_are_results():
    t = np.linspace(0.0, 2.0, 21)
    path = integrate(lambda t, x, u, args: jnp.log(1.0 - t) * x, t, np.array([1.0]))
    assert float(path.failed_at) == pytest.approx(1.0, abs=1e-6)
    assert np.isfinite(path.states[:10]).all() and np.isnan(path.states[11:]).all()
    path = integrate(_harmonic, t * 100, np.array([1.0, 0.0]), args=1.0, max_steps=20)
    assert 0.0 < float(path.failed_at) < 200.0 and np.isnan(path.states[-1]).all()


def test_jumps_in_the_right_hand_side_are_crossed():
    # x' = 2 - sign(x) from -1 climbs at rate 3 until t = 1/3, then at rate 1.
    t = np.linspace(0.0, 2.0, 21)
    path = integrate(lambda t, x, u, args: 2.0 - jnp.sign(x), t, np.array([-1.0]))
    np.testing.assert_allclose(path.states[:, 0], np.minimum(3 * t - 1, t - 1 / 3), atol=1e-7)
    step = integrate(lambda t, x, u, args: jnp.where(t > 0.777, 1.0, 0.0) * jnp.ones(1), t, np.array([1.0]))
    np.testing.assert_allclose(step.states[:, 0], 1.0 + np.maximum(t - 0.777, 0.0), atol=1e-7)


def test_one_failing_draw_leaves_the_others_alone():
    t = jnp.linspace(0.0, 5.0, 51)
    run = jax.jit(jax.vmap(lambda x0, a: integrate(_square, t, x0, args=a)))
    paths = run(jnp.array([[1.0], [1.0], [0.1]]), jnp.array([1.0, -1.0, 1.0]))
    assert float(paths.failed_at[0]) == pytest.approx(1.0, rel=1e-6)
    assert np.isnan(paths.failed_at[1:]).all()
    np.testing.assert_allclose(paths.states[1, :, 0], 1.0 / (1.0 + t), rtol=1e-6)
    np.testing.assert_allclose(paths.states[2, :, 0], 0.1 / (1.0 - 0.1 * t), rtol=1e-6)


def test_linear_and_held_inputs_are_integrated_exactly():
    # x' = u: the trapezoidal sum for straight lines between samples, the rectangle sum for held samples.
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.05, 0.3, 40))
    u = rng.standard_normal((40, 1))
    step = np.diff(t)
    expected = {
        "linear": np.cumsum(step * (u[1:, 0] + u[:-1, 0]) / 2),
        "zoh": np.cumsum(step * u[:-1, 0]),
    }
    for kind, area in expected.items():
        path = integrate(lambda t, x, u, args: u, t, np.zeros(1), u, interpolation=kind)
        np.testing.assert_allclose(path.states[1:, 0], area, atol=1e-9)
    curve = CubicSpline(t, u[:, 0]).antiderivative()
    path = integrate(lambda t, x, u, args: u, t, np.zeros(1), u, interpolation="cubic")
    np.testing.assert_allclose(path.states[:, 0], curve(t) - curve(t[0]), atol=1e-8)


def test_spline_equals_scipy():
    rng = np.random.default_rng(1)
    t = np.sort(rng.uniform(0.0, 5.0, 25))
    values = np.stack([np.sin(3 * t), t**3], axis=1)
    times = np.linspace(t[0], t[-1], 77)
    ours = jax.vmap(interpolant(t, values, "cubic"))(times)
    np.testing.assert_allclose(ours, CubicSpline(t, values)(times), rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(ours[:, 1], times**3, rtol=1e-9, atol=1e-10)


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(InputError, match="two times"):
        integrate(_square, np.zeros(1), np.ones(1), args=1.0)
    with pytest.raises(InputError, match="'cubic'"):
        interpolant(np.arange(5.0), np.ones((5, 1)), kind="cubic2")
    with pytest.raises(InputError, match="four samples"):
        interpolant(np.arange(3.0), np.ones((3, 1)), kind="cubic")
