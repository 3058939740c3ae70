"""Which inputs may be held from sample to sample: all, and each by itself."""

import numpy as np

import bayes_greybox as bg
from bayes_greybox.discovery.equation import _held

T = 0.25 * np.arange(200)
HEATER = np.repeat(np.random.default_rng(0).uniform(size=25) > 0.5, 8) * 1.0
# A thermometer that shows tenths looks neither smooth nor held.
WEATHER = np.round(5 + 6 * np.sin(2 * np.pi * T / 24), 1)


def choices(**inputs):
    return dict(_held(bg.Trajectories.from_arrays(T, states={"T": np.sin(0.1 * T)}, inputs=inputs)))


def test_one_input_is_held_or_not():
    assert choices(heater=HEATER) == {"zoh": True}
    assert choices(weather=np.sin(T)) == {"zoh": False}


def test_of_two_inputs_each_is_held_by_itself():
    """One of them switches; the other is read in tenths, and goes on."""
    found = choices(heater=HEATER, weather=WEATHER)
    assert set(found) == {"zoh", ("zoh", "cubic"), ("cubic", "zoh")}
    assert found["zoh", "cubic"] and not found["zoh"]


def test_of_many_those_that_do_not_look_smooth_are_held_together():
    found = choices(a=HEATER, b=np.roll(HEATER, 3), c=np.sin(T), d=np.cos(T))
    assert ("zoh", "zoh", "cubic", "cubic") in found and len(found) == 6
