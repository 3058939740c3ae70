"""[dictionary], [coefficients], [prior], [discrepancy] and [rows]: the parts of a model."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BeforeValidator

from bayes_greybox.data.limits import Count

from .derived import AlsoAs, Switch, Table, section_of, table_of_kinds
from .section import Section

if TYPE_CHECKING:
    from bayes_greybox.physics import terms


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


def _coefficient(given: Any) -> type[Section]:
    from bayes_greybox.model.coefficient import Coefficient

    return section_of(Coefficient)


Coefficients = dict[str, dict[str, Annotated[Any, Table(_coefficient)]]]


class Terms(Section):
    """The terms of one equation: those of the polynomial, then the listed ones."""

    polynomial: Monomials | None = None
    terms: list[Annotated[Term, BeforeValidator(lambda v: _as_term(v)), AlsoAs((str,))]] = []

    def build(self) -> "list[terms.Term]":
        """The terms of the package."""
        from bayes_greybox.physics import terms

        monomials = () if self.polynomial is None else terms.polynomial(**self.polynomial.given())
        return [*monomials, *(terms.Term(**term.given()) for term in self.terms)]


def _as_term(given: Any) -> Any:
    return {"expression": given} if isinstance(given, str) else given


def _as_terms(given: Any) -> Any:
    return {"terms": [given] if isinstance(given, str) else given} if isinstance(given, str | list) else given


Dictionary = dict[str, Annotated[Terms, BeforeValidator(_as_terms), AlsoAs((str, list[str | Term]))]]


def _priors() -> Mapping[str, type]:
    from bayes_greybox.model.priors import PRIORS

    return PRIORS


def _rows() -> Mapping[str, type]:
    from bayes_greybox.model.rows.kinds import ROWS

    return ROWS


def _discrepancy(given: Any) -> type[Section]:
    from bayes_greybox.model.gp.discrepancy import OrthogonalGP

    return section_of(OrthogonalGP, Switch)


Prior = Annotated[Any, table_of_kinds(_priors, "laplace")]
Rows = Annotated[Any, table_of_kinds(_rows, "derivative")]
Discrepancy = Annotated[Any, Table(_discrepancy)]
