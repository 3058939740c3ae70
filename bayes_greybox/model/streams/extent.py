"""Findings of a first pass over the rows: their number, ranges and sizes."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import reduce
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.columns import check_varying
from bayes_greybox.physics.terms import Dictionary

from ..algebra.stacking import empty_factor, joined
from ..rows.equation_rows import EquationRows

ROWS_AT_ONCE = 1 << 14
"""Rows whose terms are evaluated at once."""

MOST_LEVELS = 1 << 17
"""Most different measured values of rows that may be rounded: those of a converter of 17 bits. Steps of more of them
are below the least noise that is assumed anyway."""

Levels = Float[np.ndarray, " n_level"] | None
"""Different measured values, in increasing order; None where there are more than `MOST_LEVELS`."""

Ends = Mapping[str, Float[np.ndarray, "2"]]
"""Least and largest value of each state and input, in the place of their columns."""


def ends_of(columns: Mapping[str, Float[np.ndarray, " n"]]) -> Ends:
    """Return the least and the largest value of each column."""
    return {name: np.array([column.min(), column.max()], float) for name, column in columns.items()}


def _wider(one: Ends, other: Ends) -> Ends:
    return ends_of({name: np.concatenate([ends, other[name]]) for name, ends in one.items()})


@dataclass(frozen=True, eq=False)
class Sizes:
    """Numbers and sizes of the rows of one equation, or of several that share them.

    Attributes:
        n_at: Number of samples, or points of a path, that terms are evaluated at.
        n_white: Number of white numbers that the rows carry.
        log_det: log|R|.
        ends: Least and largest value of each state and input there.
        terms: Σ φ_j² of each term.
        target: Σ y².
        measured: Σ (y + g)².
        levels: Different measured values.
    """

    n_at: int
    n_white: int
    log_det: float
    ends: Ends
    terms: Float[np.ndarray, " n_term"]
    target: float
    measured: float
    levels: Levels

    @classmethod
    def of(cls, rows: EquationRows, dictionary: Dictionary) -> "Sizes":
        """Measure some rows."""
        terms = np.zeros(len(dictionary))
        for start in range(0, rows.n_sample, ROWS_AT_ONCE):
            part = rows.at(slice(start, start + ROWS_AT_ONCE))
            terms += np.sum(np.asarray(dictionary.evaluate(part)) ** 2, axis=0)
        return cls(
            n_at=rows.n_sample,
            n_white=rows.n_white,
            log_det=float(rows.noise.log_det),
            ends=ends_of(rows.columns),
            terms=terms,
            target=float(np.sum(rows.target**2)),
            measured=float(np.sum(rows.measured**2)),
            levels=_few(rows.measured),
        )

    def scales(self, rows: EquationRows, dictionary: Dictionary) -> tuple[Float[np.ndarray, " n_term"], float]:
        """Return the RMS of each term, over the size of forces on its learned state, and of the target.

        Some of the rows are enough to know these sizes.
        """
        acting = np.array([rows.learned[name].size for name in dictionary.acts_on] or [1.0])
        return np.sqrt(self.terms / self.n_at) / acting, float(np.sqrt(self.target / self.n_white))

    def __add__(self, other: "Sizes") -> "Sizes":
        levels = None
        if self.levels is not None and other.levels is not None:
            levels = _few(np.concatenate([self.levels, other.levels]))
        return Sizes(
            self.n_at + other.n_at,
            self.n_white + other.n_white,
            self.log_det + other.log_det,
            _wider(self.ends, other.ends),
            self.terms + other.terms,
            self.target + other.target,
            self.measured + other.measured,
            levels,
        )


class Factors(NamedTuple):
    """Triangular factors of the rows [Φ ψ y] of a path, whitened and as they are."""

    white: Float[np.ndarray, "n_column n_column"]
    plain: Float[np.ndarray, "n_column n_column"]

    @classmethod
    def empty(cls, n_column: int) -> "Factors":
        """Return the factors of no rows."""
        return cls(empty_factor(n_column), empty_factor(n_column))

    def scaled(self, by: Float[np.ndarray, " n_column"]) -> "Factors":
        """Return the factors with each column times a number."""
        return Factors(self.white * by, self.plain * by)

    def joined(self, other: "Factors") -> "Factors":
        """Return the factors of these rows and of others."""
        return Factors(*(joined(both) for both in zip(self, other, strict=True)))


@dataclass(frozen=True, eq=False)
class Extent:
    """Numbers, ranges and sizes of all rows.

    Attributes:
        dropped: Number of rows with missing values, left out.
        n_run: Number of runs, each as often as chunks have a part of it.
        n_telling: Number of those that have a row of an equation.
        factors: Factors of [Φ y] by equation, where rows are of paths, in the units of a sample.
    """

    n_row: int
    dropped: int
    n_run: int
    n_telling: int
    ends: Ends
    sizes: Mapping[str, Sizes]
    factors: Mapping[str, Factors] = field(default_factory=dict)

    def __add__(self, other: "Extent") -> "Extent":
        return Extent(
            self.n_row + other.n_row,
            self.dropped + other.dropped,
            self.n_run + other.n_run,
            self.n_telling + other.n_telling,
            _wider(self.ends, other.ends),
            {name: sizes + other.sizes[name] for name, sizes in self.sizes.items()},
            {name: factors.joined(other.factors[name]) for name, factors in self.factors.items()},
        )


def together(extents: Iterable[Extent]) -> Extent:
    """Add the extents of several parts in their order.

    Raises:
        InputError: A column that is the same everywhere.
    """
    whole = reduce(lambda a, b: a + b, extents)
    check_varying({f'column "{name}"': ends for name, ends in whole.ends.items()})
    return whole


def _few(values: Float[np.ndarray, " n"]) -> Levels:
    different = np.unique(values)
    return different if len(different) <= MOST_LEVELS else None
