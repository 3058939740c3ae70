"""Units of terms and coefficients, and refusal of terms whose units cannot be right.

A number in a formula may carry a unit: `sin(2*y)` is fine with y in metres (2 is then 2 per metre), `sin(y)`
is not. The expressions of a simulation are not checked: all their numbers carry units that are not written.
"""

import re
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from functools import reduce
from operator import mul
from typing import Any, NamedTuple, cast

import sympy

from bayes_greybox.data.columns import derivative_label
from bayes_greybox.data.reading.units import registry
from bayes_greybox.data.runs.stacked import Runs
from bayes_greybox.physics.formula.printing import to_text
from bayes_greybox.running.errors import InputError

from .terms import Term

UNKNOWN_UNIT = "?"
"""Declared unit of a term whose numbers carry units that nobody wrote."""


def parse_unit(text: str, what: str) -> Any:
    """Read a unit such as "m/s^2" as a pint unit; `what` names its owner in the message, such as "column 'y'"."""
    # Chains of powers and long numbers are no units and could take pint for ever.
    chained = re.search(r"(\*\*|\^)[^A-Za-z]*(\*\*|\^)|\d{4}", text)
    if len(text) <= 100 and not chained:
        try:
            return registry().parse_units(text)
        except Exception:  # pint raises errors of many kinds on malformed text
            pass
    unknown = [word for word in re.findall(r"[^\W\d]+", text[:100]) if not hasattr(registry(), word)]
    names = [name for name in dir(registry()) if not name.startswith("_")] if unknown else []
    near = [match for word in unknown for match in get_close_matches(word, names, n=2, cutoff=0.7)]
    hint = f" Did you mean {' or '.join(near)}?" if near else ""
    raise InputError(f"The unit {text[:100]!r} of {what} is not known; write it as in 'm/s^2', or '1' for none.{hint}")


def same_unit(first: str, second: str, what: str) -> bool:
    """Return True if two units, as in "m/s", are one, however they are written."""
    if first == second:
        return True
    one, other = parse_unit(first, what), parse_unit(second, what)
    # Degrees of Celsius and kelvins are as large, and count from elsewhere.
    return _same(one, other) and abs(float(registry().Quantity(0.0, one).to(other).magnitude)) < 1e-9


def require_units_of(data: Runs, train: Runs) -> None:
    """Refuse test data in other units than those of the training data, where both are declared."""
    for name, unit in train.units.items():
        other = data.units.get(name)
        if unit and other and not same_unit(unit, other, f"column {name!r}"):
            raise InputError(f"The test data have {name} in {other}, the training data in {unit}: convert them.")


def per_second(unit: str) -> float:
    """Return the number of units of time in a second: 1000 for ms; 1 where the unit is unknown, or none of time."""
    try:
        given, second = parse_unit(unit, "the time"), registry().parse_units("second")
    except InputError:
        return 1.0
    if given.dimensionality != second.dimensionality:
        return 1.0
    return float(registry().Quantity(1.0, second).to(given).magnitude)


def derivative_unit(state: str, units: Mapping[str, str]) -> str:
    """Return the unit of d(state)/dt: as declared under "d(state)/dt", else the state's unit over that of "t".

    It reads as `parse_unit` does, such as "m/s²"; "" if it is unknown.
    """
    declared = units.get(derivative_label(state))
    if declared:
        return declared
    if not units.get(state) or not units.get("t"):
        return ""
    return _shown(parse_unit(units[state], f"column {state!r}") / parse_unit(units["t"], "the time"))


def with_rates(units: Mapping[str, str], rates: Mapping[str, str | None]) -> dict[str, str]:
    """Add units of states that are nothing but the rate of another one, such as m/s for the rate of a length.

    Declared units take precedence. `rates` has the state that is the rate, by the state whose rate it is; None where
    the rate is a formula.
    """
    known = dict(units)
    for _ in rates:
        # The rate of a rate has a unit once the first one has.
        for state, rate in rates.items():
            if rate is not None and not known.get(rate) and (unit := derivative_unit(state, known)):
                known[rate] = unit
    return known


