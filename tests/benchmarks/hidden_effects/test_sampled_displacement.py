"""Hidden effects from a displacement alone, and friction of 0.3 % in a free decay."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import bayes_greybox as bg
from bayes_greybox import missing_effects
from bayes_greybox.physics.catalogue.loading import load_catalogue
from benchmarks.hidden_effects.generate import generate
from benchmarks.hidden_effects.solvers.displacement import (
    displacement,
    displacement_cases,
    study_displacement,
)

COULOMB, QUADRATIC = -0.052, -0.0045
SQUARED = 4 * np.pi**2


def test_cases_have_one_position_and_the_sensor_shows_nothing_else():
    cases = displacement_cases(1)
    assert len(cases) > 50 and {case.family for case in cases} == {"catalogue", "null"}
    data = generate(cases[0])
    train, test = displacement(data, 0.1)
    place = data.host.roles["position"]
    assert train.state_names == test.state_names == (place,) and not train.derivatives
    error = train.states[place] - data.train.states[place]
    assert np.std(error) == pytest.approx(0.1 * np.std(data.train.states[place]), rel=0.1)
    again, _ = displacement(data, 0.1)
    np.testing.assert_array_equal(again.states[place], train.states[place])
    other, _ = displacement(data, 0.05)
    assert not np.array_equal(other.states[place], train.states[place])


@pytest.mark.slow
def test_a_case_is_solved_without_its_truth(monkeypatch):
    named = ("cubic-stiffness", "dead-zone", "quadratic-drag")
    few = [replace(e, confusions=()) for e in load_catalogue("mechanical") if e.slug in named]
    whole = missing_effects.find_missing_effects

    def among_few(*given, catalogue, **settings):
        assert catalogue == "mechanical"
        return whole(*given, catalogue=few, **settings)

    monkeypatch.setattr(missing_effects, "find_missing_effects", among_few)
    case = next(c for c in displacement_cases(0) if c.effects == ("cubic-stiffness",) and c.host == "free-oscillator")
    found = study_displacement(generate(case), 0.02)
    added = [effect["slug"] for effect in found["effects"] if effect["status"] == "added"]
    assert "cubic-stiffness" in added and found["seconds"] > 0
    # The gap is in samples, and what can be closed of it is.
    assert found["closed"]["sample NMSE"] == pytest.approx(found["closable"], rel=0.02)


def decay(noise, seed, start, rate=50, periods=100):
    """A pendulum of one second whose friction is some 0.3 % of its acceleration, let go at a start [rad]."""
    t = np.arange(periods * rate) / rate

    def motion(time, x):
        return [x[1], -SQUARED * np.sin(x[0]) + COULOMB * np.tanh(x[1] / 1e-4) + QUADRATIC * x[1] * abs(x[1])]

    y = solve_ivp(motion, (0, t[-1]), [start, 0.0], t_eval=t, rtol=1e-10, atol=1e-12, method="DOP853").y[0]
    shown = y + noise * np.std(y) * np.random.default_rng(seed).standard_normal(len(t))
    return bg.Trajectories.from_arrays(t, states={"y": shown}, units={"t": "s", "y": "rad"})


@pytest.mark.slow
def test_a_decay_that_comes_to_rest_is_not_named_outright():
    # At rest sign(v) says nothing of the force, and a stand-in of three laws once was *named*.
    model = bg.GreyBox(simulation={"y": "v", "v": f"-{SQUARED!r}*sin(y)"}, rows=bg.TrajectoryRows())
    study = bg.find_missing_effects(model, decay(1e-3, 100, start=0.6), settle=False, free_runs=False, progress=False)
    assert study.verdict != "named"
