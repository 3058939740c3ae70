"""[study] and [next]: the search for missing effects, and the ranking of next experiments."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from bayes_greybox.discovery.decision.criteria import Criteria
from bayes_greybox.running.limits import Count, NotNegative, Positive

from .derived import Table, section_of
from .section import Section, wrong


def _odds(given: Any) -> type[Section]:
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
        given = self.given("odds", "catalogue")
        if "catalogue" in self.model_fields_set:
            names = self.catalogue
            given["catalogue"] = (
                _located(names, folder) if isinstance(names, str) else [_located(name, folder) for name in names]
            )
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


def _located(name: str, folder: Path) -> str:
    """Return a catalogue of the package by its name, or a file by its path from the configuration's folder."""
    return str(folder / name) if name.endswith(".toml") else name


def _words(value: Any, what: str) -> Any:
    items = value if isinstance(value, list) and value else [value]
    if all(isinstance(item, str) for item in items):
        return value
    raise wrong(f"should be the name of a {what} in quotes, or a list of such names")
