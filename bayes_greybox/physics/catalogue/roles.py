"""Roles of the columns of the data in an effect of the catalogue."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product

from bayes_greybox.data.reading.units import registry
from bayes_greybox.physics.formula.expressions import parse_expression
from bayes_greybox.physics.formula.grammar import check_name, symbol
from bayes_greybox.physics.units import parse_unit, term_unit
from bayes_greybox.running.errors import InputError

from .effect_tables import nearest
from .effects import BoundEffect, Effect

ROLES: dict[str, str] = {
    "state": "the state whose equation is learned",
    "input": "an input",
    "position": "the state whose rate is the velocity",
    "velocity": "the state whose equation is learned, or a speed that an output depends on",
    "other_position": "the position of another body",
    "other_velocity": "the velocity of another body",
    "level": "the level of this tank",
    "upstream": "the level of another tank",
    "population": "this population",
    "concentration": "the concentration whose equation is learned",
    "other": "another state, such as another population",
    "voltage": "the voltage whose equation is learned",
    "current": "the current whose equation is learned",
    "flux": "the flux linkage: the state whose rate is this voltage, or the state whose equation is learned",
    "temperature": "the temperature whose equation is learned",
    "surroundings": "another temperature, such as that of the surroundings",
    "absolute_temperature": "the temperature whose equation is learned, in kelvin",
    "absolute_surroundings": "another temperature, in kelvin",
    "grade": "the slope of the road, as an angle: say which column it is",
    "stored": "charge or flux linkage: the state whose rate is this current or voltage",
}
"""Roles of the packaged catalogues and their meaning in the equation of one state."""

_OWN_ROLES = ("state", "level", "population", "concentration", "voltage", "current", "temperature")
"""Roles of the state whose equation is learned."""

_ELECTRICAL_UNITS = {"voltage": ("V",), "current": ("A",), "flux": ("Wb",)}

_ROLE_UNITS = {
    "temperature": ("K",), "surroundings": ("K",), **_ELECTRICAL_UNITS,
    "concentration": ("mol/l", "mol/kg", "kg/m^3", "1/m^3"),
}  # fmt: skip
"""Units of the columns that may play a role; those without a unit may as well."""

_TEMPERATURE_ROLES = (
    "state", "input", "other", "temperature", "surroundings", "absolute_temperature", "absolute_surroundings",
)  # fmt: skip
"""Roles that a temperature plays: it is no speed, no level and no population, though it has a rate as they have."""

_OUTPUT_ROLE_UNITS = {"position": ("m", "rad"), "velocity": ("m/s", "rad/s"), **_ELECTRICAL_UNITS}
"""Roles that a column of such a unit plays in the equation of an output."""


@dataclass(frozen=True)
class Columns:
    """Names of the columns of the data, and their units.

    A voltage, current, flux, concentration or temperature in a unit of something else is none, and a temperature may
    only be a state, an input, another state, or what thermal effects ask for.
    """

    states: Sequence[str]
    inputs: Sequence[str]
    outputs: Sequence[str] = ()
    units: Mapping[str, str] = field(default_factory=dict)


def roles_of(
    simulation: Mapping[str, str] | Callable | None, columns: Columns, equation: str,
    given: Mapping[str, str | Sequence[str]] | None = None, pairs: Mapping[str, str] | None = None,
) -> dict[str, tuple[str, ...]]:  # fmt: skip
    """Return the columns, if any, that may play each role in the equation of one state or output.

    In the equation of an output no state is learned: columns play the roles that their units indicate, and so do a
    position and its velocity.

    Args:
        simulation: The user's simulation, formulas by state or output.
        columns: States, inputs and outputs of the data, and their units.
        equation: The state or output whose equation is learned.
        given: Column or columns by role, which take precedence; further roles are welcome, and an empty sequence
            switches a role off.
        pairs: States whose rate is another state, with that state, as `pairs.pairs_in_data` finds them; by default
            those whose formula is another state and nothing else, `{"y": "ydot"}`.
    """
    states, inputs, units = columns.states, columns.inputs, columns.units
    given = _checked(given or {}, (*states, *inputs))
    pairs = _positions(simulation, states) if pairs is None else pairs
    if equation in columns.outputs:
        return _of_output(columns, given, pairs)
    if equation not in states:
        raise InputError(
            f"There is no state {equation!r} whose equation could be learned; {nearest(equation, [*states])}"
        )
    others = tuple(name for name in states if name != equation)
    # In the equation of a position, its rate is the velocity.
    position = (equation,) if equation in pairs else tuple(x for x in states if pairs.get(x) == equation)
    velocity = pairs.get(equation, equation)
    apart = [x for x in pairs if x != velocity and velocity not in _rates(x, pairs)]
    integrals = tuple(x for x in others if pairs.get(x) == equation)
    roles = {
        **dict.fromkeys(_OWN_ROLES, (equation,)),
        # A road's slope is a force of its own.
        "input": tuple(name for name in inputs if name not in given.get("grade", ())),
        "grade": (),
        "position": position,
        "velocity": (velocity,),
        "other_position": tuple(apart),
        "other_velocity": tuple(dict.fromkeys(pairs[x] for x in apart)),
        "upstream": others,
        "other": others,
        "flux": integrals or (equation,),
        "stored": integrals,
        "surroundings": (*others, *inputs),
    }
    for role, quantities in _ROLE_UNITS.items():
        roles[role] = tuple(name for name in roles[role] if any(_may_be(name, unit, units) for unit in quantities))
    for role in ("temperature", "surroundings"):
        roles[f"absolute_{role}"] = tuple(name for name in roles[role] if _is_absolute(name, units))
    for role in set(roles).difference(_TEMPERATURE_ROLES):
        roles[role] = tuple(name for name in roles[role] if not _is_temperature(name, units))
    return {**roles, **given}


def bind_catalogue(
    effects: Iterable[Effect], roles: Mapping[str, Sequence[str]], units: Mapping[str, str] | None = None
) -> tuple[BoundEffect, ...]:
    """Put columns in the place of roles, in every way that gives a formula of its own, in the order of the catalogue.

    Effects that the units by column forbid, such as the sine of a position in metres, are left out.
    """
    return tuple(bound for effect in effects for bound in _bindings(effect, roles, units)[0])


def unbound(
    effects: Iterable[Effect], roles: Mapping[str, Sequence[str]], units: Mapping[str, str] | None = None
) -> dict[str, str]:
    """Return the reasons why `bind_catalogue` left effects out, by slug; arguments and errors are the same."""
    reasons = {effect.slug: _bindings(effect, roles, units) for effect in effects}
    return {slug: reason for slug, (bound, reason) in reasons.items() if not bound}


def unplayed_roles(effects: Iterable[Effect], roles: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """Return the first role of each effect that no column plays, by slug; nothing of effects without one."""
    empty = {effect.slug: next((role for role in effect.roles if not roles.get(role)), "") for effect in effects}
    return {slug: role for slug, role in empty.items() if role}


def _of_output(
    columns: Columns, given: Mapping[str, tuple[str, ...]], pairs: Mapping[str, str]
) -> dict[str, tuple[str, ...]]:
    """Return roles in the equation of an output: those given, and those that units and pairs indicate."""
    units, usable = columns.units, (*columns.states, *columns.inputs)
    by_unit = {
        role: tuple(name for name in usable if units.get(name) and _is_in(units[name], name, quantities))
        for role, quantities in _OUTPUT_ROLE_UNITS.items()
    }
    for role, quantity, names in (("position", "m", pairs), ("velocity", "m/s", pairs.values())):
        paired = [name for name in names if _may_be(name, quantity, units)]
        by_unit[role] = tuple(dict.fromkeys((*by_unit[role], *paired)))
    roles = {**dict.fromkeys(ROLES, ()), **by_unit, **given}
    # One column under two names would be two effects.
    taken = {name for role, names in roles.items() if role != "input" for name in names}
    return {**roles, "input": given.get("input", tuple(name for name in columns.inputs if name not in taken))}


def _bindings(
    effect: Effect, roles: Mapping[str, Sequence[str]], units: Mapping[str, str] | None
) -> tuple[list[BoundEffect], str]:
    """Return the ways to bind an effect, and the reason why others were refused."""
    for role in effect.roles:
        if role not in roles and role not in ROLES:
            raise InputError(
                f"The effect {effect.slug!r} uses the unknown role {role!r}; {nearest(role, [*ROLES])} For a role of "
                f"your own, say which column plays it: roles={{{role!r}: 'column'}}."
            )
    if role := unplayed_roles([effect], roles).get(effect.slug):
        meaning = f" ({ROLES[role]})" if role in ROLES else ""
        return [], f"no column plays the role {role!r}{meaning}"
    reason = f"the roles {', '.join(effect.roles)} need columns of their own"
    distinct = {}
    for columns in product(*(roles[role] for role in effect.roles)):
        if len(set(columns)) < len(columns):
            continue
        bound = effect.bind(dict(zip(effect.roles, columns, strict=True)))
        try:
            if units:
                # A number in a formula may carry any unit, so the value of a nonlinear parameter does not matter.
                term = bound.term({inner.name: 0.37 for inner in effect.inner})
                term_unit(term, term.units(units))
        except InputError as error:
            reason = str(error)
            continue
        named = effect.expr.xreplace({symbol(r): symbol(c) for r, c in bound.names.items()})
        # Effects with memory differ by their hidden states too.
        distinct.setdefault((named, bound.label if effect.hidden else ""), bound)
    return list(distinct.values()), reason


def _positions(simulation: Mapping[str, str] | Callable | None, states: Sequence[str]) -> dict[str, str]:
    """Return states whose rate is another state and nothing else, with that state."""
    formulas = simulation.items() if isinstance(simulation, Mapping) else ()
    rates = {state: parse_expression(str(text)) for state, text in formulas if state in states}
    return {s: str(rate) for s, rate in rates.items() if rate.is_Symbol and str(rate) in states and str(rate) != s}


def _rates(state: str, pairs: Mapping[str, str]) -> list[str]:
    """Return the rate of a state, the rate of that and so on, as far as they are states."""
    rates: list[str] = []
    while state in pairs and pairs[state] not in rates:
        state = pairs[state]
        rates.append(state)
    return rates


def _may_be(name: str, quantity: str, units: Mapping[str, str]) -> bool:
    if not units.get(name):
        return True
    unit = parse_unit(units[name], f"column {name!r}")
    return unit.dimensionless or unit.dimensionality == registry().parse_units(quantity).dimensionality


def _is_temperature(name: str, units: Mapping[str, str]) -> bool:
    unit = units.get(name)
    return bool(unit) and parse_unit(unit, f"column {name!r}").dimensionality == {"[temperature]": 1}


def _is_absolute(name: str, units: Mapping[str, str]) -> bool:
    """Return True for a temperature that counts from absolute zero; one without a unit may not."""
    if not _is_temperature(name, units):
        return False
    zero = registry().Quantity(0.0, parse_unit(units[name], f"column {name!r}"))
    return abs(float(zero.to("kelvin").magnitude)) < 1e-9


def _is_in(unit: str, name: str, quantities: Sequence[str]) -> bool:
    """Return True if a unit measures one of these quantities; an angle differs from a plain number."""
    base = registry().get_base_units(parse_unit(unit, f"column {name!r}"))[1]
    return any(base == registry().get_base_units(registry().parse_units(each))[1] for each in quantities)


def _checked(given: Mapping[str, str | Sequence[str]], known: Sequence[str]) -> dict[str, tuple[str, ...]]:
    roles = {}
    for role, value in given.items():
        check_name(role)
        columns = (value,) if isinstance(value, str) else tuple(value)
        for column in columns:
            if column not in known:
                raise InputError(
                    f"The role {role!r} is given to the unknown column {column!r}; {nearest(column, [*known])}"
                )
        roles[role] = columns
    return roles
