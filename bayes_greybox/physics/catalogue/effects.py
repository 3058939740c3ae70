"""Catalogue of physical effects: what a simulation may lack, in roles, and how it becomes a term of the data.

A role, such as position, is a column by its physical meaning. The packaged files stand beside this one, one for each
domain; users write their own in the same layout (see `effect_tables`).
"""

import math
import os
import re
import tomllib
import unicodedata
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import sympy
from jaxtyping import Float, Int

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.toml_files import read_toml
from bayes_greybox.physics.formula.expressions import parse_expression, symbol_names
from bayes_greybox.physics.formula.grammar import check_name
from bayes_greybox.physics.formula.printing import to_latex
from bayes_greybox.physics.hidden_states import HiddenState
from bayes_greybox.physics.terms import Term

from .effect_tables import effect_tables, keys_of, nearest

DOMAINS = ("mechanical", "fluid", "population", "electrical")
"""Catalogues that come with the package."""

SCALES = {
    "size": "the largest |{}|",
    "period": "the period of a wave with the spread of {} and of its rate",
    "frequency": "the angular frequency of a wave with the spread of {} and of its rate",
}
"""What the range of an inner parameter may be in shares of, in words with the role."""

_SLUG = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
_NAME = re.compile(r"(?<![\w.])[^\W\d]\w*")


@dataclass(frozen=True)
class InnerParameter:
    """A constant inside an effect's expression, such as the gap of a dead zone.

    Its prior is log-uniform between two shares of what `scale` says of a column: by default the largest absolute value
    that it takes.

    Attributes:
        name: Its name in the expression.
        meaning: What it is, in a few words.
        of: Role whose column scales it.
        low, high: Smallest and largest share.
        unit_of: Role whose unit it carries; "" for a plain number; None: that of `of`.
        scale: One of `SCALES`.
        values: How many values are tried first: as many as a resonance needs that its frequency is not missed.
    """

    name: str
    meaning: str
    of: str
    low: float
    high: float
    unit_of: str | None = None
    scale: str = "size"
    values: int = 8

    def __post_init__(self) -> None:
        """Refuse a name that formulas cannot use and a range without a log-uniform prior."""
        if self.unit_of is None:
            object.__setattr__(self, "unit_of", self.of)
        check_name(self.name)
        if self.scale not in SCALES:
            raise InputError(
                f"The inner parameter {self.name!r} has scale = {self.scale!r}; {nearest(self.scale, [*SCALES])}"
            )
        if not 0.0 < self.low < self.high < math.inf:
            raise InputError(
                f"The inner parameter {self.name!r} has low = {self.low:g} and high = {self.high:g}; they are shares "
                f"of {self.scaled_by} with 0 < low < high."
            )

    @property
    def scaled_by(self) -> str:
        """What the range is in shares of, in words."""
        return SCALES[self.scale].format(self.of)

    def size(
        self, x: Float[np.ndarray, " n"], time: Float[np.ndarray, " n"] | None, run: Int[np.ndarray, " n"] | None
    ) -> float:
        """What the range is in shares of; 0 where that is nothing.

        Args:
            x: The column of `of`.
            time: Of its values, where a time scale asks for it.
            run: Of its values, likewise.
        """
        if self.scale == "size":
            return float(np.max(np.abs(x)))
        if time is None or run is None:
            return 0.0
        step, moved = np.diff(time), np.diff(x)
        within = (np.diff(run) == 0) & (step > 0)
        speed = float(np.sqrt(np.sum(moved[within] ** 2 / step[within]) / max(float(np.sum(step[within])), 1e-300)))
        # By time, as lines between samples: runs that are padded or cut count for as long as they are.
        weight = step[within] / max(float(np.sum(step[within])), 1e-300)
        first, last = x[:-1][within], x[1:][within]
        mean = float(weight @ (first + last)) / 2
        first, last = first - mean, last - mean
        spread = math.sqrt(float(weight @ (first**2 + first * last + last**2)) / 3)
        if not (speed > 0 and spread > 0):
            return 0.0
        return 2 * math.pi * spread / speed if self.scale == "period" else speed / spread

    def nodes(
        self, scale: float, count: int | None = None
    ) -> tuple[Float[np.ndarray, " node"], Float[np.ndarray, " node"]]:
        """Values that stand for the prior: the middles of parts of equal probability.

        Args:
            scale: What `size` says of the column of `of`.
            count: Number of values; `values` by default.

        Returns:
            The values, increasing, in that unit; and their prior weights, which add up to one.

        Raises:
            InputError: A scale that is not positive and finite, or no values.
        """
        if not 0.0 < scale < math.inf:
            raise InputError(
                f"{self.name} is a share of {self.scaled_by}, which is {scale:g} on the data; leave the effect out."
            )
        count = self.values if count is None else count
        if count < 1:
            raise InputError(f"{self.name} needs at least one value, not {count}.")
        share = (np.arange(count) + 0.5) / count
        # log value = log low + share (log high - log low)
        return scale * self.low * (self.high / self.low) ** share, np.full(count, 1.0 / count)


