"""Named parameters of a simulation's formulas, what is known of them, and the tangent of a formula in them.

Of g(x, u, p) the tangent at p̂ is

    g(x, u, p) ≈ g(x, u, p̂) + Σ_k (p_k − p̂_k) ∂g/∂p_k(x, u, p̂),

whose slopes ∂g/∂p_k are terms with the coefficients p_k. It is exact for parameters that g is linear in; for others it
is taken anew at the estimate until that stays (Gauss–Newton).
"""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple, cast

import sympy

from bayes_greybox.physics.formula.grammar import check_name, symbol
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.limits import is_finite

from .coefficient import Bounds, Coefficient


@dataclass(frozen=True)
class Parameter:
    """A number with a name in the formulas of a simulation, and what is known of it.

        Parameter(30.0)                                      believed; a study may find it off
        Parameter(2.0, sd=0.1, bounds=(0, None), unit="kg")  learned: N(2, 0.1²) between the bounds

    Attributes:
        value: Its value, or with `sd` its expected value.
        sd: Standard deviation of its prior; None: it is not learned in fits.
        bounds: Its least and largest possible value; None leaves an end open.
        unit: Its unit, for tables.
        at: Value that formulas are linearised at; a fit or a study sets it. None: `value`.
        change: If true, what is learned is the difference from `value`, as in a study.

    Raises:
        InputError: A value that cannot be used: not finite, `sd` not above 0, bounds reversed or without the value.
    """

    value: float
    sd: float | None = None
    bounds: Bounds | None = None
    unit: str | None = None
    at: float | None = None
    change: bool = False

    def __post_init__(self) -> None:
        if not is_finite(self.value):
            raise InputError(f"Parameter({self.value!r}) needs a finite number, such as Parameter(2.0, sd=0.1).")
        if self.sd is not None and not (is_finite(self.sd) and self.sd > 0):
            raise InputError(
                f"Parameter({self.value:g}, sd={self.sd!r}) needs a standard deviation above 0; leave sd out for a "
                "parameter that is believed."
            )
        object.__setattr__(self, "value", float(self.value))
        object.__setattr__(self, "sd", None if self.sd is None else float(self.sd))
        if self.bounds is not None:
            object.__setattr__(self, "bounds", _ends(self.value, self.bounds))

    @property
    def learned(self) -> bool:
        """True if it has a prior, and with it a posterior in every fit."""
        return self.sd is not None

    @property
    def here(self) -> float:
        """The value that formulas are linearised at."""
        return self.value if self.at is None else self.at

    @property
    def prior(self) -> Coefficient:
        """The prior of its coefficient: of its value, or of the change."""
        least, most = self.bounds or (None, None)
        if self.change:
            return Coefficient(self.value, self.sd).centred()
        return Coefficient(self.value, self.sd, None, least, most)

    @property
    def changes(self) -> tuple[float, float]:
        """The least and the largest change that the bounds allow."""
        least, most = self.bounds or (None, None)
        return (-math.inf if least is None else least - self.value, math.inf if most is None else most - self.value)


def _ends(value: float, bounds: Any) -> Bounds:
    """Return bounds as plain numbers, or refuse them."""
    shown = f"Parameter({value:g}, bounds={bounds!r})"
    pair = isinstance(bounds, tuple | list) and len(bounds) == 2
    if not pair or not all(end is None or is_finite(end) for end in bounds):
        raise InputError(f"{shown} needs a least and a largest value, such as (0, None): None leaves an end open.")
    least, most = (None if end is None else float(end) for end in bounds)
    low, high = -math.inf if least is None else least, math.inf if most is None else most
    if not low < high:
        raise InputError(f"{shown} leaves no interval between {low:g} and {high:g}: give the lower bound first.")
    if not low <= value <= high:
        raise InputError(f"{shown} rules the value out: move the bounds around it, or correct it.")
    return least, most


Parameters = Mapping[str, Parameter]
"""Parameters by name."""


def read_parameters(given: Any) -> dict[str, Parameter]:
    """Return the parameters that a user gave, numbers among them."""
    if not isinstance(given, Mapping):
        raise InputError(
            f"GreyBox(parameters={given!r}) must map names in the formulas to numbers or bg.Parameter(...), for "
            "example {'m': bg.Parameter(2.0, sd=0.1), 'k': 30.0}."
        )
    return {check_name(name): _parameter(name, each) for name, each in given.items()}


def _parameter(name: str, given: Any) -> Parameter:
    if isinstance(given, Parameter):
        return given
    if not is_finite(given):
        raise InputError(f"The parameter {name!r} is {given!r}: give a finite number, or bg.Parameter(2.0, sd=0.1).")
    return Parameter(given)


