"""Columns that a hypothesis may hold: the user's terms, corrections, suspects, and effects by inner parameter."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.suspects.channels import ChannelSuspect
from bayes_greybox.discovery.suspects.memory import Memory
from bayes_greybox.physics.catalogue.effects import BoundEffect
from bayes_greybox.physics.terms import Term


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
        effect: The catalogue's entry, of an effect.
        inner: Values of its inner parameter.
        log_weight: Log prior weight of these values.
        suspect: The channel that is suspected, of a suspect.
        memory: What it is an element of, of a memory; which law it is.
        values: At the rows, scaled, of a suspect or a memory, and of an effect that remembers.
    """

    kind: str
    term: Term | None
    scale: float
    sd: float
    nominal: float = 0.0
    expected: float = 0.0
    effect: BoundEffect | None = None
    inner: Mapping[str, float] = field(default_factory=dict)
    log_weight: float = 0.0
    suspect: ChannelSuspect | None = None
    memory: Memory | None = None
    values: np.ndarray | None = None

    @property
    def formula(self) -> Term:
        """The term of a column that has one."""
        assert self.term is not None
        return self.term


def nodes(
    effect: BoundEffect, columns: Mapping[str, np.ndarray], values: np.ndarray | None = None,
    path: Trajectories | None = None, known: float | None = None,
) -> list[tuple[Term, dict]]:  # fmt: skip
    """The columns of one effect: one, or one for each value of its inner parameter with that value's prior weight.

    Args:
        effect: Effect bound to columns.
        columns: States and inputs, whose range scales the inner parameter's prior.
        values: Increasing values of the inner parameter; its own grid by default.
        path: The same columns with their times, for inner parameters that are times or frequencies.
        known: A value of the inner parameter that is to be on its own grid.

    Returns:
        Terms, each with what its column carries beside; none where the inner parameter is a share of nothing.
    """
    if not effect.effect.inner:
        return [(effect.term(), {"effect": effect})]
    (inner,) = effect.effect.inner
    low, high = limits(effect, columns, path)
    if high == 0:
        return []
    if values is None:
        values = inner.nodes(high / inner.high)[0]
        if known is not None and low < known < high:
            values = np.union1d(values, known)
    return [
        (
            effect.term({inner.name: float(v)}),
            {"effect": effect, "inner": {inner.name: float(v)}, "log_weight": float(w)},
        )
        for v, w in zip(values, log_weights(values, low, high), strict=True)
    ]


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
) -> tuple[float, float]:
    """Least and largest value of an effect's inner parameter, shares of what the column that it is of says.

    Args:
        effect: Effect bound to columns, with an inner parameter.
        columns: States and inputs.
        path: The same columns with their times, where there are any.
    """
    (inner,) = effect.effect.inner
    time, run = (None, None) if path is None else (path.time, path.run)
    size = inner.size(columns[effect.names[inner.of]], time, run)
    return inner.low * size, inner.high * size