@dataclass(frozen=True)
class Effect:
    """A physical effect, written in roles.

    Attributes:
        slug: Short name for tables and files, such as "dead-zone".
        name: Plain name.
        domain: Catalogue that it belongs to.
        expression: Formula over roles, the inner parameter and the hidden states.
        inner: Its inner parameter, if it has one.
        hidden: Hidden states, by whose rates it remembers; none of an effect without memory.
        meaning: What happens physically, in one sentence.
        latex: The formula in LaTeX, in customary symbols; by default in the names of the roles.
        confusions: Slugs of effects that look alike on many data.
        sign: Sign of its coefficient in the equation of the rate when it dissipates, restores or does what its
            meaning says; 0 if either is as ordinary.
        reverse: What the other sign would mean physically, in a few words; "" where `sign` is 0.
        nominal: Role whose coefficient in the simulation its own is about as large as, as that of an input which acts
            late; "" where nothing is known of it.
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
    roles: tuple[str, ...] = field(init=False)
    expr: sympy.Expr = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Read the formula, find its roles and check what belongs to it."""
        if not _SLUG.fullmatch(self.slug):
            raise InputError(f"The slug {self.slug!r} must be small letters, digits and '-', such as 'dead-zone'.")
        _check_sign(self)
        # Names are replaced in the text later, so it must be spelled as its parts were read.
        object.__setattr__(self, "expression", unicodedata.normalize("NFC", self.expression))
        expr = parse_expression(self.expression)
        if expr.is_zero:
            raise InputError(f"The expression {self.expression!r} is zero everywhere; remove the effect.")
        if len(self.inner) > 1:
            raise InputError(
                f"{self.slug!r} has {len(self.inner)} inner parameters; one at most can be integrated over."
            )
        hidden = tuple(replace(state, rate=unicodedata.normalize("NFC", state.rate)) for state in self.hidden)
        object.__setattr__(self, "hidden", hidden)
        names = {*symbol_names(expr), *(name for state in hidden for name in state.symbols)}
        own = {part.name for part in (*self.inner, *hidden)}
        used = names - own
        if hidden:
            # An effect without memory is a function of its roles alone; the rest only says how large things are.
            used |= {role for part in (*self.inner, *hidden) if (role := getattr(part, "of", part.unit_of))}
        roles = tuple(sorted(used))
        if self.nominal and self.nominal not in roles:
            raise InputError(
                f"The effect {self.slug!r} has nominal = {self.nominal!r}, which is no role of it; its roles: "
                f"{', '.join(roles) or 'none'}."
            )
        _check_hidden(self, names)
        for inner in self.inner:
            if inner.name not in names:
                raise InputError(f"The inner parameter {inner.name!r} does not occur in {self.expression!r}.")
            for role in (inner.of, inner.unit_of or inner.of):
                if role not in roles:
                    raise InputError(
                        f"The inner parameter {inner.name!r} refers to {role!r}, which is no role of "
                        f"{self.expression!r}; its roles: {', '.join(roles) or 'none'}."
                    )
        object.__setattr__(self, "roles", roles)
        object.__setattr__(self, "expr", expr)
        object.__setattr__(self, "latex", self.latex or to_latex(expr))

    def bind(self, names: Mapping[str, str]) -> "BoundEffect":
        """Put columns in the place of roles.

        Args:
            names: Column of each role; roles that the effect does not use are passed over.

        Returns:
            The effect on these columns.

        Raises:
            InputError: A role without a column, a column for two roles, or a name that formulas cannot use.
        """
        lacking = [role for role in self.roles if role not in names]
        if lacking:
            raise InputError(f"The effect {self.slug!r} needs a column for the role {lacking[0]!r}.")
        columns = {role: check_name(names[role]) for role in self.roles}
        if len(set(columns.values())) < len(columns):
            listed = ", ".join(f"{role}: {column}" for role, column in columns.items())
            raise InputError(f"The effect {self.slug!r} needs a column of its own for every role, not {listed}.")
        return BoundEffect(self, columns)

    def either_way(self) -> "Effect":
        """The effect without a usual sign, where nobody knows which way what was measured counts."""
        return replace(self, sign=0, reverse="")


