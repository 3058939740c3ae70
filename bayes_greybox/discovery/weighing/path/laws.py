"""Laws next to what was found along a path: each is weighed on rows near itself."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from bayes_greybox.data.errors import InputError
from bayes_greybox.physics.terms import Term

from .near import Near, acting, estimate

CLOSE = 100.0
"""Nats below an effect's evidence down to which a law next to it is followed along a path of its own."""


def weigh_laws(near: Near, taken: Callable[[Near], Near]) -> None:
    """Put the laws next to what was found on equal footing with it: each is weighed on rows near itself.

    A law that fits as well has a path of its own; on rows near another one it fits worse. What rows near itself say
    more of it is added to its weight.

    Args:
        near: The explanation that stays.
        taken: From an explanation to the likeliest one on rows near it.
    """
    core, columns = near.sets.likeliest(), near.base.statistics.columns
    # Finer values of an inner parameter are columns that sets under another noise may have for themselves.
    if any(i >= len(columns) or columns[i].inner for i in core):
        return
    places = {i: near.base.laws(i) for i in core}
    if not any(places.values()):
        return
    # Only now: the laws are columns that were added on the way.
    known, columns = near.under_noise(), near.base.statistics.columns
    level = known.parametric(core).all
    errors = tuple(j for j in core if columns[j].suspect is not None)
    for i, laws in places.items():
        # Beside the errors alone: off its own path a law needs the company of others.
        names = [columns[j].called for j in (*errors, i)]
        for law in laws:
            if known.parametric((*errors, law)).all < level - CLOSE:
                continue
            column = columns[law]
            try:
                here, found = _of_law(near, names, column.formula.text)
                there, found = _of_law(taken(near._replace(found=found)), names, column.formula.text)
                there, _ = _of_law(taken(near._replace(found=found)), names, column.formula.text)
            except (InputError, LookupError, np.linalg.LinAlgError):
                # Rows near another law may not have what stands beside it; it stays where it is.
                continue
            columns[law] = replace(column, log_weight=max(there - here, 0.0))
    near.base.reweigh()


def _of_law(near: Near, names: Sequence[str], law: str) -> tuple[float, tuple[tuple[Term, float], ...]]:
    """Log evidence of errors with a law in the place of the effect, the last of these names, and its terms.

    Raises:
        LookupError: One of them is no column of these rows.
    """
    own = {c.called: i for i, c in enumerate(near.base.statistics.columns) if c.kind in ("effect", "suspect")}
    core = [own[name] for name in names]
    each = near.base.laws(core[-1])
    columns = near.base.statistics.columns
    core[-1] = {columns[i].formula.text: i for i in each}[law]
    sets = near.under_noise()
    estimated, values, _ = estimate(sets, core)
    unit = sets.statistics.target_scale * sets.statistics.rows.gain
    value = sets.parametric(core).all - sum(columns[i].log_weight for i in core)
    value -= 0.5 * near.noise.noise.log_det + sets.statistics.rows.n_row * math.log(unit)
    return value, acting(estimated, values)
