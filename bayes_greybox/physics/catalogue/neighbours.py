"""Laws next to a catalogue's: the same product of powers with one exponent higher or lower by one, as odd or even.

A catalogue has x²v and not |x|v. On data that see one orbit the two are nearly the same, and of entries that are nearly
right the nearest one wins however sure the data are that it is not that; its neighbours say whether its form is told.
"""

from collections.abc import Iterable

import sympy

from bayes_greybox.physics.terms import Term

Powers = dict[str, tuple[int, bool]]
"""Degree in each variable, and whether the sign changes with it."""


def neighbours(term: Term, known: Iterable[Term]) -> list[Term]:
    """Neighbouring laws that nothing else stands for, degrees of one and above.

    Args:
        term: A law; one that is no product of whole powers has no neighbours.
        known: Terms that are weighed or in the model anyway.
    """
    own = powers(term.expr)
    if own is None:
        return []
    taken, found = [powers(each.expr) for each in known], []
    for name, (degree, odd) in own.items():
        for other in (degree - 1, degree + 1):
            law = {**own, name: (other, odd)}
            if other >= 1 and law not in taken:
                taken.append(law)
                found.append(Term("*".join(_power(each, *how) for each, how in law.items())))
    return found


def powers(expr: sympy.Expr) -> Powers | None:
    """Degrees and signs of a product of whole powers of variables, their absolute values and signs; else None."""
    found: Powers = {}
    for factor in sympy.Mul.make_args(expr):
        if factor.is_number:
            continue
        base, exponent = factor.as_base_exp()
        inside = base.args[0] if isinstance(base, sympy.Abs | sympy.sign) else base
        if not (isinstance(inside, sympy.Symbol) and exponent.is_Integer and exponent > 0):
            return None
        degree, odd = found.get(inside.name, (0, False))
        degree += 0 if isinstance(base, sympy.sign) else int(exponent)
        found[inside.name] = (degree, odd != (not isinstance(base, sympy.Abs) and bool(exponent % 2)))
    return found


def _power(name: str, degree: int, odd: bool) -> str:
    if odd == bool(degree % 2):
        return name if degree == 1 else f"{name}**{degree}"
    size = f"abs({name})" if degree - odd == 1 else f"abs({name})**{degree - odd}"
    return f"{name}*{size}" if odd else size
