"""What a first pass over the rows finds: how many there are, and in which ranges and sizes."""

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
"""Different measured values up to which rows may be rounded: those of a converter of 17 bits. Steps of more of them are
below the least noise that is assumed anyway."""

Levels = Float[np.ndarray, " n_level"] | None
"""Different measured values, in increasing order; None where there are more than `MOST_LEVELS`."""


@dataclass(frozen=True, eq=False)
class Sizes:
    """Of the rows of one equation, or of several that share them.

    Attributes:
        n_at: Samples, or points of a path, that terms are evaluated at.
        n_white: White numbers that the rows carry.
        log_det: log|R|.
        low: Least value of each state and input there.
        high: Largest value.
        terms: Σ φ_j² of each term.
        target: Σ y².
        measured: Σ (y + g)².
        levels: Different measured values.
    """

    n_at: int
    n_white: int
    log_det: float
    low: Mapping[str, float]
    high: Mapping[str, float]
    terms: Float[np.ndarray, " n_term"]
    target: float
    measured: float
    levels: Levels

    @classmethod
    def of(cls, rows: EquationRows, dictionary: Dictionary) -> "Sizes":
        """Of some rows."""
        terms = np.zeros(len(dictionary))
        for start in range(0, rows.n_sample, ROWS_AT_ONCE):
            terms += np.sum(np.asarray(dictionary.evaluate(rows.at(slice(start, start + ROWS_AT_ONCE)))) ** 2, axis=0)
        return cls(
            n_at=rows.n_sample,
            n_white=rows.n_white,
            log_det=float(rows.noise.log_det),
            low={name: float(column.min()) for name, column in rows.columns.items()},
            high={name: float(column.max()) for name, column in rows.columns.items()},
            terms=terms,
            target=float(np.sum(rows.target**2)),
            measured=float(np.sum(rows.measured**2)),
            levels=_few(rows.measured),
        )

    @property
    def ends(self) -> dict[str, Float[np.ndarray, "2"]]:
        """Both ends of each state and input, in the place of their columns."""
        return {name: np.array([self.low[name], self.high[name]]) for name in self.low}

    def scales(self, rows: EquationRows, dictionary: Dictionary) -> tuple[Float[np.ndarray, " n_term"], float]:
        """RMS of each term, over the size of the state that it acts on where several are learned, and of the target.

        Args:
            rows: Some of the rows.
            dictionary: The terms.
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
            _least(self.low, other.low),
            _largest(self.high, other.high),
            self.terms + other.terms,
            self.target + other.target,
            self.measured + other.measured,
            levels,
        )


class Factors(NamedTuple):
    """Triangular factors of the rows [Φ ψ y] of a path.

    Attributes:
        white: Of the whitened rows.
        plain: Of the rows as they are.
    """

    white: Float[np.ndarray, "n_column n_column"]
    plain: Float[np.ndarray, "n_column n_column"]

    @classmethod
    def empty(cls, n_column: int) -> "Factors":
        """Of no rows."""
        return cls(empty_factor(n_column), empty_factor(n_column))

    def scaled(self, by: Float[np.ndarray, " n_column"]) -> "Factors":
        """With each column times a number."""
        return Factors(self.white * by, self.plain * by)

    def joined(self, other: "Factors") -> "Factors":
        """Of these rows and of others."""
        return Factors(*(joined(both) for both in zip(self, other, strict=True)))


@dataclass(frozen=True, eq=False)
class Extent:
    """Of all rows.

    Attributes:
        n_row: Rows.
        dropped: Rows with missing values, left out.
        n_run: Runs, each as often as chunks have a part of it.
        n_telling: Those of them that have a row of an equation.
        low: Least value of each state and input.
        high: Largest value.
        sizes: By equation.
        factors: By equation those of [Φ y], where rows are of paths, in the units of a sample.
    """

    n_row: int
    dropped: int
    n_run: int
    n_telling: int
    low: Mapping[str, float]
    high: Mapping[str, float]
    sizes: Mapping[str, Sizes]
    factors: Mapping[str, Factors] = field(default_factory=dict)

    @property
    def ends(self) -> dict[str, Float[np.ndarray, "2"]]:
        """Both ends of each state and input, in the place of their columns."""
        return {name: np.array([self.low[name], self.high[name]]) for name in self.low}

    def __add__(self, other: "Extent") -> "Extent":
        return Extent(
            self.n_row + other.n_row,
            self.dropped + other.dropped,
            self.n_run + other.n_run,
            self.n_telling + other.n_telling,
            _least(self.low, other.low),
            _largest(self.high, other.high),
            {name: sizes + other.sizes[name] for name, sizes in self.sizes.items()},
            {name: factors.joined(other.factors[name]) for name, factors in self.factors.items()},
        )


def together(extents: Iterable[Extent]) -> Extent:
    """Of several parts, added in their order.

    Raises:
        InputError: A column that is the same everywhere.
    """
    whole = reduce(lambda a, b: a + b, extents)
    check_varying({f'column "{name}"': ends for name, ends in whole.ends.items()})
    return whole


def _least(one: Mapping[str, float], other: Mapping[str, float]) -> dict[str, float]:
    return {name: min(low, other[name]) for name, low in one.items()}


def _largest(one: Mapping[str, float], other: Mapping[str, float]) -> dict[str, float]:
    return {name: max(high, other[name]) for name, high in one.items()}


def _few(values: Float[np.ndarray, " n"]) -> Levels:
    different = np.unique(values)
    return different if len(different) <= MOST_LEVELS else None
