"""The loop that weighs hypotheses on rows near the likeliest one, until it stays."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bayes_greybox.discovery.grid.points import NO_DISCREPANCY, NoisePoint
from bayes_greybox.discovery.grid.residuals import blocks
from bayes_greybox.discovery.grid.sets import Reach
from bayes_greybox.discovery.grid.table import Features, RegressorTable
from bayes_greybox.discovery.grid.weigh import weigh
from bayes_greybox.discovery.odds import Odds
from bayes_greybox.discovery.regressors.columns import Values
from bayes_greybox.running.errors import InputError

from .near import Near, Point, Rows, as_regressor, noise_shapes
from .refine import Company, Ground, refined
from .source import Source

MOST_OUTER_ITERATIONS = 6
"""Largest number of outer iterations; after the last, everything is weighed again."""

SMALL_TABLE = 100_000
"""Number of values of a table that is weighed in a fraction of a second. It only saves time: the final table has
everything."""

LIKELIER = 1.0
"""Nats by which new rows must change the log weight of the likeliest visited hypothesis for the search to go on: six
coefficients that move by 0.6 standard deviations do so. It ends a loop, and decides no name."""


def settle(source: Source, start: Point, odds: Odds, reach: Reach, seed: int, report: Callable[[str], None]) -> Near:
    """Return the hypotheses on rows near the likeliest; the seed is that of the bagged records."""
    report("weighing hypotheses")
    rows = source.near(start)
    companies: frozenset[Company] = frozenset()
    if not start.values:
        # Effects compete at their best from the start: at coarse values, stand-ins would win.
        ground = Ground(table_of(rows), (rows.force,), (NoisePoint(NO_DISCREPANCY),), rows.floor)
        values, companies = refined(rows.regressors, ground)
        rows = source.near(replace(start, values=values)) if values else rows
    near = weighed_on(rows, odds, reach, seed)
    visits = [Visit(near, None if start.added or start.sensors else near.names(near.weighed.before))]
    if (standing := _standing(near, source, odds, reach, seed)) is not None:
        visits = [standing]
    for iteration in range(MOST_OUTER_ITERATIONS):
        here = _best(visits, seed)
        near, weighed = here.near, here.near.weighed
        ground = Ground(weighed.table, weighed.forces, weighed.grid.points, weighed.floor)
        finer, companies = refined(near.regressors, ground, weighed.hypotheses, companies)
        point = _next(near, finer, source, odds)
        same_shapes = [s.name for s in point.shapes] == [s.name for s in near.rows.point.shapes]
        stays = not finer and same_shapes and here.stays(point)
        if stays and near.rows.point.window is None:
            return near
        report(f"weighing them near the likeliest, round {iteration + 1}")
        # In the first iteration a small table is weighed whole: rates seldom need a second.
        narrow = (iteration or weighed.table.columns.size > SMALL_TABLE) and not stays
        try:
            rows = source.near(replace(point, window=near.window if narrow else None))
            there = Visit(weighed_on(rows, odds, reach, seed), near.names(near.likeliest), near)
        except (InputError, np.linalg.LinAlgError):
            # No path of that hypothesis follows the samples.
            break
        # Evidences of different numbers of rows do not compare: a delay moves some out of their run.
        if near.regressors.rows.n_row != there.near.regressors.rows.n_row:
            visits = [there]
            continue
        visits = [each for each in visits if each.hypothesis != there.hypothesis] + [there]
        if abs(there.log_weight - here.log_weight) < LIKELIER and not stays:
            break
    while (here := _best(visits, seed)).near.rows.point.window is not None:
        rows = source.near(replace(here.near.rows.point, window=None))
        whole = here._replace(near=weighed_on(rows, odds, reach, seed))
        visits = [whole, *(each for each in visits if each.hypothesis != here.hypothesis)]
    return here.near


def _standing(near: Near, source: Source, odds: Odds, reach: Reach, seed: int) -> "Visit | None":
    """Return rows near a hypothesis without discrepancy, if the likeliest on them has none either.

    A path that an unknown force moves follows the noise of its samples, and so do regressors along it: a law or a
    memory of the states fits that noise, as no effect of an input can, and its evidence is too large. The smoother
    finds no force along the path of a hypothesis that leaves nothing. So the likeliest of these are followed, each on
    rows near the one before. If it is wrong, something remains along its path, and a discrepancy is likelier: then no
    rows are returned.
    """
    if not near.rows.model.rows.follows_path or near.likeliest.complete:
        return None
    followed: list[tuple[str, ...]] = []
    for _ in range(MOST_OUTER_ITERATIONS):
        alone = replace(near, weighed=near.weighed.without_discrepancy(reach, seed))
        names, weighed = alone.names(alone.likeliest), alone.weighed
        # Two that lead to each other lead nowhere.
        if names in followed[:-1]:
            return None
        followed.append(names)
        ground = Ground(weighed.table, weighed.forces, weighed.grid.points, weighed.floor)
        finer, _ = refined(alone.regressors, ground, weighed.hypotheses)
        point = alone.point_of(alone.likeliest)
        try:
            rows = source.near(replace(point, values={**point.values, **finer}))
            near = weighed_on(rows, odds, reach, seed)
        except (InputError, np.linalg.LinAlgError):
            return None
        if near.likeliest.complete:
            return Visit(near, names, alone)
    return None


class Visit(NamedTuple):
    """Rows near a hypothesis, where it is weighed accurately; the others are linearised far from their modes.

    Attributes:
        hypothesis: Names of that hypothesis's regressors; None if the rows are near none.
    """

    near: Near
    hypothesis: tuple[str, ...] | None = None
    origin: Near | None = None

    @property
    def log_weight(self) -> float:
        """Return the log weight of the hypothesis that the rows are near, for readings in their own units.

        On its own rows the hypothesis may no longer be kept: then the least weight kept is its upper bound.
        """
        if self.hypothesis is None:
            return -np.inf
        least = min(h.log_weight for h in self.near.weighed.hypotheses)
        return self.near.log_weights().get(self.hypothesis, least) - self.near.log_unit

    def stays(self, point: Point) -> bool:
        """Return true if the likeliest hypothesis is that of the rows, at a point that has settled."""
        near = self.near
        if (point.added, point.sensors) == (near.rows.point.added, near.rows.point.sensors):
            return True
        same = near.names(near.likeliest) == self.hypothesis
        return same and self.origin is not None and near.stays(self.origin)

    def corrected(self, other: "Visit", seed: int) -> "Visit":
        """Return the rows with another hypothesis's log weight taken from the rows near that one."""
        near, logs = self.near, self.near.log_weights()
        if other.hypothesis is None or other.hypothesis == self.hypothesis or other.hypothesis not in logs:
            return self
        shift = other.log_weight + near.log_unit - logs[other.hypothesis]
        shifts = [shift * (near.names(h) == other.hypothesis) for h in near.weighed.hypotheses]
        return self._replace(near=replace(near, weighed=near.weighed.reweighted(shifts, seed)))


