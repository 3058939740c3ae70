"""What can be stated of single coefficients, and what is refused."""

import numpy as np
import pytest

import bayes_greybox as bg
from bayes_greybox.model.priors import Coefficient
from bayes_greybox.running.errors import InputError

TERMS = ["y", "ydot", "y**3"]


@pytest.fixture(scope="module")
def data():
    return bg.systems.oscillator().simulate(np.linspace(0, 20, 80), noise=0.05, seed=1)


@pytest.mark.parametrize(
    "stated",
    [
        {},
        {"mean": 1.0},
        {"sd": 1.0},
        {"mean": 1.0, "sd": 0.0},
        {"mean": 1.0, "sd": -1.0},
        {"mean": float("nan"), "sd": 1.0},
        {"mean": 1.0, "sd": float("inf")},
        {"sign": 0},
        {"sign": 2},
        {"sign": True},
        {"lower": 2.0, "upper": 1.0},
        {"lower": 1.0, "upper": 1.0},
        {"sign": 1, "upper": -1.0},
        {"sign": -1, "lower": 0.0},
        {"mean": 1.0, "sd": 1.0, "sign": -1},
        {"mean": 1.0, "sd": 1.0, "lower": 2.0},
        {"fixed": 1.0, "sd": 0.1},
        {"fixed": 1.0, "sign": 1},
        {"fixed": float("inf")},
    ],
)
def test_what_says_nothing_or_contradicts_itself_is_refused(stated):
    with pytest.raises(InputError, match="Coefficient"):
        Coefficient(**stated)


def test_sign_and_bounds_meet():
    assert Coefficient(sign=-1).interval == (-np.inf, 0.0)
    assert Coefficient(sign=1, lower=-2.0, upper=3.0).interval == (0.0, 3.0)
    assert Coefficient(lower=-1.0).interval == (-1.0, np.inf)
    assert not Coefficient(mean=1.0, sd=1.0).bounded


@pytest.mark.parametrize(
    ("coefficients", "said"),
    [
        ({"y": {"y": Coefficient(sign=1)}}, "'y', which has no equation"),
        ({"ydot": Coefficient(sign=1)}, "must map terms"),
        ({"ydot": {"y": -2.0}}, r"give bg\.priors\.Coefficient"),
    ],
)
def test_a_model_refuses_what_is_no_prior_of_a_term(coefficients, said):
    with pytest.raises(InputError, match=said):
        bg.GreyBox(dictionary={"ydot": TERMS}, coefficients=coefficients)


def test_an_unknown_term_is_named_with_the_nearest(data):
    model = bg.GreyBox(dictionary={"ydot": TERMS}, coefficients={"ydot": {"y**4": Coefficient(sign=1)}})
    with pytest.raises(InputError, match=r"'y\*\*4', which is no term of the dictionary of 'ydot' \(did you mean"):
        model.dictionaries(data)


def test_blanks_in_a_key_do_not_matter_but_two_priors_of_a_term_do(data):
    stated = {"y ** 3": Coefficient(sign=1)}
    assert list(bg.GreyBox(dictionary={"ydot": TERMS}, coefficients={"ydot": stated}).stated("ydot", data).priors) == [
        "y**3"
    ]
    twice = {"ydot": {**stated, "y**3": Coefficient(sign=1)}}
    with pytest.raises(InputError, match="two priors"):
        bg.GreyBox(dictionary={"ydot": TERMS}, coefficients=twice).dictionaries(data)


def test_something_must_be_left_to_learn(data):
    model = bg.GreyBox(dictionary={"ydot": ["y"]}, coefficients={"ydot": {"y": Coefficient(fixed=-1.0)}})
    with pytest.raises(InputError, match="fixed, so there is nothing to learn"):
        model.dictionaries(data)


def test_patterns_that_gibbs_moves_draw_are_refused_with_a_remedy(data):
    prior, stated = bg.SpikeAndSlab(enumerate_up_to=1), {"ydot": {"y": Coefficient(sign=-1)}}
    model = bg.GreyBox(dictionary={"ydot": TERMS}, prior=prior, coefficients=stated, discrepancy=None)
    with pytest.raises(InputError, match=r"Gibbs moves on them know no priors of single.*RegularisedHorseshoe"):
        model.fit(data, draws=10, tune=10, chains=1, progress=False)


def test_a_model_says_what_is_stated():
    stated = {"y": Coefficient(mean=-2.0, sd=0.1, sign=-1), "y**3": Coefficient(lower=1.0, upper=2.0)}
    model = bg.GreyBox(dictionary={"ydot": TERMS}, coefficients={"ydot": stated})
    assert model.prior_text == "SpikeAndSlab (y N(-2, 0.1²), ≤ 0; y**3 ≥ 1, ≤ 2)"
    assert bg.GreyBox(dictionary={"ydot": TERMS}).prior_text == "SpikeAndSlab"
