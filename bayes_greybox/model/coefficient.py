"""Priors of single coefficients, as a user states them of single terms."""

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Annotated, Any, NamedTuple

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.limits import Rule, require_limits
from bayes_greybox.physics.terms import Dictionary, Term


def _finite(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)


_Finite = Annotated[float, Rule(_finite, "must be a finite number")]
_Width = Annotated[float, Rule(lambda value: _finite(value) and value > 0, "must be a finite number above 0")]
_Sign = Annotated[int, Rule(lambda value: _finite(value) and abs(value) == 1, "must be 1 or -1")]


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
        sd: Standard deviation of what is known of it.
        sign: 1: not negative; -1: not positive.
        lower: Least value.
        upper: Largest value.
        fixed: Its value.

    Raises:
        InputError: Nothing stated, one of mean and sd without the other, bounds that leave no interval or contradict
            the sign, or `fixed` with anything else.
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
            there, lacks = ("mean", "sd") if self.sd is None else ("sd", "mean")
            raise InputError(
                f"Coefficient({there}=...) needs {lacks} too: both, or neither for the model's own prior on the term."
            )
        low, high = self.interval
        if not low < high:
            raise InputError(
                f"Coefficient(sign={self.sign}, lower={self.lower}, upper={self.upper}) leaves no interval between "
                f"{low:g} and {high:g}: for a single value use fixed."
            )

    @property
    def interval(self) -> tuple[float, float]:
        """Least and largest value, infinite where there is none."""
        low = -math.inf if self.lower is None else self.lower
        high = math.inf if self.upper is None else self.upper
        return (max(low, 0.0) if self.sign == 1 else low), (min(high, 0.0) if self.sign == -1 else high)

    @property
    def bounded(self) -> bool:
        """Whether some values are ruled out."""
        return self.fixed is None and self.interval != (-math.inf, math.inf)

    @property
    def learned(self) -> bool:
        """Whether it is a coefficient of the dictionary; else a number of the simulation."""
        return self.fixed is None

    @property
    def known(self) -> float:
        """What the simulation has of the term."""
        return 0.0 if self.fixed is None else self.fixed

    def centred(self) -> "Coefficient":
        """The prior of what is left of it when the simulation has the term with the mean."""
        return self if self.mean is None else _Deviation(0.0, self.sd, known_part=self.mean)

    def record(self) -> dict[str, Any]:
        """What was stated, as plain values."""
        stated = {name: getattr(self, name) for name in _FIELDS if getattr(self, name) is not None}
        return {name: int(value) if name == "sign" else float(value) for name, value in stated.items()}

    def __str__(self) -> str:
        """What was stated, in a few signs: `N(-2, 0.1²) ≤ 0`."""
        if self.fixed is not None:
            return f"= {self.fixed:g}"
        law = "" if self.mean is None else f"N({self.mean:g}, {self.sd:g}²)"
        low, high = self.interval
        limits = (f"≥ {low:g}" if math.isfinite(low) else "", f"≤ {high:g}" if math.isfinite(high) else "")
        return ", ".join(part for part in (law, *limits) if part)


_FIELDS = ("mean", "sd", "sign", "lower", "upper", "fixed")


@dataclass(frozen=True)
class _Deviation(Coefficient):
    """What is left of a coefficient beside its mean, which the simulation has.

    Attributes:
        known_part: The mean.
    """

    known_part: float = 0.0

    @property
    def known(self) -> float:
        """The mean."""
        return self.known_part

    def centred(self) -> "Coefficient":
        """Itself."""
        return self


class StatedTerms(NamedTuple):
    """The terms of one equation, and what is stated of their coefficients.

    Attributes:
        all: Every term of the dictionary.
        learned: Terms whose coefficients are learned.
        fixed: The other terms, with their coefficients.
        known: What the simulation has of the terms: the fixed ones, and means that are taken off.
        priors: Priors of single terms by name.
    """

    all: Dictionary
    learned: tuple[Term, ...]
    fixed: list[tuple[Term, float]]
    known: list[tuple[Term, float]]
    priors: dict[str, Coefficient]


