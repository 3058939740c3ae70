"""What a study answered beside what was hidden: the part of a row that benchmarks of studies share."""

from collections.abc import Mapping
from dataclasses import dataclass

import pandas as pd

SURE = 0.9
"""A wrong name above this probability is a confident one."""


@dataclass(frozen=True, eq=False)
class Answer:
    """The answer of one study.

    Attributes:
        truth: Coefficients of what was hidden, by slug; none of a control.
        verdict: Of the study.
        effects: What it weighed: slug, probability, lower, upper, tied_with, status and more.
        suspects: Of the measurement: suspect and status.
    """

    truth: Mapping[str, float]
    verdict: str
    effects: pd.DataFrame
    suspects: pd.DataFrame

    @property
    def table(self) -> pd.DataFrame:
        """Rows of the effects that were added, by slug."""
        return self.effects[self.effects["status"] == "added"].set_index("slug")

    @property
    def names(self) -> set[str]:
        """Slugs of the effects that were added."""
        return set(self.table.index)

    @property
    def added(self) -> dict[str, float]:
        """Probabilities of the effects that were added, by slug."""
        return {slug: float(row["probability"]) for slug, row in self.table.to_dict("index").items()}

    @property
    def tied(self) -> set[str]:
        """Slugs of what was added, and of what the data cannot tell from it."""
        table = self.table
        return set(table.index).union(*table["tied_with"]) if len(table) else set()

    @property
    def wrong(self) -> list[str]:
        """Slugs of what is not there, above `SURE` or in a verdict *named*."""
        sure = set(self.effects.loc[self.effects["probability"] > SURE, "slug"])
        return sorted((self.names if self.verdict == "named" else sure) - set(self.truth))

    @property
    def covered(self) -> dict[str, bool]:
        """Whether its 90 % interval holds the coefficient of what was hidden and found, by slug."""
        table = self.table
        return {
            slug: bool(table.loc[slug, "lower"] <= truth <= table.loc[slug, "upper"])
            for slug, truth in self.truth.items()
            if slug in table.index
        }

    @property
    def instrument(self) -> list[str]:
        """Suspects that are in the model."""
        return self.suspects.loc[self.suspects["status"] != "", "suspect"].tolist()