@dataclass(frozen=True)
class BoundEffect:
    """An effect on columns of the data.

    Attributes:
        effect: The effect.
        names: Column of each of its roles.
    """

    effect: Effect
    names: Mapping[str, str] = field(hash=False)

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
        """The effect as a term of a dictionary.

        Args:
            inner: Value of the inner parameter by its name, if the effect has one.

        Returns:
            The term, with the full value in its expression and four digits of it in its name.

        Raises:
            InputError: A value that is missing, unknown, or not positive and finite.
        """
        values = inner or {}
        known = {parameter.name for parameter in self.effect.inner}
        if set(values) != known:
            wanted = f"a value of {', '.join(known)}" if known else "no values"
            raise InputError(f"The effect {self.slug!r} takes {wanted}, not {', '.join(values) or 'none'}.")
        for name, value in values.items():
            if not 0.0 < value < math.inf:
                raise InputError(f"{name} of the effect {self.slug!r} is {value:g}; it must be positive and finite.")
        exact = {name: repr(float(value)) for name, value in values.items()}
        states = tuple(
            HiddenState(
                self._hidden[state.name], self._written(state.rate, exact), self.names[state.unit_of], state.meaning
            )
            for state in self.effect.hidden
        )
        name = "".join(self.text(values).split())
        return Term(self._written(self.effect.expression, exact), name=name, states=states)

    def text(self, inner: Mapping[str, float] | None = None) -> str:
        """The formula over columns, for readers: the inner parameter with four digits, or by name if not given."""
        return self._written(self.effect.expression, _short(inner))

    def hidden(self, inner: Mapping[str, float] | None = None) -> dict[str, str]:
        """Rates of its hidden states by their names, for readers as `text` is."""
        return {self._hidden[state.name]: self._written(state.rate, _short(inner)) for state in self.effect.hidden}

    @cached_property
    def _hidden(self) -> dict[str, str]:
        """Names of hidden states, none of which another effect has."""
        end = "_".join((self.slug.replace("-", "_"), *dict.fromkeys(self.names.values())))
        return {state.name: f"{state.name}_{end}" for state in self.effect.hidden}

    def _written(self, formula: str, numbers: Mapping[str, str]) -> str:
        # All names at once: a column may well be called as a role or an inner parameter is.
        words = {**self.names, **self._hidden, **numbers}
        return _NAME.sub(lambda match: words.get(match.group(), match.group()), formula)


def _short(inner: Mapping[str, float] | None) -> dict[str, str]:
    return {name: f"{value:.4g}" for name, value in (inner or {}).items()}


CatalogueSpec = str | os.PathLike[str] | Effect | Sequence[str | os.PathLike[str] | Effect]
"""What `load_catalogue` takes."""


def load_catalogue(spec: CatalogueSpec) -> tuple[Effect, ...]:
    """Read a catalogue.

    Args:
        spec: A domain ("mechanical", "fluid", "population" or "electrical"), "all", the path of a TOML file
            of the user's own, an `Effect`, or a sequence of these.

    Returns:
        The effects in order, each slug once.

    Raises:
        InputError: An unknown domain, a file that cannot be read or used, two different effects with one
            slug, a confusion with an unknown effect, or no effects at all.
    """
    effects: dict[str, Effect] = {}
    for effect in _each(spec):
        known = effects.setdefault(effect.slug, effect)
        # Some effects, such as a gain of the input, belong to several domains, each with look-alikes of its own.
        if known is not effect and replace(known, domain=effect.domain, confusions=effect.confusions) != effect:
            raise InputError(
                f"Two different effects have the slug {effect.slug!r} (in {known.domain} and {effect.domain}); "
                "rename one of them."
            )
        if known.confusions != effect.confusions:
            both = dict.fromkeys((*known.confusions, *effect.confusions))
            effects[effect.slug] = replace(known, confusions=tuple(both))
    if not effects:
        raise InputError(f"The catalogue is empty; give one of {', '.join(DOMAINS)}, 'all' or a TOML file.")
    _check_confusions(effects)
    return tuple(effects.values())