def stated_terms(terms: Any, stated: Mapping[str, Coefficient], names: Sequence[str], equation: str) -> StatedTerms:
    """Read the terms of one equation and the priors of their coefficients.

    Args:
        terms: As the user gave them.
        stated: Priors of single terms.
        names: States and inputs.
        equation: The learned state.

    Raises:
        InputError: See `Dictionary.of` and `matched`.
    """
    dictionary = Dictionary.of(terms, names)
    priors = matched(stated, dictionary.names, equation)
    learned = tuple(t for t in dictionary.terms if t.name not in priors or priors[t.name].learned)
    known = [(t, priors[t.name].known) for t in dictionary.terms if t.name in priors]
    fixed = [(t, value) for t, value in known if t not in learned]
    return StatedTerms(dictionary, learned, fixed, [(t, value) for t, value in known if value != 0], priors)


def read_coefficients(stated: Any, dictionary: Mapping[str, Any]) -> dict[str, dict[str, Coefficient]]:
    """Priors of single coefficients as a model was given them, checked.

    Args:
        stated: Priors by equation and term.
        dictionary: Of the model.

    Raises:
        InputError: No such equation, or not a mapping from terms to `Coefficient`.
    """
    example = "{'ydot': {'y**3': bg.priors.Coefficient(sign=-1)}}"
    if not isinstance(stated, Mapping):
        raise InputError(f"GreyBox(coefficients={stated!r}) must map equations to terms, for example {example}.")
    found: dict[str, dict[str, Coefficient]] = {}
    for equation, terms in stated.items():
        if equation not in dictionary:
            raise InputError(
                f"GreyBox(coefficients=...) has priors for {equation!r}, which has no equation in the dictionary; "
                f"equations: {', '.join(dictionary) or 'none'}."
            )
        if not isinstance(terms, Mapping):
            raise InputError(f"GreyBox(coefficients={{{equation!r}: ...}}) must map terms, for example {example}.")
        for term, prior in terms.items():
            if not isinstance(prior, Coefficient):
                raise InputError(
                    f"GreyBox(coefficients=...) has {prior!r} for {term!r} of {equation!r}: give "
                    "bg.priors.Coefficient(...)."
                )
        found[equation] = dict(terms)
    return found


def matched(stated: Mapping[str, Coefficient], names: Sequence[str], equation: str) -> dict[str, Coefficient]:
    """Priors by the names of the dictionary's terms, which blanks in a key do not change.

    Args:
        stated: As the user gave them.
        names: Of the terms.
        equation: The learned state.

    Raises:
        InputError: A key that is no term, or two for one term.
    """
    found: dict[str, Coefficient] = {}
    for key, prior in stated.items():
        name = key if key in names else "".join(str(key).split())
        if name not in names:
            near = difflib.get_close_matches(name, names, n=1)
            hint = f" (did you mean {near[0]!r}?)" if near else ""
            raise InputError(
                f"GreyBox(coefficients=...) has a prior for {key!r}, which is no term of the dictionary of "
                f"{equation!r}{hint}; terms: {', '.join(names)}."
            )
        if name in found:
            raise InputError(f"GreyBox(coefficients=...) has two priors for the term {name!r} of {equation!r}.")
        found[name] = prior
    return found


def centred(stated: Mapping[str, Mapping[str, Coefficient]]) -> dict[str, dict[str, Coefficient]]:
    """The priors beside a simulation that has every term with its mean, by equation and term.

    Raises:
        InputError: A coefficient has bounds, so that no evidence of the model has a closed form.
    """
    for equation, terms in stated.items():
        for term, prior in terms.items():
            if prior.bounded:
                raise InputError(
                    f"The evidence of a model has no closed form with bounds on a coefficient, as on {term!r} of "
                    f"{equation!r}: for a study give it mean and sd, or fixed, or leave its prior out; GreyBox.fit "
                    "takes it as it is."
                )
    return {name: {term: prior.centred() for term, prior in terms.items()} for name, terms in stated.items()}


def stated_in_words(stated: Mapping[str, Mapping[str, Coefficient]], several: bool) -> str:
    """The priors in a few signs: `y N(-2, 0.1²); y**3 ≤ 0`.

    Args:
        stated: By equation and term.
        several: Whether equations need their names.
    """
    return "; ".join(
        f"{term} of {equation} {prior}" if several else f"{term} {prior}"
        for equation, terms in stated.items()
        for term, prior in terms.items()
    )
