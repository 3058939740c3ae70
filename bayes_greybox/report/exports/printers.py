"""Formulas in Python with NumPy, in C and in Modelica: SymPy's printers, where they say what the package computes.

Numbers have all their digits, roots of negative numbers are none, and sign(0) is 0.
"""

from collections.abc import Mapping
from functools import reduce
from types import MappingProxyType
from typing import Any

from sympy.printing.c import C99CodePrinter
from sympy.printing.numpy import NumPyPrinter
from sympy.printing.precedence import PRECEDENCE
from sympy.printing.str import StrPrinter

LARGEST_INTEGER = 2**31
"""Whole numbers from here on are written as decimals."""


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
        return str(int(expr)) if abs(int(expr)) < LARGEST_INTEGER else repr(float(expr))

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
