"""Simulated systems: derivatives, truth, units, noise, runs."""

from functools import cache

import numpy as np
import pytest
from integration import integrate

from bayes_greybox.physics.experiments import systems
from bayes_greybox.physics.terms import Dictionary
from bayes_greybox.physics.units import check_units, coefficient_unit, derivative_unit
from bayes_greybox.running.errors import InputError

NAMES = ["oscillator", "duffing", "van_der_pol", "pendulum", "lotka_volterra", "two_tanks"]


@cache
def _run(name):
    system = getattr(systems, name)()
    return system, system.simulate()


@pytest.mark.parametrize("name", NAMES)
def test_derivatives_are_those_of_the_states(name):
    # Eighth-order central differences at samples a quarter of the default spacing apart.
    system, default = _run(name)
    t = np.linspace(0.0, 50 * (system.t[1] - system.t[0]), 201)
    inputs = {u: default.inputs[u][0] + np.cos(2 * np.pi * t / t[-1]) for u in system.inputs}
    data = system.simulate(t=t, inputs=inputs)
    weights = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
    for state in system.states:
        slope = np.convolve(data.states[state], weights[::-1], mode="valid") / (t[1] - t[0])
        exact = data.derivatives[state][4:-4]
        np.testing.assert_allclose(slope, exact, atol=1e-6 * np.std(exact))


