"""Jumps in formulas rounded for an integrator, and left alone everywhere else."""

import numpy as np
import pytest

from bayes_greybox.physics.formula.expressions import evaluate, parse_expression
from bayes_greybox.physics.formula.rounding import ROUNDED, rounded
from bayes_greybox.physics.simulation.reading import simulation_of
from bayes_greybox.physics.terms import Dictionary, Term

V = 0.5 * np.sin(np.linspace(0, 20, 400))
COLUMNS = {"v": V, "y": np.cos(V)}


@pytest.mark.parametrize("text", ["sign(v)", "heaviside(v)", "(y + 1)*sign(v + 2*y) - 3"])
def test_a_rounded_jump_is_the_jump_but_near_it(text):
    expr = parse_expression(text)
    smooth = rounded(expr, COLUMNS)
    argument = V if "y" not in text else V + 2 * COLUMNS["y"]
    far = np.abs(argument) > 20 * ROUNDED * np.sqrt(np.mean(argument**2))
    exact, near = (np.asarray(evaluate(each, COLUMNS)) for each in (expr, smooth))
    np.testing.assert_allclose(near[far], exact[far], atol=1e-12)
    at = {name: np.zeros(1) for name in COLUMNS}
    assert np.all(np.isfinite(evaluate(smooth, at)))
    slightly = {"v": np.array([1e-6, -1e-6]), "y": np.zeros(2)}
    below, above = np.asarray(evaluate(smooth, slightly))
    assert below != above and abs(below - above) < 0.1


def test_formulas_without_jumps_stay_the_very_same():
    expr = parse_expression("abs(v)*v + max(y, 0)")
    assert rounded(expr, COLUMNS) is expr
    term = Term("y**3")
    assert term.rounded(COLUMNS) is term
    # A jump whose argument is nothing has no width.
    still = parse_expression("sign(v)")
    assert rounded(still, {"v": np.zeros(5)}) is still


def test_simulations_and_dictionaries_round_each_of_their_formulas():
    simulation = simulation_of({"y": "v", "v": "-y - 0.2*sign(v)"}, ("y", "v"), ()).rounded(COLUMNS)
    assert "tanh" in str(simulation.key) and "sign" not in str(simulation.key) and simulation.kinematic("y")
    beside = simulation_of({"y": "v"}, ("y", "v"), ()).beside({"v": [(Term("sign(v)"), -0.2)]}).rounded(COLUMNS)
    assert "tanh" in str(beside.key)
    terms = Dictionary.of(["sign(v)", "v"], ("y", "v")).rounded(COLUMNS).terms
    assert [term.name for term in terms] == ["sign(v)", "v"] and "tanh" in terms[0].text

    def code(t, x, u):
        return x

    function = simulation_of(code, ("y", "v"), ())
    assert function.rounded(COLUMNS) is function
