"""Physical effects that a simulation may lack, written in roles, and how they become terms of the data.

A role, such as position, is the physical meaning of a column. Catalogues of effects are read in `loading`.
"""

import math
import re
import unicodedata
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import sympy

from bayes_greybox.physics.formula.expressions import parse_expression, symbol_names
from bayes_greybox.physics.formula.grammar import check_name, symbol
from bayes_greybox.physics.formula.numbers import Parts, parted
from bayes_greybox.physics.formula.printing import to_latex
from bayes_greybox.physics.hidden_states import HiddenState
from bayes_greybox.physics.terms import Term
from bayes_greybox.running.errors import InputError

from .inner_parameter import MOST_PARAMETERS, InnerParameter

ANSWERS = ("recalibrate", "instrument", "unknown")
"""Slugs that no effect may have: a study without an effect answers with them, in the same tables."""

_SLUG = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
_IDENTIFIER = re.compile(r"(?<![\w.])[^\W\d]\w*")
_INNER_MARK = "#"


@dataclass(frozen=True)
class Effect:
    """A physical effect, written in roles.

    Attributes:
        slug: Short name for tables and files, such as "dead-zone".
        name: Plain name.
        domain: Catalogue that it belongs to.
        expression: Formula over roles, nonlinear parameters and hidden states.
        inner: Its nonlinear parameters.
        hidden: Hidden states of an effect with memory; empty for one without.
        meaning: One sentence that says what happens physically.
        latex: The formula in LaTeX, in customary symbols; by default in the names of the roles.
        confusions: Slugs of effects that look like it on many data.
        sign: Sign of its coefficient in the equation of the rate when it dissipates, restores or does what its meaning
            says; 0 if both signs are usual.
        reverse: A few words that say what the other sign would mean physically; "" where `sign` is 0.
        nominal: Role whose coefficient in the simulation is about as large as the effect's, such as that of an input
            which acts late; "" if none is known.
        family: Name shared by effects that are one answer to a user, such as dry friction; "" where it stands alone.
        roles: Roles that the formula and the rates use, or take units and ranges from, sorted.
        expr: The formula over real symbols.
    """

    slug: str
    name: str
    domain: str
    expression: str
    inner: tuple[InnerParameter, ...] = ()
    hidden: tuple[HiddenState, ...] = ()
    meaning: str = ""
    latex: str = ""
    confusions: tuple[str, ...] = ()
    sign: int = 0
    reverse: str = ""
    nominal: str = ""
    family: str = ""
    roles: tuple[str, ...] = field(init=False)
    expr: sympy.Expr = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Read the formula, find its roles and check what belongs to it."""
        if not _SLUG.fullmatch(self.slug):
            raise InputError(f"The slug {self.slug!r} must be small letters, digits and '-', such as 'dead-zone'.")
        if self.slug in ANSWERS:
            raise InputError(f"The slug {self.slug!r} is reserved for a study's answer; give the effect another one.")
        if isinstance(self.sign, bool) or self.sign not in (-1, 0, 1):
            raise InputError(
                f"The effect {self.slug!r} has sign = {self.sign!r}; it is -1 or 1, or 0 if both signs are usual."
            )
        if self.reverse and not self.sign:
            raise InputError(
                f"The effect {self.slug!r} says what the reverse sign would mean, but not which sign is the usual one: "
                "write sign = -1 or sign = 1."
            )
        # Names are replaced in this text later, so it must be spelled as the parser spells it.
        object.__setattr__(self, "expression", unicodedata.normalize("NFC", self.expression))
        expr = parse_expression(self.expression)
        if expr.is_zero:
            raise InputError(f"The expression {self.expression!r} is zero everywhere; remove the effect.")
        if len(self.inner) > MOST_PARAMETERS:
            raise InputError(
                f"{self.slug!r} has {len(self.inner)} nonlinear parameters; at most {MOST_PARAMETERS} are integrated."
            )
        hidden = tuple(replace(state, rate=unicodedata.normalize("NFC", state.rate)) for state in self.hidden)
        object.__setattr__(self, "hidden", hidden)
        names = {*symbol_names(expr), *(name for state in hidden for name in state.symbols)}
        used = names - {part.name for part in (*self.inner, *hidden)}
        if hidden:
            # Without memory, the formula has all roles; other roles only say how large things are.
            used |= {role for part in (*self.inner, *hidden) if (role := getattr(part, "of", part.unit_of))}
            used |= {state.start for state in hidden if state.start}
        roles = tuple(sorted(used))
        if self.nominal and self.nominal not in roles:
            raise InputError(
                f"The effect {self.slug!r} has nominal = {self.nominal!r}, which is not a role of it; its roles: "
                f"{', '.join(roles) or 'none'}."
            )
        _check_hidden(self, names)
        for inner in self.inner:
            if inner.name not in names:
                raise InputError(f"The nonlinear parameter {inner.name!r} does not occur in {self.expression!r}.")
            for role in (inner.of, inner.unit_of or inner.of):
                if role not in roles:
                    raise InputError(
                        f"The nonlinear parameter {inner.name!r} refers to {role!r}, which is not a role of "
                        f"{self.expression!r}; its roles: {', '.join(roles) or 'none'}."
                    )
        object.__setattr__(self, "roles", roles)
        object.__setattr__(self, "expr", expr)
        object.__setattr__(self, "latex", self.latex or to_latex(expr))

    def bind(self, names: Mapping[str, str]) -> "BoundEffect":
        """Put a column in place of each role; other roles are ignored."""
        lacking = [role for role in self.roles if role not in names]
        if lacking:
            raise InputError(f"The effect {self.slug!r} needs a column for the role {lacking[0]!r}.")
        columns = {role: check_name(names[role]) for role in self.roles}
        if len(set(columns.values())) < len(columns):
            listed = ", ".join(f"{role}: {column}" for role, column in columns.items())
            raise InputError(f"The effect {self.slug!r} needs a column of its own for every role, not {listed}.")
        return BoundEffect(self, columns)

    def either_way(self) -> "Effect":
        """Return the effect without a usual sign, for measurements whose orientation is unknown."""
        return replace(self, sign=0, reverse="")


@dataclass(frozen=True)
class BoundEffect:
    """An effect on columns of the data, by role; a mark in names tells hidden states of several equations apart."""

    effect: Effect
    names: Mapping[str, str] = field(hash=False)
    mark: str = ""

    @cached_property
    def slug(self) -> str:
        """Short name of the effect."""
        return self.effect.slug

    @cached_property
    def label(self) -> str:
        """Short name of the effect with the columns of its roles."""
        return f"{self.slug}({', '.join(f'{role}={column}' for role, column in sorted(self.names.items()))})"

    @property
    def name(self) -> str:
        """Plain name of the effect."""
        return self.effect.name

    def term(self, inner: Mapping[str, float] | None = None) -> Term:
        """Return the effect as a term: all digits of nonlinear parameters in its expression, four in its name."""
        values = inner or {}
        parameters = [parameter.name for parameter in self.effect.inner]
        if set(values) != set(parameters):
            wanted = f"a value of {', '.join(parameters)}" if parameters else "no values"
            raise InputError(f"The effect {self.slug!r} takes {wanted}, not {', '.join(values) or 'none'}.")
        for name, value in values.items():
            if not 0.0 < value < math.inf:
                raise InputError(f"{name} of the effect {self.slug!r} is {value:g}; it must be positive and finite.")
        exact = {name: repr(float(value)) for name, value in values.items()}
        marked = {name + _INNER_MARK: value for name, value in values.items()}
        named, *rates = self._parts.at(marked) if marked else [None] * (1 + len(self.effect.hidden))
        states = []
        for state, rate in zip(self.effect.hidden, rates, strict=True):
            formula, start = self._written(state.rate, exact), self.names.get(state.start, "")
            name, unit_of = self._hidden[state.name], self.names[state.unit_of]
            states.append(HiddenState(name, formula, unit_of, state.meaning, start, named=rate))
        name = "".join(self.text(values).split())
        return Term(self._written(self.effect.expression, exact), name=name, states=tuple(states), named=named)

    def text(self, inner: Mapping[str, float] | None = None) -> str:
        """Write the formula over columns, for readers: nonlinear parameters with four digits, or by name."""
        return self._written(self.effect.expression, _short(inner))

    def hidden(self, inner: Mapping[str, float] | None = None) -> dict[str, str]:
        """Write the rates of its hidden states by their names, for readers, like `text`."""
        return {self._hidden[state.name]: self._written(state.rate, _short(inner)) for state in self.effect.hidden}

    @cached_property
    def _hidden(self) -> dict[str, str]:
        """Names of hidden states, unique to this effect."""
        mark = (self.mark,) if self.mark else ()
        end = "_".join((self.slug.replace("-", "_"), *dict.fromkeys(self.names.values()), *mark))
        return {state.name: f"{state.name}_{end}" for state in self.effect.hidden}

    @cached_property
    def _parts(self) -> Parts:
        """The formula and the rates over columns, read once for all values of nonlinear parameters."""
        formulas = [self.effect.expr, *(parse_expression(state.rate) for state in self.effect.hidden)]
        # All names at once; nonlinear parameters get names that no column has.
        inner = {part.name: part.name + _INNER_MARK for part in self.effect.inner}
        words = {symbol(old): symbol(new) for old, new in {**self.names, **self._hidden, **inner}.items()}
        return parted([each.xreplace(words) for each in formulas], inner.values())

    def _written(self, formula: str, numbers: Mapping[str, str]) -> str:
        # All names at once: a column may have the name of a role or a parameter.
        words = {**self.names, **self._hidden, **numbers}
        return _IDENTIFIER.sub(lambda match: words.get(match.group(), match.group()), formula)


def _short(inner: Mapping[str, float] | None) -> dict[str, str]:
    return {name: f"{value:.4g}" for name, value in (inner or {}).items()}


def _check_hidden(effect: Effect, names: Collection[str]) -> None:
    part_names = [part.name for part in (*effect.inner, *effect.hidden)]
    for state in effect.hidden:
        if part_names.count(state.name) > 1:
            raise InputError(f"The name {state.name!r} occurs twice in the effect {effect.slug!r}; rename one of them.")
        if state.name not in names:
            raise InputError(
                f"The hidden state {state.name!r} occurs neither in {effect.expression!r} nor in a rate; remove it."
            )
        for key, role in (("unit_of", state.unit_of), ("start", state.start or "rest")):
            if not role or role in part_names:
                raise InputError(
                    f"The hidden state {state.name!r} has {key} = {role!r}; it must be a role, such as 'position'."
                )
