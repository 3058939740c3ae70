"""Rows that are linear near a model only, taken anew near its estimate: the Gauss–Newton method.

Tangents of named parameters are taken anew with them.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.equation import Equation
from bayes_greybox.physics.parameters import step_to
from bayes_greybox.running.errors import InputError

from .descent import SETTLED_WITHIN, STAYING_WITHIN, UNSETTLED_BEYOND, added_terms, descended, frozen, likeliest_of
from .likeliest import Likeliest, likeliest

TERMS_STAY_WITHIN = 0.3
"""Change of a coefficient of the likeliest terms, in its standard deviations, below which it stays."""

MOST_SEARCHES = 16
"""Most searches for the likeliest terms; sets that lead to each other alternately are found by then."""

FORCED_ITERATIONS = 8
"""Most outer iterations in which an unknown force makes up for what a model far off does not follow."""

MOST_ITERATIONS = 32
"""Most times that rows are taken anew: the first path may follow none of the equations."""

TRIES = (1, 2, 3, 5, 8, 12, 17, 24, MOST_ITERATIONS)
"""Outer iterations with an unknown force after which paths without it are tried."""

UNFORCED_ITERATIONS = 15
"""Outer iterations of such a try on paths without the force."""

MOST_TANGENTS = 16
"""Most times that tangents are taken anew."""

FOLLOWED_NATS = 3.0
"""Nats that an unknown force may gain where a path without it follows the samples: odds of twenty."""

Model = TypeVar("Model", bound=Any)
"""A `Program`, which is made of this."""


def near_estimate(model: Model, data: Trajectories) -> Model:
    """Return the model with rows near the ridge estimate of its own terms.

    The coefficients of several equations on the same samples are found together. Their paths are moved to the samples
    by an unknown force at first, and whatever is near enough then is brought to the least squares of the whole
    equations, on paths without that force; of several such estimates the likeliest counts.
    """
    if not model.rows.follows_path:
        return _alternated(model, data)
    if len(model.equations) == 1:
        return _one_settled(model, data)
    # Paths of coefficients that are far off may leave all bounds; they are refused where they are found.
    with np.errstate(over="ignore", invalid="ignore"):
        return _settled(model, data)


def nearer(model: Any, equation: Equation, earlier: Any = None, last: bool = False) -> Any:
    """Return a model of `near_estimate` near the estimate of its equation, without f, on all rows; None if it is so.

    Of two sets of terms that lead to each other alternately, the `earlier` model's and this one's, either will do if
    they differ by one term. At the `last` time an estimate within a standard deviation will do.
    """
    if model.rows.follows_path:
        off = equation.moved(frozen(model, equation))
        return _near(model, equation) if off > (UNSETTLED_BEYOND if last else STAYING_WITHIN) else None
    best = likeliest(equation)
    if _stays(model, best, UNSETTLED_BEYOND if last else TERMS_STAY_WITHIN):
        return None
    near = replace(model, rows=model.rows.around(best.terms, best.acts_on))
    changed = added_terms(model).keys() ^ added_terms(near).keys()
    if len(changed) == 1 and earlier is not None and _stays(earlier, best, UNSETTLED_BEYOND):
        return None
    return near


def _stays(model: Any, best: Likeliest, within: float) -> bool:
    """Return whether a frozen model has the terms of a set, with coefficients within so many standard deviations."""
    before = added_terms(model)
    acts_on = best.acts_on or model.equations[:1] * len(best.terms)
    names = [(name, term.text) for (term, _), name in zip(best.terms, acts_on, strict=True)]
    off = [abs(value - before.get(name, np.inf)) for (_, value), name in zip(best.terms, names, strict=True)]
    return before.keys() == set(names) and bool(np.all(np.array(off) <= within * best.sd))


def _alternated(model: Any, data: Trajectories) -> Any:
    """Take rows that hold to the samples by themselves near the likeliest of the model's terms, until these stay.

    Where two sets that differ by one term lead to each other alternately, either will do: the data hardly tell.
    """
    # The estimate is of the terms alone, whatever f may be beside them.
    lean = replace(model, discrepancy=None)
    # The model before, where its terms were sought as thoroughly.
    before, changed = None, set()
    for iteration in range(MOST_SEARCHES):
        rows = lean.rows.from_afar(iteration)
        close = rows == lean.rows
        (equation,) = replace(lean, rows=rows).assemble(data).values()
        best = likeliest(equation, thorough=close)
        lean = replace(lean, rows=lean.rows.around(best.terms, best.acts_on))
        if before is not None:
            if _stays(before, best, TERMS_STAY_WITHIN):
                break
            changed = added_terms(lean).keys() ^ added_terms(before).keys()
        before = lean if close else None
    else:
        if len(changed) > 1:
            raise InputError(
                f"The terms of {', '.join(model.equations)} do not settle: after {MOST_SEARCHES} turns "
                f"{len(changed)} of them still come or go. The noise is too large for so many candidates: leave terms "
                "out, give more samples, or count less on long sums of rows with WeakRows(white_share=0.05)."
            )
    return replace(model, rows=lean.rows)


def _one_settled(model: Any, data: Trajectories) -> Any:
    """Settle one equation: far from the estimate a force in the noise says which way it is, as rates would."""
    # The estimate is of the terms alone, whatever f may be beside them.
    lean = replace(model, discrepancy=None) if model.dictionary else model
    try:
        # A path of coefficients that are far off may leave all bounds.
        with np.errstate(over="ignore", invalid="ignore"):
            lean = _nearer(lean, data)
    except (InputError, np.linalg.LinAlgError):
        lean = replace(lean, rows=model.rows)
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            near, moved = _turned(lean, data, FORCED_ITERATIONS, SETTLED_WITHIN)
            if moved > STAYING_WITHIN:
                near, moved = _turned(near, data, MOST_ITERATIONS - FORCED_ITERATIONS, STAYING_WITHIN)
    except (InputError, np.linalg.LinAlgError) as error:
        # What is refused at once is not for where the turns have led.
        lean.assemble(data)
        if lean.rows == model.rows:
            raise _unsettled(model, MOST_ITERATIONS, math.inf) from error
        # Without the force no path can be followed to its end: there is the one that it keeps to the samples.
        return replace(model, rows=lean.rows)
    if moved > UNSETTLED_BEYOND:
        raise _unsettled(model, MOST_ITERATIONS, moved)
    return replace(model, rows=near.rows)


def _nearer(model: Any, data: Trajectories) -> Any:
    """Return the model with rows near an estimate beside an unknown force, while that gains anything."""
    before = None
    for _ in range(FORCED_ITERATIONS):
        (equation,) = model.assemble(data).values()
        unfollowed = equation.rows.unfollowed
        if equation.rows.noise.moved or unfollowed is None or unfollowed.nats < FOLLOWED_NATS:
            break
        (forced,) = replace(model, rows=model.rows.moved_by(unfollowed.intensity)).assemble(data).values()
        moved = math.inf if before is None else forced.moved(before)
        before = forced.ridge()
        model = _near(model, forced)
        if moved < UNSETTLED_BEYOND:
            break
    return model


def _settled(model: Any, data: Trajectories) -> Any:
    forced, done, moved = model, 0, math.inf
    # Where the simulation is about right, no force is needed to come to the estimate; else that is no beginning.
    # Kinks make this way long, and it is gone once.
    start = descended(model, data, 64)
    # A minimum far off, such as of no motion, has little of the samples' motion.
    close = start is not None and (off := start.equation.rows.unfollowed) is not None and off.misfit < 0.3
    estimates = [start] if start is not None and close else []
    for tried in TRIES:
        try:
            forced, moved = _turned(forced, data, tried - done, SETTLED_WITHIN)
        except (InputError, np.linalg.LinAlgError):
            if not estimates:
                raise
            break
        done = tried
        unforced = descended(forced, data, UNFORCED_ITERATIONS)
        if unforced is not None:
            # One estimate may be of a minimum of its own; what two paths lead to stands where a force betters nothing,
            # and what three do in any case: the noise is then none that these equations explain.
            again = sum(unforced.equation.moved(other.equation.ridge()) < STAYING_WITHIN for other in estimates)
            estimates.append(unforced)
            if again + 1 >= 3 or (again and _follows(_near(forced, unforced.equation), data)):
                break
        if moved < SETTLED_WITHIN:
            break
    if estimates:
        return likeliest_of(estimates, data).model
    if moved > UNSETTLED_BEYOND:
        raise _unsettled(model, done, moved)
    # Where no path of the model can be followed to its end, there is the one that a force keeps to the samples.
    return forced


def _unsettled(model: Any, turns: int, moved: float) -> InputError:
    far = "no path can be followed where they have gone"
    if math.isfinite(moved):
        far = f"after {turns} turns one still moves by {moved:.2g} of its standard deviations"
    return InputError(
        f"The coefficients of {', '.join(model.equations)} do not settle: {far}. Leave terms out, give states without "
        "a sensor as data, or start near what is known with TrajectoryRows(added=..., added_to=...)."
    )


def _near(model: Any, equation: Equation) -> Any:
    """Return a model with rows near the estimate of an equation."""
    return replace(model, rows=model.rows.around(equation.ridge(), equation.frame.dictionary.acts_on))


def _follows(model: Any, data: Trajectories) -> bool:
    """Return whether an unknown force would gain nothing near a model."""
    try:
        (equation,) = model.assemble(data).values()
    except (InputError, np.linalg.LinAlgError):
        return False
    unfollowed = equation.rows.unfollowed
    return unfollowed is None or unfollowed.nats < FOLLOWED_NATS


def _turned(model: Any, data: Trajectories, most: int, settled: float) -> tuple[Any, float]:
    """Return the model after so many outer iterations, or the first that moves the estimate less, and the last move."""
    before, moved = None, math.inf
    for _ in range(most):
        # Rows that are linear near a model only are of one block.
        (equation,) = model.assemble(data).values()
        moved = math.inf if before is None else equation.moved(before)
        before, model = equation.ridge(), _near(model, equation)
        if moved < settled:
            break
    return model, moved


def at_estimate(model: Model, data: Trajectories, near: Callable[[Model], Model]) -> Model:
    """Return a model that is not linear in its learned parameters with formulas linearised at their estimate.

    `near` takes the rows of a model near its estimate, where they are linear only near one.
    """
    model = near(model)
    found, moved = _estimates(model, data)
    for _ in range(MOST_TANGENTS):
        if moved < STAYING_WITHIN:
            return model
        before = {name: model.parameters[name].here for name in found}
        model = _stepped(model, before, found, near)
        found, moved = _estimates(model, data)
    if moved > UNSETTLED_BEYOND:
        raise InputError(
            f"The parameters {', '.join(found)} do not settle: after {MOST_TANGENTS} steps one still moves by "
            f"{moved:.2g} of its standard deviations. Start nearer to what is likely, or say more of them: "
            "bg.Parameter(value, sd=..., bounds=...)."
        )
    return model


def _stepped(model: Model, before: dict[str, float], found: dict[str, float], near: Callable[[Model], Model]) -> Model:
    """Return the model at the estimate, or where formulas have no values there, on the way to it."""
    found = {name: step_to(value, before[name], model.parameters[name].sd or 0.0) for name, value in found.items()}
    share = 1.0
    while True:
        try:
            return near(model.at({name: before[name] + share * (found[name] - before[name]) for name in found}))
        except (InputError, np.linalg.LinAlgError):
            # Half a step, at most six times, to where formulas have values and parameters may be.
            share /= 2
            if share < 0.5**6:
                raise


def _estimates(model: Any, data: Trajectories) -> tuple[dict[str, float], float]:
    """Return the estimates of the learned parameters, and the farthest that one is away, in standard deviations."""
    found, moved = {}, 0.0
    for equation in replace(model, discrepancy=None).assemble(data).values():
        estimate = equation.ridge()
        sd = equation.standard_deviations()
        for (term, value), width in zip(estimate, sd.tolist(), strict=True):
            name = term.parameter
            if name:
                found[name] = value
                here = model.parameters[name].here
                moved = max(moved, abs(value - here) / width if width > 0 else math.inf * (value != here))
    return found, moved
