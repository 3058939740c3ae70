"""Learned equations as text: for people, and as a simulation that reads back."""

import math
from typing import Any

from sympy.core.function import AppliedUndef

from bayes_greybox.equations.learned import LearnedSystem
from bayes_greybox.physics.formula.printing import to_text
from bayes_greybox.report.words.formatting import concise, formula, unit_text

from .pieces import Piece, pieces

NOTATION = "1.23(4) is 1.23 ± 0.04."
"""How a coefficient and its standard deviation are written."""

GIVEN_MARK = "(given)"
"""Stands where the standard deviation of a coefficient would, that was fixed."""

GIVEN_NOTE = "2(given) was given, not estimated."
"""What the mark means."""


def equations_text(system: LearnedSystem) -> str:
    """Return the learned equations, a line each, with inner parameters, and the rule by which terms stand in them."""
    if not system.learned:
        return ""
    lines = [equation_text(system, name) for name in system.shown]
    for name in system.learned:
        lines += [f"  {text}" for text in inner_text(system, name)]
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
    """Return the inner parameters of one equation: `gap = 0.300(5) m (dead-zone)`."""
    lines = []
    for each in system.learned[name].inner:
        negative, size = concise(each.value.mean, each.value.sd)
        unit = unit_text(each.unit)
        text = f"{each.name} = {'−' if negative else ''}{size}{f' {unit}' if unit else ''}"
        lines.append(f"{text} ({each.effect})")
    return lines


def note(system: LearnedSystem) -> str:
    """Return the rule by which terms stand in the equations, and how numbers are written."""
    given = any(piece.given for name in system.shown for piece in pieces(system, name))
    return f"{system.rule} {NOTATION}{f' {GIVEN_NOTE}' if given else ''}"


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
            size = _justified(abs(each.value.mean), each.value.sd)
            factor = _readable(each.term.expr)
            product = f"{size}*({factor})" if each.term.expr.is_Add else f"{size}*{factor}"
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


def _justified(size: float, sd: float) -> str:
    # Without a spread nothing says which digits are idle.
    digits = 10 if not sd > 0 else min(8, max(2, math.ceil(math.log10(max(size, 1e-300) / sd)) + 2))
    return f"{size:.{digits}g}"
