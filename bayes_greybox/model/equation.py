"""One learned equation, ready for the likelihood: its rows, its frame and its design."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.physics.terms import Term

from .design import Design, EquationDraws, WeightedRows
from .frame import Frame
from .rows.equation_rows import EquationRows, Table

RIDGE = 1e-6
"""Shrinkage of the estimate that rows are taken near, over the mean square of a column."""


@dataclass(frozen=True)
class Equation:
    """One learned equation, or several that share their rows.

    Attributes:
        rows: What was measured, and with what noise.
        frame: Scaling and bases, fixed by the data.
        design: What the likelihood sees of the rows.
    """

    rows: EquationRows
    frame: Frame
    design: Design

    @property
    def target(self) -> Float[np.ndarray, " n_row"]:
        """Measured less simulated, scaled units."""
        return self.rows.target / self.frame.target_scale

    def table(self, index: Int[np.ndarray, " n"] | slice = slice(None)) -> Float[np.ndarray, "n n_column"]:
        """[Φ Ψ̃ y] in scaled units at rows, neither whitened nor compressed."""
        index = np.arange(self.rows.n_row)[index]
        return np.column_stack([self._terms(index), self.target[index]])

    def parts(
        self, index: Int[np.ndarray, " n"] | slice = slice(None)
    ) -> tuple[Float[np.ndarray, "n n_term"], Float[np.ndarray, "n n_basis"], Float[np.ndarray, " n"]]:
        """Φ, Ψ̃ and y of `table`."""
        table, n_term = self.table(index), len(self.frame.dictionary)
        return table[:, :n_term], table[:, n_term:-1], table[:, -1]

    def discrepancy(
        self, draws: EquationDraws, index: Int[np.ndarray, " n"] | slice = slice(None)
    ) -> Float[np.ndarray, "n_draw n"]:
        """Posterior draws of f at rows of the data, scaled units."""
        return self.design.at_data(self.parts(index)[1], index, draws)

    def weighted(self) -> Callable[[Int[np.ndarray, " n"]], WeightedRows]:
        """Observations by number, weighted by the inverse noise correlation; see `Design.weighted`."""
        return self.design.weighted(self.frame, self.rows, self.table)

    @cached_property
    def _terms(self) -> Table:
        """[Φ Ψ̃] by index of the rows."""
        return self.rows.table(
            lambda columns: np.column_stack([np.asarray(part) for part in self.frame.rows(columns)]),
            self.frame.dictionary.acts_on,
        )

    def ridge(self) -> list[tuple[Term, float]]:
        """Its terms with coefficients by least squares on the whitened rows, hardly shrunk; user's units.

        Coefficients with a normal prior of their own are drawn to it, and those with bounds are kept between them.
        """
        theta = self._least_squares[0] * self.frame.coefficient_scale
        return list(zip(self.frame.dictionary.terms, theta.tolist(), strict=True))

    def moved(self, before: Sequence[tuple[Term, float]]) -> float:
        """Largest change of a coefficient of `ridge` from others, in its standard deviations."""
        theta, precision = self._least_squares
        Phi, y = np.asarray(self.design.Phi), np.asarray(self.design.y)
        variance = np.sum((y - Phi @ theta) ** 2) / max(self.rows.n_white - len(theta), 1)
        change = theta - np.array([value for _, value in before]) / self.frame.coefficient_scale
        return float(np.max(np.abs(change) / np.sqrt(variance * np.diag(np.linalg.inv(precision)))))

    def log_likelihood(self) -> float:
        """Of the samples behind the rows at the estimate of `ridge`, σ profiled out, up to a constant; user's units."""
        Phi, y, n = np.asarray(self.design.Phi), np.asarray(self.design.y), self.rows.n_white
        unit = self.frame.target_scale * self.rows.gain
        square = np.sum((y - Phi @ self._least_squares[0]) ** 2) * unit**2
        return -0.5 * (n * math.log(square / n) + float(self.rows.noise.log_det))

    @cached_property
    def _least_squares(self) -> tuple[Float[np.ndarray, " n_term"], Float[np.ndarray, "n_term n_term"]]:
        """Coefficients of `ridge`, scaled units, and their precision over that of the noise."""
        Phi, y, stated = np.asarray(self.design.Phi), np.asarray(self.design.y), self.design.coefficients
        precision = Phi.T @ Phi
        precision = precision + RIDGE * np.diag(np.diag(precision))
        theta = np.linalg.solve(precision, Phi.T @ y)
        if stated.stated:
            variance = np.sum((y - Phi @ theta) ** 2) / float(self.design.n_obs)
            weight = variance / np.asarray(stated.sd) ** 2
            weight[list(stated.shared)] = 0.0
            precision = precision + np.diag(weight)
            theta = np.linalg.solve(precision, Phi.T @ y + weight * np.asarray(stated.mean))
            theta = np.clip(theta, np.asarray(stated.lower), np.asarray(stated.upper))
        return theta, precision

    def without(self, out: Sequence[int] | Int[np.ndarray, " n_out"]) -> "Equation":
        """The equation without the targets of some observations; the frame (scaling, measure, features) stays.

        Args:
            out: Observations to leave out: rows of the data, or whitened coefficients where R is singular.
        """
        gone = np.unique(np.asarray(out, int))
        removal = self.rows.without(gone)
        return replace(self, design=self.design.without(self.frame, self.rows, self.table, gone, removal))
