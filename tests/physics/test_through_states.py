"""Slopes of parameters that act through hidden states: those of what is computed at neighbouring values."""

import numpy as np
import pytest

import bayes_greybox as bg
from bayes_greybox.physics.formula.expressions import evaluate, parse_expression
from bayes_greybox.physics.hidden_states import along
from bayes_greybox.physics.parameters import Parameter
from bayes_greybox.physics.simulation.through_states import acting_through, through_states

T = 0.25 * np.arange(120)
U = np.sin(1.7 * T) + np.cos(0.4 * T)
# The second hidden state feels Q by the first alone; C is in both and in the output.
WRITTEN = {"q": "-u/Q - c*q**3", "w": "(q - w)/tau", "V": "2*q + w**2/c - R*u"}
FORMULAS = {name: parse_expression(text) for name, text in WRITTEN.items()}
PARAMETERS = {"Q": 3.0, "c": 0.4, "tau": 2.0, "R": 0.1, "q0": 0.5}
GIVEN = {name: Parameter(value) for name, value in PARAMETERS.items()}
STARTS = {"q": "q0", "w": 0.0}


def machine(**values):
    return bg.GreyBox(simulation=WRITTEN, parameters={**PARAMETERS, **values}, starts=STARTS, rows=bg.DerivativeRows())


def completed(**values):
    """Data with the hidden states at values of parameters, and the output."""
    model = machine(**values)
    data = model.started(bg.Trajectories.from_arrays(T, inputs={"u": U}, outputs={"V": 0 * T}))
    return data, model.simulator(data).on(data, "V")


def test_parameters_of_rates_of_hidden_states_act_through_these():
    assert acting_through(FORMULAS, STARTS, PARAMETERS) == {"Q", "c", "tau", "q0"}
    assert acting_through(FORMULAS, {}, PARAMETERS) == frozenset()


@pytest.mark.parametrize("name", list(PARAMETERS))
def test_a_slope_is_the_derivative_of_what_is_computed(name):
    data, _ = completed()
    (found,) = [each for each in machine().simulator(data).correctable("V") if each.parameter == name]
    step = 1e-4
    above, below = (completed(**{name: PARAMETERS[name] + sign * step})[1] for sign in (1, -1))
    fresh = np.arange(len(T)) == 0
    hidden = along([found.term.states], T, data.columns, fresh)[0] if found.term.states else {}
    slope = evaluate(found.term.expr, {**data.columns, **hidden})
    # Between samples sensitivities see interpolated states.
    np.testing.assert_allclose(slope, (above - below) / (2 * step), atol=3e-3 * np.max(np.abs(slope)))
    assert {state.name for state in found.term.states} == {
        "Q": {"slope_of_q_by_Q", "slope_of_w_by_Q"},
        "c": {"slope_of_q_by_c", "slope_of_w_by_c"},
        "tau": {"slope_of_w_by_tau"},
        "R": set(),
        "q0": {"slope_of_q_by_q0", "slope_of_w_by_q0"},
    }[name]


def test_what_no_hidden_state_of_an_equation_feels_has_no_slope_there():
    formulas = {**FORMULAS, "I": parse_expression("q - u")}
    assert through_states("I", "tau", formulas, STARTS, GIVEN) == (0, ())
    assert through_states("V", "R", formulas, STARTS, GIVEN) == (0, ())


@pytest.mark.parametrize("name", ["Q", "q0"])
def test_what_hidden_states_depend_on_is_not_learned(name):
    with pytest.raises(bg.InputError, match=f"'{name}' is learned, and a hidden state with a start depends on it"):
        machine(**{name: bg.Parameter(PARAMETERS[name], sd=0.1)})


def test_hidden_states_follow_no_tangent():
    """Linearised elsewhere, the formulas of all equations are those at that value."""
    model = machine().at({"Q": 3.6})
    data = model.started(bg.Trajectories.from_arrays(T, inputs={"u": U}, outputs={"V": 0 * T}))
    there, volts = completed(Q=3.6)
    np.testing.assert_allclose(data.states["w"], there.states["w"], rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(model.simulator(data).on(data, "V"), volts, rtol=1e-12)
    assert model.named.slopes("V", {"Q": 3.6}) == () and model.named.remainder("V", {"Q": 3.6}) == ()
    assert model.named.bends("V", {"Q": 0.1}) and model.named.moved_through({"Q": 3.6, "R": 1.0}) == {"Q": 3.6 - 3.0}
