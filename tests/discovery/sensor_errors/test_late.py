"""A position that is late against its own speed, told by their samples alone."""

import numpy as np
import pytest

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.sensor_errors.late import in_step, late_states
from bayes_greybox.physics.simulation.reading import simulation_of

STEP, N = 0.05, 500


def motion(t):
    return np.sin(t) + 0.4 * np.sin(2.3 * t + 1), np.cos(t) + 0.92 * np.cos(2.3 * t + 1)


def late(by=0.0, bend=lambda x: x, noise=0.0, runs=1, ask=late_states, shaken=0.0):
    rng = np.random.default_rng(2)
    times = [STEP * np.arange(N) + 40.0 * r for r in range(runs)]
    x = [bend(motion(t - by * STEP)[0]) + noise * rng.standard_normal(N) for t in times]
    data = Trajectories.from_arrays(
        times,
        states={"x": x, "v": [motion(t)[1] + shaken * rng.standard_normal(N) for t in times]},
        inputs={"F": [np.sin(3 * t) for t in times]},
    )
    simulation = simulation_of({"x": "v", "v": "F - x"}, data.state_names, data.input_names)
    return ask(data, simulation, {name: sd for name, sd in (("x", noise), ("v", shaken)) if sd})


@pytest.mark.parametrize("steps", [-2.0, -0.5, 0.5, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("runs", [1, 3])
def test_a_delay_is_found_with_its_size(steps, runs):
    found = late(steps, runs=runs)["x"]
    assert found.by == pytest.approx(steps * STEP, abs=0.01 * STEP) and found.step == pytest.approx(STEP)
    assert found.p < 1e-6 and found.sd < 0.03 * STEP


@pytest.mark.parametrize("steps", [0.7, -1.5])
def test_noise_on_the_samples_is_in_its_standard_deviation(steps):
    found = late(steps, noise=0.005)["x"]
    assert abs(found.by - steps * STEP) < 4 * found.sd < 0.5 * STEP


@pytest.mark.parametrize(
    "bend",
    [lambda x: x, lambda x: 1.05 * x, lambda x: x - 0.2 * x**3, lambda x: np.round(4 * x) / 4, lambda x: x + 3.0],
    ids=["right", "gain", "compressed", "coarse", "offset"],
)
def test_what_is_no_delay_is_not_called_one(bend):
    assert late(bend=bend) == {}


def test_a_delay_far_beyond_the_steps_is_left_to_others():
    assert late(9.0) == {}


def test_a_state_whose_rate_is_no_state_is_not_judged():
    t = STEP * np.arange(N)
    x, v = motion(t - 0.1)[0], motion(t)[1]
    data = Trajectories.from_arrays(t, states={"x": x}, derivatives={"x": v})
    assert late_states(data, simulation_of({"x": "-x"}, ("x",), ()), {}) == {}


def test_of_states_that_agree_neither_is_late_by_more_than_their_samples_say():
    assert late(ask=in_step) == pytest.approx({"x": 0.0, "v": 0.0}, abs=0.02 * STEP)
    assert set(late(noise=0.01, shaken=0.02, ask=in_step)) == {"x", "v"}
    assert late(2.0, ask=in_step) == {}
