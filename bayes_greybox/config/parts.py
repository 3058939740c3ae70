"""[dictionary], [prior] and [discrepancy]: the parts of a model."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag

import bayes_greybox as bg

from .section import Count, Positive, Section, suggestion, wrong


class Monomials(Section):
    """Arguments of `polynomial`."""

    variables: list[str]
    degree: Count
    interactions: bool = True
    constant: bool = False


class Term(Section):
    """One term with a name or a unit of its own."""

    expression: str
    name: str = ""
    unit: str | None = None


class Terms(Section):
    """The terms of one equation: those of the polynomial, then the listed ones."""

    polynomial: Monomials | None = None
    terms: list[Annotated[Term, BeforeValidator(lambda v: {"expression": v} if isinstance(v, str) else v)]] = []

    def build(self) -> "list[bg.Term]":
        """The terms of the package."""
        monomials = () if self.polynomial is None else bg.polynomial(**self.polynomial.given())
        return [*monomials, *(bg.Term(**term.given()) for term in self.terms)]


def _as_terms(given: Any) -> Any:
    return {"terms": [given] if isinstance(given, str) else given} if isinstance(given, str | list) else given


Dictionary = dict[str, Annotated[Terms, BeforeValidator(_as_terms)]]


class _Prior(Section):
    """A key that the file leaves out has the default of the package: None stands for it here."""

    def build(self) -> Any:
        """The prior of the package."""
        return getattr(bg, type(self).__name__)(**self.given("kind"))


class Normal(_Prior):
    """The fields of `bayes_greybox.Normal`."""

    kind: Literal["normal"]
    scale: Positive | None = None


class Laplace(_Prior):
    """The fields of `bayes_greybox.Laplace`."""

    kind: Literal["laplace"]
    scale: Positive | None = None


class RegularisedHorseshoe(_Prior):
    """The fields of `bayes_greybox.RegularisedHorseshoe`."""

    kind: Literal["regularised_horseshoe"]
    expected_active: Positive | None = None
    slab_scale: Positive | None = None
    slab_df: Positive | None = None


class SpikeAndSlab(_Prior):
    """The fields of `bayes_greybox.SpikeAndSlab`."""

    kind: Literal["spike_and_slab"]
    a: Positive | None = None
    b: Positive | None = None
    slab_scale: Positive | None = None
    enumerate_up_to: Annotated[int, Field(ge=0)] | None = None


KINDS = ("spike_and_slab", "laplace", "regularised_horseshoe", "normal")


def _check_kind(given: Any) -> Any:
    if isinstance(given, Mapping) and given.get("kind") not in KINDS:
        if "kind" not in given:
            raise wrong(f"needs the key 'kind'; known: {', '.join(KINDS)}")
        raise wrong(f"kind = {given['kind']!r} is not available; {suggestion(str(given['kind']), list(KINDS))}")
    if not isinstance(given, Mapping | Section):
        raise wrong('should be a table with the key kind, such as { kind = "laplace" }')
    return given


def _tag(given: Any) -> str:
    return f"<{given['kind'] if isinstance(given, Mapping) else given.kind}>"


Prior = Annotated[
    Annotated[SpikeAndSlab, Tag("<spike_and_slab>")]
    | Annotated[Laplace, Tag("<laplace>")]
    | Annotated[RegularisedHorseshoe, Tag("<regularised_horseshoe>")]
    | Annotated[Normal, Tag("<normal>")],
    Discriminator(_tag),
    BeforeValidator(_check_kind),
]


def _features(value: Any) -> Any:
    if all(type(count) is int and count > 0 for count in (value if isinstance(value, list) else [value])):
        return value
    raise wrong("should be a positive whole number, or a list with one for each variable")


class Discrepancy(Section):
    """The fields of `bayes_greybox.OrthogonalGP`, and the switch."""

    enabled: bool = True
    variant: Literal["projected", "conditioned", "printed", "none"] | None = None
    measure: Literal["empirical", "box", "box-monte-carlo"] | None = None
    kernel: Literal["squared_exponential", "matern32", "matern52"] | None = None
    path: Literal["hsgp", "exact"] | None = None
    variables: list[str] | None = None
    features: Annotated[int | list[int] | None, BeforeValidator(_features)] = None
    boundary: Annotated[float, Field(gt=1)] | None = None
    length_scale: Positive | None = None
    length_scale_spread: Positive | None = None
    amplitude: Positive | None = None
    monte_carlo: Count | None = None
    seed: Annotated[int, Field(ge=0)] | None = None

    def build(self) -> "bg.OrthogonalGP | None":
        """The process of the package, or None where it is switched off."""
        if not self.enabled:
            return None
        fields: dict[str, Any] = {
            key: tuple(value) if isinstance(value, list) else value for key, value in self.given("enabled").items()
        }
        return bg.OrthogonalGP(**fields)