def _each(spec: Any) -> Iterator[Effect]:
    if isinstance(spec, Effect):
        yield spec
    elif isinstance(spec, str) and spec in (*DOMAINS, "all"):
        for domain in DOMAINS if spec == "all" else (spec,):
            yield from _packaged(domain)
    elif isinstance(spec, str | os.PathLike):
        yield from _own(spec)
    elif isinstance(spec, Sequence):
        for part in spec:
            yield from _each(part)
    else:
        raise InputError(
            f"A catalogue is a domain ({', '.join(DOMAINS)}), 'all', the path of a TOML file, an Effect or a list of "
            f"these, not {type(spec).__name__}."
        )


@cache
def _packaged(domain: str) -> tuple[Effect, ...]:
    file = resources.files(__package__ or "").joinpath(f"{domain}.toml")
    return _effects(tomllib.loads(file.read_text(encoding="utf-8")), domain)


def _own(path: str | os.PathLike[str]) -> tuple[Effect, ...]:
    given = Path(path)
    if isinstance(path, str) and not given.suffix and given.name == path and not given.exists():
        raise InputError(
            f"There is no catalogue {path!r}: {nearest(path, [*DOMAINS, 'all'])} Or give the path of a TOML file."
        )
    content = read_toml(given, "catalogue")
    try:
        return _effects(content, given.stem)
    except InputError as error:
        raise InputError(f'"{path}": {error}') from None


def _effects(content: Mapping[str, Any], domain: str) -> tuple[Effect, ...]:
    # The domain is the whole file's, and the name of an inner parameter or a hidden state that of its table.
    parts = {"inner": keys_of(InnerParameter, "name"), "hidden": keys_of(HiddenState, "name")}
    tables = effect_tables(content, keys_of(Effect, "domain"), parts)
    return tuple(_effect(table, content.get("domain", domain)) for table in tables)


def _effect(table: dict[str, Any], domain: str) -> Effect:
    try:
        inner = tuple(InnerParameter(**item) for item in table["inner"])
        hidden = tuple(HiddenState(**item) for item in table["hidden"])
        confusions = tuple(table["confusions"])
        return Effect(**{**table, "domain": domain, "inner": inner, "hidden": hidden, "confusions": confusions})
    except InputError as error:
        raise InputError(f"effect {table['slug']!r}: {error}") from None


def _check_sign(effect: Effect) -> None:
    if isinstance(effect.sign, bool) or effect.sign not in (-1, 0, 1):
        raise InputError(
            f"The effect {effect.slug!r} has sign = {effect.sign!r}; it is -1, 1 or, if the coefficient may as well be "
            "of either sign, 0."
        )
    if effect.reverse and not effect.sign:
        raise InputError(
            f"The effect {effect.slug!r} says what the reverse sign would mean, but not which sign is the usual one: "
            "write sign = -1 or sign = 1."
        )


def _check_hidden(effect: Effect, names: Collection[str]) -> None:
    own = [part.name for part in (*effect.inner, *effect.hidden)]
    for state in effect.hidden:
        if own.count(state.name) > 1:
            raise InputError(f"The name {state.name!r} occurs twice in the effect {effect.slug!r}; rename one of them.")
        if state.name not in names:
            raise InputError(
                f"The hidden state {state.name!r} occurs neither in {effect.expression!r} nor in a rate; remove it."
            )
        if not state.unit_of or state.unit_of in own:
            raise InputError(
                f"The hidden state {state.name!r} has unit_of = {state.unit_of!r}; it must be a role, such as "
                "'position'."
            )


def _check_confusions(effects: Mapping[str, Effect]) -> None:
    for effect in effects.values():
        for slug in effect.confusions:
            if slug not in effects:
                known = [*effects, *(entry.slug for domain in DOMAINS for entry in _packaged(domain))]
                if slug not in known:
                    hint = nearest(slug, known)
                    raise InputError(
                        f"The effect {effect.slug!r} has the unknown {slug!r} among its confusions; {hint}"
                    )
