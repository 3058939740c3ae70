"""Integration in time against closed forms, and blow-ups as results."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from integration import integrate
from scipy.interpolate import CubicSpline

from bayes_greybox.physics.integration.adaptive_steps import (
    PIECE,
    Limits,
    Samples,
    _input_at,
    between_samples,
    curvature_of,
    cut,
    follow_piece,
    joined,
)
from bayes_greybox.physics.integration.solvers import ordered_times
from bayes_greybox.running.errors import InputError


def interpolant(t, values, kind="linear"):
    """The input between samples as the integrator sees it."""
    kinds, curvature = curvature_of(t, values, kind)
    samples = Samples(*map(jnp.asarray, (t, values, curvature)))
    return lambda time: _input_at(time, samples, kinds)


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
    # x' = 2 - sign(x) from -1 climbs at rate 3 until t = 1/3, then at rate 1. Across a jump the estimate of a step's
    # error, which is held to 1e-8, is one of its magnitude only: hence 1e-6.
    t = np.linspace(0.0, 2.0, 21)
    path = integrate(lambda t, x, u, args: 2.0 - jnp.sign(x), t, np.array([-1.0]))
    np.testing.assert_allclose(path.states[:, 0], np.minimum(3 * t - 1, t - 1 / 3), atol=1e-6)
    step = integrate(lambda t, x, u, args: jnp.where(t > 0.777, 1.0, 0.0) * jnp.ones(1), t, np.array([1.0]))
    np.testing.assert_allclose(step.states[:, 0], 1.0 + np.maximum(t - 0.777, 0.0), atol=1e-6)


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


def test_smooth_inputs_get_splines_and_steps_get_lines():
    t = np.linspace(0.0, 20.0, 401)
    smooth = np.sin(2 * np.pi * t * 2.5)  # eight samples a period
    steps = np.sign(np.sin(0.7 * t))
    noisy = np.random.default_rng(0).normal(size=len(t))
    assert between_samples(t, np.column_stack([smooth, steps, noisy])) == ("cubic", "linear", "linear")
    uneven = np.sort(np.random.default_rng(1).uniform(0, 20, 401))
    assert between_samples(uneven, np.sin(uneven)[:, None]) == ("cubic",)
    assert between_samples(t[:8], smooth[:8, None]) == ("linear",)
    assert between_samples(t, np.zeros((401, 0))) == ()


def test_each_input_may_have_its_own_interpolation():
    t = np.linspace(0.0, 3.0, 7)
    values = np.column_stack([t**2, t**2, t**2])
    at = interpolant(t, values, ("linear", "zoh", "cubic"))
    np.testing.assert_allclose(at(1.25), [1.625, 1.0, 1.5625], rtol=1e-12)
    with pytest.raises(InputError, match="2 interpolations for 3 inputs"):
        interpolant(t, values, ("linear", "cubic"))


@pytest.mark.slow
def test_long_runs_are_cut_where_nobody_sees_it():
    t = np.linspace(0.0, 60.0, 3 * PIECE + 17)
    u = np.sin(0.9 * t)[:, None]

    def rhs(t, x, u, args):
        return jnp.array([x[1], u[0] - x[0] - 0.2 * x[1]])

    path = integrate(rhs, t, np.array([1.0, 0.0]), u, interpolation="cubic")
    twice = integrate(rhs, t[PIECE // 2 :], path.states[PIECE // 2], u[PIECE // 2 :], interpolation="cubic")
    # Splines of the two records differ near the later one's start.
    np.testing.assert_allclose(path.states[PIECE // 2 :], twice.states, atol=1e-5)
    assert np.isnan(path.failed_at)


@pytest.mark.parametrize("kind", ["linear", "cubic"])
def test_numpy_and_jax_cut_and_join_alike(kind):
    t = np.linspace(0.0, 60.0, 2 * PIECE + 17)
    u = np.sin(0.9 * t)[:, None]
    ours, kinds = cut(t, u, kind)
    theirs, same = cut(jnp.asarray(t), jnp.asarray(u), kind)
    assert kinds == same
    for one, other in zip(ours, theirs, strict=True):
        assert isinstance(one, np.ndarray) and isinstance(other, jax.Array)
        np.testing.assert_allclose(one, other, rtol=1e-13, atol=1e-13)
    rng = np.random.default_rng(0)
    x0, states = rng.standard_normal((3, 2)), rng.standard_normal((3, 3, PIECE, 2))
    # One that does not fail, one that does twice, and one that fails beyond the end.
    failed = np.array([[np.nan] * 3, [np.nan, 31.0, 55.0], [np.nan, np.nan, 60.5]])
    whole, first = joined(x0, t, states, failed)
    np.testing.assert_array_equal(first, [np.nan, 31.0, np.nan])
    assert whole.shape == (3, len(t), 2)
    for k in range(3):
        row = joined(*map(jnp.asarray, (x0[k], t, states[k], failed[k])))
        np.testing.assert_array_equal(row[0], whole[k])
        np.testing.assert_array_equal(row[1], first[k])


def test_a_blow_up_in_a_later_piece_ends_the_run_there():
    t = np.linspace(0.0, 5.0, 4 * PIECE)
    path = integrate(lambda t, x, u, args: x**2, t, np.array([0.25]))
    assert path.failed_at == pytest.approx(4.0, abs=0.02)
    assert np.array_equal(np.isfinite(path.states[:, 0]), t <= float(path.failed_at))


@pytest.mark.parametrize("kind", ["linear", "zoh"])
def test_a_run_of_two_rows_has_no_inner_sample_to_step_on(kind):
    # x' = u; held, u is 1 all the way, and on a line it averages 2.
    path = integrate(lambda t, x, u, args: u, np.array([0.0, 0.5]), np.zeros(1), np.array([[1.0], [3.0]]), None,
                     interpolation=kind)  # fmt: skip
    assert float(path.states[1, 0]) == pytest.approx(0.5 if kind == "zoh" else 1.0) and np.isnan(path.failed_at)


def test_a_path_calls_no_python_so_that_its_program_can_be_kept():
    def follow(x0, times):
        limits = Limits(x0, times[-1], times[-1] - times[0], jnp.ones(2), jnp.asarray(1e6))
        samples = Samples(times, jnp.zeros((len(times), 0)), jnp.zeros((len(times), 0)))
        return follow_piece(_harmonic, (x0, jnp.array(True)), samples, limits, 1.0, ())

    program = jax.jit(follow).lower(jnp.array([1.0, 0.0]), jnp.linspace(0.0, 1.0, 11)).as_text()
    assert "while" in program and "callback" not in program


def test_diffrax_tests_the_times_of_others():
    from equinox import internal

    before = internal.error_if
    with pytest.raises(KeyError), ordered_times():
        assert internal.error_if is not before
        raise KeyError
    assert internal.error_if is before
