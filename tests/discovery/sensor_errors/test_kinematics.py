"""A position that disagrees with its own speed, told by their samples alone."""

import numpy as np
import pytest

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.sensor_errors.kinematics import (
    departing,
    disagreeing,
    in_step,
    known_errors,
    without_departures,
)
from bayes_greybox.physics.simulation.reading import simulation_of

STEP, N = 0.05, 500
SIMULATION = simulation_of({"x": "v", "v": "F - x"}, ("x", "v"), ("F",))


def motion(t):
    return np.sin(t) + 0.4 * np.sin(2.3 * t + 1), np.cos(t) + 0.92 * np.cos(2.3 * t + 1)


def seen(by=0.0, bend=lambda x: x, noise=0.0, runs=1, shaken=0.0, rate=lambda v: v):
    rng = np.random.default_rng(2)
    times = [STEP * np.arange(N) + 40.0 * r for r in range(runs)]
    x = [bend(motion(t - by * STEP)[0]) + noise * rng.standard_normal(N) for t in times]
    return Trajectories.from_arrays(
        times,
        states={"x": x, "v": [rate(motion(t)[1]) + shaken * rng.standard_normal(N) for t in times]},
        inputs={"F": [np.sin(3 * t) for t in times]},
    )


def asked(ask, noise=0.0, shaken=0.0, **about):
    noises = {name: sd for name, sd in (("x", noise), ("v", shaken)) if sd}
    return ask(seen(noise=noise, shaken=shaken, **about), SIMULATION, noises)


def known(**about):
    return {suspect.key: error for suspect, error in asked(known_errors, **about).items()}


