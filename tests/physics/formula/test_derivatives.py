"""Derivatives of formulas along a path, against differences and against the kick of a jump."""

import numpy as np
import pytest

from bayes_greybox.physics.formula.expressions import evaluate, parse_expression
from bayes_greybox.physics.formula.rounding import gradient


@pytest.mark.parametrize(
    "text",
    ["y**2*abs(v)", "sin(2*y)*v", "max(0, y - 0.3)", "y/(1 + v**2)", "exp(-y**2)*tanh(3*v)", "F*y", "sqrt(abs(v))"],
)
def test_derivatives_are_those_of_differences(text):
    expr, rng, h = parse_expression(text), np.random.default_rng(0), 1e-6
    columns = {name: rng.uniform(0.1, 1, 30) * rng.choice([-1, 1], 30) for name in ("y", "v", "F")}
    found = gradient(expr, ("y", "v"), columns)
    for k, name in enumerate(("y", "v")):
        up, down = (evaluate(expr, columns | {name: columns[name] + side * h}) for side in (1, -1))
        np.testing.assert_allclose(found[:, k], (np.asarray(up) - np.asarray(down)) / (2 * h), atol=1e-6)


@pytest.mark.parametrize(("text", "jump"), [("sign(v)", 2.0), ("heaviside(v - 0.2)", 1.0), ("3*sign(v)*y**0", 6.0)])
def test_a_jump_kicks_by_its_height_whatever_the_nodes(text, jump):
    for n in (40, 100, 400):
        t = np.linspace(0, 4, n)
        v = 0.7 * (t - 2.03) + 0.01 * (t - 2.03) ** 2
        slope = gradient(parse_expression(text), ("v",), {"v": v, "y": np.ones(n)})[:, 0]
        assert np.trapezoid(slope, v) == pytest.approx(jump, rel=0.01)


def test_what_has_no_derivative_has_none():
    v = np.array([-1.0, 0.0, 1.0])
    np.testing.assert_array_equal(np.isfinite(gradient(parse_expression("sqrt(abs(v))"), ("v",), {"v": v})), True)
    constant = gradient(parse_expression("sign(v)"), ("v",), {"v": np.ones(5)})
    np.testing.assert_allclose(constant, np.full((5, 1), 1 - np.tanh(1.0) ** 2))
