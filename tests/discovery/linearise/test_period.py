"""The period of a motion."""

import numpy as np
import pytest

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.linearise.source import period_of

T = np.arange(400) * 0.05
"""Twenty seconds."""


def data(x, t=T, **more):
    return Trajectories.from_arrays(t, states={"x": x, **more}, derivatives={"x": np.ones_like(x)}, constant="keep")


@pytest.mark.parametrize("period", [0.8, 2.0, 5.0])
def test_a_wave_has_its_own_period(period):
    # Turns are whole numbers: one of them more or less.
    assert period_of(data(np.sin(2 * np.pi * T / period + 0.3)), "x") == pytest.approx(
        period, rel=0.5 * period / 20 + 0.02
    )


def test_noise_that_is_small_beside_the_motion_makes_no_turns():
    noisy = np.sin(np.pi * T) + 0.03 * np.random.default_rng(0).standard_normal(400)
    assert period_of(data(noisy), "x") == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize("x", [np.exp(-T / 5), 0 * T, T - 3], ids=["decay", "rest", "growth"])
def test_a_state_that_does_not_turn_has_the_length_of_the_record(x):
    assert period_of(data(x), "x") == pytest.approx(T[-1])


def test_of_several_runs_the_longest_bounds_it():
    x = [np.exp(-T[:100]), np.exp(-T)]
    runs = Trajectories.from_arrays([T[:100], T], states={"x": x}, derivatives={"x": x})
    assert period_of(runs, "x") == pytest.approx(T[-1])
    waves = Trajectories.from_arrays([T, T], states={"x": [np.sin(np.pi * T)] * 2}, derivatives={"x": [T, T]})
    assert period_of(waves, "x") == pytest.approx(2.0, rel=0.1)


def test_an_output_has_the_period_of_the_state_that_turns_most_often():
    both = data(np.sin(np.pi * T / 4), slow=np.sin(np.pi * T))
    assert period_of(both, "force") == pytest.approx(2.0, rel=0.1)
