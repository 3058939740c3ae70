"""Named parameters and the tangents of formulas in them."""

import numpy as np
import pytest
import sympy

import bayes_greybox as bg
from bayes_greybox.physics.formula.expressions import evaluate, parse_expression
from bayes_greybox.physics.parameters import Parameter, bends, moved_to, read_parameters, step_to, tangent

POINT = {"y": np.array([0.3, -1.2, 0.0]), "v": np.array([0.5, 0.0, -2.0]), "u": np.array([1.0, 2.0, -0.5])}
OSCILLATOR = parse_expression("(u - k*y - c*v)/m")


def value(formula, **parameters):
    return evaluate(formula, {**POINT, **{name: np.asarray(each) for name, each in parameters.items()}})


def test_a_tangent_of_what_it_is_linear_in_is_the_formula():
    parameters = {"m": Parameter(2.0), "k": Parameter(30.0, sd=3.0, at=17.0), "c": Parameter(0.8, sd=0.1)}
    found = tangent(OSCILLATOR, parameters)
    assert not bends(OSCILLATOR, ["k", "c"])
    # The terms of learned parameters are gone, to the last digit.
    assert found.rest == parse_expression("u/2")
    np.testing.assert_allclose(value(found.slopes["k"]), -POINT["y"] / 2)


@pytest.mark.parametrize("m", [1.7, 2.0, 2.6])
def test_a_tangent_touches_the_formula_and_its_slope_is_the_derivative(m):
    parameters = {"m": Parameter(2.0, sd=0.5, at=m), "k": Parameter(30.0), "c": Parameter(0.8)}
    found, about = tangent(OSCILLATOR, parameters), {"k": 30.0, "c": 0.8}
    assert bends(OSCILLATOR, ["m"]) and bends(OSCILLATOR, ["k", "m"])
    np.testing.assert_allclose(value(found.rest) + m * value(found.slopes["m"]), value(OSCILLATOR, m=m, **about))
    h = 1e-5
    slope = (value(OSCILLATOR, m=m + h, **about) - value(OSCILLATOR, m=m - h, **about)) / (2 * h)
    np.testing.assert_allclose(value(found.slopes["m"]), slope, rtol=1e-7)


def test_a_formula_is_not_taken_apart():
    """Expanded, exp(V - i) is a product of numbers that leave the range of the computer."""
    formula = parse_expression("a*(exp((y - 800)/b) - 1)")
    parameters = {"a": Parameter(2.0, sd=0.1), "b": Parameter(50.0, sd=5.0)}
    found, y = tangent(formula, parameters), np.array([790.0, 900.0])
    total = evaluate(found.rest, {"y": y}) + sum(
        each.here * evaluate(found.slopes[name], {"y": y}) for name, each in parameters.items()
    )
    np.testing.assert_allclose(total, 2.0 * (np.exp((y - 800) / 50) - 1), rtol=1e-12)


@pytest.mark.parametrize("value", [3.0, 2.05, -5.0])
def test_a_step_is_no_longer_than_a_tangent_is_good_for(value):
    assert step_to(value, 2.0, 0.3) == min(max(value, 1.0), 3.0)
    assert step_to(value, 0.0, 0.3) == min(max(value, -0.3), 0.3)


def test_a_believed_parameter_keeps_its_value_wherever_the_tangent_is_taken():
    m, there = Parameter(2.0), 2.5
    formula = parse_expression("u/m")
    rest = tangent(formula, moved_to({"m": m}, {"m": there})).rest
    # u/2.5 + (2 - 2.5) (-u/2.5²)
    np.testing.assert_allclose(value(rest), POINT["u"] * (1 / there + (2.0 - there) * -1 / there**2))


@pytest.mark.parametrize("text", ["abs(v)**n*sign(v)", "sign(v - n)", "exp(-y/n)"])
def test_a_slope_is_finite_where_the_formula_is(text):
    formula = parse_expression(text)
    slope = tangent(formula, {"n": Parameter(1.5, sd=0.2)}).slopes["n"]
    assert np.all(np.isfinite(value(slope)))


def test_a_power_has_the_slope_of_its_exponent():
    formula, n = parse_expression("abs(v)**n"), 1.5
    slope = tangent(formula, {"n": Parameter(n, sd=0.2)}).slopes["n"]
    moving = POINT["v"] != 0
    v = np.abs(POINT["v"][moving])
    np.testing.assert_allclose(value(slope)[moving], v**n * np.log(v), rtol=1e-6)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Parameter(float("nan")), "finite number"),
        (lambda: Parameter(2.0, sd=0.0), "above 0"),
        (lambda: Parameter(2.0, bounds=(3.0, 1.0)), "lower bound first"),
        (lambda: Parameter(-1.0, bounds=(0.0, None)), "rules the value out"),
        (lambda: read_parameters({"sin": 1.0}), "taken by a function"),
        (lambda: read_parameters({"m": "2"}), "finite number"),
        (lambda: read_parameters([1.0]), "map names"),
        (lambda: tangent(OSCILLATOR, {"m": Parameter(0.0), "k": Parameter(1.0), "c": Parameter(1.0)}), "at m = 0"),
    ],
)
def test_what_is_no_parameter_is_refused(make, words):
    with pytest.raises(bg.InputError, match=words):
        make()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"simulation": {"v": "-y"}, "parameters": {"m": 2.0}}, "in no formula"),
        ({"simulation": lambda t, x, u: x, "parameters": {"m": 2.0}}, "function or an FMU"),
        (
            {"simulation": {"a": "-k*a", "b": "-k*b"}, "parameters": {"k": bg.Parameter(1.0, sd=0.1)}},
            "equations of a and b",
        ),
    ],
)
def test_a_parameter_that_stands_nowhere_or_twice_is_refused(arguments, words):
    with pytest.raises(bg.InputError, match=words):
        bg.GreyBox(**arguments)


def test_a_parameter_is_no_column():
    t = np.linspace(0.0, 1.0, 20)
    data = bg.Trajectories.from_arrays(t, states={"y": np.sin(t)}, derivatives={"y": np.cos(t)})
    model = bg.GreyBox(simulation={"y": "-y*k"}, parameters={"k": 1.0})
    assert model.simulator(data).formula("y") == -sympy.Symbol("y", real=True)
    with pytest.raises(bg.InputError, match="name of a column"):
        bg.GreyBox(simulation={"y": "-y"}, parameters={"y": 1.0}).simulator(data)