def target_unit(equation: str, data: Runs) -> str:
    """Return the unit of what an equation gives: of a state's derivative, or an output's own; "" if it is unknown."""
    return (data.unit(equation) or "") if data.is_output(equation) else derivative_unit(equation, data.units)


def term_unit(term: Term, units: Mapping[str, str]) -> Any:
    """Return the pint unit of a term, from the units of its columns or its own declaration; None if it is unknown."""
    if term.unit == UNKNOWN_UNIT:
        return None
    if term.unit:
        return parse_unit(term.unit, f"term {term.name!r}")
    return _Walk(term.name, units).quantity(term.expr).unit


def coefficient_unit(target_unit: str, term: Term, units: Mapping[str, str]) -> str:
    """Return the unit of a term's coefficient, unit(dx/dt) / unit(term), ready to print: "1/s²", or "1" for none.

    It is "" if a unit is missing. `target_unit` is the unit of what the equation gives.
    """
    unit = term_unit(term, units)
    if unit is None or not target_unit:
        return ""
    quotient = parse_unit(target_unit, "the derivative") / unit
    # (m/s²)/N is 1/kg: take the base units where they say the same in fewer letters.
    size, base = registry().get_base_units(quotient)
    simpler = abs(float(size) - 1.0) < 1e-12 and len(_shown(base)) < len(_shown(quotient))
    return _shown(base if simpler else quotient)


def slope_unit(target: str, unit: str | None) -> str:
    """Return the declared unit of a slope ∂g/∂p, from those of what the equation gives and of the parameter."""
    return f"({target})/({unit})" if target and unit else UNKNOWN_UNIT


def check_units(
    dictionary: Mapping[str, Iterable[Term]], units: Mapping[str, str], states: Iterable[str] = (), time: str = "t"
) -> None:
    """Refuse units that cannot be right.

    Args:
        dictionary: Terms by equation (the learned state), for example `{"ydot": some_dictionary.terms}`.
        units: Units by column name, the time's under "t"; columns without one are not checked.
        states: States beside the equations whose declared derivative unit is compared with state over time.
        time: Name of the time, for the message.
    """
    for name, unit in units.items():
        if unit:
            parse_unit(unit, f"column {name!r}")
    _require_time(units.get("t") or "s", time)
    for state in dict.fromkeys((*states, *dictionary)):
        declared = units.get(derivative_label(state))
        if not declared or not units.get(state) or not units.get("t"):
            continue
        expected = parse_unit(f"({units[state]})/({units['t']})", f"column {state!r}")
        if not _same(parse_unit(declared, f"the derivative of {state!r}"), expected):
            raise InputError(
                f"The derivative of {state!r} is declared in {declared!r}, but {state!r} over {time!r} is in "
                f"{_shown(expected)}; convert the derivative or correct its unit."
            )
    for terms in dictionary.values():
        for term in terms:
            term_unit(term, units)


def _require_time(text: str, name: str) -> None:
    """Refuse a unit of the time that measures something else: Min is a mega-inch, S a siemens."""
    unit = parse_unit(text, f"column {name!r}")
    if unit.dimensionless or unit.dimensionality == registry().second.dimensionality:
        return
    small = text.lower()
    meant = hasattr(registry(), small) and parse_unit(small, name).dimensionality == registry().second.dimensionality
    remedy = f"did you mean {small!r}?" if meant else "give it in one, such as 's' or 'min'."
    raise InputError(f"The unit {text!r} of {name!r} is {unit}, which is no unit of time; {remedy}")


class _Quantity(NamedTuple):
    """Unit of a part of a formula (None: unknown), with `free` true if a number in it may carry a further unit."""

    unit: Any
    free: bool


