"""Which inputs may be held from sample to sample: all, and each by itself."""

import numpy as np
import pytest

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


@pytest.mark.slow
def test_a_voltage_that_is_logged_a_sample_late_is_late_and_no_other_resistance():
    rng = np.random.default_rng(0)
    t = 2.0 * np.arange(501)
    current = np.repeat(rng.choice([-1.5, 0.0, 0.8, 1.6, 2.5, 4.0], 51), 10)[:501]
    soc = 0.9 - np.concatenate([[0], np.cumsum(2.0 * current[:-1])]) / 9000
    voltage = 3.2 + 0.9 * soc - 0.05 * current + 0.0007 * rng.standard_normal(501)
    data = bg.Trajectories.from_arrays(t[1:], inputs={"i": current[1:]}, outputs={"V": voltage[:-1]})
    model = bg.GreyBox(
        simulation={"soc": "-i/(3600*Q)", "V": "3.2 + 0.9*soc - R0*i"},
        parameters={"Q": 2.5, "R0": 0.05},
        starts={"soc": 0.9},
        rows=bg.DerivativeRows(interpolation="zoh"),
    )
    study = bg.find_missing_effects(model, data, catalogue="battery", settle=False, progress=False)
    assert study.verdict == "instrument"
    late = study.instrument.iloc[0]
    assert (late["suspect"], late["channel"]) == ("delay", "V") and abs(late["samples"] - 1) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("first", [0.0, 1.0])
def test_a_late_infusion_is_no_depot(first):
    """A depot fits late doses nearly as well as the delay, and its column is exact where it is first tried.

    A record that begins with a dose does not show that there was none before; that there is none most of the time does.
    """
    rng, t, late = np.random.default_rng(0), 0.5 * np.arange(60), 0.7
    doses = ((first, first + 2.0), (12.0, 15.0))
    infused = np.sum([np.where((t >= a) & (t < b), 4.0, 0.0) for a, b in doses], axis=0)

    def decayed(since, until):
        return 20 * (np.exp(-0.2 * (t - np.clip(t, since, until))) - np.exp(-0.2 * (t - since))) * (t > since)

    level = sum(decayed(a + late, b + late) for a, b in doses) * np.exp(0.06 * rng.standard_normal(60))
    data = bg.Trajectories.from_arrays(t, states={"c": level}, inputs={"u": infused})
    held = bg.TrajectoryRows(interpolation="zoh")
    model = bg.GreyBox(simulation={"c": "u - k*c"}, parameters={"k": 0.2}, rows=held)
    study = bg.find_missing_effects(model, data, catalogue="compartment", settle=False, progress=False)
    assert study.verdict == "instrument"
    found = study.instrument.set_index(["suspect", "channel"]).loc[("delay", "u")]
    assert abs(found["mean"] + late) < 0.05
