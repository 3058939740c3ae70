"""Laws next to a catalogue's."""

import numpy as np
import pytest

from bayes_greybox.physics.catalogue.effects import Effect
from bayes_greybox.physics.catalogue.inner_parameter import InnerParameter
from bayes_greybox.physics.catalogue.loading import load_catalogue
from bayes_greybox.physics.catalogue.neighbours import bent, between, neighbours, powers
from bayes_greybox.physics.terms import Term


@pytest.mark.parametrize(
    ("law", "near"),
    [
        ("x**2*v", "v*abs(x) v*abs(x)**1.5 v*abs(x)**2.5 v*x**2*abs(x) v*x**2*abs(v)**0.5 v*x**2*abs(v)"),
        ("v*abs(v)", "v v*abs(v)**0.5 v*abs(v)**1.5 v**3"),
        ("x**3", "x*abs(x) x*abs(x)**1.5 x*abs(x)**2.5 x**3*abs(x)"),
        ("x*abs(x)**1.5", "x*abs(x)**0.5 x*abs(x) x**3 x*abs(x)**2.5"),
        ("sign(v)", "v"),
        ("abs(v)", "v**2 abs(v)**1.5"),
        ("-3*x**2", "abs(x) abs(x)**1.5 abs(x)**2.5 x**2*abs(x)"),
        ("sqrt(max(x, 0))", ""),
        ("max(x - 0.3, 0)", ""),
        ("sin(x)", ""),
        ("1/x", ""),
        ("1", ""),
    ],
)
def test_one_exponent_goes_up_or_down_and_signs_stay(law, near):
    assert {term.text for term in neighbours(Term(law), [])} == {Term(text).text for text in near.split()}


@pytest.mark.parametrize(
    ("first", "second", "laws"),
    [
        ("x*abs(x)", "x**3", "x*abs(x)**1.25 x*abs(x)**1.5 x*abs(x)**1.75"),
        ("x**3", "x*abs(x)", "x*abs(x)**1.25 x*abs(x)**1.5 x*abs(x)**1.75"),
        ("sign(v)", "v*abs(v)", "v v*abs(v)**0.25 v*abs(v)**0.5 v*abs(v)**0.75"),
        ("x**2*v", "v*abs(x)", "v*abs(x)**1.25 v*abs(x)**1.5 v*abs(x)**1.75"),
        # Of another sign, another variable, two exponents, or the same law: nothing lies between.
        ("x**2", "x**3", ""),
        ("x**3", "v**3", ""),
        ("x*abs(v)", "x**3*v**2", ""),
        ("x**3", "-2*x**3", ""),
        ("sin(x)", "x", ""),
    ],
)
def test_between_two_laws_are_those_whose_exponent_lies_between(first, second, laws):
    assert {term.text for term in between(Term(first), Term(second), [])} == {Term(text).text for text in laws.split()}


def test_a_law_that_stands_for_itself_is_no_neighbour():
    known = [Term("-2*x*abs(x)"), Term("x*abs(x)**1.5")]
    near = {Term("x*abs(x)**2.5").text, Term("x**3*abs(x)").text}
    assert {term.text for term in neighbours(Term("x**3"), known)} == near
    assert [term.text for term in between(Term("sign(x)"), Term("x**3"), [*known, Term("x")])][:2] == [
        Term("x*abs(x)**0.25").text, Term("x*abs(x)**0.5").text,
    ]  # fmt: skip


def test_neighbours_of_a_law_that_bends_have_its_inner_parameters():
    fading = Effect(
        slug="fading", name="Fading friction", domain="test", expression="sign(r)*exp(-r**2/s**2)",
        inner=(InnerParameter("s", "where it fades", of="r", low=0.1, high=1.0),), sign=-1, reverse="feeds energy in",
    ).bind({"r": "v"})  # fmt: skip
    near = bent(fading)
    assert [law.term({"s": 0.5}).expr for law in near] == [
        Term("sign(v)*abs(v)**0.5*exp(-v**2/0.5**2)").expr,
        Term("sign(v)*abs(v)*exp(-v**2/0.5**2)").expr,
    ]
    assert all(law.effect.inner == fading.effect.inner and law.effect.sign == 0 for law in near)
    assert len({law.label for law in (*near, fading)}) == 3


def test_a_law_that_does_not_depend_on_what_its_inner_parameter_is_of_has_no_neighbours():
    clock = Effect(
        slug="clock", name="Clock", domain="test", expression="r*exp(-q/s)",
        inner=(InnerParameter("s", "scale", of="q", low=0.1, high=1.0),),
    ).bind({"r": "v", "q": "x"})  # fmt: skip
    assert [law.effect.expression for law in bent(clock)] == ["(r*exp(-q/s))*abs(q)**0.5", "(r*exp(-q/s))*abs(q)"]


@pytest.mark.parametrize("effect", load_catalogue("all"), ids=lambda e: e.slug)
def test_powers_are_those_of_the_formula(effect):
    found = powers(effect.expr)
    if found is None or not found:
        return
    rng = np.random.default_rng(0)
    at = {name: rng.uniform(0.5, 2, 5) for name in found}
    term = Term(effect.expr)
    for name, (degree, odd) in found.items():
        np.testing.assert_allclose(term.evaluate({**at, name: 3 * at[name]}), 3.0 ** float(degree) * term.evaluate(at))
        np.testing.assert_allclose(term.evaluate({**at, name: -at[name]}), (-1.0) ** odd * term.evaluate(at))
