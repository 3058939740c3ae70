"""Rows that are linear near a model only, taken anew near its estimate: Gauss and Newton's method."""

import math
from dataclasses import replace
from typing import Any, TypeVar

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.trajectories import Trajectories

TURNS = 3
"""How often rows are taken anew near the estimate of one equation, whose other terms already follow the samples."""

MOST_TURNS = 30
"""How often at most for several equations that share their rows: the first path follows none of them."""

SETTLED, UNSETTLED = 0.01, 1.0
"""Change of a coefficient from one turn to the next, in its standard deviations, that ends them; or that is refused."""

Model = TypeVar("Model", bound=Any)
"""A `Program`, which is made of this."""


def near_estimate(model: Model, data: Trajectories) -> Model:
    """The model with rows near the ridge estimate of its own terms.

    Of several equations on the same samples the coefficients are found together, first on paths that an unknown force
    moves to where the samples are, then on paths of the model alone, which are those of least squares: an estimate on a
    path that a force moves is near it only.

    Args:
        model: The model.
        data: Samples.

    Raises:
        InputError: What `Program.assemble` refuses; coefficients that do not settle.
    """
    if len(model.equations) == 1:
        return _turned(model, data, TURNS, -math.inf)[0]
    forced, moved = _turned(model, data, MOST_TURNS, SETTLED)
    try:
        found, left = _turned(replace(forced, rows=forced.rows.unforced()), data, MOST_TURNS, SETTLED)
    except InputError:
        found, left = forced, math.inf
    # Where no path of the model can be followed to its end, there is the one that a force keeps to the samples.
    found, left = (found, left) if left <= UNSETTLED else (forced, moved)
    if left > UNSETTLED:
        raise InputError(
            f"The coefficients of {', '.join(model.equations)} do not settle: after {MOST_TURNS} turns one still moves "
            f"by {left:.2g} of its standard deviations. Leave terms out, give states without a sensor as data, or "
            "start near what is known with TrajectoryRows(added=..., added_to=...)."
        )
    return found


def _turned(model: Model, data: Trajectories, most: int, settled: float) -> tuple[Model, float]:
    """Rows near the estimate, and by how many standard deviations that moved in the last of so many turns."""
    added, moved = None, math.inf
    for _ in range(most):
        # Rows that are linear near a model only are of one block.
        (equation,) = model.assemble(data).values()
        moved = math.inf if added is None else equation.moved(added)
        added = equation.ridge()
        model = replace(model, rows=model.rows.around(added, equation.frame.dictionary.acts_on))
        if moved < settled:
            break
    return model, moved
