"""Formulas as text that reads back, as LaTeX and as MathML."""

import re
from typing import Any

import sympy
from sympy.printing.conventions import split_super_sub
from sympy.printing.latex import LatexPrinter
from sympy.printing.mathml import MathMLPresentationPrinter
from sympy.printing.pretty.pretty_symbology import greek_unicode
from sympy.printing.str import StrPrinter

from .functions import FUNCTIONS

WORD_GAP = "0.17em"
"""Space between a word and another factor, as TeX's thin space."""


def to_text(expr: sympy.Basic, blanks: bool = False) -> str:
    """Write an expression as text that `parse_expression` reads back, with blanks around signs or without any."""
    text = _TextPrinter().doprint(expr)
    return text if blanks else text.replace(" ", "")


def to_latex(expr: sympy.Basic) -> str:
    r"""Write an expression in LaTeX: `ydot` as \dot{y}, `tank_1` with a subscript, whole words upright."""
    return _FormulaPrinter().doprint(expr)


def to_mathml(expr: sympy.Basic) -> str:
    """Write an expression in MathML without the outer element, names as in LaTeX."""
    return _MathMLPrinter().doprint(expr)


_WORD = r"\\mathrm\{[A-Za-z]+\}(?:_\{[^{}]*\})?(?:\^\{[^{}]*\})?"
"""An upright word in LaTeX with its indices."""


class _TextPrinter(StrPrinter):
    """SymPy's text, with this module's function names."""

    def _print_Function(self, expr):  # noqa: N802
        for name, function in FUNCTIONS.items():
            if isinstance(expr, function.node):
                return f"{name}({', '.join(self._print(a) for a in function.written(expr.args))})"
        return super()._print_Function(expr)

    _print_Abs = _print_Max = _print_Min = _print_Heaviside = _print_Function

    def _print_Float(self, expr):  # noqa: N802
        return repr(float(expr))

    def _print_Exp1(self, expr):  # noqa: N802  # pyright: ignore[reportIncompatibleMethodOverride]
        return "exp(1)"


class _FormulasInExponents:
    """Products whose powers have formulas as exponents, which are printed beforehand.

    SymPy simplifies them to decide on which side of a fraction the powers stand, and may never finish.
    """

    _below = False
    """True if exponents that are products may be printed below the line, which needs no simplification."""

    def __init__(self, *args: Any, **settings: Any) -> None:
        super().__init__(*args, **settings)
        self._printed: dict[str, Any] = {}

    def _with_known_sides(self, product: sympy.Expr) -> sympy.Expr:
        # SymPy prints some powers as if they were products.
        if not isinstance(product, sympy.Mul):
            return product
        known = {}
        for power in product.args:
            exponent = power.args[-1] if isinstance(power, sympy.Pow | sympy.exp) else sympy.Integer(1)
            if exponent.free_symbols and not exponent.is_Symbol and not (self._below and exponent.is_Mul):
                stands = sympy.Symbol(f"exponent {len(self._printed)}", positive=True)
                self._printed[stands.name] = self._print(exponent)  # pyright: ignore[reportAttributeAccessIssue]
                known[power] = power.func(*power.args[:-1], stands, evaluate=False)  # pyright: ignore[reportCallIssue]
        return sympy.Mul(*(known.get(part, part) for part in product.args), evaluate=False) if known else product


class _FormulaPrinter(_FormulasInExponents, LatexPrinter):
    """SymPy's LaTeX, with words upright and H for the step function."""

    def _print_Symbol(self, expr, style="plain"):  # noqa: N802
        if expr.name in self._printed:
            return self._printed[expr.name]
        latex = super()._print_Symbol(expr, style)
        return re.sub(r"^([A-Za-z]{2,})(?=$|[_^])", r"\\mathrm{\1}", latex)

    def _print_Mul(self, expr):  # noqa: N802
        # TeX sets factors without a gap, and two words would be read as one.
        latex = re.sub(r"(?<=[\w})]) (?=\\mathrm\{)", r" \\, ", super()._print_Mul(self._with_known_sides(expr)))
        return re.sub(rf"({_WORD}) (?!\\,)(?=[\\\w])", r"\1 \\, ", latex)

    def _print_Heaviside(self, expr, exp=None):  # noqa: N802
        latex = rf"H\left({self._print(expr.args[0])}\right)"
        return rf"{latex}^{{{exp}}}" if exp else latex


