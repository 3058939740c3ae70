"""Rates with added terms, whose numbers are arguments, against the formulas."""

import jax.numpy as jnp
import numpy as np

from bayes_greybox.model.rows.path.forced_rate import Force, ForcedRate
from bayes_greybox.physics.simulation.reading import simulation_of
from bayes_greybox.physics.terms import Term


def test_columns_may_be_called_anything_beside_numbers_in_formulas():
    simulation = simulation_of({"number_0": "v", "v": "number_1"}, ("number_0", "v"), ("number_1",))
    rate = ForcedRate(simulation, (1,), [Force(Term("sin(2.5*number_0 + 0.3*number_1)"), -2.0, 1)])
    y, v, F = np.random.default_rng(0).normal(size=(3, 5))
    for k in range(5):
        found = rate(jnp.zeros(()), jnp.array([y[k], v[k]]), jnp.array([F[k]]), rate.args)
        np.testing.assert_allclose(found, [v[k], F[k] - 2 * np.sin(2.5 * y[k] + 0.3 * F[k])], rtol=1e-12)


def test_formulas_that_differ_in_their_numbers_alone_are_equal():
    simulation = simulation_of({"y": "v"}, ("y", "v"), ())
    one, other, third = (
        ForcedRate(simulation, (1,), [Force(Term(text), -2.0, 1)]) for text in ("sin(2.5*y)", "sin(0.4*y)", "sin(2*y)")
    )
    assert one == other and hash(one) == hash(other) and one != third


def test_so_are_simulations_and_each_has_its_own_rates():
    """A hidden state that follows at another rate is no other program."""
    names = ("y", "v", "z"), ("F",)
    drag = Term("v*abs(v)"), -0.7
    given = ({"y": "v", "v": "z - 2*y", "z": f"{k}*(F - z)"} for k in (1.2, 7.4))
    slow, fast = (ForcedRate(simulation_of(each, *names).beside({"v": [drag]}), (1,), []) for each in given)
    assert slow == fast and hash(slow) == hash(fast)
    x, u = jnp.array([0.3, -0.4, 0.1]), jnp.array([0.9])
    for rate, k in ((slow, 1.2), (fast, 7.4)):
        found = slow(jnp.zeros(()), x, u, rate.args)
        np.testing.assert_allclose(found, [-0.4, 0.1 - 0.6 + 0.7 * 0.16, k * 0.8], rtol=1e-12)
