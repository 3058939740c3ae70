"""Numbers and formulas of learned equations as they are written."""

from xml.dom.minidom import parseString

import pytest

from bayes_greybox.physics.formula.expressions import parse_expression
from bayes_greybox.physics.formula.printing import to_mathml, to_text
from bayes_greybox.report.words.formatting import concise


@pytest.mark.parametrize(
    ("mean", "sd", "text"),
    [
        (-1.0013, 0.0021, "-1.001(2)"),
        (0.8, 0.0104, "0.800(10)"),
        (123.4, 9.6, "123(10)"),
        (1234, 56, "1.23(6)·10³"),
        (1.5e-5, 2e-7, "1.50(2)·10⁻⁵"),
        (-0.1, 0.4, "-0.1(4)"),
        # What rounds to zero has no sign.
        (-0.001, 0.04, "0.00(4)"),
        (9.996, 0.03, "10.00(3)"),
        (-5.0, 0.0, "-5"),
        (2.5e-9, float("nan"), "2.5·10⁻⁹"),
        # More digits than anybody reads are not written; the standard deviation is at most the last.
        (1.0, 1e-14, "1.00000000(1)"),
    ],
)
def test_a_standard_deviation_stands_in_units_of_the_last_digit(mean, sd, text):
    negative, size = concise(mean, sd)
    assert f"{'-' if negative else ''}{size}" == text


@pytest.mark.parametrize(
    ("formula", "inside"),
    [
        ("ydot**2", "<msup><mover><mi>y</mi><mo>˙</mo></mover><mn>2</mn></msup>"),
        ("tank_1", '<msub><mi mathvariant="normal">tank</mi><mi>1</mi></msub>'),
        ("predator*y", '<mo rspace="0.17em">\u2062</mo><mi>y</mi>'),
        ("x*y", "<mi>x</mi><mo>\u2062</mo><mi>y</mi>"),
        ("heaviside(y)", "<mi>H</mi>"),
        ("max(abs(y) - 0.3, 0)*sign(y)", '<mi mathvariant="normal">max</mi>'),
        ("omega*1e-7", "<msup><mn>10</mn><mn>−7</mn></msup>"),
        ("exp(-y)", "<msup><mi>e</mi>"),
        ("sqrt(y)/(1 + atan(y))", "<mfrac><msqrt><mi>y</mi></msqrt>"),
    ],
)
def test_mathml_is_well_formed_and_has_names_as_they_are_written(formula, inside):
    text = to_mathml(parse_expression(formula)).replace("&InvisibleTimes;", "\u2062")
    root = parseString(f"<math>{text}</math>").documentElement
    assert inside in root.toxml()


def test_text_with_blanks_reads_back():
    for formula in ("F - y - 0.1*ydot", "max(0, abs(y) - 0.3)*sign(y)", "exp(1)*y**(-2)"):
        expr = parse_expression(formula)
        assert parse_expression(to_text(expr, blanks=True)) == expr == parse_expression(to_text(expr))
