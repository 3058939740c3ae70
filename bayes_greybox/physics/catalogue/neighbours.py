"""Laws next to a catalogue's: the same product of powers with one exponent a little higher or lower, as odd or even.

A catalogue has x²v and not |x|v, y|y| and y³ and not what lies between. On data that see one orbit such laws are nearly
the same, and of entries that are nearly right the nearest one wins however sure the data are that it is not that; or
two of them together make the law between. Its neighbours say whether its form is told. A law that bends where an inner
parameter says has no exponents; its neighbours are that law times a power of what it bends with.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache

import sympy

from bayes_greybox.physics.formula.expressions import symbol_names
from bayes_greybox.physics.terms import Term

from .effects import BoundEffect

Powers = Mapping[str, tuple[Fraction, bool]]
"""Degree in each variable, and whether the sign changes with it."""

STEPS = (Fraction(-1), Fraction(-1, 2), Fraction(1, 2), Fraction(1))
"""Changes of an exponent that make a neighbour."""

BETWEEN = Fraction(1, 4)
"""Distance of the exponents between two laws."""


def neighbours(term: Term, known: Iterable[Term]) -> list[Term]:
    """Neighbouring laws that nothing else stands for, degrees of one and above.

    Args:
        term: A law; one that is no product of powers has no neighbours.
        known: Terms that are weighed or in the model anyway.
    """
    own = powers(term.expr)
    if own is None:
        return []
    wanted = [
        {**own, name: (degree + step, odd)}
        for name, (degree, odd) in own.items()
        for step in STEPS
        if degree + step >= 1
    ]
    return _laws(wanted, known)


def between(first: Term, second: Term, known: Iterable[Term]) -> list[Term]:
    """Laws between two that differ in one exponent alone: what the two together may be imitating.

    Args:
        first: A law.
        second: Another one; no laws are between those that differ in sign, in two variables, or in other ways.
        known: Terms that are weighed or in the model anyway.
    """
    one, other = powers(first.expr), powers(second.expr)
    if one is None or other is None or one.keys() != other.keys():
        return []
    apart = [name for name in one if one[name] != other[name]]
    if len(apart) != 1 or one[apart[0]][1] != other[apart[0]][1]:
        return []
    name, odd = apart[0], one[apart[0]][1]
    low, high = sorted((one[name][0], other[name][0]))
    steps = int((high - low) / BETWEEN)
    wanted = [{**one, name: (low + k * BETWEEN, odd)} for k in range(1, steps) if low + k * BETWEEN >= 1]
    return _laws(wanted, known)


@lru_cache(256)
def bent(effect: BoundEffect) -> tuple[BoundEffect, ...]:
    """Laws next to one with inner parameters: times the root of the size of what these are of, and times that size.

    Their inner parameters are free again: where such a law bends is not where the effect would.

    Args:
        effect: Bound to columns.
    """
    own = effect.effect
    used = symbol_names(own.expr)
    roles = [role for role in dict.fromkeys(inner.of for inner in own.inner) if role in used]
    factors = [f"abs({role}){power}" for role in roles for power in ("**0.5", "")]
    plain = replace(own, latex="", confusions=(), sign=0, reverse="", nominal="")
    return tuple(
        BoundEffect(replace(plain, slug=f"{own.slug}-{k}", expression=f"({own.expression})*{factor}"), effect.names)
        for k, factor in enumerate(factors, start=1)
    )


@lru_cache(1024)
def powers(expr: sympy.Expr) -> Powers | None:
    """Degrees and signs of a product of powers of variables, their absolute values and signs; else None."""
    found: dict[str, tuple[Fraction, bool]] = {}
    for factor in sympy.Mul.make_args(expr):
        if factor.is_number:
            continue
        base, exponent = factor.as_base_exp()
        sized = isinstance(base, sympy.Abs | sympy.sign)
        inside = base.args[0] if sized else base
        if not (isinstance(inside, sympy.Symbol) and exponent.is_number and exponent > 0):
            return None
        if not (exponent.is_Integer or isinstance(base, sympy.Abs)):
            return None
        size = Fraction(str(exponent)).limit_denominator(100)
        degree, odd = found.get(inside.name, (Fraction(0), False))
        degree += 0 if isinstance(base, sympy.sign) else size
        found[inside.name] = (degree, odd != (not isinstance(base, sympy.Abs) and bool(size % 2)))
    return found


def _laws(wanted: Iterable[Mapping[str, tuple[Fraction, bool]]], known: Iterable[Term]) -> list[Term]:
    taken, found = [powers(each.expr) for each in known], []
    for law in wanted:
        if law not in taken:
            taken.append(dict(law))
            found.append(Term("*".join(_power(each, *how) for each, how in law.items())))
    return found


def _power(name: str, degree: Fraction, odd: bool) -> str:
    if degree.denominator == 1 and odd == bool(degree % 2):
        return name if degree == 1 else f"{name}**{degree}"
    rest = degree - odd
    size = f"abs({name})" if rest == 1 else f"abs({name})**{rest if rest.denominator == 1 else float(rest)}"
    if not odd:
        return size
    return f"{name}*{size}"
