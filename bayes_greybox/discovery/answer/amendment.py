"""The addition of a study to one equation, as rates at rows and as terms and weights for an integrator."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.grid.log_evidence import TINY, law_variances, modes
from bayes_greybox.discovery.grid.points import LAW
from bayes_greybox.discovery.grid.weigh import Hypothesis
from bayes_greybox.discovery.linearise.near import Near
from bayes_greybox.discovery.regressors.columns import EvaluatedColumns
from bayes_greybox.discovery.sensor_errors.channels import ChannelSuspect
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.row_kind import RowKind
from bayes_greybox.physics.hidden_states import HiddenState
from bayes_greybox.physics.simulation.protocol import KnownTerms
from bayes_greybox.physics.terms import Term

from .coefficients import Coefficients, factor_of

FEATURE_ROWS = 4096
"""Rows on which the features of f are evaluated at once."""


@dataclass(frozen=True)
class Remainder:
    """Posterior of the discrepancy f beside the added columns, orthogonal to them in the metric of R⁻¹.

    f(x) = (ψ(x) − φ(x) P) w, P the projection of the features ψ on the columns φ over the training rows. Being
    orthogonal, w, of mean `mean` and covariance WᵀW, W = `root`, is independent of the columns' coefficients, given η.
    """

    statistics: EvaluatedColumns
    indices: tuple[int, ...]
    projection: Float[np.ndarray, "n_column n_basis"]
    mean: Float[np.ndarray, " n_basis"]
    root: Float[np.ndarray, "n_basis n_basis"]

    @classmethod
    def of(cls, near: Near, hypothesis: Hypothesis, coefficients: Coefficients) -> "Remainder":
        """Return the f beside the columns of a hypothesis, at its likeliest noise point with a law."""
        weighed, regressors = near.weighed, near.regressors
        table, columns = weighed.table, regressors.columns
        laws = [k for k, point in enumerate(weighed.grid.points) if point.kind == LAW]
        number = max(laws, key=lambda k: (hypothesis.points[k], -k))
        point = weighed.grid.points[number]
        mode = modes(weighed.grid, weighed.precision, [hypothesis.members], np.array([number]), weighed.floor)
        v, mean = float(mode.v[0]), mode.mean[0]
        inside = np.flatnonzero(coefficients.draws.any(axis=0))
        likeliest = [int(np.bincount(column).argmax()) for column in coefficients.inner.T]
        every = (*coefficients.indices[: coefficients.n_own], *likeliest)
        indices = [every[k] for k in inside]
        of_sensors = [k for k, i in enumerate(hypothesis.members) if columns[i].suspect is not None]
        errors = table.columns[:, [hypothesis.members[k] for k in of_sensors]] @ mean[of_sensors]
        force = weighed.forces[point.shape]
        rows = np.column_stack([table.target - errors, table.columns[:, indices], table.law.rows])
        white = force.whiten_plain(rows)
        y, X, Psi = white[:, 0], white[:, 1 : 1 + len(indices)], white[:, 1 + len(indices) :]
        # (I − X X⁺) ψ
        projection = np.linalg.pinv(X, rcond=1e-12) @ Psi if indices else np.zeros((0, Psi.shape[1]))
        apart = Psi - X @ projection
        variance = v * point.ratio**2 * law_variances(table, point.scale)
        kept = variance > TINY * np.max(variance)
        inverse = np.linalg.inv(apart[:, kept].T @ apart[:, kept] / v + np.diag(1 / variance[kept]))
        weights, root = np.zeros(len(variance)), np.zeros((len(variance), len(variance)))
        weights[kept] = inverse @ (apart[:, kept].T @ y) / v
        root[np.ix_(kept, kept)] = factor_of(inverse)
        return cls(regressors, tuple(indices), projection, weights, root)

    def weights(self, n_draw: int, seed: int = 0) -> Float[np.ndarray, "n_draw n_basis"]:
        """Return posterior draws of w, scaled."""
        return self.mean + np.random.default_rng(seed).standard_normal((n_draw, len(self.mean))) @ self.root

    def rates(self, columns: Mapping[str, np.ndarray], n_draw: int) -> Float[np.ndarray, "n_draw n_row"]:
        """Return posterior draws of f at any rows, scaled."""
        weights, statistics = self.weights(n_draw), self.statistics
        parts = []
        for start in range(0, len(next(iter(columns.values()))), FEATURE_ROWS):
            part = {name: np.asarray(column)[start : start + FEATURE_ROWS] for name, column in columns.items()}
            psi = statistics.evaluate_features(part) - statistics.evaluate(self.indices, part) @ self.projection
            parts.append(weights @ psi.T)
        return np.concatenate(parts, axis=1)


class Added(NamedTuple):
    """Terms and features added to one right-hand side, each row of coefficients a draw."""

    terms: list[Term]
    coefficients: Float[np.ndarray, "n_draw n_term"]
    weights: Float[np.ndarray, "n_draw n_basis"]


@dataclass(frozen=True)
class Amendment:
    """The addition to one equation: columns of its statistics and posterior draws of their coefficients.

    Attributes:
        before: Coefficients of the user's own dictionary alone, scaled.
        sigma: Noise standard deviation of the rows after, user's units; with `gain` that of the sensor.
        corrected: Function that removes the sensors' errors from data of the same sensors.
        rows: Rows near the model after, if rows are linear only near one; None: those of the model before.
        sensors: Errors of the sensors of states and inputs that are in the model after, in their units.
        clock: Data whose time drifts are counted on; None: the data at hand.
        hidden: Hidden states of the model after, beside those of the model before.
        alike: Draws whose hidden states have these rates; None: all.
        forced: True if a latent force is part of the rows' noise.
        parameters: Values of parameters that act through hidden states.
        slopes: Sensitivities of hidden states to parameters, which columns of the draws depend on.
        remainder: Rest of the tangent at the values of parameters that were found, in the unit of the rate.
    """

    statistics: EvaluatedColumns
    before: Float[np.ndarray, " n_free"]
    after: Coefficients
    sigma: float
    discrepancy: Remainder | None = None
    corrected: Callable[[Trajectories], Trajectories] = lambda data: data
    rows: RowKind | None = None
    sensors: Mapping[ChannelSuspect, float] = field(default_factory=dict)
    clock: Trajectories | None = None
    hidden: tuple[HiddenState, ...] = ()
    alike: Int[np.ndarray, " n"] | None = None
    gain: float = 1.0
    forced: bool = False
    parameters: Mapping[str, float] = field(default_factory=dict)
    slopes: tuple[HiddenState, ...] = ()
    remainder: KnownTerms = ()

    @property
    def able(self) -> Int[np.ndarray, " n"]:
        """Return the numbers of all draws that one model can have."""
        return np.arange(len(self.after.draws)) if self.alike is None else self.alike

    def pick(self, n_draw: int) -> Int[np.ndarray, " n_draw"]:
        """Return draws that one model can have, evenly thinned or repeated to `n_draw`."""
        return self.able[np.linspace(0, len(self.able) - 1, n_draw).astype(int)]

    def model(self, before: Program) -> Program:
        """Return the model before with the rows, hidden states and sensitivities of the model after."""
        near = (before if self.rows is None else replace(before, rows=self.rows)).at(self.parameters)
        data = self.clock or self.statistics.path
        return near if data is None else near.remembering((*self.hidden, *self.slopes), data)

    @property
    def jumping(self) -> tuple[int, ...]:
        """Columns, before or after, that may jump."""
        inner = np.unique(self.after.inner).tolist()
        used = {*self.after.indices, *inner, *self.statistics.of_kind("free")}
        return tuple(int(i) for i in sorted(used) if self.statistics.columns[int(i)].formula.jumps)

    def rates(self, columns: Mapping[str, np.ndarray], n_draw: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the rates added at rows: before [n_row], and draws of after, with f [n_draw, n_row]."""
        statistics, n_own = self.statistics, self.after.n_own
        pick = self.pick(n_draw)
        beta, inner = self.after.draws[pick], self.after.inner[pick]
        after = beta[:, :n_own] @ statistics.evaluate(self.after.indices[:n_own], columns).T
        for k in range(inner.shape[1]):
            for index in np.unique(inner[:, k]):
                rows = inner[:, k] == index
                after[rows] += np.outer(beta[rows, n_own + k], statistics.evaluate([int(index)], columns)[:, 0])
        if self.discrepancy is not None:
            after += self.discrepancy.rates(columns, n_draw)
        rest = sum((value * np.asarray(term.evaluate(columns)) for term, value in self.remainder), np.zeros(()))
        return self.rates_before(columns), statistics.target_scale * after + rest

    def rates_before(self, columns: Mapping[str, np.ndarray]) -> Float[np.ndarray, " n_row"]:
        """Return the rate that the user's own dictionary adds to the simulation's at rows."""
        statistics = self.statistics
        return statistics.target_scale * statistics.evaluate(statistics.of_kind("free"), columns) @ self.before

    def terms_before(self) -> list[tuple[Term, float]]:
        """Return the terms of the user's own dictionary with their coefficients."""
        statistics, free = self.statistics, zip(self.statistics.of_kind("free"), self.before.tolist(), strict=True)
        columns = [(statistics.columns[i], b) for i, b in free]
        return [(c.formula, b * statistics.target_scale / c.scale) for c, b in columns]

    def added(self, n_before: int, n_draw: int) -> Added:
        """Return terms and features: `n_before` rows of coefficients of the model before, then draws of after.

        An effect has one column for each value of its nonlinear parameter that a draw has, with zeros in other draws.
        The projection of f on the columns, −φ P w, is in the columns' coefficients.
        """
        statistics, f, n_own = self.statistics, self.discrepancy, self.after.n_own
        pick = self.pick(n_draw)
        beta, inner = self.after.draws[pick], self.after.inner[pick]
        indices = list(dict.fromkeys([*self.after.indices[:n_own], *np.unique(inner), *(f.indices if f else ())]))
        place = {index: k for k, index in enumerate(indices)}
        values = np.zeros((n_before + n_draw, len(indices)))
        values[:n_before, : len(self.before)] = self.before
        after = values[n_before:]
        after[:, :n_own] = beta[:, :n_own]
        for k in range(inner.shape[1]):
            after[np.arange(n_draw), [place[index] for index in inner[:, k]]] += beta[:, n_own + k]
        weights = np.zeros((n_before + n_draw, 0))
        if f is not None:
            w = f.weights(n_draw)
            after[:, [place[index] for index in f.indices]] -= w @ f.projection.T
            weights = statistics.target_scale * np.vstack([np.zeros((n_before, w.shape[1])), w])
        appear = np.flatnonzero(values.any(axis=0))
        chosen = [statistics.columns[indices[k]] for k in appear]
        scale = np.array([statistics.target_scale / column.scale for column in chosen])
        known = np.zeros((len(values), len(self.remainder)))
        known[n_before:] = [value for _, value in self.remainder]
        terms = [*(column.formula for column in chosen), *(term for term, _ in self.remainder)]
        return Added(terms, np.hstack([values[:, appear] * scale, known]), weights)

    def features(self, columns: Mapping[str, Array] | Mapping[str, np.ndarray]) -> Array | np.ndarray:
        """Return the features of f before projection, for an integrator; beyond their domain they are constant."""
        return self.statistics.features_at(columns)

    def orthogonal_features(self, columns: Mapping[str, Array] | Mapping[str, np.ndarray]) -> Array | np.ndarray:
        """Return the features of f less their projection on the columns, ψ − φ P; without f the features."""
        psi, f = self.features(columns), self.discrepancy
        for index, taken in zip(f.indices, f.projection, strict=True) if f is not None else ():
            column = self.statistics.columns[index]
            phi = column.formula.evaluate(columns) / column.scale
            psi = psi - phi[:, None] * taken
        return psi
