"""What a term may state of its own coefficient, and what is refused with the remedy."""

import os
from collections import deque

import numpy as np
import pytest

import bayes_greybox as bg
from bayes_greybox.physics.terms import stating
from bayes_greybox.running.errors import InputError

Coefficient = bg.priors.Coefficient

pytestmark = pytest.mark.skipif(
    os.environ.get("BAYES_GREYBOX_TYPECHECK", "0") == "1", reason="arguments of other types are what is tried here"
)


@pytest.mark.parametrize(
    ("said", "stated"),
    [
        ({}, None),
        ({"sign": "+"}, Coefficient(sign=1)),
        ({"sign": "-", "prior": (-40, 10)}, Coefficient(mean=-40.0, sd=10.0, sign=-1)),
        ({"prior": [0, np.float64(2.0)], "bounds": [None, 1]}, Coefficient(mean=0.0, sd=2.0, upper=1.0)),
        ({"bounds": (-3, 4)}, Coefficient(lower=-3.0, upper=4.0)),
        # Sign and bounds meet; a mean may lie on the edge.
        ({"sign": "+", "bounds": (-3, 4), "prior": (0, 1)}, Coefficient(0.0, 1.0, 1, -3.0, 4.0)),
        ({"fixed": 0}, Coefficient(fixed=0.0)),
    ],
)
def test_a_term_states_what_a_coefficient_does(said, stated):
    term = bg.Term("y**3", **said)
    assert term.stated == stated
    assert hash(term) == hash(bg.Term("y**3", **said))
    assert term.plain == bg.Term("y**3") and term.plain.stated is None
    assert [each.name for each in stating(["y", [term]])] == (["y**3"] if said else [])


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ({"sign": "positive"}, r"sign='positive': write \"\+\" for not negative"),
        ({"sign": -1}, "sign=-1: write"),
        ({"prior": -40}, r"prior=-40: give mean and standard deviation.*\(-40, 10\)"),
        ({"prior": (-40,)}, "two finite numbers"),
        ({"prior": (-40, 0)}, "above 0"),
        ({"prior": (float("nan"), 1)}, "finite"),
        ({"prior": (0, float("inf"))}, "finite"),
        ({"fixed": float("inf")}, "fixed=inf: give the coefficient, a finite number"),
        ({"fixed": "3"}, "a finite number"),
        ({"fixed": True}, "a finite number"),
        ({"bounds": (0, float("inf"))}, "None in place of one leaves that end open"),
        ({"bounds": (None, None)}, "leave bounds out"),
        ({"bounds": (2, 2)}, "write fixed=2"),
        ({"bounds": (5, -5)}, r"wrong way round: write bounds=\(-5, 5\)"),
        ({"fixed": 1, "sign": "+"}, r"fixed=1 and sign='\+'.*leave out sign, or fixed"),
        ({"fixed": 1, "prior": (1, 1)}, "leave out prior"),
        ({"fixed": 1, "bounds": (0, 2)}, "leave out bounds"),
        ({"sign": "-", "bounds": (0, 5)}, "no coefficient has that sign: leave out one of them, or turn it round"),
        ({"sign": "+", "bounds": (None, -1)}, "no coefficient has that sign"),
        ({"sign": "-", "prior": (40, 10)}, "mean is not possible with sign='-': move the mean"),
        ({"bounds": (-5, 5), "prior": (6, 1)}, r"not possible with bounds=\(-5, 5\)"),
        ({"sign": "+", "bounds": (-5, 5), "prior": (-1, 1)}, "not possible with sign='\\+' and bounds"),
    ],
)
def test_what_contradicts_itself_is_refused_by_the_name_of_the_term(said, why):
    with pytest.raises(InputError, match=f"^The term 'cube' has .*{why}"):
        bg.Term("y**3", name="cube", **said)


def test_a_model_takes_them_from_its_dictionary_nested_or_not():
    inner = [bg.Term("y", sign="-"), "ydot"]
    model = bg.GreyBox({"ydot": [inner, bg.Term("y**3", name="cube", fixed=-1)], "z": bg.Term("z", prior=(1, 2))})
    expected = {
        "ydot": {"y": Coefficient(sign=-1), "cube": Coefficient(fixed=-1.0)},
        "z": {"z": Coefficient(mean=1.0, sd=2.0)},
    }
    assert model.coefficients == expected
    # A copy has them, whichever of its parts is copied.
    assert bg.GreyBox(model.dictionary).coefficients == expected
    assert bg.GreyBox(model.dictionary, coefficients=model.coefficients).coefficients == expected
    parsed = bg.Dictionary.of(inner, ["y", "ydot"])
    assert bg.GreyBox({"ydot": parsed}).coefficients == {"ydot": {"y": Coefficient(sign=-1)}}


def test_two_statements_of_one_term_are_refused_unless_they_agree():
    dictionary = {"ydot": ["y", bg.Term("y**3", sign="-")]}
    agreed = bg.GreyBox(dictionary, coefficients={"ydot": {"y**3": Coefficient(sign=-1), "y": Coefficient(sign=1)}})
    assert agreed.coefficients == {"ydot": {"y**3": Coefficient(sign=-1), "y": Coefficient(sign=1)}}
    with pytest.raises(InputError, match=r"'y\*\*3' of 'ydot' is stated twice, ≤ 0 and ≥ 0: state it once"):
        bg.GreyBox(dictionary, coefficients={"ydot": {"y**3": Coefficient(sign=1)}})


def test_a_study_moves_means_into_the_simulation_and_refuses_bounds():
    model = bg.GreyBox({"ydot": [bg.Term("y", prior=(-2, 0.1)), bg.Term("ydot", fixed=-0.1)]}, simulation={"y": "ydot"})
    data = bg.systems.oscillator().simulate(np.linspace(0, 5, 40), noise=0.1, seed=1)
    around = model.centred()
    assert [term.stated for term in around.dictionary["ydot"]] == [None, None]
    assert around.stated("ydot", data).known[0][1] == -2.0
    with pytest.raises(InputError, match="no closed form with bounds"):
        bg.GreyBox({"ydot": [bg.Term("y", sign="-")]}).centred()


def test_what_was_stated_is_told_with_all_its_digits():
    assert str(bg.Term("y", fixed=-0.123456789).stated) == "= -0.123456789"
    assert str(bg.Term("y", prior=(1234567.5, 3), bounds=(1e6, None)).stated) == "N(1234567.5, 3²), ≥ 1000000"


@pytest.mark.parametrize("held", [tuple, iter, lambda terms: {str(k): t for k, t in enumerate(terms)}.values(), deque])
def test_statements_are_heard_whatever_holds_the_terms(held):
    model = bg.GreyBox(dictionary={"v": held([bg.Term("y", fixed=-2.0), bg.Term("v", sign="-")])})
    assert set(model.coefficients["v"]) == {"y", "v"}
