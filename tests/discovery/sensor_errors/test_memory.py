"""Elements that remember, against their closed forms along paths of straight pieces."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.sensor_errors.memory import (
    HYSTERESIS,
    LIMITS,
    RELAXATION,
    Memory,
    memory_columns,
    relaxation_times,
)

N = 201


def along(t, x, **inputs):
    return dict(memory_columns(Trajectories.from_arrays(t, states={"x": x}, inputs=inputs, constant="keep")))


def times_of(t, x=None):
    return relaxation_times(t if x is None else x, t, [slice(0, len(t))], x is None)


def test_time_constants_of_an_input_go_from_two_steps_to_half_a_run_by_about_two():
    found = times_of(np.linspace(0, 6.4, 65))
    np.testing.assert_allclose(found[[0, -1]], [0.2, 3.2])
    np.testing.assert_allclose(found[1:] / found[:-1], 2.0)
    assert len(times_of(np.arange(1e6))) == 12 and len(times_of(np.array([0.0, 1.0, 2.0]))) == 1


def test_a_decay_between_time_constants_is_a_sum_of_theirs():
    t, known = np.linspace(0, 20, 2001), 2.0 ** np.arange(-6, 4)
    elements = np.exp(-t[:, None] / known)
    for tau in 2.0 ** np.linspace(-3, 1, 9):
        decay = np.exp(-t / tau)
        assert np.max(np.abs(elements @ np.linalg.lstsq(elements, decay, rcond=1e-10)[0] - decay)) < 0.002


def there_and_back():
    """From 0 up to 1, down to -1 and back to 0, at a steady speed."""
    t = np.linspace(0, 4, 4 * (N - 1) + 1)
    return t, np.interp(t, [0, 1, 3, 4], [0.0, 1.0, -1.0, 0.0])


@pytest.mark.parametrize("k", range(len(LIMITS)))
def test_an_iwan_element_is_a_spring_up_to_its_limit_and_turns_back_from_there(k):
    t, x = there_and_back()
    r, z = LIMITS[k], along(t, x)[Memory(HYSTERESIS, "x")][:, k]
    up, down, again = t <= 1, (t >= 1) & (t <= 3), t >= 3
    np.testing.assert_allclose(z[up], np.minimum(x[up], r), atol=1e-12)
    np.testing.assert_allclose(z[down], np.maximum(r + x[down] - 1, -r), atol=1e-12)
    np.testing.assert_allclose(z[again], np.minimum(-r + x[again] + 1, r), atol=1e-12)


def test_an_input_that_leaps_has_two_values_at_one_time():
    t = np.repeat(np.linspace(0, 10, 101), 2)[1:]
    u = np.repeat(np.sign(np.sin(np.linspace(0, 10, 101) + 0.3)), 2)[:-1]
    once = np.append(np.diff(t) > 0, True)
    data = Trajectories.from_arrays(t[once], states={"x": np.sin(t[once])}, inputs={"u": u[once]})
    # As rows of a path have it, not as anybody measures it.
    leaping = replace(data, time=t, run=np.zeros(len(t), int), states={"x": np.sin(t)}, inputs={"u": u})
    columns, plain = dict(memory_columns(leaping)), dict(memory_columns(data))
    assert set(columns) == {Memory(kind, name) for kind in (HYSTERESIS, RELAXATION) for name in ("x", "u")}
    np.testing.assert_allclose(columns[Memory(HYSTERESIS, "u")][once], plain[Memory(HYSTERESIS, "u")], atol=1e-12)
    assert all(np.all(np.isfinite(table)) for table in columns.values())


def test_a_loop_is_closed_and_has_the_area_of_its_friction():
    t = np.linspace(0, 4 * np.pi, 4001)
    x = np.sin(t)
    table, second = along(t, x)[Memory(HYSTERESIS, "x")], t >= 2 * np.pi
    for r, z in zip(LIMITS, table.T, strict=True):
        # Sliding 2 (1 - r) each way against r.
        assert np.trapezoid(z[second], x[second]) == pytest.approx(4 * r * (1 - r), rel=1e-3)


@pytest.mark.parametrize("k", range(3))
def test_a_maxwell_element_follows_a_steady_speed_exactly_whatever_the_steps(k):
    t = np.concatenate([np.linspace(0, 1, 7), np.linspace(1.3, 5, 50)])
    t = np.concatenate([t, 5 + np.linspace(0, 5, 40)[1:]])
    x, up = np.where(t <= 5, 2.0 * t, 20.0 - 2.0 * t), t <= 5
    z = along(t, x)[Memory(RELAXATION, "x")][:, k]
    tau = times_of(t, x)[k]
    assert tau == pytest.approx((0.1, 0.3, 1.0)[k] * 2 * np.pi * np.std(x) / 2.0)
    np.testing.assert_allclose(z[up], 2.0 * tau * -np.expm1(-t[up] / tau), rtol=1e-12)


def test_a_swinging_maxwell_element_is_a_damper_where_it_is_fast_and_a_spring_where_it_is_slow():
    t = np.linspace(0, 20 * np.pi, 60001)
    table = along(t, np.sin(t))[Memory(RELAXATION, "x")]
    late = t > 18 * np.pi
    for tau, z in zip(times_of(t, np.sin(t)), table.T, strict=True):
        expected = tau * (np.cos(t) + tau * np.sin(t)) / (1 + tau**2)
        np.testing.assert_allclose(z[late], expected[late], atol=2e-3 * tau)


def test_elements_of_a_ragged_path_are_those_of_its_steps_one_by_one():
    rng, n = np.random.default_rng(0), 3000
    h = rng.uniform(0.5, 1.5, n) * 0.01
    h[1500] = 400.0  # A pause in which all is forgotten.
    t, x = np.concatenate([[0.0], np.cumsum(h)]), np.cumsum(rng.standard_normal(n + 1)) * 0.02
    x[700:720] = x[700]
    tables = along(t, x)
    limits, times = np.array(LIMITS) * np.ptp(x) / 2, times_of(t, x)
    held, relaxed = np.zeros((n + 1, len(limits))), np.zeros((n + 1, len(times)))
    for k, change in enumerate(np.diff(x)):
        held[k + 1] = np.clip(held[k] + change, -limits, limits)
        steady = change / h[k] * times
        relaxed[k + 1] = steady + (relaxed[k] - steady) * np.exp(-h[k] / times)
    np.testing.assert_allclose(tables[Memory(HYSTERESIS, "x")], held, atol=1e-12 * np.ptp(x))
    np.testing.assert_allclose(tables[Memory(RELAXATION, "x")], relaxed, atol=1e-9 * np.ptp(x))


def test_an_input_may_be_held_and_may_begin_with_the_run():
    t = np.linspace(0, 10, 101)
    u = np.where(t % 5 < 2, 3.0, 0.0)
    table, times = along(t, np.sin(t), u=u)[Memory(RELAXATION, "u")], times_of(t)
    _, held, begun, late = np.split(table, 4, axis=1)
    # Leaps decay from where they are; that from zero at the start is the difference of the two.
    leaps = np.diff(np.append(0.0, u))
    expected = np.array(
        [np.sum(leaps[: k + 1, None] * np.exp(-(t[k] - t[: k + 1, None]) / times), 0) for k in range(101)]
    )
    np.testing.assert_allclose(held + begun, expected, atol=1e-9)
    assert np.all(held[0] == 0) and np.all(begun[0] == 3.0)
    np.testing.assert_allclose(held + late, np.repeat(u[:, None], len(times), axis=1), atol=1e-12)


def test_each_run_starts_without_a_past():
    t, x = there_and_back()
    data = Trajectories.from_arrays([t, t], states={"x": [x, -x]})
    for _, table in memory_columns(data):
        np.testing.assert_allclose(table[len(t) :], -table[: len(t)], atol=1e-12)
        assert np.all(table[[0, len(t)]] == 0)


def test_channels_that_do_not_move_and_runs_of_a_sample_remember_nothing():
    t, x = there_and_back()
    found = along(t, x, u=np.full(len(t), 3.0))
    assert {memory.channel for memory in found} == {"x"}
    short = Trajectories.from_arrays([t, t[:1]], states={"x": [x, x[:1]]})
    for _, table in memory_columns(short):
        assert np.all(table[len(t) :] == 0) and np.any(table[: len(t)] != 0)


@pytest.mark.parametrize(
    "path", [lambda t: np.exp(-t), lambda t: 1 / (1 + np.exp(2 - t)), lambda t: t], ids=["decay", "growth", "ramp"]
)
def test_on_a_path_that_never_comes_back_nothing_is_remembered(path):
    t = np.linspace(0, 5, 200)
    assert not along(t, path(t))
    noisy = path(t) + 0.01 * np.ptp(path(t)) * np.random.default_rng(1).standard_normal(200)
    assert not along(t, noisy)
    assert along(t, np.sin(3 * t) * path(t))


def test_stamps_that_repeat_are_no_time():
    t, x = there_and_back()
    data = Trajectories.from_arrays(t, states={"x": x})
    (_, held), (_, relaxing) = memory_columns(data)
    twice = np.repeat(np.arange(len(t)), 2)
    again = Trajectories.from_arrays(np.arange(2 * len(t)) * 1.0, states={"x": x[twice]})
    object.__setattr__(again, "time", t[twice])
    (_, held_twice), (_, relaxing_twice) = memory_columns(again)
    np.testing.assert_allclose(held_twice[::2], held, atol=1e-12)
    np.testing.assert_allclose(relaxing_twice[1::2] / np.std(relaxing_twice), relaxing / np.std(relaxing), atol=0.05)