class _MathMLPrinter(_FormulasInExponents, MathMLPresentationPrinter):
    """SymPy's MathML, with dots over letters, words upright, this module's function names and H for the step."""

    _below = True
    _ACCENTS = {"ddot": "\u00a8", "dot": "\u02d9", "hat": "^", "bar": "\u00af", "tilde": "~"}

    def _print_Symbol(self, sym, style="plain"):  # noqa: N802
        if sym.name in self._printed:
            return self._printed[sym.name].cloneNode(True)
        parts: Any = split_super_sub(sym.name)
        name, above, below = parts
        accent = next((a for a in self._ACCENTS if name.endswith(a) and len(name) > len(a)), "")
        shown = self._letters(name.removesuffix(accent))
        if accent:
            shown = self._around("mover", shown, self._text("mo", self._ACCENTS[accent]))
        for tag, words in (("msub", below), ("msup", above)):
            if words:
                shown = self._around(tag, shown, self._letters(" ".join(words)))
        return shown

    def _print_Mul(self, expr):  # noqa: N802
        shown = super()._print_Mul(self._with_known_sides(expr))
        for times in shown.childNodes:
            beside = [each.toxml() for each in (times.previousSibling, times.nextSibling) if each is not None]
            if times.nodeName == "mo" and "Times" in times.toxml() and any("normal" in each for each in beside):
                times.setAttribute("rspace", WORD_GAP)
        return shown

    def _print_Function(self, expr):  # noqa: N802  # pyright: ignore[reportIncompatibleMethodOverride]
        known = {function.node: name for name, function in FUNCTIONS.items() if function.node}
        name = known.get(expr.func)
        called = "H" if name == "heaviside" else name or expr.func.__name__
        head = self._print_Symbol(sympy.Symbol(called))
        args = FUNCTIONS[name].written(expr.args) if name else expr.args
        inside = [self._text("mo", "(")]
        for k, arg in enumerate(args):
            inside += [self._text("mo", ",")] if k else []
            shown: Any = self._print(arg)
            inside.append(shown)
        # U+2061, function application: read aloud as "of".
        brackets = self._around("mrow", *inside, self._text("mo", ")"))
        return self._around("mrow", head, self._text("mo", "\u2061"), brackets)

    _print_Heaviside = _print_Max = _print_Min = _print_sign = _print_Function

    def _print_exp(self, expr):  # noqa: N802
        return self._around("msup", self._letters("e"), self._print(expr.args[0]))

    def _print_Exp1(self, e):  # noqa: N802
        return self._letters("e")

    def _print_Float(self, expr):  # noqa: N802
        mantissa, _, power = repr(float(expr)).partition("e")
        if not power:
            return self._text("mn", mantissa)
        ten = self._around("msup", self._text("mn", "10"), self._text("mn", str(int(power)).replace("-", "\u2212")))
        return self._around("mrow", self._text("mn", mantissa), self._text("mo", "\u00b7"), ten)

    def _letters(self, text):
        text = str(greek_unicode.get(text, text))
        shown = self._text("mi", text)
        if len(text) > 1:
            shown.setAttribute("mathvariant", "normal")
        return shown

    def _text(self, tag, text):
        node = self.dom.createElement(tag)
        node.appendChild(self.dom.createTextNode(text))
        return node

    def _around(self, tag, *inside):
        node = self.dom.createElement(tag)
        for each in inside:
            node.appendChild(each)
        return node