class Tangent(NamedTuple):
    """A formula without the terms of learned parameters, whose coefficients are their values; ∂g/∂p by parameter."""

    rest: sympy.Expr
    slopes: dict[str, sympy.Expr]


def tangent(formula: sympy.Expr, parameters: Parameters) -> Tangent:
    """Return the tangent of a formula in its parameters.

    The rest is g(p̂) − Σ p̂_k ∂g/∂p_k over learned parameters, and + Σ (p_k − p̂_k) ∂g/∂p_k over believed ones, whose
    values p_k stay what they are said to be, wherever the tangent is taken.
    """
    return _tangent(formula, tuple(parameters.items()))


@lru_cache(maxsize=1024)
def _tangent(formula: sympy.Expr, parameters: tuple[tuple[str, Parameter], ...]) -> Tangent:
    used = {name: each for name, each in parameters if symbol(name) in formula.free_symbols}
    here: dict[Any, Any] = {symbol(name): _number(each.here) for name, each in used.items()}
    slopes: dict[str, Any] = {name: slope_by(formula, name, each.here) for name, each in used.items()}
    moving = {symbol(name) for name, each in used.items() if each.learned or each.here != each.value}
    curved = {name for name in used if symbol(name) in moving and slopes[name].free_symbols & moving}
    # What the formula is linear in is taken out of it, and not off it: no rounding is left.
    straight: dict[Any, Any] = {
        symbol(name): sympy.S.Zero if each.learned else _number(each.value)
        for name, each in used.items()
        if symbol(name) in moving and name not in curved
    }
    rest: Any = formula.xreplace(straight)
    for name in curved:
        away = -symbol(name) if used[name].learned else _number(used[name].value) - symbol(name)
        rest = rest + away * slopes[name]
    found = Tangent(rest.xreplace(here), {name: slope.xreplace(here) for name, slope in slopes.items()})
    for part in (found.rest, *found.slopes.values()):
        if part.has(sympy.zoo, sympy.nan, sympy.oo, sympy.I):
            values = ", ".join(f"{name} = {each.here:g}" for name, each in used.items())
            raise InputError(f"The formula {formula} has no value, or no finite slope, at {values}: correct these.")
    return found


@lru_cache(maxsize=1024)
def _bends(formula: sympy.Expr, moving: frozenset[sympy.Symbol]) -> bool:
    return any(sympy.diff(formula, p).free_symbols & moving for p in moving)


def bends(formula: sympy.Expr, names: Collection[str]) -> bool:
    """Return True if a formula is not linear in some parameters together."""
    return _bends(formula, frozenset(symbol(name) for name in names))


def step_to(value: float, here: float, spread: float) -> float:
    """Return where a tangent is taken next: at a value, or on the way there if it is far.

    A tangent says little beyond a change by half of the parameter or by its prior standard deviation: that of F/m at
    4 kg says of 2 kg that it is nothing at all.
    """
    longest = max(abs(here) / 2, spread)
    return here + min(max(value - here, -longest), longest)


def at_here(formula: sympy.Expr, parameters: Parameters) -> sympy.Expr:
    """Return a formula at the values that formulas are linearised at."""
    here: Any = {symbol(name): _number(each.here) for name, each in parameters.items()}
    return cast(sympy.Expr, formula.xreplace(here))


def slope_by(formula: sympy.Expr, name: str, value: float) -> sympy.Expr:
    """Return the derivative of a formula by a name, or central differences where it is not finite everywhere.

    Their step goes with the size of `value`, their error with its square.
    """
    slope = sympy.diff(formula, symbol(name))
    logs = slope.atoms(sympy.log) - formula.atoms(sympy.log)
    if not logs and not slope.has(sympy.DiracDelta, sympy.Derivative, sympy.Subs):
        return slope
    step = _number(1e-4 * (abs(value) or 1.0))
    p: Any = symbol(name)
    more: Any = formula.xreplace({p: p + step})
    return (more - formula.xreplace({p: p - step})) / (2 * step)


def _number(value: float) -> sympy.Expr:
    # A whole exponent is one of a product, also of negative numbers.
    return sympy.Integer(int(value)) if value == int(value) else sympy.Float(value)


def moved_to(parameters: Parameters, values: Mapping[str, float]) -> dict[str, Parameter]:
    """Return parameters with formulas linearised at some values."""
    return {name: replace(each, at=values.get(name, each.at)) for name, each in parameters.items()}