def _best(visits: Sequence[Visit], seed: int) -> Visit:
    """Return the rows near the likeliest of the visited hypotheses, corrected by the rows near the others."""
    best = max(visits, key=lambda each: each.log_weight)
    for other in visits:
        best = best.corrected(other, seed)
    return best


def weighed_on(rows: Rows, odds: Odds, reach: Reach, seed: int) -> Near:
    """Return the hypotheses on rows; the seed is that of the bagged records."""
    shapes = [(rows.force.weighted(shape.spread[rows.place]), shape.log_prior) for shape in rows.point.shapes]
    return Near(rows, weigh(table_of(rows), odds, reach, rows.floor, shapes, seed, rows.point.window))


def table_of(rows: Rows) -> RegressorTable:
    """Return the table that hypotheses are weighed on."""
    regressors = rows.regressors
    samples, sample = np.unique(regressors.rows.sample, return_inverse=True)
    n_sample, n_white = len(samples), regressors.rows.n_white
    block = blocks(n_sample)[sample]
    if n_white != regressors.rows.n_row and not rows.force.forced:
        block = blocks(n_white)
    # A coefficient that settles, at whatever rate, is one kind of memory.
    memories: dict[str, Features] = {}
    for memory, (at_rows, at_samples) in regressors.memories.items():
        elements = Features(at_rows, at_samples[:n_sample])
        memories[memory.text] = memories[memory.text].beside(elements) if memory.text in memories else elements
    law = Features(regressors.features(), regressors.evaluate_features(regressors.rows.at_rows())[:n_sample])
    columns = tuple(as_regressor(column, rows.force.gap) for column in regressors.columns)
    return RegressorTable(
        columns, regressors.target, regressors.values, regressors.acting[:n_sample], rows.force,
        block, law, np.asarray(regressors.basis.frequency), memories,
    )  # fmt: skip


def _next(near: Near, finer: Mapping[str, Values], source: Source, odds: Odds) -> Point:
    """Return the linearisation point of the likeliest hypothesis, with finer values and noise shapes."""
    rows, white = near.rows, near.weighed.white(near.likeliest)
    shapes = []
    for shape in noise_shapes(white, source.quantities(rows), odds) if rows.force.forced else ():
        # The spread is one at rows that are left out.
        spread = np.ones(rows.n_all)
        spread[rows.place] = shape.spread
        shapes.append(shape._replace(spread=spread))
    values = {**rows.point.values, **finer, **_with_memory(near)}
    point, spread = near.point_of(near.likeliest), rows.force.rescaled(white)
    return replace(point, values=values, shapes=tuple(shapes), spread=spread)


def _with_memory(near: Near) -> dict[str, Values]:
    """Return the values of effects with memory in the likeliest hypothesis, whose hidden states are the path's."""
    values, columns = {}, near.regressors.columns
    for i in near.likeliest.members:
        effect = columns[i].effect
        if effect is not None and effect.effect.hidden and columns[i].inner:
            group = [columns[j] for j in near.regressors.group(effect.label)]
            points = np.array([list(column.inner.values()) for column in group])
            values[effect.label] = Values(points, np.array([column.log_weight for column in group]))
    return values
