"""The summands of a learned equation as they are written, the same for text, LaTeX and MathML."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import sympy
from sympy.core.function import AppliedUndef

from bayes_greybox.equations.learned import LearnedSystem
from bayes_greybox.physics.formula.grammar import symbol
from bayes_greybox.report.words.formatting import Concise, concise, exact, unit_text

FORMULA_DIGITS = 6
"""Significant digits of numbers within formulas; the mean of an inner parameter has no more that mean anything."""


@dataclass(frozen=True)
class Piece:
    """One summand, sign · coefficient [unit] · formula.

    Attributes:
        negative: True if it is subtracted.
        factor: The coefficient's size and standard deviation; None of a part of the simulation, and of f.
        unit: Unit of the coefficient, as people write it; "" for a plain number.
        expr: The formula; None where the coefficient stands alone.
        given: True if the coefficient was given and not estimated.
    """

    negative: bool
    factor: Concise | None
    unit: str
    expr: Any
    given: bool = False

    @property
    def bracketed(self) -> bool:
        """True if the formula is a sum, or has a number of its own beside the coefficient."""
        if self.factor is None or self.expr is None:
            return False
        return bool(self.expr.is_Add) or self.expr.as_coeff_Mul()[0] != 1


def pieces(system: LearnedSystem, name: str) -> Iterator[Piece]:
    """Yield the summands of an equation's right-hand side: simulation, given and learned terms, f."""
    simulated: Any = system.simulation.own_formula(name)
    for part in simulated.as_ordered_terms() if simulated != 0 else ():
        negative = bool(part.could_extract_minus_sign())
        yield Piece(negative, None, "", _short(-part if negative else part, system, name))
    learned = system.learned.get(name)
    if learned is None:
        return
    # A term that is fixed at zero is out.
    given = [each for each in learned.given if each.value.mean != 0]
    for each in (*given, *learned.terms):
        fixed = each in given
        negative, factor = exact(each.value.mean) if fixed else concise(each.value.mean, each.value.sd)
        unit = unit_text(each.unit)
        expr = None if each.term.expr == 1 else _short(each.term.expr)
        yield Piece(negative, factor, unit, expr, fixed)
    f = learned.discrepancy
    if f is not None and f.left:
        yield Piece(False, None, "", _called("f", f.variables, system, name))


def _short(expr: Any, system: LearnedSystem | None = None, name: str = "") -> Any:
    """Return a formula with few digits; code as g(x, u)."""
    if isinstance(expr, AppliedUndef) and system is not None:
        return _called("g", ("x", "u") if system.inputs else ("x",), system, name)
    return expr.xreplace({number: _rounded(float(number)) for number in expr.atoms(sympy.Float)})


def _rounded(number: float) -> sympy.Number:
    """Return a number with few digits; a whole one as an integer, so that a coefficient of one is not written."""
    short = float(f"{number:.{FORMULA_DIGITS}g}")
    return sympy.Integer(int(short)) if short.is_integer() and abs(short) < 10**FORMULA_DIGITS else sympy.Float(short)


def _called(letter: str, arguments: tuple[str, ...], system: LearnedSystem, name: str) -> Any:
    """Return the function f or g, with the equation as its index where there are several."""
    index = f"_{name}" if len(system.shown) > 1 else ""
    return sympy.Function(f"{letter}{index}")(*map(symbol, arguments))
