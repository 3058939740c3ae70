"""One learned equation, ready for the likelihood: its rows, its frame and its design."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import lsq_linear

from bayes_greybox.physics.terms import Term

from .design import Design, EquationDraws
from .design.protocol import PickRows
from .frame import Frame
from .rows.equation_rows import EquationRows, Table

Index = Int[np.ndarray, " n"] | slice


@dataclass(frozen=True)
class Equation:
    """One learned equation, or several that share their rows, with a frame fixed by the data and a design."""

    rows: EquationRows
    frame: Frame
    design: Design

    @property
    def target(self) -> Float[np.ndarray, " n_row"]:
        """Measured less simulated values, scaled units."""
        return self.rows.target / self.frame.target_scale

    def table(self, index: Index = slice(None)) -> Float[np.ndarray, "n n_column"]:
        """Return [Φ Ψ̃ y] in scaled units at rows, neither whitened nor compressed."""
        index = np.arange(self.rows.n_row)[index]
        return np.column_stack([self._terms(index), self.target[index]])

    def parts(
        self, index: Index = slice(None)
    ) -> tuple[Float[np.ndarray, "n n_term"], Float[np.ndarray, "n n_basis"], Float[np.ndarray, " n"]]:
        """Return Φ, Ψ̃ and y of `table`."""
        table, n_term = self.table(index), len(self.frame.dictionary)
        return table[:, :n_term], table[:, n_term:-1], table[:, -1]

    def discrepancy(self, draws: EquationDraws, index: Index = slice(None)) -> Float[np.ndarray, "n_draw n"]:
        """Return posterior draws of f at rows of the data, scaled units."""
        return self.design.at_data(self.parts(index)[1], index, draws)

    def weighted(self) -> PickRows:
        """Return observations by number, weighted by the inverse noise correlation; see `FeatureDesign.weighted`."""
        return self.design.weighted(self.rows, self.table)

    @cached_property
    def _terms(self) -> Table:
        """[Φ Ψ̃] by index of the rows."""
        frame, rows = self.frame, self.rows
        if rows.spread is None or not frame.jumps.places:
            return rows.table(lambda columns: np.column_stack([*frame.rows(columns)]), frame.dictionary.acts_on)
        # What is projected out of the features are the terms of the rows, jumps and all.
        terms = rows.table(lambda columns: np.asarray(frame.dictionary_rows(columns)), jumps=frame.jumps)
        plain = rows.table(lambda columns: np.asarray(frame.plain_features(columns)))

        def table(index: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n n_column"]:
            Phi = terms(index)
            return np.column_stack([Phi, np.asarray(frame.orthogonal(Phi, plain(index)))])

        return table

    def ridge(self) -> list[tuple[Term, float]]:
        """Return the terms with coefficients by least squares on the whitened rows, hardly shrunk; user's units.

        Coefficients with a normal prior of their own are drawn to it, and those with bounds are kept between them.
        """
        return self._named(self._least_squares[0])

    def moved(self, before: Sequence[tuple[Term, float]]) -> float:
        """Return the largest change of a coefficient of `ridge` from others, in its standard deviations."""
        theta, sd = self._least_squares[0], self.standard_deviations() / self.frame.coefficient_scale
        return float(np.max(np.abs(theta - self._scaled(before)) / sd))

    def standard_deviations(self) -> Float[np.ndarray, " n_term"]:
        """Return the standard deviations of the coefficients of `ridge`, user's units."""
        _, precision = self._least_squares
        sd = np.sqrt(self.variance * np.diag(np.linalg.inv(precision)))
        return sd * np.asarray(self.frame.coefficient_scale)

    def log_density(self, at: Sequence[tuple[Term, float]]) -> float:
        """Return the log density of the samples and of stated priors at other coefficients, up to a constant."""
        theta, stated, n = self._scaled(at), self.design.coefficients, self.rows.n_white
        square = np.sum(self._residual(theta) ** 2) * (self.frame.target_scale * self.rows.gain) ** 2
        log_likelihood = -0.5 * (n * math.log(square / n) + float(self.rows.noise.log_det))
        return log_likelihood - 0.5 * float(self._stated_weight @ (theta - np.asarray(stated.mean)) ** 2)

    def damped(self, at: Sequence[tuple[Term, float]], damping: float) -> tuple[list[tuple[Term, float]], float]:
        """Return coefficients after a Levenberg–Marquardt step from others, and the gain that it promises, nats.

        (H + μ diag H) θ' = b + μ diag H θ within the bounds, with H θ = b the equation of `ridge`.
        """
        (precision, pull), extra = self._normal, damping * np.diag(self._normal[0])
        whole = self._bounded(precision + np.diag(extra), pull + extra * self._scaled(at))
        moved = self._named(whole)
        return moved, self.log_density(moved) - self.log_density(at)

    @cached_property
    def _least_squares(self) -> tuple[Float[np.ndarray, " n_term"], Float[np.ndarray, "n_term n_term"]]:
        """Coefficients of `ridge`, scaled units, and their precision over that of the noise."""
        precision, pull = self._normal
        return self._bounded(precision, pull), precision

    @cached_property
    def _normal(self) -> tuple[Float[np.ndarray, "n_term n_term"], Float[np.ndarray, " n_term"]]:
        """Precision H and pull b of the rows and of the stated priors, over the precision of the noise: H θ = b."""
        Phi, y, stated = np.asarray(self.design.Phi), np.asarray(self.design.y), self.design.coefficients
        precision, pull = Phi.T @ Phi, Phi.T @ y
        precision = precision + 1e-6 * np.diag(np.diag(precision))
        if not stated.stated:
            return precision, pull
        variance = np.sum(self._residual(np.linalg.solve(precision, pull)) ** 2) / float(self.design.n_obs)
        weight = variance * self._stated_weight
        return precision + np.diag(weight), pull + weight * np.asarray(stated.mean)

    def _bounded(self, precision: np.ndarray, pull: np.ndarray) -> Float[np.ndarray, " n_term"]:
        """Minimise ½ θᵀHθ − bᵀθ within the stated bounds."""
        theta, stated = np.linalg.solve(precision, pull), self.design.coefficients
        lower, upper = np.asarray(stated.lower), np.asarray(stated.upper)
        if not stated.stated or np.all((theta >= lower) & (theta <= upper)):
            return theta
        # As a least squares problem in units in which the precision is a correlation.
        unit = 1.0 / np.sqrt(np.diag(precision))
        L = np.linalg.cholesky(precision * np.outer(unit, unit))
        solution = lsq_linear(L.T, np.linalg.solve(L, pull * unit), (lower / unit, upper / unit), method="bvls")
        return np.clip(solution.x * unit, lower, upper)

    @cached_property
    def variance(self) -> float:
        """Variance of the whitened rows about the estimate of `ridge`, scaled units."""
        theta, _ = self._least_squares
        square = np.sum(self._residual(theta) ** 2)
        return float(square) / max(float(self.design.n_obs) - len(theta), 1.0)

    @property
    def _stated_weight(self) -> Float[np.ndarray, " n_term"]:
        """Precision of the stated prior of each coefficient; zero under the model's prior."""
        stated = self.design.coefficients
        weight = 1.0 / np.asarray(stated.sd) ** 2
        weight[list(stated.shared)] = 0.0
        return weight

    def _residual(self, theta: np.ndarray) -> Float[np.ndarray, " n_row"]:
        return np.asarray(self.design.y) - np.asarray(self.design.Phi) @ theta

    def _named(self, theta: Float[np.ndarray, " n_term"]) -> list[tuple[Term, float]]:
        values = (theta * self.frame.coefficient_scale).tolist()
        return list(zip(self.frame.dictionary.terms, values, strict=True))

    def _scaled(self, coefficients: Sequence[tuple[Term, float]]) -> Float[np.ndarray, " n_term"]:
        return np.array([value for _, value in coefficients]) / self.frame.coefficient_scale

    def without(self, out: Sequence[int] | Int[np.ndarray, " n_out"]) -> "Equation":
        """Return the equation without the targets of some rows, or whitened coefficients where R is singular."""
        gone = np.unique(np.asarray(out, int))
        removal = self.rows.without(gone)
        return replace(self, design=self.design.without(self.rows, self.table, gone, removal))
