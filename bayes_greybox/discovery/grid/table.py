"""The table that hypotheses are made of: target and regressors at the rows, each with its prior."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from .latent_force import LatentForce

FREE, CORRECTION, SENSOR, EFFECT = "free", "correction", "suspect", "effect"
"""Kinds of regressors, as files have them: own terms, the simulation's coefficients, errors of channels, effects."""


FREE_SCALE = 10.0
"""Prior standard deviation of the user's terms without a stated one, in units of the target."""


@dataclass(frozen=True)
class Regressor:
    """Prior and names of one column, for the search.

    Attributes:
        group: Name of the columns that exclude each other: the values of an effect's nonlinear parameters.
        name: Name in the tables of probabilities: an effect's slug, else the group.
        sd: Prior standard deviation of its coefficient, in the unit of the target per unit of the column.
        log_weight: Log prior weight of this value of the nonlinear parameters among those of its group.
        sign, expected: Sign and size that physics expects of its coefficient; 0 where it expects none.
        limits: Least and largest value of its coefficient, in prior standard deviations.
        sure: Name that it shares with other errors of sensors, of which one at least is sure to be there; "" for none.
    """

    kind: str
    group: str
    name: str
    sd: float
    quantity: tuple[str, ...] = ()
    bends: bool = False
    log_weight: float = 0.0
    sign: int = 0
    expected: float = 0.0
    limits: tuple[float, float] = (-math.inf, math.inf)
    sure: str = ""

    @property
    def ranged(self) -> bool:
        """Return true if its prior is no plain normal density."""
        return bool(self.sign or self.expected or any(map(math.isfinite, self.limits)))


@dataclass(frozen=True)
class Features:
    """Features of a discrepancy: their effects on the rows, and themselves at the samples, in the unit of the force."""

    rows: Float[np.ndarray, "n_row n_feature"]
    acting: Float[np.ndarray, "n_sample n_feature"]


@dataclass(frozen=True)
class RegressorTable:
    """Target, of unit size, and regressors at rows in order of time, each run by itself.

    Attributes:
        acting: Regressors at the samples, in the unit of the force; zero for those that act on a sensor alone.
        law: Features of f; none where no f is weighed.
        frequency: Square roots of the Laplacian's eigenvalues of the features.
        memories: Elements of forces with memory, by the memory's name.
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

    @property
    def own(self) -> tuple[int, ...]:
        """Return the columns of the user's own terms that may have any size: those without a stated prior."""
        return tuple(of_any_size(self.regressors))

    def of_kind(self, kind: str) -> tuple[int, ...]:
        """Return the columns of one kind."""
        return tuple(i for i, each in enumerate(self.regressors) if each.kind == kind)


def of_any_size(regressors: Sequence[Any]) -> list[int]:
    """Return the places of the user's own terms without a stated prior, among regressors or columns."""
    return [i for i, each in enumerate(regressors) if each.kind == FREE and each.sd >= FREE_SCALE]
