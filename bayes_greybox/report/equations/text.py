"""Learned equations as text, for people and as a simulation that reads back, and their summands, the same for LaTeX."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import sympy
from sympy.core.function import AppliedUndef

from bayes_greybox.equations.learned import LearnedParameter, LearnedSystem, Value
from bayes_greybox.physics.formula.expressions import symbol_names
from bayes_greybox.physics.formula.grammar import symbol
from bayes_greybox.physics.formula.printing import to_text
from bayes_greybox.report.words.formatting import Concise, concise, exact, formula, unit_text

FORMULA_DIGITS = 6
"""Significant digits of numbers within formulas; the mean of a nonlinear parameter has no more that mean anything."""


@dataclass(frozen=True)
class Piece:
    """One summand, sign · coefficient [unit] · formula; without coefficient it is of the simulation or f."""

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


GIVEN_MARK = "(given)"
"""Stands where the standard deviation of a coefficient would, that was fixed."""


def equations_text(system: LearnedSystem) -> str:
    """Return the learned equations, a line each, with nonlinear parameters, and the rule by which terms stand."""
    if not system.learned:
        return ""
    lines = [equation_text(system, name) for name in system.shown]
    for name in system.learned:
        lines += [f"  {text}" for text in inner_text(system, name)]
    lines += [f"  {text}" for text in parameter_text(system)]
    return "\n".join([*lines, note(system)])


def equation_text(system: LearnedSystem, name: str) -> str:
    """Return one equation: `d(v)/dt = F − y − 0.80(2) [1/(m²·s²)] y³ + f`."""
    parts = [("−" if piece.negative else "+", _piece(piece)) for piece in pieces(system, name)]
    if not parts:
        return f"{system.data.target_label(name)} = 0"
    (sign, first), *rest = parts
    start = f"−{first}" if sign == "−" else first
    return " ".join([f"{system.data.target_label(name)} = {start}", *(f"{sign} {text}" for sign, text in rest)])


def inner_text(system: LearnedSystem, name: str) -> list[str]:
    """Return the nonlinear parameters of one equation: `gap = 0.300(5) m (dead-zone)`."""
    return [f"{_valued(each.name, each.value, each.unit)} ({each.effect})" for each in system.learned[name].inner]


def parameter_text(system: LearnedSystem) -> list[str]:
    """Return the named parameters in the shown equations: `m = 2.201(4) kg`, `c = 0.8(given)`."""
    return [_valued(each.name, each.value, each.unit, not each.learned) for each in shown_parameters(system)]


def _valued(name: str, value: Value, unit: str, given: bool = False) -> str:
    negative, size = exact(value.mean) if given else concise(value.mean, value.sd)
    shown = unit_text(unit)
    return f"{name} = {'−' if negative else ''}{size}{GIVEN_MARK if given else ''}{f' {shown}' if shown else ''}"


def shown_parameters(system: LearnedSystem) -> list[LearnedParameter]:
    """Return the parameters in the shown equations."""
    used = {name for each in system.shown for name in symbol_names(system.simulation.own_formula(each))}
    return [each for each in system.parameters if each.name in used]


def note(system: LearnedSystem) -> str:
    """Return the rule by which terms stand in the equations, and how numbers are written."""
    given = any(piece.given for name in system.shown for piece in pieces(system, name))
    given = given or not all(each.learned for each in shown_parameters(system))
    shown = any(each.terms for each in system.learned.values()) or parameter_text(system)
    notation = ["1.23(4) is 1.23 ± 0.04."] if shown else []
    not_learned = ["Numbers marked (given) were not estimated."] if given else []
    return " ".join([*([system.rule] if system.rule else []), *notation, *not_learned])


def as_simulation(system: LearnedSystem) -> str:
    """Return the whole model as the expressions of a configuration's [simulation]; "" where it has code.

    Coefficients are means, with the digits that their standard deviations justify. f is not in it.
    """
    lines = []
    for name in system.names:
        expr = system.simulation.formula(name)
        if expr.atoms(AppliedUndef):
            return ""
        text = "" if expr == 0 else _readable(expr)
        for each in system.learned[name].terms if name in system.learned else ():
            size, sd = abs(each.value.mean), each.value.sd
            # Without a spread nothing says which digits are idle.
            digits = 10 if not sd > 0 else min(8, max(2, math.ceil(math.log10(max(size, 1e-300) / sd)) + 2))
            factor = _readable(each.term.expr)
            product = f"{size:.{digits}g}*{f'({factor})' if each.term.expr.is_Add else factor}"
            sign = "-" if each.value.mean < 0 else "+"
            text = f"{text} {sign} {product}" if text else f"{'-' if sign == '-' else ''}{product}"
        lines.append(f'{name} = "{text or 0}"')
    return "\n".join(lines)


def _piece(piece: Piece) -> str:
    words = []
    if piece.factor is not None:
        words = [f"{piece.factor}{GIVEN_MARK if piece.given else ''}", *([f"[{piece.unit}]"] if piece.unit else [])]
    if piece.expr is not None:
        text = _expression(piece.expr)
        words.append(f"({text})" if piece.bracketed else text)
    return " ".join(words)


def _expression(expr: Any) -> str:
    if isinstance(expr, AppliedUndef):
        letter = expr.func.__name__
        return letter if letter.startswith("f") else f"{letter}({', '.join(map(str, expr.args))})"
    return formula(_readable(expr))


def _readable(expr: Any) -> str:
    return to_text(expr, blanks=True)
