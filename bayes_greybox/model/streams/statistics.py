"""Statistics of all rows of an equation, whose number does not depend on that of the rows: sizes, then factors."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.columns import check_varying
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.algebra.compression import empty_factor, joined
from bayes_greybox.model.algebra.linalg import require_independent
from bayes_greybox.model.assemble import common_of, feature_design, sums_of_squares
from bayes_greybox.model.coefficient import by_block
from bayes_greybox.model.equation import Equation
from bayes_greybox.model.frame import scaled_frame, with_measure
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.equation_rows import EquationRows
from bayes_greybox.physics.coefficient import Coefficient
from bayes_greybox.physics.terms import Dictionary
from bayes_greybox.running.errors import InputError

MOST_LEVELS = 1 << 17
"""Most different measured values of rows that may be rounded: those of a converter of 17 bits. Steps of more of them
are below the least noise that is assumed anyway."""

Levels = Float[np.ndarray, " n_level"] | None
"""Different measured values, in increasing order; None where there are more than `MOST_LEVELS`."""

Ends = Mapping[str, Float[np.ndarray, "2"]]
"""Least and largest value of each state and input, in the place of their columns."""

Square = Float[np.ndarray, "n_column n_column"]


def ends_of(columns: Mapping[str, Float[np.ndarray, " n"]]) -> Ends:
    """Return the least and the largest value of each column."""
    return {name: np.array([column.min(), column.max()], float) for name, column in columns.items()}


def _wider(one: Ends, other: Ends) -> Ends:
    return ends_of({name: np.concatenate([ends, other[name]]) for name, ends in one.items()})


@dataclass(frozen=True, eq=False)
class Sizes:
    """Numbers and sizes of the rows of one equation, or of several that share them: Σ φ_j², Σ y², and Σ (y + g)².

    Terms are evaluated at `n_at` samples, or points of a path.
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
        target, measured = float(np.sum(rows.target**2)), float(np.sum(rows.measured**2))
        terms, log_det = sums_of_squares(rows, dictionary, 1 << 14), float(rows.noise.log_det)
        numbers = rows.n_sample, rows.n_white, log_det
        return cls(*numbers, ends_of(rows.columns), terms, target, measured, _few(rows.measured))

    def scales(self, rows: EquationRows, dictionary: Dictionary) -> tuple[Float[np.ndarray, " n_term"], float]:
        """Return the RMS of each term, over the size of forces on its learned state in some rows, and of the target."""
        acting = np.array([rows.learned[name].size for name in dictionary.acts_on] or [1.0])
        return np.sqrt(self.terms / self.n_at) / acting, float(np.sqrt(self.target / self.n_white))

    def __add__(self, other: "Sizes") -> "Sizes":
        levels = None
        if self.levels is not None and other.levels is not None:
            levels = _few(np.concatenate([self.levels, other.levels]))
        names = ("n_at", "n_white", "log_det", "terms", "target", "measured")
        sums = {name: getattr(self, name) + getattr(other, name) for name in names}
        return Sizes(ends=_wider(self.ends, other.ends), levels=levels, **sums)


class Factors(NamedTuple):
    """Triangular factors of the rows [Φ ψ y] of a path, whitened and as they are."""

    white: Square
    plain: Square

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
    """Numbers, ranges and sizes of all rows; `dropped` ones have missing values.

    Runs count as often as chunks have a part of them; `n_telling` have a row of an equation. Where rows are of paths,
    there are factors of [Φ y] by equation, in the units of a sample.
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
    """Add the extents of several parts in their order; a column that is the same everywhere is refused."""
    whole = reduce(lambda a, b: a + b, extents)
    check_varying({f'column "{name}"': ends for name, ends in whole.ends.items()})
    return whole


def _few(values: Float[np.ndarray, " n"]) -> Levels:
    different = np.unique(values)
    return different if len(different) <= MOST_LEVELS else None


@dataclass(frozen=True, eq=False)
class RowStatistics:
    """All rows of one equation, of which a frame and a design are made.

    Attributes:
        term_scale: RMS of each term, user's units.
        target_scale: RMS of the target, user's units.
        noise_floor: Least σ, scaled units.
        factor: Triangular factor of [Φ ψ y], whitened, scaled units.
        plain: The same factor without whitening, where that is another one.
    """

    n_row: int
    ends: Ends
    term_scale: Float[np.ndarray, " n_term"]
    target_scale: float
    noise_floor: float
    factor: Square
    n_white: int
    log_det: float = 0.0
    plain: Square | None = None

    @property
    def digest(self) -> str:
        """Word that distinguishes these rows from others."""
        ends = np.concatenate([*self.ends.values()])
        scales = np.array([self.target_scale, self.noise_floor, self.log_det])
        parts = (ends, self.term_scale, scales, self.factor)
        total = hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts))
        return f"{self.n_row} rows ({total.hexdigest()[:8]})"

    def equation(
        self, sample: EquationRows, dictionary: Dictionary, discrepancy: OrthogonalGP | None,
        coefficients: Sequence[Coefficient | None],
    ) -> Equation:  # fmt: skip
        """Return the equation as the likelihood sees it, with a design of all rows, and some of them to look at."""
        name, n_term = sample.equation, len(dictionary)
        frame = scaled_frame(name, dictionary, discrepancy, self.ends, self.term_scale, self.target_scale)
        factors = [each for each in (self.factor, self.plain) if each is not None]
        if any(each.shape != (frame.n_column, frame.n_column) or not np.all(np.isfinite(each)) for each in factors):
            raise InputError(f"The statistics of {name!r} are not those of its {n_term} terms and its discrepancy.")
        plain = self.factor if self.plain is None else self.plain
        require_independent(plain[:, :n_term], dictionary.names, name)
        if self.plain is not None and not sample.noise.derived:
            require_independent(self.factor[:, :n_term], dictionary.names, name)
        if discrepancy is not None:
            nodes = plain if discrepancy.measure == "unweighted" else self.factor
            frame = with_measure(frame, discrepancy, self.ends, nodes, self.n_white)
        common = common_of(frame, self.n_white, self.log_det, self.noise_floor, coefficients)
        design = feature_design(frame, discrepancy, self.factor, common)
        return Equation(replace(sample, n_all=self.n_row), frame, design)


def equations_of(model: Program, sample: Trajectories, statistics: Mapping[str, RowStatistics]) -> dict[str, Equation]:
    """Return equations by block, in the place of `model.assemble(data)` with all rows in `data`."""
    dictionaries = by_block(model.blocks, model.dictionaries(sample))
    equations = {}
    for block, dictionary in dictionaries.items():
        rows, priors = model.equation_rows(sample, block), model.priors_of(block, sample)
        equations[block] = statistics[block].equation(rows, dictionary, model.discrepancy, priors)
    return equations
