"""Prior knowledge of single coefficients, as a user states it of single terms."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from bayes_greybox.running.errors import InputError
from bayes_greybox.running.limits import Rule, is_finite, require_limits

_Finite = Annotated[float, Rule(is_finite, "must be a finite number")]
_Width = Annotated[float, Rule(lambda value: is_finite(value) and value > 0, "must be a finite number above 0")]
_Sign = Annotated[int, Rule(lambda value: is_finite(value) and abs(value) == 1, "must be 1 or -1")]


@dataclass(frozen=True)
class Coefficient:
    """Prior of one coefficient θ_j, in user's units, in place of the model's prior or as a limit to it.

        mean, sd               θ_j ~ N(mean, sd²); the term is in whatever the data say
        sign, lower, upper     the same, or else the model's own prior, restricted to lower ≤ θ_j ≤ upper
        fixed                  θ_j = fixed: the term is a part of the simulation

    A restriction of the model's prior p(θ_j | scale) is p(θ_j | scale) 1[lower ≤ θ_j ≤ upper] / P(lower ≤ θ_j ≤ upper |
    scale). Under a spike-and-slab prior it is the slab that is restricted: the term may still be out. Where the bounds
    keep zero out, the term is in.

    Attributes:
        mean: Its expected value.
        sd: Standard deviation of the prior.
        sign: 1: not negative; -1: not positive.
        lower: Least value.
        upper: Largest value.
        fixed: Its value.

    Raises:
        InputError: Nothing is stated; only one of mean and sd is given; bounds leave no interval or contradict the
            sign; bounds rule the mean out; or `fixed` stands beside anything else.
    """

    mean: _Finite | None = None
    sd: _Width | None = None
    sign: _Sign | None = None
    lower: _Finite | None = None
    upper: _Finite | None = None
    fixed: _Finite | None = None

    def __post_init__(self) -> None:
        require_limits(self)
        stated = list(self.record())
        if not stated:
            raise InputError("Coefficient() says nothing: give mean and sd, sign, lower, upper, or fixed.")
        if self.fixed is not None and len(stated) > 1:
            raise InputError(
                f"Coefficient(fixed={self.fixed:g}, {stated[0]}=...) says two things: a fixed coefficient has its "
                "value and no prior."
            )
        if (self.mean is None) != (self.sd is None):
            present, missing = ("mean", "sd") if self.sd is None else ("sd", "mean")
            raise InputError(
                f"Coefficient({present}=...) needs {missing} too: both, or neither for the model's own prior."
            )
        low, high = self.interval
        if not low < high:
            raise InputError(
                f"Coefficient(sign={self.sign}, lower={self.lower}, upper={self.upper}) leaves no interval between "
                f"{low:g} and {high:g}: for a single value use fixed."
            )
        if self.mean is not None and not low <= self.mean <= high:
            raise InputError(
                f"Coefficient(mean={self.mean:g}) is expected where its bounds rule it out, from {low:g} to {high:g}: "
                "move the mean between them, or leave mean and sd out for the model's own prior between the bounds."
            )

    @property
    def interval(self) -> tuple[float, float]:
        """Least and largest value, infinite where there is none."""
        low = -math.inf if self.lower is None else self.lower
        high = math.inf if self.upper is None else self.upper
        return (max(low, 0.0) if self.sign == 1 else low), (min(high, 0.0) if self.sign == -1 else high)

    @property
    def bounded(self) -> bool:
        """True if some values are ruled out."""
        return self.fixed is None and self.interval != (-math.inf, math.inf)

    @property
    def certain(self) -> bool:
        """True if the term is in whatever the data say, also under a prior with inclusion."""
        return self.fixed is not None or self.mean is not None or not self.interval[0] <= 0 <= self.interval[1]

    @property
    def learned(self) -> bool:
        """True if it is a coefficient of the dictionary; false if it is a number of the simulation."""
        return self.fixed is None

    @property
    def known(self) -> float:
        """The part of the coefficient that belongs to the simulation."""
        return 0.0 if self.fixed is None else self.fixed

    def centred(self) -> "Coefficient":
        """Return the prior of the deviation from the mean, for a simulation that has the term with the mean."""
        return self if self.mean is None else _Deviation(0.0, self.sd, known_part=self.mean)

    def record(self) -> dict[str, Any]:
        """Return the statement as plain values."""
        stated = {name: getattr(self, name) for name in ("mean", "sd", "sign", "lower", "upper", "fixed")}
        plain = {name: int if name == "sign" else float for name in stated}
        return {name: plain[name](value) for name, value in stated.items() if value is not None}

    def __str__(self) -> str:
        """Return the statement in a few signs: `N(-2, 0.1²) ≤ 0`."""
        if self.fixed is not None:
            return f"= {_digits(self.fixed)}"
        law = "" if self.mean is None or self.sd is None else f"N({_digits(self.mean)}, {_digits(self.sd)}²)"
        low, high = self.interval
        limits = [f"{sign} {_digits(end)}" for sign, end in (("≥", low), ("≤", high)) if math.isfinite(end)]
        return ", ".join([law, *limits] if law else limits)


def _digits(value: float) -> str:
    """Write a number as it was stated, with all its digits."""
    return repr(float(value)).removesuffix(".0")


@dataclass(frozen=True)
class _Deviation(Coefficient):
    """Deviation of a coefficient from its mean, where the simulation has the term with the mean."""

    known_part: float = 0.0

    @property
    def known(self) -> float:
        return self.known_part

    def centred(self) -> "Coefficient":
        return self


Bounds = tuple[float | None, float | None]
"""Least and largest value, None where an end is open."""


def coefficient_of_term(
    term: str, sign: str | None, prior: Sequence[float] | None, fixed: float | None,
    bounds: Sequence[float | None] | None,
) -> Coefficient | None:  # fmt: skip
    """Return what a term states of its own coefficient (see `Term`); None where it states nothing."""
    every = {"sign": sign, "prior": prior, "fixed": fixed, "bounds": bounds}
    stated = {key: value for key, value in every.items() if value is not None}
    if not stated:
        return None
    subject = f"The term {term!r} has "
    for key, (holds, remedy) in _STATEMENT_CHECKS.items():
        if key in stated and not holds(stated[key]):
            raise InputError(f"{subject}{key}={stated[key]!r}: {remedy}.")
    if fixed is not None and len(stated) > 1:
        other = next(key for key in stated if key != "fixed")
        raise InputError(
            f"{subject}fixed={fixed:g} and {other}={stated[other]!r}: a fixed coefficient has its value and nothing is "
            f"learned of it; leave out {other}, or fixed."
        )
    least, largest = bounds or (None, None)
    low, high = -math.inf if least is None else least, math.inf if largest is None else largest
    shown = f"{subject}bounds={tuple(bounds or ())!r}"
    if bounds is not None and (low, high) == (-math.inf, math.inf):
        raise InputError(f"{shown}, which rule out nothing: leave bounds out.")
    if low == high:
        raise InputError(f"{shown}, which leave a single value: write fixed={low:g}.")
    if low > high:
        raise InputError(f"{shown}, the wrong way round: write bounds=({high:g}, {low:g}).")
    if (sign == "+" and high <= 0) or (sign == "-" and low >= 0):
        raise InputError(
            f"{subject}sign={sign!r} and bounds={tuple(bounds or ())!r}, between which no coefficient has that sign: "
            "leave out one of them, or turn it round."
        )
    low, high = max(low, 0.0) if sign == "+" else low, min(high, 0.0) if sign == "-" else high
    if prior is not None and not low <= prior[0] <= high:
        limit = " and ".join(f"{key}={stated[key]!r}" for key in ("sign", "bounds") if key in stated)
        raise InputError(
            f"{subject}prior={tuple(prior)!r}, whose mean is not possible with {limit}: move the mean to where the "
            "coefficient may be, or correct the limit."
        )
    mean, sd = prior or (None, None)
    return Coefficient(mean, sd, None if sign is None else {"+": 1, "-": -1}[sign], least, largest, fixed)


def _is_pair(value: Any) -> bool:
    return isinstance(value, tuple | list) and len(value) == 2


_STATEMENT_CHECKS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "sign": (lambda sign: sign in ("+", "-"), 'write "+" for not negative, or "-" for not positive'),
    "prior": (
        lambda prior: _is_pair(prior) and all(map(is_finite, prior)) and prior[1] > 0,
        "give mean and standard deviation of the coefficient, two finite numbers of which the second is above 0, such "
        "as (-40, 10)",
    ),
    "fixed": (is_finite, "give the coefficient, a finite number"),
    "bounds": (
        lambda bounds: _is_pair(bounds) and all(end is None or is_finite(end) for end in bounds),
        "give least and largest value of the coefficient, two finite numbers such as (-50, 0); None in place of one "
        "leaves that end open",
    ),
}
