"""Formulas as text that reads back, and as LaTeX."""

import sympy
from sympy.printing.latex import LatexPrinter
from sympy.printing.str import StrPrinter

from bayes_greybox.physics.formula.functions import FUNCTIONS


def to_text(expr: sympy.Basic) -> str:
    """The expression as text without blanks that `parse_expression` reads back."""
    return _TextPrinter().doprint(expr).replace(" ", "")


def to_latex(expr: sympy.Basic) -> str:
    r"""The expression in LaTeX: `ydot` as \dot{y}, `tank_1` with a subscript, whole words upright."""
    return _FormulaPrinter().doprint(expr)


class _TextPrinter(StrPrinter):
    """SymPy's text, with this module's function names."""

    def _print_Function(self, expr):  # noqa: N802
        for name, function in FUNCTIONS.items():
            if isinstance(expr, function.node):
                return f"{name}({', '.join(self._print(a) for a in function.written(expr.args))})"
        return super()._print_Function(expr)

    _print_Abs = _print_Max = _print_Min = _print_Heaviside = _print_Function

    def _print_LatticeOp(self, expr):  # noqa: N802
        return self._print_Function(expr)

    def _print_Float(self, expr):  # noqa: N802
        return repr(float(expr))

    def _print_Exp1(self, expr):  # noqa: N802  # pyright: ignore[reportIncompatibleMethodOverride]
        return "exp(1)"


class _FormulaPrinter(LatexPrinter):
    """SymPy's LaTeX, with words upright and H for the step function."""

    def _print_Symbol(self, expr, style="plain"):  # noqa: N802
        latex = super()._print_Symbol(expr, style)
        return rf"\mathrm{{{latex}}}" if latex.isalpha() and len(latex) > 1 else latex

    def _print_Heaviside(self, expr, exp=None):  # noqa: N802
        latex = rf"H\left({self._print(expr.args[0])}\right)"
        return rf"{latex}^{{{exp}}}" if exp else latex
