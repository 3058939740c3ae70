"""Units of coefficients, and terms whose units cannot be right."""

import numpy as np
import pytest

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.terms import Dictionary, Term
from bayes_greybox.physics.units import (
    check_units,
    coefficient_unit,
    derivative_unit,
    parse_unit,
    require_units_of,
    same_unit,
    target_unit,
    term_unit,
    with_rates,
)
from bayes_greybox.running.errors import InputError

UNITS = {
    "t": "s", "y": "m", "ydot": "m/s", "F": "N", "phi": "rad", "psi": "degree", "r": "1", "q": "mm",
    "share": "percent",
}  # fmt: skip


@pytest.mark.parametrize(
    ("term", "unit"),
    [
        ("y", "1/s²"),
        ("ydot", "1/s"),
        ("y**3", "1/m²/s²"),
        ("ydot**3", "s/m²"),
        ("y*abs(y)", "1/m/s²"),
        ("F", "1/kg"),
        ("1", "m/s²"),
        ("sign(ydot)", "m/s²"),
        ("heaviside(y-0.1)*ydot", "1/s"),
        ("max(y-0.1,0)", "1/s²"),
        ("sin(phi)", "m/s²"),
        ("sin(6*y)", "m/s²"),
        ("y+0.5*ydot", "1/s²"),
        ("sqrt(y**2)", "1/s²"),
        ("z", ""),
        ("y*z", ""),
    ],
)
def test_coefficient_unit_makes_the_term_consistent(term, unit):
    assert coefficient_unit(derivative_unit("ydot", UNITS), Term(term), UNITS) == unit


def test_plain_numbers_overrides_and_missing_units():
    assert coefficient_unit("m/s", Term("ydot"), UNITS) == "1"
    assert coefficient_unit("N", Term("y*z", unit="kg"), UNITS) == "N/kg"
    assert coefficient_unit("", Term("y"), UNITS) == ""
    assert coefficient_unit("m/s", Term("ydot"), {}) == ""


def test_derivative_unit_prefers_the_declared_one():
    assert parse_unit(derivative_unit("ydot", UNITS), "x") == parse_unit("m/s^2", "x")
    assert derivative_unit("ydot", {**UNITS, "d(ydot)/dt": "N/kg"}) == "N/kg"
    assert derivative_unit("z", UNITS) == "" and derivative_unit("y", {"y": "m"}) == ""


def test_the_rate_of_a_state_has_a_unit_of_its_own():
    rates = {"a": None, "v": "a", "y": "v", "F": "G"}
    known = with_rates({"t": "s", "y": "mm"}, rates)
    assert {name: parse_unit(unit, name) for name, unit in known.items()} == {
        "t": parse_unit("s", "t"), "y": parse_unit("mm", "y"), "v": parse_unit("mm/s", "v"),
        "a": parse_unit("mm/s^2", "a"),
    }  # fmt: skip
    # What is said stays, and nothing is made up without a unit of time.
    assert with_rates({"t": "s", "y": "mm", "v": "m/s", "a": ""}, {"y": "v"})["v"] == "m/s"
    assert with_rates({"y": "mm"}, {"y": "v"}) == {"y": "mm"}


def test_the_unit_of_an_output_is_its_own():
    t = np.arange(3.0)
    data = Trajectories.from_arrays(
        t, states={"v": t}, outputs={"R": t, "q": t}, units={"t": "s", "v": "m/s", "R": "N"}
    )
    assert target_unit("R", data) == "N" and target_unit("q", data) == ""
    assert target_unit("v", data) == derivative_unit("v", data.units) == "m/s²"
    assert coefficient_unit(target_unit("R", data), Term("v*abs(v)"), data.units) == "kg/m"


@pytest.mark.parametrize(
    ("term", "words"),
    [
        ("y+ydot", r"'y\+ydot'.*in m and.*in m/s"),
        ("y-q", "mm"),
        ("max(y,ydot)", "in m/s"),
        ("sign(ydot-F)", "in N"),
        ("sin(y)", r"y in m inside sin\(y\)"),
        ("sin(-y)", "inside sin"),
        ("y*exp(ydot)", "ydot in m/s inside exp"),
        ("sin(y+1)", "inside sin"),
        ("2**y", r"inside 2\*\*y"),
        ("y**r", r"y in m inside y\*\*r"),
        ("sin(psi)", "pi/180"),
        ("exp(share)", "in %"),
    ],
)
def test_unit_mismatch_is_refused(term, words):
    with pytest.raises(InputError, match=words):
        check_units({"ydot": [Term(term)]}, UNITS)