class _Walk:
    """Finds the unit of a formula from the inside out."""

    def __init__(self, name: str, units: Mapping[str, str]):
        self.name = name
        self.units = units
        self.none = registry().dimensionless

    def quantity(self, expr: sympy.Basic) -> _Quantity:
        if isinstance(expr, sympy.Symbol):
            text = self.units.get(expr.name)
            return _Quantity(parse_unit(text, f"column {expr.name!r}") if text else None, free=False)
        if isinstance(expr, sympy.Expr) and expr.is_number:
            return _Quantity(self.none, free=True)
        if isinstance(expr, sympy.Mul):
            return self.product(expr)
        if isinstance(expr, sympy.Pow):
            return self.power(expr)
        if isinstance(expr, sympy.Add | sympy.Min | sympy.Max):
            return self.common(expr)
        if isinstance(expr, sympy.Abs):
            return self.quantity(expr.args[0])
        argument = self.quantity(expr.args[0])
        if not isinstance(expr, sympy.sign | sympy.Heaviside):
            self.need_plain(expr.args[0], argument, to_text(expr))
        return _Quantity(self.none, free=False)

    def product(self, expr: sympy.Basic) -> _Quantity:
        # A factor of -1 is a sign, not a number that a user wrote to carry a unit.
        parts = [(arg, self.quantity(arg)) for arg in expr.args]
        free = any(q.free and arg != -1 for arg, q in parts)
        units = [q.unit for _, q in parts]
        return _Quantity(None if None in units else reduce(mul, units), free)

    def power(self, expr: sympy.Basic) -> _Quantity:
        base, exponent = cast(Any, expr.args)
        quantity = self.quantity(base)
        if exponent.is_number:
            return _Quantity(None if quantity.unit is None else quantity.unit ** float(exponent), quantity.free)
        self.need_plain(exponent, self.quantity(exponent), to_text(expr))
        self.need_plain(base, quantity, to_text(expr))
        return _Quantity(self.none, free=False)

    def common(self, expr: sympy.Basic) -> _Quantity:
        """Return the unit of a sum, minimum or maximum: that of the parts whose unit no number can change."""
        parts = [(arg, self.quantity(arg)) for arg in expr.args]
        fixed = [(arg, q.unit) for arg, q in parts if not q.free]
        if not fixed:
            units = [q.unit for _, q in parts]
            known = None not in units and all(_same(units[0], unit) for unit in units)
            return _Quantity(units[0] if known else None, free=True)
        (first, unit), *others = fixed
        for other, other_unit in others:
            if unit is not None and other_unit is not None and not _same(unit, other_unit):
                raise InputError(
                    f"The term {self.name!r} puts together {to_text(first)} in {_shown(unit)} and "
                    f"{to_text(other)} in {_shown(other_unit)}; bring them to one unit with a numeric "
                    "factor, or make them separate terms."
                )
        return _Quantity(None if any(u is None for _, u in fixed) else unit, free=False)

    def need_plain(self, expr: sympy.Basic, quantity: _Quantity, where: str) -> None:
        if quantity.free or quantity.unit is None or _same(quantity.unit, self.none):
            return
        remedy = "pi/180, which" if quantity.unit == registry().degree else "a number that"
        raise InputError(
            f"The term {self.name!r} has {to_text(expr)} in {_shown(quantity.unit)} inside {where}, which "
            f"needs a plain number or an angle in radian; multiply {to_text(expr)} by {remedy} takes its "
            "unit away."
        )


def _same(a: Any, b: Any) -> bool:
    """Compare dimension and size: m/s² and N/kg are the same, m and mm are not."""
    if a.dimensionality != b.dimensionality:
        return False
    size_a, size_b = (float(registry().get_root_units(unit)[0]) for unit in (a, b))
    return abs(size_a - size_b) <= 1e-9 * abs(size_b)


def _shown(unit: Any) -> str:
    return f"{unit:~P}" or "1"
