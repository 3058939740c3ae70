"""Coefficients that would have to be of another size are spoken of, and no others."""

import numpy as np
import pytest
from tiny_equation import CUBE, tiny_regressors

from bayes_greybox.discovery.answer.checks import other_sizes


@pytest.mark.parametrize(
    "hidden, times", [(lambda x: -999 * x, 1000.0), (lambda x: 3 * x, -2.0)], ids=["a unit", "a wrong sign"]
)
def test_a_coefficient_of_another_size_is_said_with_its_factor(hidden, times):
    (text,) = other_sizes(tiny_regressors([CUBE], hidden, simulation={"x": "-x"}))
    assert "are its units those of the data?" in text
    factor = float(text.split("coefficients, of x ")[1].split(" times")[0])
    assert factor == pytest.approx(times, rel=0.05)


@pytest.mark.parametrize(
    "hidden, about",
    [
        (lambda x: -2 * x, {"simulation": {"x": "-x"}}),
        (lambda x: -40 * np.cos(6 * x), {"simulation": {"x": "-x"}}),
        (lambda x: -999 * x, {"simulation": {"x": "-x"}, "dictionary": {"x": ["x"]}}),
        (lambda x: -999 * x, {"simulation": lambda t, x, u: [-x[0]]}),
    ],
    ids=["a coefficient that is off", "an effect", "a term that is learned", "code"],
)
def test_nothing_is_said_of_what_is_no_size(hidden, about):
    assert other_sizes(tiny_regressors([CUBE], hidden, **about)) == []


def test_as_many_coefficients_as_rows_say_nothing():
    """Noise alone, which four terms follow through five rows."""
    many = {"simulation": {"x": "-x + 0.01*sin(3*x) + 0.01*cos(5*x) + 0.01*sin(7*x)"}}
    assert other_sizes(tiny_regressors([], n=5, noise=1.0, **many)) == []
