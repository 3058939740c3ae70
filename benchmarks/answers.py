"""A study of a record, and its answer beside what was hidden: the part of a record that benchmarks of studies share."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pandas as pd

if TYPE_CHECKING:
    from bayes_greybox.data.trajectories import Trajectories
    from bayes_greybox.greybox import GreyBox
    from bayes_greybox.missing_effects import Study

SURE = 0.9
"""A wrong name above this probability is a confident one."""


def studied(model: "GreyBox", train: "Trajectories", **settings: Any) -> "tuple[Study, float]":
    """Study a record without sampling a posterior, and return the study and its seconds."""
    # Imported here: it brings JAX, which the modules that make the data do without.
    from bayes_greybox.missing_effects import find_missing_effects

    start = time.perf_counter()
    study = find_missing_effects(model, train, settle=False, progress=False, **settings)
    return study, time.perf_counter() - start


@dataclass(frozen=True, eq=False)
class Answer:
    """The answer of one study.

    Attributes:
        truth: Coefficients of the hidden effects, by slug; none of a control.
        verdict: Verdict of the study.
        effects: Weighed effects: slug, probability, lower, upper, tied_with, status and more.
        suspects: Weighed errors of the measurement: suspect and status.
    """

    truth: Mapping[str, float]
    verdict: str
    effects: pd.DataFrame
    suspects: pd.DataFrame

    @classmethod
    def of(cls, study: "Study", truth: Mapping[str, float]) -> "Answer":
        """Return the answer of a study."""
        return cls(truth, study.verdict, study.effects, study.instrument)

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
        """Slugs of the effects that were added, and of those that the data cannot tell from them."""
        table = self.table
        return set(table.index).union(*table["tied_with"]) if len(table) else set()

    @property
    def wrong(self) -> list[str]:
        """Slugs of effects that are not there, above `SURE` or in a verdict *named*."""
        sure = set(self.effects.loc[self.effects["probability"] > SURE, "slug"])
        return sorted((self.names if self.verdict == "named" else sure) - set(self.truth))

    @property
    def covered(self) -> dict[str, bool]:
        """True where the 90 % interval of a hidden effect that was added holds its coefficient, by slug."""
        table = self.table
        return {
            slug: bool(table.loc[slug, "lower"] <= truth <= table.loc[slug, "upper"])
            for slug, truth in self.truth.items()
            if slug in table.index
        }

    @property
    def instrument(self) -> list[str]:
        """Errors of the measurement that are in the model."""
        return self.suspects.loc[self.suspects["status"] != "", "suspect"].tolist()
