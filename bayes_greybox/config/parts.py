"""[simulation], [dictionary], [coefficients], [prior], [discrepancy] and [rows]: the parts of a model."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from bayes_greybox.running.errors import InputError
from bayes_greybox.running.limits import Count, Positive, is_finite

from .derived import AlsoAs, Switch, Table, section_of, table_of_kinds
from .section import Section, wrong

if TYPE_CHECKING:
    from bayes_greybox.physics import terms
    from bayes_greybox.physics.simulation.fmu.given import FMU


class Monomials(Section):
    """Arguments of `polynomial`."""

    variables: list[str]
    degree: Count
    interactions: bool = True
    constant: bool = False


Finite = Annotated[float, Field(allow_inf_nan=False)]
Pair = tuple[Finite, Finite]


class Term(Section):
    """One term with a name or a unit of its own, or with what is known of its coefficient, in the data's units."""

    expression: str
    name: str = ""
    unit: str | None = None
    sign: Literal["+", "-"] | None = None
    prior: Annotated[Pair | None, BeforeValidator(lambda v: _pair(v, "mean and standard deviation"))] = None
    fixed: Finite | None = None
    bounds: Annotated[Pair | None, BeforeValidator(lambda v: _pair(v, "least and largest value"))] = None

    @model_validator(mode="after")
    def _check_stated(self) -> Any:
        stated = self.given("expression", "name", "unit")
        if stated:
            from bayes_greybox.physics.coefficient import coefficient_of_term

            statement = [stated.get(key) for key in ("sign", "prior", "fixed", "bounds")]
            try:
                coefficient_of_term(self.name or self.expression, *statement)
            except InputError as error:
                raise wrong(str(error)) from None
        return self


class FMUFile(Section):
    """[simulation] with the key fmu: an FMU, and the arguments of `FMU` beside the file."""

    fmu: str
    parameters: dict[str, Finite] = {}
    states: dict[str, str] = {}
    inputs: dict[str, str] = {}
    outputs: dict[str, str] = {}
    starts: dict[str, str] = {}
    step: Positive | None = None

    def build(self, folder: Path) -> "FMU":
        """Return the simulation; relative paths start from the folder.

        Raises:
            InputError: The file cannot be used, or lacks a name.
        """
        from bayes_greybox.physics.simulation.fmu.given import FMU

        return FMU(folder / self.fmu, **self.given("fmu"))


def _kind_of_simulation(given: Any) -> str:
    # A state may be called fmu, too: its rate is no name of a file.
    named = isinstance(given, Mapping) and str(given.get("fmu", "")).lower().endswith(".fmu")
    return "<fmu>" if isinstance(given, FMUFile) or named else "<formulas>"


Simulation = Annotated[
    Annotated[dict[str, str], Tag("<formulas>")] | Annotated[FMUFile, Tag("<fmu>")],
    Discriminator(_kind_of_simulation),
    AlsoAs((dict[str, str], FMUFile), only=True),
]
"""Formulas by state, or an FMU."""


def _pair(given: Any, what: str) -> Any:
    numbers = isinstance(given, list) and len(given) == 2 and all(map(is_finite, given))
    if given is not None and not numbers:
        example = "[-50.0, 0.0]; for one of them alone use lower or upper of [coefficients]"
        raise wrong(f"must be {what} of the coefficient, such as {'[-40.0, 10.0]' if 'mean' in what else example}")
    return given if given is None else tuple(given)


def _coefficient(given: Any) -> type[Section]:
    from bayes_greybox.physics.coefficient import Coefficient

    return section_of(Coefficient)


Coefficients = dict[str, dict[str, Annotated[Any, Table(_coefficient)]]]


TermOrFormula = Annotated[
    Term, BeforeValidator(lambda v: {"expression": v} if isinstance(v, str) else v), AlsoAs((str,))
]


class Terms(Section):
    """The terms of one equation: those of the polynomial, then the listed ones."""

    polynomial: Monomials | None = None
    terms: list[TermOrFormula] = []

    def build(self) -> "list[terms.Term]":
        """Return the terms of the package."""
        from bayes_greybox.physics import terms

        monomials = () if self.polynomial is None else terms.polynomial(**self.polynomial.given())
        return [*monomials, *(terms.Term(**term.given()) for term in self.terms)]


def _as_terms(given: Any) -> Any:
    return {"terms": [given] if isinstance(given, str) else given} if isinstance(given, str | list) else given


Dictionary = dict[str, Annotated[Terms, BeforeValidator(_as_terms), AlsoAs((str, list[str | Term]))]]


def _priors() -> Mapping[str, type]:
    from bayes_greybox.model.priors import PRIORS

    return PRIORS


def _rows() -> Mapping[str, type]:
    from bayes_greybox.model.rows.kinds import ROW_KINDS

    return ROW_KINDS


def _discrepancy(given: Any) -> type[Section]:
    from bayes_greybox.model.gp.discrepancy import OrthogonalGP

    return section_of(OrthogonalGP, Switch)


Prior = Annotated[Any, table_of_kinds(_priors, "laplace")]
Rows = Annotated[Any, table_of_kinds(_rows, "derivative")]
Discrepancy = Annotated[Any, Table(_discrepancy)]
