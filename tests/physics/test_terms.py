"""Terms and dictionaries: names, order, values, and the refusal of duplicates."""

from dataclasses import FrozenInstanceError

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import sympy

from bayes_greybox.physics.terms import Dictionary, Term, polynomial
from bayes_greybox.running.errors import InputError

NAMES = ("y", "ydot")


def test_name_is_the_text_without_blanks_unless_given():
    assert Term("y * ydot ** 2").name == "y*ydot**2"
    assert Term("y**3", name="hardening").name == "hardening"
    y = sympy.Symbol("y")
    assert Term(y * sympy.Abs(y)).name == "y*abs(y)"


def test_term_knows_its_symbols_and_latex_and_is_frozen():
    term = Term("ydot*sin(y)")
    assert term.symbols == ("y", "ydot")
    assert term.latex == r"\dot{y} \sin{\left(y \right)}"
    with pytest.raises(FrozenInstanceError):
        term.name = "other"


def test_dictionary_takes_a_mix_and_keeps_the_order():
    spec = ["y * ydot", Term("y**5", name="quintic"), polynomial("ydot", 2), sympy.Symbol("y") ** 2]
    dictionary = Dictionary.of(spec, NAMES)
    assert dictionary.names == ("y*ydot", "quintic", "ydot", "ydot**2", "y**2")
    assert dictionary.latex[1] == "y^{5}"
    assert len(dictionary) == 5 and dictionary.symbols == NAMES
    assert Dictionary.of(dictionary, NAMES) == dictionary
    assert Dictionary.of("y", NAMES).names == ("y",)


def test_matrix_has_a_row_per_observation_and_a_column_per_term():
    rng = np.random.default_rng(0)
    y, v = rng.standard_normal((2, 9))
    dictionary = Dictionary.of(["1", "y", "y**2*ydot", "abs(y)"], NAMES)
    matrix = dictionary.evaluate({"y": y, "ydot": v})
    np.testing.assert_allclose(matrix, np.stack([np.ones(9), y, y**2 * v, np.abs(y)], axis=1), rtol=1e-15)
    by_row = jax.jit(jax.vmap(dictionary.evaluate))({"y": jnp.asarray(y), "ydot": jnp.asarray(v)})
    np.testing.assert_allclose(by_row, matrix, rtol=1e-14)


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ([], "no terms"),
        (["y", "z"], "unknown name 'z'"),
        (["y", "y"], "'y' and 'y'"),
        (["y*y", "y**2"], r"'y\*y' and 'y\*\*2'"),
        (["(y+1)**2", "y**2 + 2*y + 1"], "same up to a constant factor"),
        (["y", "-0.3*y"], "same up to a constant factor"),
        (["1", "2.5"], "same up to a constant factor"),
        (["y + 2*ydot", "0.1*y + 0.2*ydot"], "same up to a constant factor"),
        ([polynomial(NAMES, 2), "ydot*y"], "same up to a constant factor"),
        ([Term("y", name="a"), Term("y**2", name="a")], "name 'a'"),
        (["y - y"], "zero everywhere"),
        ([["y", ["ydot"]]], "list"),
        ({"y": 1}, "list of formulas"),
        ([3.0], "float"),
        (["y^2"], r"'\*\*'"),
    ],
)
def test_bad_dictionaries_are_refused(spec, words):
    with pytest.raises(InputError, match=words):
        Dictionary.of(spec, NAMES)


def test_near_duplicates_that_differ_are_kept():
    terms = [
        "y",
        "abs(y)",
        "y*abs(y)",
        "y**2",
        "heaviside(y-1)",
        "heaviside(y-2)",
        "(y+1)**2",
        "y**2+1",
        "sin(y)",
    ]
    assert Dictionary.of(terms, NAMES).names == tuple(terms)


def test_polynomial_is_graded_and_named_plainly():
    names = [term.name for term in polynomial(NAMES, 3)]
    assert names == [
        *("y", "ydot", "y**2", "y*ydot", "ydot**2"),
        *("y**3", "y**2*ydot", "y*ydot**2", "ydot**3"),
    ]
    plain = [term.name for term in polynomial(NAMES, 3, interactions=False, constant=True)]
    assert plain == ["1", "y", "ydot", "y**2", "ydot**2", "y**3", "ydot**3"]


def test_polynomial_counts_all_monomials():
    # C(n + d, d) monomials of degree at most d in n variables, the constant among them.
    assert len(polynomial(["a", "b", "c"], 4, constant=True)) == 35
    assert len(Dictionary.of(polynomial(["a", "b", "c"], 4), ["a", "b", "c"])) == 34


@pytest.mark.parametrize(
    ("variables", "degree"),
    [([], 2), (["y", "y"], 2), (["y"], 0), (["y"], True), (["sin"], 2), (list("abcdefgh"), 10)],
)
def test_polynomial_refuses_bad_requests(variables, degree):
    with pytest.raises(InputError):
        polynomial(variables, degree)
