"""Dictionary terms: single candidate effects, and the dictionary Phi(x) that collects them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import InitVar, dataclass, field, replace
from functools import cached_property
from itertools import combinations_with_replacement
from math import comb
from typing import Any

import numpy as np
import sympy
from jaxtyping import Array, Float

from bayes_greybox.physics.formula.expressions import (
    check_expression,
    evaluate,
    namespace,
    parse_expression,
    symbol_names,
)
from bayes_greybox.physics.formula.grammar import MAX_EXPONENT, check_known, check_name
from bayes_greybox.physics.formula.numbers import Named, as_columns
from bayes_greybox.physics.formula.printing import to_latex, to_text
from bayes_greybox.physics.formula.rounding import rounded
from bayes_greybox.running.errors import InputError

from .coefficient import Bounds, Coefficient, coefficient_of_term
from .hidden_states import HiddenState

_MAX_TERMS = 1000
"""Larger polynomial families are a slip in the degree or the variables."""


@dataclass(frozen=True)
class Term:
    """One candidate effect, a column of the dictionary, and what is known of its coefficient.

        Term("y**3", sign="-")             the coefficient is not positive; its size follows the model's prior
        Term("y**3", prior=(-40, 10))      N(-40, 10²) in place of the model's prior; the term is in
        Term("y**3", bounds=(-60, 0))      the one or the other, restricted to an interval
        Term("y**3", fixed=-40)            known and not learned: the term belongs to the simulation

    Coefficients are in your units; see `Coefficient` for how these combine, and for their meaning under each prior.

    Attributes:
        expression: The formula, as text or as a SymPy expression.
        name: Name in tables and figures; by default the formula as written, without blanks.
        unit: The term's unit, where it cannot follow from the columns' (a nonlinear parameter carries one).
        states: Hidden states that the formula uses beside columns, where it has memory; `Program.remembering` gives
            them to a simulation.
        sign: "+" where the coefficient is not negative, "-" where it is not positive.
        prior: Mean and standard deviation of the coefficient.
        fixed: Value of the coefficient.
        bounds: Its least and largest value; None leaves an end open.
        parameter: Name of the parameter of the simulation whose slope the term is, and whose value its coefficient.
        named: The same formula, if it was parsed before, with names for numbers in it. Text is then read only when it
            is asked for: a study evaluates hundreds of terms that differ in a number.
        stated: Sign, prior, fixed and bounds as one; None where nothing is stated.
    """

    expression: str | sympy.Expr
    name: str = ""
    unit: str | None = None
    states: tuple[HiddenState, ...] = ()
    sign: str | None = None
    prior: tuple[float, float] | None = None
    fixed: float | None = None
    bounds: Bounds | None = None
    parameter: str = ""
    named: InitVar[Named | None] = None
    stated: Coefficient | None = field(init=False, repr=False, compare=False)
    _named: Named | None = field(init=False, repr=False, compare=False)

    def __post_init__(self, named: Named | None) -> None:
        """Read the formula and what is stated of its coefficient, and fill in the name."""
        if not isinstance(self.expression, str | sympy.Expr):
            kind = type(self.expression).__name__
            raise InputError(f"A term must be text or a SymPy expression, not {kind}; write for example 'y**2'.")
        name = "".join(self.expression.split()) if isinstance(self.expression, str) else to_text(self.expr)
        # In SymPy's canonical form zero is the number; to ask for more takes longer than to read the formula.
        if named is None and self.expr == 0:
            raise InputError(f"The term {name!r} is zero everywhere; remove it.")
        object.__setattr__(self, "_named", named)
        object.__setattr__(self, "name", self.name or name)
        stated = coefficient_of_term(self.name, self.sign, self.prior, self.fixed, self.bounds)
        object.__setattr__(self, "stated", stated)
        # As plain values: lists, as files have them, cannot be keys.
        for key, plain in (("prior", _plain), ("fixed", float), ("bounds", _plain)):
            value = getattr(self, key)
            object.__setattr__(self, key, None if value is None else plain(value))

    @cached_property
    def expr(self) -> sympy.Expr:
        """The SymPy expression over real symbols."""
        formula = self.expression
        return parse_expression(formula) if isinstance(formula, str) else check_expression(formula)

    @property
    def latex(self) -> str:
        """The formula in LaTeX, without dollar signs."""
        return to_latex(self.expr)

    @property
    def symbols(self) -> tuple[str, ...]:
        """Names of the columns that the term uses, sorted."""
        return symbol_names(self.expr)

    @property
    def text(self) -> str:
        """The formula as text that reads back as the same formula, to the last digit."""
        return to_text(self.expr)

    @property
    def plain(self) -> "Term":
        """The term without what is stated of its coefficient."""
        return self if self.stated is None else replace(self, sign=None, prior=None, fixed=None, bounds=None)

    @cached_property
    def jumps(self) -> bool:
        """True if the term may jump, as sign and heaviside do."""
        formula = self.expr if self._named is None else self._named.formula
        return bool(formula.atoms(sympy.sign, sympy.Heaviside))

    def evaluate(self, columns: Mapping[str, Float[Array | np.ndarray, "..."]]) -> Float[Array | np.ndarray, "..."]:
        """Evaluate the term, in the shape of the columns (see `expressions.evaluate`)."""
        if self._named is None:
            return evaluate(self.expr, columns)
        return evaluate(self._named.formula, {**columns, **as_columns([np.asarray(x) for x in self._named.numbers])})

    def units(self, units: Mapping[str, str]) -> dict[str, str]:
        """Return the units of columns and of the term's hidden states."""
        return {**units, **{state.name: units.get(state.unit_of, "") for state in self.states}}

    def rounded(self, columns: Mapping[str, Float[np.ndarray, " n"]]) -> "Term":
        """Return the term with its jumps rounded, as an integrator needs it (see `rounding.rounded`)."""
        smooth = rounded(self.expr, columns)
        return self if smooth is self.expr else replace(self, expression=smooth)


