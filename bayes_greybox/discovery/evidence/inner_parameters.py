"""Refinement of the grid over an inner parameter of an effect, such as the width of a dead zone."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .columns import limits, log_weights, nodes
from .evaluations import Evaluations

SPANS = 0.2
"""Posterior probability of the likeliest value below which values are near enough for intervals to be smooth."""

ZOOMS, ZOOM_NODES = 4, 9
"""How often the grid over an inner parameter is refined around its best value, and by how many values."""


def refine(evaluations: Evaluations, base: Sequence[int], group: Sequence[int]) -> tuple[int, ...]:
    """Refine the grid over an effect's inner parameter until its posterior spans several values.

    Args:
        evaluations: Evidence; new columns are added to its statistics.
        base: Columns beside the effect.
        group: Columns of the effect.

    Returns:
        All columns of the effect, old and new.
    """
    statistics, found = evaluations.statistics, list(group)
    column = statistics.columns[found[0]]
    if not column.inner or column.effect is None:
        return tuple(found)
    (key,) = column.inner
    least, most = limits(column.effect, statistics.rows.columns, statistics.path)
    for _ in range(ZOOMS):
        values = np.array([statistics.columns[i].inner[key] for i in found])
        log_z = np.array([v.all for v in evaluations.parametric([(*base, i) for i in found])])
        posterior = np.exp(log_z - np.logaddexp.reduce(log_z))
        # Of one value alone: what the others do on these data, other columns do as well.
        if np.max(posterior) < SPANS or len(values) == 1:
            break
        order = np.argsort(values)
        at = int(np.flatnonzero(order == int(np.argmax(posterior)))[0])
        # The cells of the first and the last value reach to the ends of the prior.
        low = values[order[at - 1]] if at else least
        high = values[order[at + 1]] if at + 1 < len(order) else most
        fresh = np.setdiff1d(np.geomspace(low, high, ZOOM_NODES + 2)[1:-1], values)
        if not len(fresh):
            break
        # New weights for old and new values together: each is the width of its cell under the prior.
        merged = np.sort(np.concatenate([values, fresh]))
        weights = dict(zip(merged.tolist(), log_weights(merged, least, most).tolist(), strict=True))
        for i in found:
            statistics.columns[i] = replace(statistics.columns[i], log_weight=weights[statistics.columns[i].inner[key]])
        new = [
            (t, {**about, "log_weight": weights[about["inner"][key]], "nominal": column.nominal})
            for t, about in nodes(column.effect, statistics.rows.columns, fresh, statistics.path)
        ]
        before = len(statistics.columns)
        statistics.add("effect", new)
        found += range(before, len(statistics.columns))
    return tuple(found)
