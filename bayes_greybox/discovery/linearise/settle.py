"""The loop that weighs hypotheses on rows near the likeliest one, until it stays."""

from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import replace

import numpy as np

from bayes_greybox.discovery.grid.points import NO_DISCREPANCY, NoisePoint
from bayes_greybox.discovery.grid.sets import Window
from bayes_greybox.discovery.regressors.columns import Values
from bayes_greybox.discovery.sensor_errors.channels import DELAY, Sizes
from bayes_greybox.model.estimate.near import MOST_TANGENTS
from bayes_greybox.running.errors import InputError

from .near import Near, Point, noise_shapes
from .refine import Ground, refined
from .standing import LIKELIER, NO_EFFECT, Standing, standing_visit
from .visits import MOST_OUTER_ITERATIONS, SMALL_TABLE, Visit, Weigher, best_of, table_of


def settle(weigher: Weigher, start: Point, report: Callable[[str], None]) -> Visit:
    """Return the hypotheses on rows near the likeliest that was visited.

    Effects are tried beside the hidden states that parameters of the start give, and some at values that make up for
    these: all are tried again beside those of the parameters that were found or, where none moved, of the corrections
    that close the gap best without an effect. The column of an effect with memory is exact from the first try, that of
    a delay only near the right delay: all are tried again beside the delays that close the gap best by themselves.
    """
    found = _settled(weigher, start, report)
    near = found.near
    if near.names(near.likeliest) == near.names(near.weighed.before):
        return found

    def again(point: Point, beside: str) -> Visit:
        other = _settled(weigher, point, lambda text: report(f"{text}, beside {beside}"))
        # Evidences of different numbers of rows do not compare.
        alike = other.near.regressors.rows.n_row == near.regressors.rows.n_row
        return max(found, other, key=lambda visit: visit.near.log_evidence) if alike else found

    # Along some hidden states a formula has no value.
    if through := weigher.source.model.named.through:
        with suppress(InputError, np.linalg.LinAlgError):
            moved = _through(near, through)
            if not moved:
                window = Window(frozenset(), near.weighed.prior, (), complete=True)
                moved = _through(weigher.near(replace(start, window=window)), through)
            if not moved.keys() <= start.parameters.keys():
                before, elsewhere = found, replace(start, parameters=moved)
                found = again(elsewhere, "other parameters")
                start = start if found is before else elsewhere
    if late := _late_alone(found.near, weigher):
        with suppress(InputError, np.linalg.LinAlgError):
            other = again(replace(start, sensors={**start.sensors, **late}), "late channels")
            # If the likeliest there has none of these delays, it was weighed before, and only linearised elsewhere.
            if {error.key for error in late}.intersection(other.near.names(other.near.likeliest)):
                return other
    return found


def _late_alone(near: Near, weigher: Weigher) -> Sizes:
    """Return the delays of samples that may close a gap as well as the likeliest hypothesis, if it remembers.

    A delay of rates moves rows out of their run, and evidences do not compare.
    """
    columns, point = near.regressors.columns, near.rows.point
    effects = [columns[i].effect for i in near.likeliest.members]
    remembers = any(effect.effect.hidden for effect in effects if effect is not None)
    if not (remembers and near.rows.model.rows.follows_path):
        return {}
    delays = {c.suspect: 0.0 for c in columns if c.suspect is not None and c.suspect.kind == DELAY}
    rival, start = near.log_evidence, replace(point, added=(), sensors=delays)
    alone = Standing(weigher, near.weighed.prior).by_itself(start, NO_EFFECT, rival) if delays else None
    if alone is None or alone.log_weight < rival - weigher.reach.window:
        return {}
    sensors = alone.near.point_of(alone.near.likeliest).sensors
    known = {error.key for error in point.sensors}
    return sensors if any(error.key not in known for error in sensors) else {}


def _through(near: Near, through: Collection[str]) -> dict[str, float]:
    return {name: value for name, value in near.point_of(near.likeliest).parameters.items() if name in through}


def _settled(weigher: Weigher, start: Point, report: Callable[[str], None]) -> Visit:
    report("weighing hypotheses")
    rows = weigher.source.near(start)
    # Effects compete at their best from the start: at coarse values, or those of other rows, stand-ins would win.
    ground = Ground(table_of(rows), (rows.force,), (NoisePoint(NO_DISCREPANCY),), rows.floor)
    values, companies = refined(rows.regressors, ground)
    near = weigher.near(replace(start, values={**start.values, **values})) if values else weigher.on(rows)
    away = start.added or start.parameters or start.sensors
    visits = [Visit(near, None if away else near.names(near.weighed.before))]
    if (standing := standing_visit(near, weigher)) is not None:
        visits = [standing]
    for iteration in range(MOST_OUTER_ITERATIONS):
        here = best_of(visits, weigher.seed)
        near, weighed = here.near, here.near.weighed
        finer, companies = refined(near.regressors, Ground.of(weighed), weighed.hypotheses, companies)
        point = _next(near, finer, weigher)
        same_shapes = [s.name for s in point.shapes] == [s.name for s in near.rows.point.shapes]
        stays = not finer and same_shapes and here.stays(point)
        if stays and near.rows.point.window is None:
            return Visit(_on_tangent(near, weigher), near.names(near.likeliest))
        report(f"weighing them near the likeliest, round {iteration + 1}")
        # In the first iteration a small table is weighed whole: rates seldom need a second.
        narrow = (iteration or weighed.table.columns.size > SMALL_TABLE) and not stays
        around = weigher.tried(replace(point, window=near.window if narrow else None))
        if around is None:
            break
        there = Visit(around, near.names(near.likeliest), near, iteration + 1)
        # Evidences of different numbers of rows do not compare: a delay moves some out of their run.
        if near.regressors.rows.n_row != there.near.regressors.rows.n_row:
            visits = [there]
            continue
        visits = [each for each in visits if each.hypothesis != there.hypothesis] + [there]
        # Evidence says little of a parameter's tangent, which has nearly the same shape wherever it is taken.
        if abs(there.log_weight - here.log_weight) < LIKELIER and not stays and there.near.on_tangent:
            break
    while (here := best_of(visits, weigher.seed)).near.rows.point.window is not None:
        whole = here._replace(near=weigher.near(replace(here.near.rows.point, window=None)))
        visits = [whole, *(each for each in visits if each.hypothesis != here.hypothesis)]
    return here._replace(near=_on_tangent(here.near, weigher))


def _on_tangent(near: Near, weigher: Weigher) -> Near:
    for _ in range(MOST_TANGENTS):
        if near.on_tangent:
            break
        there = weigher.tried(replace(near.point_of(near.likeliest), window=None))
        if there is None:
            break
        near = there
    return near


def _next(near: Near, finer: Mapping[str, Values], weigher: Weigher) -> Point:
    """Return the linearisation point of the likeliest hypothesis, with finer values and noise shapes."""
    rows, white = near.rows, near.weighed.white(near.likeliest)
    shapes = []
    for shape in noise_shapes(white, weigher.source.quantities(rows), weigher.odds) if rows.force.forced else ():
        # The spread is one at rows that are left out.
        spread = np.ones(rows.n_all)
        spread[rows.place] = shape.spread
        shapes.append(shape._replace(spread=spread))
    # Where no path is followed, columns are exact at any value.
    on_path = _with_memory(near) if rows.model.rows.follows_path else {}
    values = {**rows.point.values, **finer, **on_path}
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