@dataclass(frozen=True)
class Dictionary:
    """The candidate terms of one equation, Phi(x) = [phi_1(x), ..., phi_K(x)].

    Build it with `Dictionary.of`, which checks the terms against the columns and each other.

    Attributes:
        terms: The terms, in order.
        parts: Dictionaries by learned state, in the order of the terms, where this one joins those of several states.
    """

    terms: tuple[Term, ...]
    parts: tuple[tuple[str, "Dictionary"], ...] = ()

    @classmethod
    def joined(cls, parts: Mapping[str, "Dictionary"]) -> "Dictionary":
        """Join the dictionaries of several learned states; a term of the state x is called "x: x*y" in it."""
        terms = [replace(term, name=f"{state}: {term.name}") for state, part in parts.items() for term in part.terms]
        return cls(tuple(terms), tuple(parts.items()))

    def rounded(self, columns: Mapping[str, Float[np.ndarray, " n"]]) -> "Dictionary":
        """Return the dictionary with jumps of its terms rounded, as an integrator needs them."""
        parts = tuple((state, part.rounded(columns)) for state, part in self.parts)
        return Dictionary(tuple(term.rounded(columns) for term in self.terms), parts)

    @property
    def acts_on(self) -> tuple[str, ...]:
        """Learned state to whose rate each term adds, where there are several states; else empty."""
        return tuple(state for state, part in self.parts for _ in part.terms)

    @classmethod
    def of(cls, spec: object, names: Iterable[str]) -> "Dictionary":
        """Collect terms and check them.

        Args:
            spec: A formula, a `Term`, a SymPy expression, a `Dictionary`, or a sequence of these, in which
                sequences such as the result of `polynomial` may be nested one level deep.
            names: Names of the columns that terms may use.

        Returns:
            The dictionary, with the terms in the order given.

        Raises:
            InputError: There are no terms; two terms are equal up to a constant factor, or have one name; a term uses
                an unknown column.
        """
        names = tuple(check_name(name) for name in names)
        terms = terms_of(spec)
        if not terms:
            raise InputError("A dictionary has no terms; give at least one, such as 'y'.")
        first_by_form: dict[sympy.Expr, str] = {}
        for term in terms:
            check_known(term.symbols, names, term.name)
            form = _canonical(term.expr)
            if form in first_by_form:
                raise InputError(
                    f"The terms {first_by_form[form]!r} and {term.name!r} are the same up to a constant "
                    "factor; remove one of them."
                )
            if term.name in first_by_form.values():
                raise InputError(f"Two terms have the name {term.name!r}; give one of them another name.")
            first_by_form[form] = term.name
        return cls(terms)

    def __len__(self) -> int:
        """Number of terms, K."""
        return len(self.terms)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the terms, in order."""
        return tuple(term.name for term in self.terms)

    @property
    def latex(self) -> tuple[str, ...]:
        """Formulas of the terms in LaTeX, in order."""
        return tuple(term.latex for term in self.terms)

    @property
    def symbols(self) -> tuple[str, ...]:
        """Names of the columns that any term uses, sorted."""
        return tuple(sorted({name for term in self.terms for name in term.symbols}))

    @property
    def jumping(self) -> tuple[int, ...]:
        """Indices of the terms that may jump."""
        return tuple(i for i, term in enumerate(self.terms) if term.jumps)

    def evaluate(
        self, columns: Mapping[str, Float[Array | np.ndarray, "*rows"]]
    ) -> Float[Array | np.ndarray, "*rows n_term"]:
        """Return the dictionary matrix Phi: values of the terms along a new last axis, on columns of one shape.

        Raises:
            InputError: A column is missing.
        """
        return namespace(columns.values()).stack([term.evaluate(columns) for term in self.terms], axis=-1)


def polynomial(
    variables: str | Sequence[str], degree: int, interactions: bool = True, constant: bool = False
) -> tuple[Term, ...]:
    """Return all monomials of the variables up to a degree, lowest degree first.

    Args:
        variables: Column names; their order decides the order of the terms.
        degree: Largest total degree, at least 1.
        interactions: If true, products of different variables are included.
        constant: If true, the constant term 1 comes first.

    Returns:
        The terms, for example y, ydot, y**2, y*ydot, ydot**2.

    Raises:
        InputError: No variables, a repeated one, a degree below 1, or more than 1000 terms.
    """
    names = (variables,) if isinstance(variables, str) else tuple(variables)
    names = tuple(check_name(name) for name in names)
    if not names or len(set(names)) < len(names):
        raise InputError(f"polynomial needs distinct variables, not {list(names)}; list each column once.")
    if isinstance(degree, bool) or not isinstance(degree, int) or not 1 <= degree <= MAX_EXPONENT:
        raise InputError(f"polynomial needs a whole degree between 1 and {MAX_EXPONENT}, not {degree!r}; 3 is usual.")
    count = comb(len(names) + degree, degree) if interactions else len(names) * degree
    if count > _MAX_TERMS:
        raise InputError(
            f"polynomial of degree {degree} in {len(names)} variables has {count} terms; {_MAX_TERMS} is the "
            "limit: lower the degree or turn interactions off."
        )
    terms = [Term("1")] if constant else []
    for total in range(1, degree + 1):
        for factors in combinations_with_replacement(names, total):
            if interactions or len(set(factors)) == 1:
                powers = {name: factors.count(name) for name in factors}
                terms.append(Term("*".join(name if n == 1 else f"{name}**{n}" for name, n in powers.items())))
    return tuple(terms)


def terms_of(spec: object) -> tuple[Term, ...]:
    """Read terms as `Dictionary.of` does, without checking them against columns or each other."""
    # Nested sequences are opened one level deep.
    return tuple(_as_term(item) for part in _items(spec) for item in _items(part))


def stating(spec: object) -> tuple[Term, ...]:
    """Return the terms of a term list that state something of their coefficients; formulas are not read."""
    if isinstance(spec, str | sympy.Expr | Mapping) or not isinstance(spec, Iterable | Term | Dictionary):
        return ()
    items = _items(spec)
    nested = [each if isinstance(each, Term | Dictionary | list | tuple) else () for each in items]
    return tuple(t for each in nested for t in _items(each) if isinstance(t, Term) and t.stated is not None)


def _plain(pair: Iterable[float | None]) -> tuple[float | None, ...]:
    return tuple(None if value is None else float(value) for value in pair)


def _items(spec: object) -> list[object]:
    if isinstance(spec, Dictionary):
        return list(spec.terms)
    if isinstance(spec, str | Term | sympy.Expr):
        return [spec]
    if isinstance(spec, Mapping) or not isinstance(spec, Iterable):
        raise InputError(
            f"A dictionary is a list of formulas or terms, not {type(spec).__name__}; write ['y', 'y**2']."
        )
    return list(spec)


def _as_term(item: object) -> Term:
    if isinstance(item, str | sympy.Expr):
        return Term(item)
    if not isinstance(item, Term):
        raise InputError(
            f"A term must be a formula, a Term or a SymPy expression, not {type(item).__name__} "
            f"({str(item)[:40]!r}); write for example 'y**2'."
        )
    return item


def _canonical(expr: Any) -> Any:
    """Return one form for all expressions that are equal up to a constant factor."""
    # Decimals as exact fractions: ratios such as 0.1/0.1 are then the whole number 1.
    expr = expr.xreplace({f: sympy.Rational(repr(float(f))) for f in expr.atoms(sympy.Float)})
    exponents = [power.exp for power in expr.atoms(sympy.Pow) if isinstance(power.base, sympy.Add)]
    # Large powers of sums are left as they are: expanding them could take minutes.
    if all(exponent.is_number and abs(float(exponent)) <= 8 for exponent in exponents):
        expr = sympy.expand(expr)
    if isinstance(expr, sympy.Add):
        first: Any = expr.as_ordered_terms()[0]
        expr = sympy.expand(expr / first.as_coeff_Mul()[0])
    return expr.as_coeff_Mul()[1]
