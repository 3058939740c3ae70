"""The sections of a model's parts, [simulation] to [rows], of a study and of the next experiment."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from bayes_greybox.config.section import AlsoAs, Section, Switch, Table, section_of, table_of_kinds, wrong
from bayes_greybox.discovery.decision.criteria import Criteria
from bayes_greybox.running.limits import Count, NotNegative, Positive, is_finite

if TYPE_CHECKING:
    from bayes_greybox.physics import parameters, terms
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
            coefficient_of_term(self.name or self.expression, *statement)
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
        """Return the simulation; relative paths start from the folder."""
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


class Parameter(Section):
    """A named number in the formulas of [simulation]; with `sd` it is learned in fits."""

    value: Finite
    sd: Positive | None = None
    lower: Finite | None = None
    upper: Finite | None = None
    unit: str | None = None

    @model_validator(mode="after")
    def _check_stated(self) -> Any:
        self.build()
        return self

    def build(self) -> "parameters.Parameter":
        """Return the parameter of the package."""
        from bayes_greybox.physics.parameters import Parameter

        ends = (self.lower, self.upper)
        return Parameter(self.value, self.sd, None if ends == (None, None) else ends, self.unit)


AnyParameter = Annotated[Parameter, BeforeValidator(lambda v: {"value": v} if is_finite(v) else v), AlsoAs((float,))]
Parameters = dict[str, AnyParameter]


def _start(given: Any) -> Any:
    if not (is_finite(given) or isinstance(given, str) and given):
        raise wrong("must be a number, or the column that has the value where a run starts, such as 1.0")
    return given


Starts = dict[str, Annotated[float | str, BeforeValidator(_start)]]


def _pair(given: Any, what: str) -> Any:
    numbers = isinstance(given, list) and len(given) == 2 and all(map(is_finite, given))
    if given is not None and not numbers:
        example = "[-50.0, 0.0]; for one of them alone use lower or upper of [coefficients]"
        raise wrong(f"must be {what} of the coefficient, such as {'[-40.0, 10.0]' if 'mean' in what else example}")
    return given if given is None else tuple(given)


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


def _part(name: str) -> Any:
    """Return a class, or a registry of classes, of the rooms of models, which are imported only where it is needed."""
    match name:
        case "prior":
            from bayes_greybox.model.priors import PRIORS as part
        case "rows":
            from bayes_greybox.model.rows.kinds import ROW_KINDS as part
        case "discrepancy":
            from bayes_greybox.model.gp.discrepancy import OrthogonalGP as part
        case _:
            from bayes_greybox.physics.coefficient import Coefficient as part
    return part


Coefficients = dict[str, dict[str, Annotated[Any, Table(lambda _: section_of(_part("coefficient")))]]]
Prior = Annotated[Any, table_of_kinds(lambda: _part("prior"), "laplace")]
Rows = Annotated[Any, table_of_kinds(lambda: _part("rows"), "derivative")]
Discrepancy = Annotated[Any, Table(lambda _: section_of(_part("discrepancy"), Switch))]


def _odds(given: Any) -> type[Section]:
    # A fit needs none of it.
    from bayes_greybox.discovery.odds import Odds

    return section_of(Odds)


Odds = Annotated[Any, Table(_odds)]


class Study(Section):
    """[study]: arguments of `find_missing_effects`.

    Data on which no decision is made are those of [data]: test_fraction or the table test.
    """

    catalogue: Annotated[str | list[str], BeforeValidator(lambda v: v if v == [] else _words(v, "catalogue"))] = (
        "mechanical"
    )
    roles: dict[str, Annotated[str | list[str], BeforeValidator(lambda v: _words(v, "column"))]] = {}
    effects_at_most: Count = 3
    negligible: Annotated[float, Field(ge=0.0, lt=1.0)] = Criteria.negligible
    odds: Odds = None
    settle: bool = True
    free_runs: bool = True
    interpolation: Literal["linear", "cubic", "zoh"] | None = None

    def files(self, folder: Path) -> list[Path]:
        """List the catalogues that are files; their paths start from the folder."""
        names = [self.catalogue] if isinstance(self.catalogue, str) else self.catalogue
        return [folder / name for name in names if name.endswith(".toml")]

    def arguments(self, folder: Path) -> dict[str, Any]:
        """Return the arguments of `find_missing_effects` for the keys in the file; paths start from the folder."""
        given = self.given("odds")
        if "catalogue" in given:
            given["catalogue"] = _located(self.catalogue, folder)
        if self.odds is not None:
            given["odds"] = self.odds.build()
        return given


class Next(Section):
    """[next]: arguments of `Study.next_experiment`; options of the command next go before them.

    Attributes:
        sensors: Standard deviation of the noise by channel.
        starts: States at the start, each a table of values by name.
    """

    signals: list[str] | None = None
    amplitudes: list[Positive] | None = None
    starts: list[dict[str, float]] | None = None
    sensors: dict[str, Positive] | None = None
    duration: Positive | None = None
    rows: Count | None = None
    batch: Count | None = None
    threshold: NotNegative | None = None
    outcomes: Count | None = None


def _located(catalogue: str | list[str], folder: Path) -> Any:
    """Return catalogues of the package by their names, and files by their paths from the configuration's folder."""
    if isinstance(catalogue, list):
        return [_located(each, folder) for each in catalogue]
    return str(folder / catalogue) if catalogue.endswith(".toml") else catalogue


def _words(value: Any, what: str) -> Any:
    items = value if isinstance(value, list) and value else [value]
    if all(isinstance(item, str) for item in items):
        return value
    raise wrong(f"should be the name of a {what} in quotes, or a list of such names")
