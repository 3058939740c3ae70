"""A lag of the actuator and one of the only sensor: one transfer function of a linear machine, and two of another."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import odeint

import bayes_greybox as bg
from bayes_greybox.data.errors import InputError
from bayes_greybox.discovery.answer import mirrored
from bayes_greybox.discovery.answer.finding import Finding
from bayes_greybox.discovery.answer.mirrored import mirrors
from bayes_greybox.discovery.evidence.columns import Column
from bayes_greybox.discovery.evidence.odds import Odds
from bayes_greybox.physics.catalogue.loading import load_catalogue
from bayes_greybox.physics.terms import Term

LAG = 0.3

LATE_F, LATE_G = "actuator-lag(input=F, state=v)", "actuator-lag(input=G, state=v)"
"""Bindings."""


def shown(lagging, cubic, force=1.0):
    """Positions of a driven oscillator whose actuator or whose sensor lags; SciPy."""
    t = np.arange(260) * 0.2
    drive = lambda t: force * (np.sin(0.8 * t) + 0.7 * np.sin(1.3 * t + 1))  # noqa: E731

    def rate(t, x):
        y, v, z = x
        arrived, late = (z, drive(t)) if lagging == "actuator" else (drive(t), y)
        return [v, arrived - y - 0.2 * v - cubic * y**3, (late - z) / LAG]

    path = odeint(rate, [0.0, 0.0, 0.0], t, tfirst=True, rtol=1e-9, atol=1e-11).T
    y = path[0] if lagging == "actuator" else path[2]
    noisy = y + 0.01 * np.std(y) * np.random.default_rng(3).standard_normal(len(t))
    return bg.Trajectories.from_arrays(t, states={"y": noisy}, inputs={"F": drive(t)})


def lag(u, time):
    """A column of a lag of an input."""
    (effect,) = (each for each in load_catalogue("mechanical") if each.slug == "actuator-lag")
    bound = effect.bind({"input": u, "state": "v"})
    return Column("effect", bound.term({"lag": time}), 1.0, 1.0, effect=bound, inner={"lag": time})


def found(*corrections, time=LAG, suspects=(), noise=(), inputs="F", slow_sensor=0.5):
    """An answer that has a lag of the input F, as a study finds it, or of several."""
    lags = [lag(u, time) for u in inputs]
    odds = Odds(slow_sensor=slow_sensor)
    columns = [*lags, *(Column("correction", Term(text), 1.0, 1.0) for text in corrections)]
    numbers = {"correction": list(range(len(lags), len(columns)))}
    statistics = SimpleNamespace(columns=columns, of_kind=lambda kind: numbers[kind])
    world = SimpleNamespace(
        evaluations=SimpleNamespace(statistics=statistics, odds=odds), model=SimpleNamespace(names=tuple(noise))
    )
    places = tuple(SimpleNamespace(index=k) for k in range(len(lags)))
    made = object.__new__(Finding)
    made.__dict__.update(places=places, world=world, explanation=SimpleNamespace(suspects=tuple(suspects)))
    return made


def model_of(cubic, **more):
    rows = bg.TrajectoryRows(interpolation="cubic")
    return bg.GreyBox(simulation={"y": "v", "v": f"F - y - 0.2*v - {cubic}*y**3"}, rows=rows, **more)


def weighed(model, data, finding):
    return mirrors(model, data, "v", finding, (), lambda _: None)


@pytest.mark.parametrize("lagging", ["actuator", "sensor"])
def test_of_a_linear_machine_nothing_tells_which_one_lags(lagging):
    told = weighed(model_of(0.0), shown(lagging, 0.0), found(time=LAG * 1.01))
    assert told[LATE_F].name == "lag of y"
    # They are the same but for the input between its samples.
    assert 0.2 < told[LATE_F].share < 0.8


@pytest.mark.parametrize(("lagging", "of_the_sensor"), [("actuator", False), ("sensor", True)])
def test_a_hardening_machine_tells_which_one_lags(lagging, of_the_sensor):
    told = weighed(model_of(0.3), shown(lagging, 0.3, force=2.0), found())
    assert (told[LATE_F].share > 0.99) == of_the_sensor
    assert (told[LATE_F].share < 0.01) != of_the_sensor


@pytest.mark.slow
def test_what_is_known_of_the_sensor_is_prior_odds():
    data, model = shown("actuator", 0.0), model_of(0.0)
    even, fast = (weighed(model, data, found(slow_sensor=p))[LATE_F].share for p in (0.5, 0.01))
    assert fast / (1 - fast) == pytest.approx(even / (1 - even) / 99)
    assert weighed(model, data, found(noise=["AR"], slow_sensor=0.01))[LATE_F].share == pytest.approx(0.01)


@pytest.mark.slow
@pytest.mark.parametrize("lagging", ["actuator", "sensor"])
def test_a_stiffness_that_is_a_little_off_tells_nothing(lagging):
    rows = bg.TrajectoryRows(interpolation="cubic")
    model = bg.GreyBox(simulation={"y": "v", "v": "F - 1.03*y - 0.2*v"}, rows=rows)
    told = weighed(model, shown(lagging, 0.0), found("F", "y", "v"))
    assert 0.05 < told[LATE_F].share < 0.95


def test_what_does_not_settle_is_no_evidence(monkeypatch):
    def lost(model, data):
        raise InputError("lost")

    monkeypatch.setattr("bayes_greybox.discovery.answer.mirrored.near_estimate", lost)
    assert weighed(model_of(0.0), shown("actuator", 0.0), found())[LATE_F].share == Odds().slow_sensor
    assert weighed(model_of(0.0), shown("actuator", 0.0), found(noise=["AR"]))[LATE_F].share == Odds().slow_sensor


@pytest.mark.slow
def test_paths_of_more_segments_are_no_evidence(monkeypatch):
    plain = mirrored._log_likelihood

    def cut(model, data, terms):
        # The path of the lagging sensor has a segment more, and every sample on it.
        value, segments = plain(model, data, terms)
        return (value + 50, segments + 1) if len(terms) == 2 else (value, segments)

    monkeypatch.setattr(mirrored, "_log_likelihood", cut)
    assert weighed(model_of(0.3), shown("actuator", 0.3, force=2.0), found())[LATE_F].share == Odds().slow_sensor


def test_of_two_inputs_each_has_its_own():
    found_on = found(inputs="FG", time=0.4)
    told = weighed(model_of(0.0), shown("actuator", 0.0), found_on)
    assert {key: (each.instead, each.share) for key, each in told.items()} == {
        LATE_F: ("F", 0.5), LATE_G: ("G", 0.5)
    }  # fmt: skip
    assert {(each.name, each.time) for each in told.values()} == {("lag of y", 0.4)}
    assert told[LATE_F].step == pytest.approx(0.2)
    again = mirrors(model_of(0.0), shown("actuator", 0.0), "v", found_on, {LATE_F}, lambda _: None)
    assert list(again) == [LATE_G]


def test_nothing_is_said_where_another_sensor_would_have_to_lag_as_well_or_rates_were_measured():
    data = shown("actuator", 0.0)
    v = np.gradient(data.states["y"], data.time)
    both = bg.Trajectories.from_arrays(data.time, states={"y": data.states["y"], "v": v}, inputs=data.inputs)
    assert weighed(model_of(0.0), both, found()) == {}
    rates = bg.GreyBox(simulation={"y": "v", "v": "F - y"}, rows=bg.DerivativeRows())
    assert weighed(rates, data, found()) == {}
