"""[study]: how missing effects are looked for."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from bayes_greybox.discovery.decision.criteria import Criteria
from bayes_greybox.running.limits import Count

from .derived import Table, section_of
from .section import Section, wrong


def _odds(given: Any) -> type[Section]:
    from bayes_greybox.discovery.odds import Odds

    return section_of(Odds)


Odds = Annotated[Any, Table(_odds)]


class Study(Section):
    """[study]: arguments of `find_missing_effects`.

    The data that no decision is made on are those of [data]: test_fraction or the table test.
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
        """Catalogues that are files.

        Args:
            folder: Where their paths start.
        """
        names = [self.catalogue] if isinstance(self.catalogue, str) else self.catalogue
        return [folder / name for name in names if name.endswith(".toml")]

    def arguments(self, folder: Path) -> dict[str, Any]:
        """Arguments of `find_missing_effects`, for the keys that the file has.

        Args:
            folder: Where the paths of catalogues start.
        """
        given = self.given("odds", "catalogue")
        if "catalogue" in self.model_fields_set:
            names = self.catalogue
            found = [_located(name, folder) for name in ([names] if isinstance(names, str) else names)]
            given["catalogue"] = found[0] if isinstance(names, str) else found
        if self.odds is not None:
            given["odds"] = self.odds.build()
        return given


def _located(name: str, folder: Path) -> str:
    """A catalogue of the package by its name; a file by its path, from the configuration's folder."""
    return str(folder / name) if name.endswith(".toml") else name


def _words(value: Any, what: str) -> Any:
    items = value if isinstance(value, list) and value else [value]
    if all(isinstance(item, str) for item in items):
        return value
    raise wrong(f"should be the name of a {what} in quotes, or a list of such names")
