"""Learned equations in LaTeX."""

import re

from bayes_greybox.equations.learned import LearnedSystem
from bayes_greybox.physics.formula.grammar import symbol
from bayes_greybox.physics.formula.printing import to_latex

from .pieces import Piece, pieces

_POWER_DIGITS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


def equations_latex(system: LearnedSystem) -> str:
    """Return all equations of the model, also those of the simulation alone, in an `aligned` environment."""
    rows = [f"{left_latex(system, name)} &= {right_latex(system, name)}" for name in system.names]
    return "\n".join([r"\begin{aligned}", " \\\\\n".join(rows), r"\end{aligned}"])


def left_latex(system: LearnedSystem, name: str) -> str:
    r"""Return the left-hand side: \frac{\mathrm{d} \dot{y}}{\mathrm{d} t} of a state, an output as it is."""
    shown = to_latex(symbol(name))
    if system.is_output(name):
        return shown
    gap = r"\, " if shown.startswith(r"\mathrm") else ""
    return rf"\frac{{\mathrm{{d}} {gap}{shown}}}{{\mathrm{{d}} {to_latex(symbol(system.data.time_name))}}}"


def right_latex(system: LearnedSystem, name: str) -> str:
    """Return the right-hand side: simulation, terms with coefficients, and f where it is left."""
    text = "".join(f" {'-' if piece.negative else '+'} {_piece(piece)}" for piece in pieces(system, name))
    return text.removeprefix(" + ").strip() or "0"


def _piece(piece: Piece) -> str:
    words = []
    if piece.factor is not None:
        words.append(piece.factor.digits + (rf" \cdot 10^{{{piece.factor.power}}}" if piece.factor.power else ""))
        if piece.given:
            words.append(r"\,(\mathrm{given})\,")
        if piece.unit:
            words.append(rf"\,[\mathrm{{{_unit(piece.unit)}}}]\,")
    if piece.expr is not None:
        shown = to_latex(piece.expr)
        if words and not piece.unit and shown.startswith(r"\mathrm"):
            words.append(r"\,")
        words.append(rf"\left({shown}\right)" if piece.bracketed else shown)
    return " ".join(words)


def _unit(unit: str) -> str:
    raised = re.sub("[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+", lambda match: f"^{{{match[0].translate(_POWER_DIGITS)}}}", unit)
    return raised.replace("%", r"\%").replace(" ", r"\ ").replace("·", r"\cdot ")