@pytest.mark.parametrize(
    "term",
    [
        "sin(2*y)",
        "sin(y/0.3)",
        "sin(2*y+0.3)",
        "exp(-0.1*ydot)",
        "y-1",
        "(1-y**2)*ydot",
        "2**r",
        "r**r",
        "sin(phi)",
    ]
    + [
        "sin(pi*psi/180)",
        "y+z",
        "sin(z)",
        "y+0.001*q",
        "tanh(100*ydot)*F",
        "min(y,0.1)",
        "abs(y)+y",
        "asin(r)",
    ],
)
def test_terms_that_can_be_right_pass(term):
    check_units({"ydot": Dictionary.of([term], [*UNITS, "z"]).terms}, UNITS)


@pytest.mark.parametrize(
    "unit",
    [
        "metter",
        "foo/s",
        "m/",
        "3*m",
        "9**9**9",
        "(9**99)**99",
        "m**9999",
        "__import__('os')",
        "m" * 500,
        "Volt",
    ],
)
def test_unknown_unit_is_refused_with_its_column(unit):
    with pytest.raises(InputError, match="column 'y'"):
        check_units({}, {"y": unit})


def test_unknown_unit_suggests_a_known_one():
    with pytest.raises(InputError, match="Did you mean .*newton"):
        parse_unit("newtom", "column 'F'")


@pytest.mark.parametrize("unit", ["m/s^2", "m/s**2", "m s**-2", "m/s²", "N/kg", "millimeter*1/s/ms"])
def test_one_unit_may_be_written_in_many_ways(unit):
    assert parse_unit(unit, "column 'a'").dimensionality == parse_unit("m/s^2", "column 'a'").dimensionality


def test_derivative_unit_must_be_state_over_time():
    check_units({"ydot": [Term("y")]}, {**UNITS, "d(ydot)/dt": "N/kg"})
    for wrong in ("m/s", "mm/s^2"):
        with pytest.raises(InputError, match="derivative of 'ydot'"):
            check_units({"ydot": [Term("y")]}, {**UNITS, "d(ydot)/dt": wrong})
        with pytest.raises(InputError, match="derivative of 'ydot'"):
            check_units({}, {**UNITS, "d(ydot)/dt": wrong}, states=["ydot"])


def test_declared_unit_of_a_term_replaces_the_check():
    assert term_unit(Term("sin(y)", unit="1"), UNITS) == parse_unit("1", "x")
    check_units({"ydot": [Term("sin(y)", unit="1")]}, UNITS)


def test_data_in_another_unit_are_refused_and_in_the_same_one_otherwise_written_are_not():
    def data(**units):
        return Trajectories.from_arrays(np.arange(3), states={"y": [0.0, 1.0, 3.0]}, units=units)

    train = data(y="N", t="s")
    for same in (data(y="kg*m/s^2", t="sec"), data(y="N"), data()):
        require_units_of(same, train)
    with pytest.raises(InputError, match="test data have t in ms, the training data in s: convert them"):
        require_units_of(data(y="N", t="ms"), train)
    # As large, but they count from elsewhere.
    assert not same_unit("degC", "K", "column 'T'") and same_unit("degC", "°C", "column 'T'")


@pytest.mark.parametrize(
    ("text", "said"), [("Min", "'min'"), ("S", "'s'"), ("Hz", "such as 's'"), ("m", "such as 's'")]
)
def test_a_unit_of_the_time_that_is_none_is_answered_with_the_one_that_was_meant(text, said):
    with pytest.raises(InputError, match=f"unit '{text}' of 'Zeit' is .*no unit of time; .*{said}"):
        check_units({}, {"t": text, "y": "m"}, time="Zeit")
    for known in ("min", "h", "ms", "deg", "1", ""):
        check_units({}, {"t": known})
