"""Laws next to a catalogue's."""

import numpy as np
import pytest

from bayes_greybox.physics.catalogue.loading import load_catalogue
from bayes_greybox.physics.catalogue.neighbours import neighbours, powers
from bayes_greybox.physics.terms import Term


@pytest.mark.parametrize(
    ("law", "near"),
    [
        ("x**2*v", {"v*abs(x)", "v*x**2*abs(x)", "v*x**2*abs(v)"}),
        ("v*abs(v)", {"v", "v**3"}),
        ("x**3", {"x*abs(x)", "x**3*abs(x)"}),
        ("sign(v)", {"v"}),
        ("abs(v)", {"v**2"}),
        ("-3*x**2", {"abs(x)", "x**2*abs(x)"}),
        ("sqrt(max(x, 0))", set()),
        ("max(x - 0.3, 0)", set()),
        ("sin(x)", set()),
        ("1/x", set()),
        ("1", set()),
    ],
)
def test_one_exponent_goes_up_or_down_and_signs_stay(law, near):
    assert {term.text for term in neighbours(Term(law), [])} == {Term(text).text for text in near}


def test_a_law_that_stands_for_itself_is_no_neighbour():
    assert [term.text for term in neighbours(Term("x**3"), [Term("-2*x*abs(x)")])] == [Term("x**3*abs(x)").text]


@pytest.mark.parametrize("effect", load_catalogue("all"), ids=lambda e: e.slug)
def test_powers_are_those_of_the_formula(effect):
    found = powers(effect.expr)
    if found is None or not found:
        return
    rng = np.random.default_rng(0)
    at = {name: rng.uniform(0.5, 2, 5) for name in found}
    term = Term(effect.expr)
    for name, (degree, odd) in found.items():
        np.testing.assert_allclose(term.evaluate({**at, name: 3 * at[name]}), 3.0**degree * term.evaluate(at))
        np.testing.assert_allclose(term.evaluate({**at, name: -at[name]}), (-1.0) ** odd * term.evaluate(at))
