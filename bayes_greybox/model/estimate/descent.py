"""Descents to an estimate on paths of a model alone: Levenberg–Marquardt steps, each on rows taken anew.

A path that amplifies what changes it is cut into segments with free starts. More of them follow samples better, and the
wide prior of each start costs some ten nats: densities compare coefficients only on paths of as many segments.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.equation import Equation
from bayes_greybox.running.errors import InputError

SETTLED_WITHIN, STAYING_WITHIN, UNSETTLED_BEYOND = 0.01, 0.1, 1.0
"""Changes of a coefficient by an outer iteration, in its standard deviations: one that ends the iterations, one that
will do where many have not ended them, as where a path has kinks, and one that is refused."""


class Standing(NamedTuple):
    """A model with rows near coefficients, their log density, and how many standard deviations off the estimate is."""

    model: Any
    equation: Equation
    at: list[tuple[Any, float]]
    density: float
    moved: float

    @property
    def segments(self) -> int:
        """Number of segments of each run of the path."""
        return self.equation.rows.segments


def descended(model: Any, data: Trajectories, most: int) -> Standing | None:
    """Return the estimate on paths of the model alone, in at most `most` steps; None where it does not settle."""
    start, asked = _standing(replace(model, rows=model.rows.unforced()), data, None), model.rows.segments(data)
    estimate = _settled(start, data, most)
    # Once more where fewer segments do at its end than on its way.
    if estimate is not None and (bare := _cut(estimate, data, asked)) is not None and bare.segments < estimate.segments:
        return _settled(bare, data, most) or estimate
    return estimate


def likeliest_of(estimates: Sequence[Standing], data: Trajectories) -> Standing:
    """Return the likeliest of several estimates, at least one, judged on paths of as many segments."""
    most = max(each.segments for each in estimates)
    alike = [_cut(each, data, most) for each in estimates]
    densities = [-math.inf if each is None else each.density for each in alike]
    return estimates[int(np.argmax(densities))]


def frozen(model: Any, equation: Equation) -> list[tuple[Any, float]]:
    """Return the coefficients of an equation's terms that its rows are near; zero for those that they do not have."""
    dictionary, added = equation.frame.dictionary, added_terms(model)
    acts_on = dictionary.acts_on or model.equations[:1] * len(dictionary.terms)
    return [(term, added.get((name, term.text), 0.0)) for term, name in zip(dictionary.terms, acts_on, strict=True)]


def added_terms(model: Any) -> dict[tuple[str, str], float]:
    """Return the coefficients of the model that rows are near, by learned state and term."""
    to = model.rows.added_to or model.equations[:1] * len(model.rows.added)
    return {(name, text): value for (text, value), name in zip(model.rows.added, to, strict=True)}


def _settled(start: Standing | None, data: Trajectories, most: int) -> Standing | None:
    """Return the end of the steps, with no fewer segments than on the way; None where they do not settle.

    They are damped by what a step promised and gained (Nielsen 1999, IMM-REP-1999-05, Eq. 2.9): whole steps go around
    an estimate near a kink of the equations without end, or to where no path is.
    """
    here, damping, factor = start, 1e-2, 2.0
    for _ in range(most):
        if here is None or here.moved < SETTLED_WITHIN:
            break
        at, promised = here.equation.damped(here.at, damping)
        acts_on = here.equation.frame.dictionary.acts_on
        rows = here.model.rows.in_segments(here.segments, data).around(at, acts_on)
        there = _standing(replace(here.model, rows=rows), data, at)
        before = here if there is None else _cut(here, data, there.segments)
        gained = -1.0
        # Near a bound a step may promise nothing: a shorter one may.
        if there is not None and before is not None and promised > 0:
            gained = (there.density - before.density) / promised
        if there is not None and gained > 0:
            here, damping, factor = there, damping * max(1 / 3, 1 - (2 * gained - 1) ** 3), 2.0
        else:
            damping, factor = damping * factor, 2 * factor
            if before is not None and here.moved < UNSETTLED_BEYOND:
                # Around here some paths have more segments: with as many, all that is left is one descent.
                here = before
    return here if here is not None and here.moved < STAYING_WITHIN else None


def _cut(standing: Standing, data: Trajectories, segments: int) -> Standing | None:
    """Cut each run into at least so many segments; None where no path can be followed."""
    if segments == standing.segments:
        return standing
    model = replace(standing.model, rows=standing.model.rows.in_segments(segments, data))
    return _standing(model, data, standing.at)


def _standing(model: Any, data: Trajectories, at: list[tuple[Any, float]] | None) -> Standing | None:
    """Take the rows near coefficients, by default their own; None where no path of the model can be followed."""
    try:
        (equation,) = model.assemble(data).values()
        if at is None:
            at = frozen(model, equation)
        density, moved = equation.log_density(at), equation.moved(at)
    except (InputError, np.linalg.LinAlgError):
        return None
    return Standing(model, equation, at, density, moved) if math.isfinite(density + moved) else None
