"""The table that hypotheses are made of: target and regressors at the rows, each with its prior."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from .noise.latent_force import LatentForce

FREE, CORRECTION, SENSOR, EFFECT = "free", "correction", "sensor", "effect"
"""Kinds of regressors: the user's terms, the simulation's coefficients, sensor errors, effects of the catalogue."""


@dataclass(frozen=True)
class Regressor:
    """What the search needs to know of one column.

    Attributes:
        kind: One of `FREE`, `CORRECTION`, `SENSOR`, `EFFECT`.
        group: Columns of one group exclude each other: the values of an effect's nonlinear parameters.
        name: What its probability counts for in the tables: an effect's slug, else the group.
        family: Effects of one family are one answer to a user, such as dry friction.
        quantity: Columns of the data that an effect is a function of.
        bends: Whether an effect has a nonlinear parameter.
        sd: Prior standard deviation of its coefficient, in the unit of the target per unit of the column.
        log_weight: Log prior weight of this value of the nonlinear parameters among those of its group.
        sign: Sign that physics expects of its coefficient; 0 where it expects none.
        expected: What its coefficient is about as large as; 0 where nothing is known.
        limit: Largest size of its coefficient, in prior standard deviations; infinite where there is none.
    """

    kind: str
    group: str
    name: str
    sd: float
    family: str = ""
    quantity: tuple[str, ...] = ()
    bends: bool = False
    log_weight: float = 0.0
    sign: int = 0
    expected: float = 0.0
    limit: float = math.inf

    @property
    def ranged(self) -> bool:
        """Return whether its prior is no plain normal density."""
        return bool(self.sign or self.expected or math.isfinite(self.limit))


@dataclass(frozen=True)
class Features:
    """Features of a discrepancy.

    Attributes:
        rows: What they do to the rows.
        acting: Themselves at the samples, in the unit of the force; the very rows where these are rates.
    """

    rows: Float[np.ndarray, "n_row n_feature"]
    acting: Float[np.ndarray, "n_sample n_feature"]

    def beside(self, other: "Features") -> "Features":
        """Return these features with others."""
        return Features(np.hstack([self.rows, other.rows]), np.hstack([self.acting, other.acting]))


@dataclass(frozen=True)
class RegressorTable:
    """Target and regressors at rows in order of time, each run by itself.

    Attributes:
        regressors: One for each column.
        target: y, of unit size.
        columns: X.
        acting: The regressors themselves at the samples, in the unit of the force; zero of what acts on a sensor alone.
        force: How a latent force and the sensor's noise act on the rows.
        block: Number of the block of the record that each row belongs to.
        law: Features of f; none where no f is weighed.
        frequency: Square roots of the Laplacian's eigenvalues of the features.
        memories: Elements of forces that remember, by what they are.
    """

    regressors: tuple[Regressor, ...]
    target: Float[np.ndarray, " n_row"]
    columns: Float[np.ndarray, "n_row n_column"]
    acting: Float[np.ndarray, "n_sample n_column"]
    force: LatentForce
    block: Int[np.ndarray, " n_row"]
    law: Features
    frequency: Float[np.ndarray, "n_feature n_variable"]
    memories: Mapping[str, Features] = field(default_factory=dict)

    def of_kind(self, kind: str) -> tuple[int, ...]:
        """Return the columns of one kind."""
        return tuple(i for i, each in enumerate(self.regressors) if each.kind == kind)
