"""Statistics of all rows of an equation, whose number does not depend on that of the rows."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.coefficient import Coefficient
from bayes_greybox.physics.terms import Dictionary
from bayes_greybox.running.errors import InputError

from ..algebra.linalg import require_independent
from ..assemble import common_of, feature_design
from ..blocks import by_block
from ..equation import Equation
from ..gp.discrepancy import OrthogonalGP
from ..program import Program
from ..rows.equation_rows import EquationRows
from ..scaling import scaled_frame, with_measure


@dataclass(frozen=True, eq=False)
class RowStatistics:
    """All rows of one equation: a frame and a design are made of them without the rows.

    Attributes:
        ends: Least and largest value of each state and input, user's units.
        term_scale: RMS of each term, user's units.
        target_scale: RMS of the target, user's units.
        noise_floor: Least σ, scaled units.
        factor: Triangular factor of [Φ ψ y], whitened, scaled units.
        n_white: Number of white numbers that the rows carry.
        plain: The same factor without whitening, where that is another one.
    """

    n_row: int
    ends: Mapping[str, Float[np.ndarray, "2"]]
    term_scale: Float[np.ndarray, " n_term"]
    target_scale: float
    noise_floor: float
    factor: Float[np.ndarray, "n_column n_column"]
    n_white: int
    log_det: float = 0.0
    plain: Float[np.ndarray, "n_column n_column"] | None = None

    @property
    def digest(self) -> str:
        """Word that distinguishes these rows from others."""
        ends = np.concatenate([*self.ends.values()])
        scales = np.array([self.target_scale, self.noise_floor, self.log_det])
        parts = (ends, self.term_scale, scales, self.factor)
        total = hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts))
        return f"{self.n_row} rows ({total.hexdigest()[:8]})"

    def equation(
        self,
        sample: EquationRows,
        dictionary: Dictionary,
        discrepancy: OrthogonalGP | None,
        coefficients: Sequence[Coefficient | None],
    ) -> Equation:
        """Return the equation as the likelihood sees it, with a design of all rows, and some of them to look at.

        Raises:
            InputError: Collinear terms; statistics of another model.
        """
        name, n_term = sample.equation, len(dictionary)
        frame = scaled_frame(name, dictionary, discrepancy, self.ends, self.term_scale, self.target_scale)
        n_column = n_term + 1 + (0 if frame.basis is None else frame.basis.size)
        factors = [each for each in (self.factor, self.plain) if each is not None]
        if any(each.shape != (n_column, n_column) or not np.all(np.isfinite(each)) for each in factors):
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
    """Return equations by block, in the place of `model.assemble(data)` with all rows in `data`.

    Raises:
        InputError: See `RowStatistics.equation`.
    """
    dictionaries = by_block(model.blocks, model.dictionaries(sample))
    return {
        block: statistics[block].equation(
            model.equation_rows(sample, block), dictionary, model.discrepancy, model.priors_of(block, sample)
        )
        for block, dictionary in dictionaries.items()
    }
