"""What a first pass over the rows finds: how many there are, and in which ranges and sizes."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import reduce

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.columns import check_varying
from bayes_greybox.physics.terms import Dictionary

from ..rows.equation_rows import EquationRows

ROWS = 1 << 14
"""Rows whose terms are evaluated at once."""

LEVELS = 1 << 17
"""Different measured values up to which rows may be rounded: those of a converter of 17 bits. Steps of more of them are
below the least noise that is assumed anyway."""

Levels = Float[np.ndarray, " n_level"] | None
"""Different measured values, in increasing order; None where there are more than `LEVELS`."""


@dataclass(frozen=True, eq=False)
class Sizes:
    """Of the rows of one equation.

    Attributes:
        terms: Σ φ_j² of each term.
        target: Σ y².
        measured: Σ (y + g)².
        levels: Different measured values.
    """

    terms: Float[np.ndarray, " n_term"]
    target: float
    measured: float
    levels: Levels

    @classmethod
    def of(cls, rows: EquationRows, dictionary: Dictionary) -> "Sizes":
        """Of some rows, each at a sample of its own."""
        terms = np.zeros(len(dictionary))
        for start in range(0, rows.n_row, ROWS):
            terms += np.sum(np.asarray(dictionary.evaluate(rows.at(slice(start, start + ROWS)))) ** 2, axis=0)
        return cls(terms, float(np.sum(rows.target**2)), float(np.sum(rows.measured**2)), _few(rows.measured))

    def __add__(self, other: "Sizes") -> "Sizes":
        levels = None
        if self.levels is not None and other.levels is not None:
            levels = _few(np.concatenate([self.levels, other.levels]))
        return Sizes(self.terms + other.terms, self.target + other.target, self.measured + other.measured, levels)


@dataclass(frozen=True, eq=False)
class Extent:
    """Of all rows.

    Attributes:
        n_row: Rows.
        dropped: Rows with missing values, left out.
        low: Least value of each state and input.
        high: Largest value.
        sizes: By equation.
    """

    n_row: int
    dropped: int
    low: Mapping[str, float]
    high: Mapping[str, float]
    sizes: Mapping[str, Sizes]

    @property
    def ends(self) -> dict[str, Float[np.ndarray, "2"]]:
        """Both ends of each state and input, in the place of their columns."""
        return {name: np.array([self.low[name], self.high[name]]) for name in self.low}

    def __add__(self, other: "Extent") -> "Extent":
        return Extent(
            self.n_row + other.n_row,
            self.dropped + other.dropped,
            {name: min(low, other.low[name]) for name, low in self.low.items()},
            {name: max(high, other.high[name]) for name, high in self.high.items()},
            {name: sizes + other.sizes[name] for name, sizes in self.sizes.items()},
        )


def together(extents: Iterable[Extent]) -> Extent:
    """Of several parts, added in their order.

    Raises:
        InputError: A column that is the same everywhere.
    """
    whole = reduce(lambda a, b: a + b, extents)
    check_varying({f'column "{name}"': ends for name, ends in whole.ends.items()})
    return whole


def _few(values: Float[np.ndarray, " n"]) -> Levels:
    different = np.unique(values)
    return different if len(different) <= LEVELS else None
