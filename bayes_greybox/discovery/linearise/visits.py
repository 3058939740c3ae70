"""Hypotheses weighed on rows near one of them, and the likeliest of several that were visited."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from bayes_greybox.discovery.grid.residuals import blocks
from bayes_greybox.discovery.grid.sets import Reach
from bayes_greybox.discovery.grid.table import Features, RegressorTable
from bayes_greybox.discovery.grid.weigh import weigh
from bayes_greybox.discovery.odds import Odds
from bayes_greybox.running.errors import InputError

from .near import Near, Point, Rows, as_regressor
from .source import Source

MOST_OUTER_ITERATIONS = 6
"""Largest number of times that rows are taken anew."""

SMALL_TABLE = 100_000
"""Number of values of a table that is weighed in a fraction of a second; it only saves time."""


class Visit(NamedTuple):
    """Rows near a hypothesis, where it is weighed accurately, or near none; others are linearised far from their modes.

    `turn` counts the visits before: values of nonlinear parameters are finer in later ones.
    """

    near: Near
    hypothesis: tuple[str, ...] | None = None
    origin: Near | None = None
    turn: int = 0

    @property
    def log_weight(self) -> float:
        """Return the log weight of its hypothesis, or the bound of those not kept, for readings in their own units."""
        if self.hypothesis is None:
            return -np.inf
        return self.near.log_weights().get(self.hypothesis, self.near.weighed.outside) - self.near.log_unit

    def stays(self, point: Point) -> bool:
        """Return true if the likeliest hypothesis is that of the rows, at a point that has settled."""
        near = self.near
        here = near.rows.point
        if (point.added, point.parameters, point.sensors) == (here.added, here.parameters, here.sensors):
            return True
        same = near.names(near.likeliest) == self.hypothesis
        return same and self.origin is not None and near.stays(self.origin)

    def corrected(self, others: Sequence["Visit"], seed: int) -> "Visit":
        """Return the rows, with log weights of hypotheses from the rows near the visited ones that differ least.

        Rows are linear near the hypothesis that was visited, and with a further small effect. Of earlier visits, where
        values are coarser, that very hypothesis alone is known.
        """
        near, shifts = self.near, []
        there = [
            (other, other.near.log_weights(), {column.called for column in other.near.regressors.columns})
            for other in others
            if other.hypothesis is not None
        ]
        logs = near.log_weights()
        for hypothesis in near.weighed.hypotheses:
            names = near.names(hypothesis)
            closest, shift = self.distance(names), 0.0
            for other, weights, called in there:
                distance = other.distance(names)
                knows = not distance or (other.turn > self.turn and called.issuperset(names))
                if distance < closest and knows:
                    weight = weights.get(names, other.near.weighed.outside)
                    closest, shift = distance, weight - other.near.log_unit + near.log_unit - logs[names]
            shifts.append(shift)
        return self._replace(near=replace(near, weighed=near.weighed.reweighted(shifts, seed)))

    def distance(self, names: Sequence[str]) -> float:
        """Return the number of regressors in which a hypothesis differs from the visited one; infinite without one."""
        return np.inf if self.hypothesis is None else float(len({*self.hypothesis}.symmetric_difference(names)))


def best_of(visits: Sequence[Visit], seed: int) -> Visit:
    """Return the rows near the likeliest of the visited hypotheses, corrected by the rows near the others."""
    best = max(visits, key=lambda each: each.log_weight)
    return best.corrected([other for other in visits if other is not best], seed)


@dataclass(frozen=True)
class Weigher:
    """Rows of an equation, and how hypotheses are weighed on them; the seed is that of the bagged records."""

    source: Source
    odds: Odds
    reach: Reach
    seed: int

    def near(self, point: Point) -> Near:
        """Return the hypotheses on rows near a point."""
        return self.on(self.source.near(point))

    def on(self, rows: Rows) -> Near:
        """Return the hypotheses on rows."""
        shapes = [(rows.force.weighted(shape.spread[rows.place]), shape.log_prior) for shape in rows.point.shapes]
        window = rows.point.window
        return Near(rows, weigh(table_of(rows), self.odds, self.reach, rows.floor, shapes, self.seed, window))

    def tried(self, point: Point) -> Near | None:
        """Return the hypotheses on rows near a point; None if no path of the model there follows the samples."""
        try:
            return self.near(point)
        except (InputError, np.linalg.LinAlgError):
            return None


def table_of(rows: Rows) -> RegressorTable:
    """Return the table that hypotheses are weighed on."""
    regressors = rows.regressors
    samples, sample = np.unique(regressors.rows.sample, return_inverse=True)
    n_sample, n_white = len(samples), regressors.rows.n_white
    block = blocks(n_sample)[sample]
    if n_white != regressors.rows.n_row and not rows.force.forced:
        block = blocks(n_white)
    # A coefficient that settles, at whatever rate, is one kind of memory.
    elements: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    for memory, (at_rows, at_samples) in regressors.memories.items():
        elements.setdefault(memory.text, []).append((at_rows, at_samples[:n_sample]))
    memories = {text: Features(*map(np.hstack, zip(*parts, strict=True))) for text, parts in elements.items()}
    if (window := rows.point.window) is not None and window.complete:
        # No f is weighed there, and its features cost as much as the rest.
        law = Features(np.zeros((regressors.rows.n_row, 0)), np.zeros((n_sample, 0)))
    else:
        law = Features(regressors.features(), regressors.evaluate_features(regressors.rows.at_rows())[:n_sample])
    columns = tuple(as_regressor(column, rows.force.effect_size) for column in regressors.columns)
    return RegressorTable(
        columns, regressors.target, regressors.values, regressors.acting[:n_sample], rows.force,
        block, law, np.asarray(regressors.basis.frequency), memories,
    )  # fmt: skip
