"""Columns that a hypothesis may hold: the user's terms, corrections, suspects, and effects by inner parameter."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.sensor_errors.channels import ChannelSuspect
from bayes_greybox.discovery.sensor_errors.memory import Memory
from bayes_greybox.model.gp.features import HilbertBasis
from bayes_greybox.physics.catalogue.effects import BoundEffect
from bayes_greybox.physics.terms import Term

from .clouds import Cloud


@dataclass(frozen=True)
class Nearer:
    """What a set gains on rows near itself by a column that stands in the place of another.

    Attributes:
        gain: Nats.
        beside: What the set's other columns are called; no other set gains anything.
    """

    gain: float
    beside: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Column:
    """One column of the table.

    Attributes:
        kind: "free" (a term of the user's dictionary), "correction" (a term of the simulation), "suspect" (something
            about the measurement), "effect", "memory" (an element of a force that remembers) or "law" (next to an
            effect's, and in no catalogue).
        term: Its formula over the data's columns and its hidden states; None for a suspect or a memory, which are
            known at the rows only.
        scale: RMS over the data, user's units.
        sd: Prior standard deviation of its coefficient, scaled units.
        nominal: The simulation's own coefficient, of a correction; that of an input which acts otherwise, of an effect.
        expected: What the coefficient of such an effect is about as large as, scaled units; 0 where nothing is known.
        direction: Sign of the simulation's own coefficient of the input that an effect is of; an input that brakes has
            what a drive has with the other sign.
        effect: The catalogue's entry, of an effect.
        inner: Values of its inner parameters.
        log_weight: Log prior weight of these values.
        suspect: The channel that is suspected, of a suspect.
        memory: What it is an element of, of a memory; which law it is.
        values: At the rows, scaled, of a suspect or a memory, and of an effect that remembers.
        drawn: Where the values of several inner parameters were drawn from; None: they are on the first grid.
        nearer: What it gains on rows near itself.
        law: What a law with inner parameters is at their values: an effect that is in no catalogue.
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
    memory: Memory | None = None
    values: np.ndarray | None = None
    drawn: Cloud | None = None
    nearer: Nearer | None = None
    law: BoundEffect | None = None

    @property
    def shape(self) -> BoundEffect | None:
        """What the column is at its values of inner parameters: the catalogue's entry, or a law next to it."""
        return self.effect or self.law

    @property
    def sign(self) -> int:
        """Return the usual sign of an effect's coefficient; 0 of all others, and where it has none."""
        return 0 if self.effect is None else self.effect.effect.sign * self.direction

    @property
    def called(self) -> str:
        """An error by its key, an effect on its columns, a memory by what it is, or a term."""
        if self.suspect is not None:
            return self.suspect.key
        if self.memory is not None:
            return self.memory.text
        return self.formula.text if self.effect is None else self.effect.label

    @property
    def formula(self) -> Term:
        """The term of a column that has one."""
        assert self.term is not None
        return self.term


@dataclass(frozen=True, eq=False)
class Values:
    """Values of an effect's nonlinear parameters that stand for all.

    Attributes:
        points: Values, in the order of the parameters.
        log_weights: Log prior weights; of all values together they add up to one.
    """

    points: Float[np.ndarray, "n_point n_inner"]
    log_weights: Float[np.ndarray, " n_point"]


def first_values(
    shape: BoundEffect, columns: Mapping[str, np.ndarray], path: Trajectories | None = None
) -> Values | None:
    """Return the first values of an effect's nonlinear parameters: middles of parts of equal prior probability.

    Args:
        shape: Effect bound to columns, with nonlinear parameters.
        columns: States and inputs, whose range scales the priors.
        path: The same columns with their times, for parameters that are times or frequencies.

    Returns:
        The values; None where a parameter is a share of nothing.
    """
    least, most = limits(shape, columns, path)
    if not np.all(most > 0):
        return None
    each = [inner.nodes(*ends)[0] for inner, *ends in zip(shape.effect.inner, least, most, strict=True)]
    points = np.array(list(product(*each)))
    return Values(points, np.full(len(points), -np.log(len(points))))


def at_values(shape: BoundEffect, values: Values, /, **about: Any) -> list[tuple[Term, dict]]:
    """Return the terms of an effect at values of its nonlinear parameters, each with what its column carries.

    Args:
        shape: Effect bound to columns.
        values: Of its parameters.
        about: What else their columns carry.
    """
    found = []
    for point, weight in zip(values.points, values.log_weights, strict=True):
        inner = {each.name: float(value) for each, value in zip(shape.effect.inner, point, strict=True)}
        found.append((shape.term(inner), {"effect": shape, "inner": inner, "log_weight": float(weight), **about}))
    return found


def log_weights(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """Log prior weights of values of an inner parameter, trapezoidal, so that grids of any spacing can be mixed.

    Args:
        values: Increasing.
        low: End of the log-uniform prior.
        high: Its other end.
    """
    position = np.log(np.asarray(values) / low) / np.log(high / low)
    edges = np.clip(np.concatenate([[0.0], (position[1:] + position[:-1]) / 2, [1.0]]), 0.0, 1.0)
    return np.log(np.maximum(np.diff(edges), 1e-12))


def limits(
    effect: BoundEffect, columns: Mapping[str, np.ndarray], path: Trajectories | None = None
) -> tuple[Float[np.ndarray, " n_inner"], Float[np.ndarray, " n_inner"]]:
    """Least and largest values of an effect's inner parameters, shares of what the columns that they are of say.

    Args:
        effect: Effect bound to columns, with inner parameters.
        columns: States and inputs.
        path: The same columns with their times, where there are any.
    """
    time, run = (None, None) if path is None else (path.time, path.run)
    inner = effect.effect.inner
    ends = np.array([each.ends(columns[effect.names[each.of]], time, run) for each in inner]).reshape(-1, 2)
    return ends[:, 0], ends[:, 1]


@runtime_checkable
class EvaluatedColumns(Protocol):
    """Columns of an equation and features of its f, at any samples: what equations and free runs are made of.

    `SufficientStatistics` are such columns; a study that was read has them without rows and products.
    """

    @property
    def equation(self) -> str:
        """The learned state or output."""
        ...

    @property
    def columns(self) -> list[Column]:
        """Terms of the model before and after."""
        ...

    @property
    def variables(self) -> tuple[str, ...]:
        """What f depends on."""
        ...

    @property
    def centre(self) -> Float[np.ndarray, " n_var"]:
        """Of the box that the data fill, user's units."""
        ...

    @property
    def half_width(self) -> Float[np.ndarray, " n_var"]:
        """Of the same box."""
        ...

    @property
    def basis(self) -> HilbertBasis:
        """Features of f."""
        ...

    @property
    def target_scale(self) -> float:
        """RMS of the measured rate less the simulation, user's units."""
        ...

    @property
    def path(self) -> Trajectories | None:
        """States and inputs where terms are evaluated, on rows of samples."""
        ...

    def of_kind(self, kind: str) -> list[int]:
        """Indices of the columns of one kind."""
        ...

    def evaluate(
        self, indices: Sequence[int], columns: Mapping[str, np.ndarray]
    ) -> Float[np.ndarray, "n_row n_column"]:
        """Chosen columns at any samples, scaled."""
        ...

    def evaluate_features(self, columns: Mapping[str, np.ndarray]) -> Float[np.ndarray, "n_row n_basis"]:
        """Features of f at any rows."""
        ...
