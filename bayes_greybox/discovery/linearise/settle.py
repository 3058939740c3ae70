"""One loop: rows and regressors near the likeliest hypothesis, weighed, until it stays."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.errors import InputError
from bayes_greybox.discovery.grid.agreement import blocks
from bayes_greybox.discovery.grid.hypotheses import weigh
from bayes_greybox.discovery.grid.noise_grid import NONE, NoisePoint
from bayes_greybox.discovery.grid.regressors import Features, RegressorTable
from bayes_greybox.discovery.grid.search import Reach
from bayes_greybox.discovery.odds import Odds
from bayes_greybox.discovery.regressors.columns import Values
from bayes_greybox.discovery.regressors.regressors import Regressors

from .near import Near, Point, Rows, as_regressor
from .noise_shapes import noise_shapes
from .refine import Ground, refined

TURNS = 5
"""How often rows are taken anew near what was found."""

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
    first = build(start)
    # Effects compete at their best from the start: coarse values would leave their places to stand-ins.
    ground = Ground(table_of(first), (first.force,), (NoisePoint(NONE),), first.floor)
    values, known = refined(first.regressors, ground)
    near = _weighed(build(replace(start, values=values)) if values else first, odds, reach, seed)
    stayed, best = False, near
    for turn in range(TURNS):
        weighed = near.weighed
        ground = Ground(weighed.table, weighed.forces, weighed.grid.points, weighed.floor)
        finer, known = refined(near.regressors, ground, weighed.hypotheses, known)
        point = _next(near, finer, quantities, odds)
        same = not finer and _names(point) == _names(near.rows.point)
        if same and (stayed or (point.added, point.sensors) == (near.rows.point.added, near.rows.point.sensors)):
            return near
        report(f"weighing them near the likeliest, turn {turn + 1}")
        try:
            fresh = _weighed(build(point), odds, reach, seed)
        except (InputError, np.linalg.LinAlgError):
            # No path of what was found follows the samples.
            break
        near, stayed = fresh, fresh.stays(near)
        # Only the same rows can be compared: a delay takes some out of their run.
        rows = near.regressors.rows.n_row, best.regressors.rows.n_row
        best = near if rows[0] != rows[1] or near.log_evidence > best.log_evidence else best
    # Hypotheses may lead to each other by turns.
    return best


def _names(point: Point) -> list[str]:
    """Return the shapes of the noise that are weighed."""
    return [shape.name for shape in point.shapes]


def _weighed(rows: Rows, odds: Odds, reach: Reach, seed: int) -> Near:
    table = table_of(rows)
    shapes = [(rows.force.weighted(shape.spread[rows.place]), shape.log_prior) for shape in rows.point.shapes]
    return Near(rows, weigh(table, odds, reach, rows.floor, shapes, seed))


def table_of(rows: Rows) -> RegressorTable:
    """Return the table that hypotheses are weighed on."""
    regressors: Regressors = rows.regressors
    own = regressors.rows
    n_sample = len(np.unique(own.sample))
    block = blocks(n_sample)[np.searchsorted(np.unique(own.sample), own.sample)]
    if own.n_white != own.n_row and not rows.force.forced:
        block = blocks(own.n_white)
    acting = regressors.evaluate_features(own.at_rows())[:n_sample]
    # Elements of one kind are one force, whatever the times that they settle over.
    elements: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    for memory, (at_rows, at_samples) in regressors.memories.items():
        elements.setdefault(memory.text, []).append((at_rows, at_samples[:n_sample]))
    memories: dict[str, Features] = {}
    for memory, (at_rows, force) in regressors.memories.items():
        # A coefficient that settles at one rate or at another is one kind of memory.
        own_elements = Features(at_rows, force[:n_sample])
        memories[memory.text] = memories[memory.text].beside(own_elements) if memory.text in memories else own_elements
    return RegressorTable(
        tuple(as_regressor(column) for column in regressors.columns), regressors.target, regressors.values, rows.force,
        block, Features(regressors.features(), acting), np.asarray(regressors.basis.frequency), memories,
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
