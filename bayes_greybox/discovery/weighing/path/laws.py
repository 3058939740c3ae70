"""Laws next to what was found along a path: each is weighed on rows near itself."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from bayes_greybox.data.errors import InputError
from bayes_greybox.discovery.evidence.columns import Nearer
from bayes_greybox.discovery.evidence.inner_parameters import refine
from bayes_greybox.discovery.evidence.ties import first_of_best
from bayes_greybox.physics.terms import Term

from ..worlds import log_noise
from .near import Near, acting, estimate

CLOSE = 100.0
"""Nats below an effect's evidence down to which a law next to it is followed along a path of its own."""


def weigh_laws(near: Near, taken: Callable[[Near], Near]) -> None:
    """Put the laws next to what was found on equal footing with it: each is weighed on rows near itself.

    A law that fits as well has a path of its own; on rows near another one it fits worse. What rows near itself say
    more of it is gained by its set with the errors that it was weighed beside, and by no other.

    Args:
        near: The explanation that stays.
        taken: From an explanation to the likeliest one on rows near it.
    """
    found, core = near.sets.statistics.columns, near.sets.likeliest()
    # Finer values of an inner parameter are columns that sets under another noise may have for themselves, so that
    # columns are known by what they are called.
    errors = tuple(found[i].called for i in core if found[i].suspect is not None)
    effects = tuple(found[i].called for i in core if found[i].effect is not None)
    places = {name: laws for name in effects if (laws := near.base.laws.next_to(_places(near)[name]))}
    if not places:
        return
    # Only now: the laws are columns that were added on the way.
    known = near.under_noise()
    level = near.sets.parametric(core).all
    beside = tuple(_places(near)[name] for name in errors)
    for name, laws in places.items():
        for law in laws:
            # Beside the errors alone: off its own path a law needs the company of others.
            if max(known.parametric((*beside, i)).all for i in law) < level - CLOSE:
                continue
            called = known.statistics.columns[law[0]].called
            try:
                here, path = _of_law(near, (*errors, name), called)
                _, path = _of_law(taken(near._replace(found=path)), (*errors, name), called)
                there, _ = _of_law(taken(near._replace(found=path)), (*errors, name), called)
            except (InputError, LookupError, np.linalg.LinAlgError):
                # Rows near another law may not have what stands beside it; it stays where it is.
                continue
            nearer, columns = Nearer(max(there - here, 0.0), frozenset(errors)), near.base.statistics.columns
            for i in near.base.evaluations.group(law[0]):
                columns[i] = replace(columns[i], nearer=nearer)
    near.base.reweigh()


def _places(near: Near) -> dict[str, int]:
    """Columns of effects and errors on rows near a model, by what they are called: any of those by inner parameter."""
    return {c.called: i for i, c in enumerate(near.base.statistics.columns) if c.kind in ("effect", "suspect")}


def _of_law(near: Near, names: Sequence[str], law: str) -> tuple[float, tuple[tuple[Term, float], ...]]:
    """Log evidence of errors with a law in the place of the effect, the last of these names, and its terms.

    Raises:
        LookupError: One of them is no column of these rows.
    """
    *beside, effect = [_places(near)[name] for name in names]
    laws = near.base.laws.next_to(effect)
    group = {near.base.statistics.columns[each[0]].called: each for each in laws}[law]
    sets = near.under_noise()
    group = refine(sets.evaluations, beside, group)
    each = [fitted.all for fitted in sets.evaluations.parametric([(*beside, i) for i in group])]
    estimated, values, _ = estimate(sets, (*beside, group[first_of_best(each)]))
    unit = sets.statistics.target_scale * sets.statistics.rows.gain
    value = float(np.logaddexp.reduce(each)) + log_noise(near.noise, sets.odds)
    return value - sets.statistics.rows.n_row * math.log(unit), acting(estimated, values)
