"""Columns that a hypothesis may hold: terms, corrections, sensor errors, and effects by nonlinear parameter.

Values of several nonlinear parameters are drawn from importance-sampling proposals. Positions are shares of the
logarithms of the ranges, between which priors are uniform. Points of the first grid stand for the whole unit cube; a
cloud adds points from a normal density near a mode. All together are a sample of the mixture of these densities, so
that a point weighs

    w_i = 1 / (n₀ + Σ_c n_c q_c(s_i)),    ∫ L(s) ds ≈ Σ_i w_i L(s_i)

(Cornuet, Marin, Mira & Robert 2012, Scand. J. Stat. 39:798, with deterministic weights).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.stats import norm, qmc

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.sensor_errors.channels import ChannelSuspect
from bayes_greybox.model.frame import held_features, scaled_position
from bayes_greybox.model.gp.features import HilbertBasis
from bayes_greybox.model.rows.equation_rows import Columns
from bayes_greybox.physics.catalogue.effects import BoundEffect
from bayes_greybox.physics.terms import Term

CLOUD_POINTS, TRIED_FOR_ONE = 64, 8
"""Largest number of points of a cloud, and points that are drawn for each that it needs inside the cube."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of a normal density inside the unit cube, which has the share `inside` of it."""

    mean: Float[np.ndarray, " d"]
    covariance: Float[np.ndarray, "d d"]
    points: Float[np.ndarray, "n d"]
    inside: float

    @classmethod
    def around(cls, mean: Float[np.ndarray, " d"], covariance: Float[np.ndarray, "d d"]) -> "Cloud":
        """Draw the points evenly, by Sobol's sequence."""
        values, vectors = np.linalg.eigh(covariance)
        # The first point of the sequence is a corner.
        white = norm.ppf(qmc.Sobol(len(mean), scramble=False).random(CLOUD_POINTS * TRIED_FOR_ONE)[1:])
        drawn = mean + (white * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
        within = np.all((drawn > 0) & (drawn < 1), axis=1)
        return cls(mean, covariance, drawn[within][:CLOUD_POINTS], max(float(np.mean(within)), 1 / len(drawn)))

    def density(self, at: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
        """Return the density inside the cube."""
        values, vectors = np.linalg.eigh(self.covariance)
        values = np.maximum(values, np.finfo(float).tiny)
        square = np.sum(((at - self.mean) @ vectors) ** 2 / values, axis=-1)
        return np.exp(-0.5 * (square + np.sum(np.log(2 * np.pi * values)))) / self.inside


def weights_of(at: Float[np.ndarray, "n d"], drawn: Sequence[Cloud | None]) -> Float[np.ndarray, " n"]:
    """Return the log prior weights of points."""
    clouds = {id(cloud): cloud for cloud in drawn if cloud is not None}
    total = np.full(len(at), float(sum(cloud is None for cloud in drawn)))
    for cloud in clouds.values():
        total += len(cloud.points) * cloud.density(at)
    return -np.log(total)


@dataclass(frozen=True)
class Column:
    """One column of the table.

    Attributes:
        kind: "free" (a term of the user's dictionary), "correction" (a term of the simulation), "suspect" (an error of
            a sensor or an input), or "effect".
        term: Formula over the data's columns and its hidden states; None for a sensor error, which is known at the rows
            only.
        sd: Prior standard deviation of its coefficient, scaled units.
        nominal: The simulation's own coefficient: of a correction, or of the input that an effect changes.
        expected: Expected coefficient of such an effect, scaled units; 0 where nothing is known.
        direction: Sign of the simulation's own coefficient of the input that an effect is of; an input that brakes has
            the effects of a drive with the other sign.
        parameter: Name of the simulation's parameter whose slope the term is, and whose change its coefficient.
        limits: Least and largest value of its coefficient, in prior standard deviations.
    """

    kind: str
    term: Term | None
    scale: float
    sd: float
    nominal: float = 0.0
    expected: float = 0.0
    direction: int = 1
    effect: BoundEffect | None = None
    inner: Mapping[str, float] = field(default_factory=dict)
    log_weight: float = 0.0
    suspect: ChannelSuspect | None = None
    parameter: str = ""
    limits: tuple[float, float] = (-math.inf, math.inf)

    @property
    def sign(self) -> int:
        """Return the usual sign of an effect's coefficient; 0 for all others, and where it has none."""
        return 0 if self.effect is None else self.effect.effect.sign * self.direction

    @property
    def called(self) -> str:
        """Return the name: the key of an error, the label of an effect, of a parameter its own, or a term's text."""
        if self.parameter:
            return self.parameter
        if self.suspect is not None:
            return self.suspect.key
        return self.formula.text if self.effect is None else self.effect.label

    @property
    def formula(self) -> Term:
        """Return the term of a column that has one."""
        assert self.term is not None
        return self.term


@dataclass(frozen=True, eq=False)
class Values:
    """Values of an effect's nonlinear parameters that stand for all; prior weights of all add up to one at most."""

    points: Float[np.ndarray, "n_point n_inner"]
    log_weights: Float[np.ndarray, " n_point"]


def first_values(effect: BoundEffect, columns: Columns, path: Trajectories | None = None) -> Values | None:
    """Return first values of an effect's nonlinear parameters, equally likely; None where one is a share of nothing."""
    least, most = limits(effect, columns, path)
    if not np.all(most > 0):
        return None
    nodes = [inner.nodes(*ends) for inner, *ends in zip(effect.effect.inner, least, most, strict=True)]
    points = np.array(list(product(*nodes)))
    return Values(points, np.full(len(points), -np.log(len(points))))


def at_values(effect: BoundEffect, values: Values, /, **about: Any) -> list[tuple[Term, dict]]:
    """Return the terms of an effect at values of its nonlinear parameters, each with the fields of its column."""
    items = []
    for point, weight in zip(values.points, values.log_weights, strict=True):
        inner = {each.name: float(value) for each, value in zip(effect.effect.inner, point, strict=True)}
        items.append((effect.term(inner), {"effect": effect, "inner": inner, "log_weight": float(weight), **about}))
    return items


def log_weights(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return trapezoidal log prior weights of increasing values of a log-uniform parameter, on any grid."""
    position = np.log(np.asarray(values) / low) / np.log(high / low)
    edges = np.clip(np.concatenate([[0.0], (position[1:] + position[:-1]) / 2, [1.0]]), 0.0, 1.0)
    return np.log(np.maximum(np.diff(edges), 1e-12))


def limits(
    effect: BoundEffect, columns: Columns, path: Trajectories | None = None
) -> tuple[Float[np.ndarray, " n_inner"], Float[np.ndarray, " n_inner"]]:
    """Return the ends of an effect's nonlinear parameters, shares of its columns; times need the path instead."""
    time, run, columns = (None, None, columns) if path is None else (path.time, path.run, path.columns)
    inner = effect.effect.inner
    ends = np.array([each.ends(columns[effect.names[each.of]], time, run) for each in inner]).reshape(-1, 2)
    return ends[:, 0], ends[:, 1]


@dataclass(eq=False)
class EvaluatedColumns:
    """Columns of an equation and features of its f, at any samples: equations and free runs are made of these.

    Attributes:
        centre, half_width: Middle of the box that the columns fill in the data, and half its sides, user's units.
        target_scale: RMS of the measured rate less the simulation, user's units.
        path: States and inputs where terms are evaluated, in order of time, on rows of samples.
    """

    equation: str
    target_scale: float
    variables: tuple[str, ...]
    centre: Float[np.ndarray, " n_var"]
    half_width: Float[np.ndarray, " n_var"]
    basis: HilbertBasis
    columns: list[Column] = field(default_factory=list)
    path: Trajectories | None = field(default=None, repr=False)

    def of_kind(self, kind: str) -> list[int]:
        """Return the columns of one kind."""
        return [i for i, column in enumerate(self.columns) if column.kind == kind]

    def evaluate(self, indices: Sequence[int], columns: Columns) -> Float[np.ndarray, "n_row n_column"]:
        """Return chosen columns at any samples, scaled; sensor errors are known at the rows only."""
        return evaluated([(self.columns[i].formula, self.columns[i].scale) for i in indices], columns)

    def features_at(self, columns: Mapping[str, Any]) -> Any:
        """Return the features of f at any samples, of JAX or NumPy; beyond their domain they are constant."""
        return held_features(self.basis, scaled_position(columns, self.variables, self.centre, self.half_width))

    def evaluate_features(self, columns: Mapping[str, np.ndarray]) -> Float[np.ndarray, "n_row n_basis"]:
        """Return the features of f at any samples, of NumPy."""
        return np.asarray(self.features_at(columns))


def evaluated(chosen: Sequence[tuple[Term, float]], columns: Mapping[str, np.ndarray]) -> Float[np.ndarray, "n k"]:
    """Return terms over their scales."""
    parts = [np.asarray(term.evaluate(columns)) / scale for term, scale in chosen]
    return np.column_stack(parts) if parts else np.zeros((len(next(iter(columns.values()))), 0))
