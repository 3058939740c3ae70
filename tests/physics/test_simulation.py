"""Simulations with further terms whose coefficients are known."""

import jax.numpy as jnp
import numpy as np
import pytest

import bayes_greybox as bg
from bayes_greybox.physics.simulation.code import CallableSimulation
from bayes_greybox.physics.simulation.reading import simulation_of
from bayes_greybox.physics.terms import Term

KNOWN = {"v": ((Term("y**3"), -2.0), (Term("F*v"), 0.5)), "y": ()}


@pytest.mark.parametrize("given", [None, {"y": "v", "v": "F - y"}, lambda t, x, u: jnp.array([x[1], u[0] - x[0]])])
def test_known_terms_are_added_in_rows_and_in_integrators(given):
    plain = simulation_of(given, ("y", "v"), ("F",))
    both = plain.beside(KNOWN)
    rng = np.random.default_rng(0)
    y, v, F = rng.normal(size=(3, 6))
    data = bg.Trajectories.from_arrays(np.arange(6.0), states={"y": y, "v": v}, inputs={"F": F})
    added = -2.0 * y**3 + 0.5 * F * v
    np.testing.assert_allclose(both.on(data, "v"), plain.on(data, "v") + added)
    np.testing.assert_allclose(both.on(data, "y"), plain.on(data, "y"))
    for i in range(6):
        point = (jnp.zeros(()), jnp.array([y[i], v[i]]), jnp.array([F[i]]))
        np.testing.assert_allclose(both.rate(*point) - plain.rate(*point), [0.0, added[i]], atol=1e-12)
    assert both.additive_terms("v") == plain.additive_terms("v") and "v" in both.equations
    assert both.kinematic("y") == plain.kinematic("y") and not both.kinematic("v")
    assert both.key != plain.key and hash(both.key) == hash(plain.beside(KNOWN).key)
    assert plain.beside({"v": ()}) is plain


def test_an_output_is_in_rows_and_in_no_integrator():
    given = {"y": "v", "v": "F - y", "R": "2*y", "S": "y"}
    simulation = simulation_of(given, ("y", "v"), ("F",), ("R", "S")).beside({"R": ((Term("v"), 3.0),)})
    rng = np.random.default_rng(0)
    y, v, F = rng.normal(size=(3, 6))
    data = bg.Trajectories.from_arrays(np.arange(6.0), states={"y": y, "v": v}, inputs={"F": F})
    np.testing.assert_allclose(simulation.on(data, "R"), 2 * y + 3 * v)
    x = np.column_stack([y, v])
    np.testing.assert_allclose(simulation.rates(data.time, x, F[:, None]), np.column_stack([v, F - y]))
    assert simulation.rate(jnp.zeros(()), jnp.array(x[0]), jnp.array(F[:1])).shape == (2,)
    assert simulation.jacobian(data.time, x, F[:, None]).shape == (6, 2, 2)
    assert set(simulation.equations) == {"y", "v", "R", "S"}
    # What is measured of a state twice has no rate.
    assert simulation.kinematic("y") and not simulation.kinematic("S")


def test_what_an_output_is_not():
    with pytest.raises(bg.InputError, match="'Q', which is neither a state nor an output .*; states: y; outputs: R"):
        simulation_of({"Q": "y"}, ("y",), (), ("R",))
    with pytest.raises(bg.InputError, match="unknown name 'R'"):
        simulation_of({"y": "-R"}, ("y",), (), ("R",))
    data = bg.Trajectories.from_arrays(np.arange(3.0), states={"y": np.arange(3.0)}, outputs={"R": np.ones(3)})
    function = simulation_of(lambda t, x, u: -x, ("y",), (), ("R",))
    with pytest.raises(bg.InputError, match="rates of states and not the output 'R': give formulas"):
        function.on(data, "R")


class _Spring:
    """What a notebook may do: a number that is changed after the model was made, in an object that has no hash."""

    __hash__ = None

    def __init__(self, k):
        self.k = k

    def __call__(self, t, x, u):
        return [x[1], -self.k * x[0]]


def test_code_that_reads_another_number_is_another_simulation():
    spring = _Spring(1.0)
    simulation = CallableSimulation(("y", "v"), (), spring)
    t, x, u = np.zeros(3), np.ones((3, 2)), np.zeros((3, 0))
    before = simulation.key
    assert simulation.key == before and hash(simulation.key) == hash(before)
    np.testing.assert_allclose(simulation.jacobian(t, x, u)[0], [[0, 1], [-1, 0]])
    spring.k = 5.0
    assert simulation.key != before
    np.testing.assert_allclose(simulation.rates(t, x, u)[:, 1], -5.0)
    np.testing.assert_allclose(simulation.jacobian(t, x, u)[0], [[0, 1], [-5, 0]])
