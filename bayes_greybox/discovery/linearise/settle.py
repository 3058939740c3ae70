"""One loop: rows and regressors near the likeliest hypothesis, weighed, until it stays."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bayes_greybox.discovery.grid.evidence.search import Reach
from bayes_greybox.discovery.grid.hypotheses.agreement import blocks
from bayes_greybox.discovery.grid.hypotheses.weigh import weigh
from bayes_greybox.discovery.grid.noise.points import NO_DISCREPANCY, NoisePoint
from bayes_greybox.discovery.grid.table import Features, RegressorTable
from bayes_greybox.discovery.odds import Odds
from bayes_greybox.discovery.regressors.columns import Values
from bayes_greybox.discovery.regressors.regressors import Regressors
from bayes_greybox.running.errors import InputError

from .near import Near, Point, Rows, as_regressor
from .noise_shapes import noise_shapes
from .refine import Company, Ground, refined

TURNS = 6
"""Largest number of times that rows are taken anew near what was found; the last one weighs everything again."""

SMALL = 100_000
"""Number of values of a table that is weighed in a fraction of a second. It saves time alone: what is said at the end
is of a table with everything."""

LIKELIER = 1.0
"""Nats by which rows near another hypothesis have to make it likelier, or less likely, for the search to go on: six
coefficients that move by 0.6 of their standard deviations are worth as much. It ends a loop, and decides no name."""

Build = Callable[[Point], Rows]
"""From a point to the rows near it."""

Quantities = Callable[[Rows], Mapping[str, Float[np.ndarray, " n_row"]]]
"""What the noise of rows may grow with."""


def settle(
    build: Build, quantities: Quantities, start: Point, odds: Odds, reach: Reach, seed: int,
    report: Callable[[str], None],
) -> Near:  # fmt: skip
    """Return the hypotheses on rows near the likeliest of them.

    Args:
        build: Makes rows near a point.
        quantities: What the noise may grow with.
        start: Where to begin.
        odds: Prior probabilities.
        reach: How far searches go.
        seed: Of the bagged records.
        report: Told in words what is being done.
    """
    report("weighing hypotheses")
    rows = build(start)
    known: frozenset[Company] = frozenset()
    if not start.values:
        # Effects compete at their best from the start: coarse values would leave their places to stand-ins.
        ground = Ground(table_of(rows), (rows.force,), (NoisePoint(NO_DISCREPANCY),), rows.floor)
        values, known = refined(rows.regressors, ground)
        rows = build(replace(start, values=values)) if values else rows
    near = weighed_on(rows, odds, reach, seed)
    visits = [Visit(near, None if start.added or start.sensors else near.names(near.weighed.before))]
    for turn in range(TURNS):
        here = _best(visits, seed)
        near, weighed = here.near, here.near.weighed
        ground = Ground(weighed.table, weighed.forces, weighed.grid.points, weighed.floor)
        finer, known = refined(near.regressors, ground, weighed.hypotheses, known)
        point = _next(near, finer, quantities, odds)
        stays = not finer and _names(point) == _names(near.rows.point) and here.stays(point)
        if stays and near.rows.point.window is None:
            return near
        report(f"weighing them near the likeliest, turn {turn + 1}")
        # In the first turn a small table is weighed whole: rates are seldom moved a second time.
        some = turn or weighed.table.columns.size > SMALL
        window = near.window if some and not stays else None
        try:
            rows = build(replace(point, window=window))
            there = Visit(weighed_on(rows, odds, reach, seed), near.names(near.likeliest), near)
        except (InputError, np.linalg.LinAlgError):
            # No path of what was found follows the samples.
            break
        # Only as many rows can be compared: a delay takes some out of their run.
        if near.regressors.rows.n_row != there.near.regressors.rows.n_row:
            visits = [there]
            continue
        visits = [each for each in visits if each.hypothesis != there.hypothesis] + [there]
        if abs(there.own - here.own) < LIKELIER and not stays:
            break
    while (here := _best(visits, seed)).near.rows.point.window is not None:
        rows = build(replace(here.near.rows.point, window=None))
        whole = here._replace(near=Near(rows, weighed_on(rows, odds, reach, seed).weighed))
        visits = [whole, *(each for each in visits if each.hypothesis != here.hypothesis)]
    return here.near


class Visit(NamedTuple):
    """Rows near a hypothesis, on which it is weighed truly: what is said of the others there is a guess from afar.

    Attributes:
        near: The rows with all hypotheses.
        hypothesis: Names of what the rows are near to; None where that is none of theirs.
        origin: Rows that it was the likeliest on.
    """

    near: Near
    hypothesis: tuple[str, ...] | None = None
    origin: Near | None = None

    @property
    def own(self) -> float:
        """Return the log weight of the hypothesis that the rows are near to, of the readings in their own units.

        Near itself it may be no longer among those that are kept: then it is at most that of the last of them.
        """
        if self.hypothesis is None:
            return -np.inf
        near = self.near
        least = min(h.log_weight for h in near.weighed.hypotheses)
        return near.log_weights().get(self.hypothesis, least) - near.log_unit

    def stays(self, point: Point) -> bool:
        """Return whether the likeliest hypothesis is that of the rows, at a point that is known no better."""
        near = self.near
        if (point.added, point.sensors) == (near.rows.point.added, near.rows.point.sensors):
            return True
        found = near.names(near.likeliest) == self.hypothesis
        return found and self.origin is not None and near.stays(self.origin)

    def told(self, other: "Visit", seed: int) -> "Visit":
        """Return the rows with what other rows, near another hypothesis, say of that.

        Args:
            other: The other rows.
            seed: Of the bagged records.
        """
        near, logs = self.near, self.near.log_weights()
        if other.hypothesis is None or other.hypothesis == self.hypothesis or other.hypothesis not in logs:
            return self
        more = other.own + near.log_unit - logs[other.hypothesis]
        shifts = [more * (near.names(h) == other.hypothesis) for h in near.weighed.hypotheses]
        return self._replace(near=replace(near, weighed=near.weighed.reweighted(shifts, seed)))


def _best(visits: Sequence[Visit], seed: int) -> Visit:
    """Return the rows near the likeliest of what was weighed truly, with what is known of the others."""
    best = max(visits, key=lambda each: each.own)
    for other in visits:
        best = best.told(other, seed)
    return best


def _names(point: Point) -> list[str]:
    """Return the shapes of the noise that are weighed."""
    return [shape.name for shape in point.shapes]


def weighed_on(rows: Rows, odds: Odds, reach: Reach, seed: int) -> Near:
    """Return the hypotheses on rows.

    Args:
        rows: The rows.
        odds: Prior probabilities.
        reach: How far the search goes.
        seed: Of the bagged records.
    """
    table = table_of(rows)
    shapes = [(rows.force.weighted(shape.spread[rows.place]), shape.log_prior) for shape in rows.point.shapes]
    return Near(rows, weigh(table, odds, reach, rows.floor, shapes, seed, rows.point.window))


def table_of(rows: Rows) -> RegressorTable:
    """Return the table that hypotheses are weighed on."""
    regressors: Regressors = rows.regressors
    own = regressors.rows
    n_sample = len(np.unique(own.sample))
    block = blocks(n_sample)[np.searchsorted(np.unique(own.sample), own.sample)]
    if own.n_white != own.n_row and not rows.force.forced:
        block = blocks(own.n_white)
    # Elements of one kind are one force, whatever the times that they settle over.
    elements: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    for memory, (at_rows, at_samples) in regressors.memories.items():
        elements.setdefault(memory.text, []).append((at_rows, at_samples[:n_sample]))
    memories: dict[str, Features] = {}
    for memory, (at_rows, force) in regressors.memories.items():
        # A coefficient that settles at one rate or at another is one kind of memory.
        own_elements = Features(at_rows, force[:n_sample])
        memories[memory.text] = memories[memory.text].beside(own_elements) if memory.text in memories else own_elements
    law = Features(regressors.features(), regressors.evaluate_features(own.at_rows())[:n_sample])
    columns = tuple(as_regressor(column, rows.force.gap) for column in regressors.columns)
    return RegressorTable(
        columns, regressors.target, regressors.values, regressors.acting[:n_sample], rows.force,
        block, law, np.asarray(regressors.basis.frequency), memories,
    )  # fmt: skip


def _next(near: Near, finer: Mapping[str, Values], quantities: Quantities, odds: Odds) -> Point:
    """Return the point of the likeliest hypothesis, with finer values and the shapes of its noise."""
    likeliest = near.likeliest
    point = near.point_of(likeliest)
    white = near.weighed.white(likeliest)
    values = {**near.rows.point.values, **finer, **_remembered(near)}
    shapes = noise_shapes(white, quantities(near.rows), odds) if near.rows.force.forced else ()
    everywhere = (shape._replace(spread=near.rows.everywhere(shape.spread)) for shape in shapes)
    return replace(point, values=values, shapes=tuple(everywhere), spread=near.rows.force.rescaled(white))


def _remembered(near: Near) -> dict[str, Values]:
    """Return the values of effects that remember in the likeliest hypothesis: its hidden states are the path's."""
    found, columns = {}, near.regressors.columns
    for i in near.likeliest.members:
        effect = columns[i].effect
        if effect is not None and effect.effect.hidden and columns[i].inner:
            group = [columns[j] for j in near.regressors.group(effect.label)]
            points = np.array([list(column.inner.values()) for column in group])
            found[effect.label] = Values(points, np.array([column.log_weight for column in group]))
    return found