@pytest.mark.parametrize("steps", [-2.0, -0.5, 0.5, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("runs", [1, 3])
def test_a_delay_is_found_with_its_size(steps, runs):
    (found,) = known(by=steps, runs=runs).values()
    assert found.suspect.key == "delay of x" and found.suspect.step == pytest.approx(STEP)
    assert found.size == pytest.approx(steps * STEP, abs=0.01 * STEP)
    assert found.p < 1e-6 and found.sd < 0.03 * STEP


@pytest.mark.parametrize("steps", [0.7, -1.5])
def test_noise_on_the_samples_is_in_its_standard_deviation(steps):
    (found,) = known(by=steps, noise=0.005).values()
    assert abs(found.size - steps * STEP) < 4 * found.sd < 0.5 * STEP


@pytest.mark.parametrize(("power", "key"), [(2, "quadratic error"), (3, "cubic error")])
@pytest.mark.parametrize("size", [0.03, -0.03])
@pytest.mark.parametrize("noise", [0.0, 0.005])
def test_a_sensor_that_bends_is_found_with_its_size(power, key, size, noise):
    # Of x, and of v: each is some 5 % off at its end.
    error = known(bend=lambda x: x + size * x**power, noise=noise)[f"{key} of x"]
    assert abs(error.size - size) < max(4 * error.sd, 0.01 * abs(size)) and error.sd < 0.2 * abs(size)
    error = known(rate=lambda v: v + size * v**power, shaken=noise)[f"{key} of v"]
    assert abs(error.size - size) < max(4 * error.sd, 0.01 * abs(size)) and error.sd < 0.2 * abs(size)


@pytest.mark.parametrize(
    "bend",
    [lambda x: x, lambda x: 1.05 * x, lambda x: x - 0.003 * x**3, lambda x: np.round(4 * x) / 4, lambda x: x + 3.0],
    ids=["right", "gain", "hardly compressed", "coarse", "offset"],
)
def test_what_is_neither_late_nor_bent_is_not_called_so(bend):
    assert known(bend=bend) == {}


def test_a_delay_far_beyond_the_steps_is_left_to_others():
    assert known(by=9.0) == {}


def test_a_state_whose_rate_is_no_state_is_not_judged():
    t = STEP * np.arange(N)
    x, v = motion(t - 0.1)[0], motion(t)[1]
    data = Trajectories.from_arrays(t, states={"x": x}, derivatives={"x": v})
    assert known_errors(data, simulation_of({"x": "-x"}, ("x",), ()), {}) == {}


def test_of_states_that_agree_neither_is_late_by_more_than_their_samples_say():
    assert asked(in_step) == pytest.approx({"x": 0.0, "v": 0.0}, abs=0.02 * STEP)
    assert set(asked(in_step, noise=0.01, shaken=0.02)) == {"x", "v"}
    assert asked(in_step, by=2.0) == {}


def with_play(x, half=0.1):
    shown = np.array(x)
    for row in range(1, len(x)):
        shown[row] = np.clip(shown[row - 1], x[row] - half, x[row] + half)
    return shown


def test_play_is_a_departure_of_the_position_and_the_integral_of_its_speed_is_without_it():
    data = seen(bend=with_play, runs=2)
    assert known_errors(data, SIMULATION, {}) == {}
    (suspect, followed), (other, _) = departing(data, SIMULATION, {}).items()
    true = seen(runs=2).states["x"]
    assert (suspect.key, other.key) == ("departure of x", "departure of v")
    # The line takes what is slow in the play itself.
    assert np.std(followed - true) < 0.2 * np.std(data.states["x"] - true)
    given = data.states["x"].copy()
    right = without_departures(data, SIMULATION, {suspect: suspect.sd})
    np.testing.assert_array_equal(data.states["x"], given)
    np.testing.assert_allclose(right.states["x"], followed, rtol=1e-12)
    np.testing.assert_array_equal(without_departures(data, SIMULATION, {suspect: -0.1}).states["x"], data.states["x"])


def test_a_speed_that_reads_too_much_one_way_is_the_slope_of_its_position():
    data = seen(rate=lambda v: v * np.where(v > 0, 1.3, 1.0))
    (suspect, right) = list(departing(data, SIMULATION, {}).items())[1]
    assert suspect.key == "departure of v"
    true = seen().states["v"]
    np.testing.assert_allclose(right[3:-3], true[3:-3], atol=1e-4)
    mended = without_departures(data, SIMULATION, {suspect: suspect.sd}).states["v"]
    np.testing.assert_allclose(mended[3:-3], true[3:-3], atol=1e-4)


@pytest.mark.parametrize("gain", [1.02, 1.05])
@pytest.mark.parametrize("about", [{}, {"noise": 0.01}, {"runs": 4}])
def test_a_gain_is_left_to_the_model(gain, about):
    assert known(bend=lambda x: gain * x, **about) == {} and asked(departing, bend=lambda x: gain * x, **about) == {}


@pytest.mark.parametrize("about", [{}, {"noise": 0.01}, {"runs": 4}, {"by": 1.0}])
@pytest.mark.parametrize(("gain", "offset"), [(1.05, 0.0), (1.0, 0.1), (3.6, 0.0), (-0.9, -0.2)])
def test_a_gain_or_an_offset_is_an_error_of_one_of_the_two(gain, offset, about):
    found = asked(disagreeing, rate=lambda v: gain * v + offset, **about)
    span = 40.0 * (about.get("runs", 1) - 1) + STEP * (N - 1)
    gains = {"gain of x": 1 / gain - 1, "gain of v": gain - 1} if gain != 1 else {}
    zeros = {"offset of v": offset, "drift of x": -offset / gain * span} if offset else {}
    assert {*found} == {*gains, *zeros}
    for key, size in {**gains, **zeros}.items():
        assert found[key].expected == pytest.approx(size, rel=0.02) and found[key].sd >= abs(found[key].expected)
    assert {found[key].sure for key in gains} <= {"gain of x and v"}
    assert {found[key].sure for key in zeros} <= {"offset of x and v"}


@pytest.mark.parametrize("stuck", [{"bend": lambda x: 0.0 * x}, {"rate": lambda v: 0.0 * v}])
def test_one_that_does_not_move_with_the_other_has_no_gain(stuck):
    assert asked(disagreeing, noise=0.01, shaken=0.01, **stuck) == {}


@pytest.mark.parametrize(
    "about", [{}, {"noise": 0.02, "shaken": 0.02}, {"by": 1.0}, {"bend": lambda x: x + 0.03 * x**3}]
)
def test_states_that_agree_but_for_a_delay_or_a_bend_have_no_gain(about):
    assert asked(disagreeing, **about) == {}


def test_a_speed_that_is_late_is_right_before_its_position_is_judged():
    simulation = simulation_of({"x": "v", "v": "w", "w": "F - x"}, ("x", "v", "w"), ("F",))
    t = STEP * np.arange(N)
    x, late = motion(t)[0], motion(t - STEP)[1]
    w = -np.sin(t) - 2.116 * np.sin(2.3 * t + 1)
    data = Trajectories.from_arrays(t, states={"x": x, "v": late, "w": w}, inputs={"F": np.sin(3 * t)})
    assert {error.key: round(k.size / STEP, 2) for error, k in known_errors(data, simulation, {}).items()} == {
        "delay of v": 1.0
    }


@pytest.mark.parametrize("about", [{}, {"noise": 0.02, "shaken": 0.02}, {"bend": lambda x: x + 3.0}])
def test_states_that_agree_do_not_depart(about):
    assert asked(departing, **about) == {}


def test_a_speed_that_a_filter_computed_has_no_sensor_of_its_own():
    t = STEP * np.arange(N)
    data = Trajectories.from_arrays(t, states={"x": np.sin(3 * t)}, inputs={"F": np.sin(2 * t)})
    # So long a window flattens the speed.
    data = data.differentiate(window=31, polyorder=3, rates={"x": "v"})
    assert known_errors(data, SIMULATION, {}) == {} and departing(data, SIMULATION, {}) == {}


def test_states_that_are_the_rates_of_each_other_are_judged_too():
    t = STEP * np.arange(100)
    simulation = simulation_of({"x": "v", "v": "x"}, ("x", "v"), ())
    data = Trajectories.from_arrays(t, states={"x": np.exp(-t) + 0.01 * np.exp(t), "v": -np.exp(-t) + 0.01 * np.exp(t)})
    assert known_errors(data, simulation, {}) == {} and departing(data, simulation, {}) == {}
