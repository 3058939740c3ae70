"""Formulas, names and text in Python with NumPy, in C and in Modelica.

SymPy's printers say what the package computes: numbers have all their digits, roots of negative numbers are none, and
sign(0) is 0. Text cannot leave the comment that it stands in.
"""

import re
import unicodedata
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import reduce
from types import MappingProxyType
from typing import Any

from sympy.printing.c import C99CodePrinter
from sympy.printing.numpy import NumPyPrinter
from sympy.printing.precedence import PRECEDENCE
from sympy.printing.str import StrPrinter


class _Printed:
    """Names, numbers with all digits, and extremes of several, as all three languages have them."""

    maximum, minimum = "max", "min"
    """Functions of two numbers."""

    def __init__(self, names: Mapping[str, str]) -> None:
        super().__init__()
        self._names = names

    def _print_Symbol(self, expr):  # noqa: N802
        return self._names[expr.name]

    def _print_Float(self, expr):  # noqa: N802
        return repr(float(expr))

    def _print_Integer(self, expr):  # noqa: N802
        return str(int(expr)) if abs(int(expr)) < 2**31 else repr(float(expr))

    def _print_Rational(self, expr):  # noqa: N802
        return repr(float(expr))

    _print_Half = _print_NumberSymbol = _print_Pi = _print_Exp1 = _print_Float

    def _print_Max(self, expr):  # noqa: N802
        return reduce(lambda a, b: f"{self.maximum}({a}, {b})", map(self._print, expr.args))  # type: ignore

    def _print_Min(self, expr):  # noqa: N802
        return reduce(lambda a, b: f"{self.minimum}({a}, {b})", map(self._print, expr.args))  # type: ignore

    def product(self, factor: str, formula: Any) -> str:
        """Return a coefficient times a formula."""
        if formula == 1:
            return factor
        return f"{factor}*{self.parenthesize(formula, PRECEDENCE['Mul'], strict=True)}"  # type: ignore


class PythonPrinter(_Printed, NumPyPrinter):
    """Formulas with NumPy's functions, on numbers and on arrays."""

    maximum, minimum = "numpy.maximum", "numpy.minimum"

    def _print_Heaviside(self, expr):  # noqa: N802
        return f"numpy.heaviside({self._print(expr.args[0])}, {self._print(expr.args[1])})"


class CPrinter(_Printed, C99CodePrinter):  # pyright: ignore[reportIncompatibleMethodOverride]
    """Formulas in C99; `sign_of`, `step_of`, `max_of` and `min_of` are functions of the program that keep NaN."""

    # Macros such as M_LN2, which it would take for log(2), are not of the standard.
    math_macros = MappingProxyType({})
    maximum, minimum = "max_of", "min_of"

    def _print_Abs(self, expr):  # noqa: N802
        # Of whole numbers too, for which SymPy has the function of integers.
        return f"fabs({self._print(expr.args[0])})"

    def _print_sign(self, func):  # noqa: N802
        return f"sign_of({self._print(func.args[0])})"

    def _print_Heaviside(self, expr):  # noqa: N802
        return f"step_of({self._print(expr.args[0])}, {self._print(expr.args[1])})"

    def _print_Pow(self, expr):  # noqa: N802
        # SymPy's cbrt has values where a root of a negative number has none.
        base, exponent = self._print(expr.base), expr.exp
        if exponent == -1:
            return f"1.0/{self.parenthesize(expr.base, PRECEDENCE['Pow'])}"
        if exponent.is_Rational and exponent.q == 2:
            root = f"sqrt({base})"
            return root if exponent.p == 1 else f"pow({root}, {int(exponent.p)})"
        return f"pow({base}, {self._print(exponent)})"


class ModelicaPrinter(_Printed, StrPrinter):
    """Formulas in Modelica 3."""

    def _print_Pow(self, expr, rational=False):  # noqa: N802
        if expr.exp.is_Rational and expr.exp.q == 2:
            root = f"sqrt({self._print(expr.base)})"
            return root if expr.exp.p == 1 else f"{root}^({int(expr.exp.p)})"
        base, exponent = self.parenthesize(expr.base, PRECEDENCE["Atom"], strict=True), self._print(expr.exp)
        return f"{base}^{exponent}" if expr.exp.is_Integer and expr.exp > 0 else f"{base}^({exponent})"

    def _print_Abs(self, expr):  # noqa: N802
        return f"abs({self._print(expr.args[0])})"

    def _print_Heaviside(self, expr):  # noqa: N802
        x, at_zero = map(self._print, expr.args)
        return f"(if {x} > 0 then 1.0 elseif {x} < 0 then 0.0 else {at_zero})"


_ASCII_SIGNS = {
    "±": "+-", "−": "-", "–": "-", "·": "*", "⋅": "*", "×": "*", "°": "deg", "µ": "u", "μ": "u", "Ω": "Ohm", "∞": "inf",
    "≥": ">=", "≤": "<=",
}  # fmt: skip
_RAISED_DIGITS = {"⁻": "-", **{raised: str(k) for k, raised in enumerate("⁰¹²³⁴⁵⁶⁷⁸⁹")}}


def distinct(wanted: Sequence[str], taken: Iterable[str]) -> list[str]:
    """Return names that differ from each other and from those that are taken, by underscores at their ends."""
    used, names = set(taken), []
    for name in wanted:
        while name in used:
            name = f"{name}_"
        used.add(name)
        names.append(name)
    return names


def identifiers(names: Sequence[str], reserved: Collection[str]) -> dict[str, str]:
    """Return an identifier of ASCII letters, digits and underscores for each name; the name itself if it is one.

    None is one of `reserved`: words of the language, and names that the program uses itself.
    """
    plain = {}
    for name in names:
        word = re.sub(r"\W", "_", "".join(map(_letter, name)), flags=re.ASCII)
        # Names that start with an underscore belong to compilers.
        plain[name] = word if re.match("[A-Za-z]", word) else f"v{word}"
    # Those that stay as they are come first, so that no other takes their name.
    order = sorted(names, key=lambda name: plain[name] != name)
    return dict(zip(order, distinct([plain[name] for name in order], reserved), strict=True))


def ascii_text(text: str) -> str:
    """Return text in ASCII, on one line: ± as +-, m² as m^2; a letter without a likeness by its name."""
    text = re.sub("[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+", lambda match: f"^{''.join(_RAISED_DIGITS[c] for c in match[0])}", text)
    return "".join(_ASCII_SIGNS.get(char) or _letter(char) for char in one_line(text))


def one_line(text: str) -> str:
    """Return text on one line, without characters that do not show."""
    return " ".join("".join(c if c.isprintable() or c.isspace() else " " for c in text).split())


def within_c(text: str) -> str:
    """Return text for a comment of C, which cannot end it."""
    # A backslash at the end of a line would join the next one to it, and ??/ is one.
    return ascii_text(text).replace("*/", "* /").replace("/*", "/ *").replace("\\", "/").replace("??", "? ?")


def quoted(text: str) -> str:
    """Return text as a string of Modelica."""
    return '"' + ascii_text(text).replace("\\", "\\\\").replace('"', '\\"') + '"'


def _letter(char: str) -> str:
    if char.isascii():
        return char
    likeness = unicodedata.normalize("NFKD", char).encode("ascii", "ignore").decode()
    if likeness.strip():
        return likeness
    if unicodedata.category(char) == "Zs":
        return " "
    name = unicodedata.name(char, "")
    spoken = re.search(r"LETTER ([A-Z]+)(?: |$)", name)
    word = spoken[1].lower() if spoken else f"u{ord(char):04x}"
    return word.capitalize() if "CAPITAL" in name else word
