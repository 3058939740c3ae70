"""No formula crashes the parser, hangs it or is executed."""

import probes
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from inputs import FORMULAS, WORDS

SETTINGS = settings(derandomize=True, deadline=None, max_examples=150, database=None)


@SETTINGS
@given(FORMULAS)
def test_what_looks_like_a_formula_is_read_or_refused(text):
    probes.expression(text)


@SETTINGS
@given(st.one_of(WORDS, FORMULAS.flatmap(lambda text: st.permutations(text[:40]).map("".join))))
def test_so_is_any_text(text):
    probes.expression(text)


HUGE = {
    "tower": "9**9**9**9",
    "nested powers": "((((y**100)**100)**100)**100)",
    "huge exponent": "y**1e308",
    "products of powers": "(y + v)**100*(y + F)**100*(v + F)**99",
    "digits": "7" * 1999,
    "hexadecimal": "0x" + "f" * 1990,
    "roots": "sqrt(2 + " * 49 + "y" + ")" * 49,
    "constant roots": "sqrt(2 + " * 49 + "2" + ")" * 49,
    "minima": "min(" * 49 + "y" + ", v)" * 49,
    "a sum": "+".join(f"sin({k})" for k in range(150)),
    "a product": "*".join(f"(y + {k})" for k in range(200)),
    "signs": "-" * 1990 + "y",
    "brackets": "(" * 999 + ")" * 999,
    "distances": "+".join(f"abs(y - {k})" for k in range(150)),
}


@pytest.mark.parametrize("name", HUGE)
def test_formulas_made_to_hang_do_not(name):
    probes.expression(HUGE[name])
