"""Learned equations in LaTeX, and in MathML for pages that fetch nothing.

Browsers draw MathML themselves: letters grow with the reader's, are selected and read aloud, and need no script and no
font from elsewhere, which a picture of LaTeX has none of. Each summand is a formula of its own, so that a long equation
breaks between summands at the width of a phone.
"""

import re
from html import escape

from bayes_greybox.equations.learned import LearnedSystem
from bayes_greybox.physics.formula.grammar import symbol
from bayes_greybox.physics.formula.printing import WORD_GAP, to_latex, to_mathml
from bayes_greybox.report.equations.text import Piece, pieces
from bayes_greybox.report.words.formatting import concise, exact, unit_text


def equations_latex(system: LearnedSystem) -> str:
    """Return all equations of the model, also those of the simulation alone, in an `aligned` environment."""
    rows = [f"{left_latex(system, name)} &= {right_latex(system, name)}" for name in system.names]
    for each in system.parameters:
        negative, size = concise(each.value.mean, each.value.sd) if each.learned else exact(each.value.mean)
        value = _latex(Piece(negative, size, unit_text(each.unit), None, not each.learned))
        rows.append(f"{to_latex(symbol(each.name))} &= {'-' if negative else ''}{value}")
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
    text = "".join(f" {'-' if piece.negative else '+'} {_latex(piece)}" for piece in pieces(system, name))
    return text.removeprefix(" + ").strip() or "0"


def _latex(piece: Piece) -> str:
    words = []
    if piece.factor is not None:
        words.append(piece.factor.digits + (rf" \cdot 10^{{{piece.factor.power}}}" if piece.factor.power else ""))
        if piece.given:
            words.append(r"\,(\mathrm{given})\,")
        if piece.unit:
            digits = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
            unit = re.sub("[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+", lambda match: f"^{{{match[0].translate(digits)}}}", piece.unit)
            unit = unit.replace("%", r"\%").replace(" ", r"\ ").replace("·", r"\cdot ")
            words.append(rf"\,[\mathrm{{{unit}}}]\,")
    if piece.expr is not None:
        shown = to_latex(piece.expr)
        if words and not piece.unit and shown.startswith(r"\mathrm"):
            words.append(r"\,")
        words.append(rf"\left({shown}\right)" if piece.bracketed else shown)
    return " ".join(words)


def equation_mathml(system: LearnedSystem, name: str) -> list[str]:
    """Return one equation as formulas that a line may break between: left-hand side, then each signed summand."""
    shown, d = to_mathml(symbol(name)), '<mi mathvariant="normal">d</mi>'
    if not system.is_output(name):
        time = to_mathml(symbol(system.data.time_name))
        # A word after the d would be read as one with it.
        gap = f'<mspace width="{WORD_GAP}"/>' if "normal" in shown else ""
        shown = f"<mfrac><mrow>{d}{gap}{shown}</mrow><mrow>{d}{time}</mrow></mfrac>"
    formulas = [_math(f"{shown}<mo>=</mo>")]
    for k, piece in enumerate(pieces(system, name)):
        # Without a summand before it a sign belongs to the number: "prefix" keeps it close.
        form = ' form="prefix"' if k == 0 else ' form="infix"'
        sign = f"<mo{form}>−</mo>" if piece.negative else "" if k == 0 else f"<mo{form}>+</mo>"
        formulas.append(_math(sign + _mathml(piece)))
    return formulas if len(formulas) > 1 else [*formulas, _math("<mn>0</mn>")]


def _mathml(piece: Piece) -> str:
    parts = []
    if piece.factor is not None:
        parts.append(f"<mn>{piece.factor.digits}</mn>")
        if piece.factor.power:
            parts.append(f"<mo>·</mo><msup><mn>10</mn><mn>{str(piece.factor.power).replace('-', '−')}</mn></msup>")
        if piece.given:
            parts.append("<mtext>(given)</mtext>")
        if piece.unit:
            parts.append(f"<mtext>\u202f[{escape(piece.unit)}]\u202f</mtext>")
        elif piece.expr is not None:
            parts.append(f'<mspace width="{WORD_GAP}"/>')
    if piece.expr is not None:
        shown = to_mathml(piece.expr)
        parts.append(f"<mrow><mo>(</mo>{shown}<mo>)</mo></mrow>" if piece.bracketed else shown)
    return "".join(parts)


def _math(inside: str) -> str:
    return f'<math displaystyle="true"><mrow>{inside}</mrow></math>'