@pytest.mark.parametrize("name", NAMES)
def test_truth_reproduces_the_learned_derivatives(name):
    system, data = _run(name)
    assert system.learned
    for state, terms in system.truth.items():
        dictionary = Dictionary.of(list(terms), system.names)
        value = np.asarray(dictionary.evaluate(data.columns)) @ np.array(list(terms.values()))
        np.testing.assert_allclose(value, data.derivatives[state], rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("name", NAMES)
def test_units_are_consistent(name):
    system, data = _run(name)
    assert dict(data.units) == dict(system.units)
    check_units({s: Dictionary.of(list(terms), system.names).terms for s, terms in system.truth.items()}, system.units)


def test_coefficients_have_the_units_that_the_docstrings_state():
    def unit(system, state, index):
        term = Dictionary.of(list(system.truth[state]), system.names).terms[index]
        return coefficient_unit(derivative_unit(state, system.units), term, system.units)

    assert unit(systems.oscillator(), "ydot", 0) == "1/m²/s²"
    assert unit(systems.oscillator(), "ydot", 1) == "s/m²"
    assert unit(systems.duffing(), "ydot", 0) == "1/kg"
    assert unit(systems.pendulum(), "omega", 0) == "rad/s²"
    assert unit(systems.lotka_volterra(), "prey", 0) == "1/a"
    assert unit(systems.two_tanks(), "h1", 0) == "cm/s/V"


@pytest.mark.parametrize("name", ["oscillator", "duffing"])
def test_free_run_integrator_agrees_with_the_generator(name):
    system, _ = _run(name)
    data = system.simulate(t=system.t[:201])
    inputs = data.matrix(system.inputs) if system.inputs else None
    path = integrate(
        lambda t, x, u, args: system.rate(
            {s: x[i] for i, s in enumerate(system.states)} | {s: u[i] for i, s in enumerate(system.inputs)}
        ),
        data.time,
        np.array(system.x0),
        inputs,
        scale=np.std(data.matrix(system.states), axis=0),
        rtol=1e-10,
        atol=1e-10,
        interpolation="cubic",
    )
    np.testing.assert_allclose(path.states, data.matrix(system.states), atol=1e-7)


def test_oscillator_keeps_swinging_and_decays_over_the_papers_record():
    _, data = _run("oscillator")
    y, energy = data.states["y"], data.states["ydot"] ** 2 / 2 + data.states["y"] ** 4 / 4
    assert data.time[0] == 0.0 and data.time[-1] == 100.0
    assert np.sum(np.diff(np.sign(y)) != 0) >= 10
    assert np.all(np.diff(energy) <= 1e-10) and 0.3 < np.max(np.abs(y[-200:])) / np.max(np.abs(y[:200])) < 0.9


def test_tank_levels_stay_positive_when_the_pump_stops():
    # sqrt(h) falls linearly: an undriven tank from h0 is empty at t = 2 sqrt(h0) / c1.
    system = systems.two_tanks()
    t = np.linspace(0.0, 200.0, 401)
    data = system.simulate(t=t, inputs={"u": np.zeros(401)})
    assert all(np.all(level > -1e-9) for level in data.states.values())
    expected = np.maximum(np.sqrt(4.0) - 0.1 * t / 2, 0.0) ** 2
    np.testing.assert_allclose(data.states["h1"], expected, atol=1e-6)


def test_noise_has_the_stated_size_and_place():
    system, clean = _run("van_der_pol")
    noisy = system.simulate(noise=0.1, seed=3)
    np.testing.assert_array_equal(noisy.states["y"], clean.states["y"])
    for state in system.states:
        residual = noisy.derivatives[state] - clean.derivatives[state]
        # SD of 601 draws has a relative standard error of 1/sqrt(2 * 601) = 2.9 %; 5 of these allowed.
        assert np.std(residual) == pytest.approx(0.1 * np.std(clean.derivatives[state]), rel=0.145)
    on_states = system.simulate(noise=0.1, noise_on="states", seed=3)
    np.testing.assert_array_equal(on_states.derivatives["y"], clean.derivatives["y"])
    assert np.std(on_states.states["y"] - clean.states["y"]) == pytest.approx(
        0.1 * np.std(clean.states["y"]), rel=0.145
    )
    both = system.simulate(noise=0.1, noise_on="both", seed=3)
    np.testing.assert_array_equal(both.states["y"], on_states.states["y"])
    np.testing.assert_array_equal(both.derivatives["y"], noisy.derivatives["y"])
    again = system.simulate(noise=0.1, seed=3)
    np.testing.assert_array_equal(again.derivatives["y"], noisy.derivatives["y"])
    assert np.any(system.simulate(noise=0.1, seed=4).derivatives["y"] != noisy.derivatives["y"])


def test_several_starts_give_several_runs_with_their_own_excitation():
    system = systems.duffing()
    t = np.linspace(0.0, 20.0, 201)
    data = system.simulate(t=t, x0=[(0.0, 0.0), {"ydot": 1.0, "y": 0.2}])
    assert data.n_run == 2 and data.n_obs == 402
    second = data.take(1)
    assert second.states["y"][0] == 0.2 and second.states["ydot"][0] == 1.0
    assert np.corrcoef(data.take(0).inputs["F"], second.inputs["F"])[0, 1] < 0.9
    forced = system.simulate(t=t, x0=[(0.0, 0.0), (0.0, 0.0)], inputs={"F": [np.cos(t), np.sin(t)]})
    np.testing.assert_array_equal(forced.take(1).inputs["F"], np.sin(t))


def test_multisine_fills_its_band_and_nothing_else():
    t = np.arange(1000) * 0.05
    signal = systems.multisine(t, (0.2, 2.0), 3.0, seed=1)
    assert np.max(np.abs(signal)) == pytest.approx(3.0, rel=1e-12)
    power = np.abs(np.fft.rfft(signal))
    frequency = np.fft.rfftfreq(1000, 0.05)
    inside = (frequency > 0.2 - 1e-9) & (frequency < 2.0 + 1e-9)
    assert np.sum(inside) == 91
    np.testing.assert_allclose(power[inside], power[inside][0], rtol=1e-9)
    assert np.max(power[~inside]) < 1e-9 * power[inside][0]
    assert np.any(signal != systems.multisine(t, (0.2, 2.0), 3.0, seed=2))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: systems.duffing(m=0.0), "m of duffing is 0.0"),
        (lambda: systems.pendulum(b=float("nan")), "b of pendulum"),
        (lambda: systems.oscillator().simulate(x0=(1.0,)), "x0 of oscillator"),
        (lambda: systems.oscillator().simulate(x0={"y": 1.0}), "name y, ydot"),
        (lambda: systems.oscillator().simulate(t=[0.0, 1.0, 1.0, 2.0]), "increasing"),
        (lambda: systems.oscillator().simulate(inputs={"F": [1.0]}), "no input 'F'"),
        (lambda: systems.duffing().simulate(inputs={"F": np.ones(3)}), "input 'F' needs one finite value"),
        (lambda: systems.duffing().simulate(inputs={"F": [np.ones(1201)] * 2}), "2 runs for 1"),
        (lambda: systems.oscillator().simulate(noise=-1.0), "noise is -1.0"),
        (lambda: systems.oscillator().simulate(noise_on="derivative"), "noise_on"),
        (lambda: systems.oscillator(c=0.0, k=-5.0).simulate(), "blows up near t"),
        (lambda: systems.oscillator(c=0.5, k=-5.0).simulate(t=[0.0, 1.0, 2.0, 9.0]), "changes too fast"),
        (lambda: systems.multisine(np.arange(100.0), (0.1, 0.6), 1.0, 0), "sample faster"),
        (lambda: systems.multisine(np.arange(100.0), (0.001, 0.002), 1.0, 0), "too short"),
        (lambda: systems.multisine(np.arange(100.0), (0.2, 0.1), 1.0, 0), "band"),
    ],
)
def test_bad_requests_are_refused(call, words):
    with pytest.raises(InputError, match=words):
        call()
