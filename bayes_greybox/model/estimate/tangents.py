"""Tangents of formulas in their named parameters, taken anew at the estimate until that stays: Gauss–Newton."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.parameters import step_to
from bayes_greybox.running.errors import InputError

from .descent import STAYING_WITHIN, UNSETTLED_BEYOND

MOST_TANGENTS = 16
"""Most times that tangents are taken anew."""

MOST_HALVINGS = 6
"""Most halvings of a step to where the formulas have no values, or to values that the parameters cannot have."""

Model = TypeVar("Model", bound=Any)
"""A `Program`, which is made of this."""


def at_estimate(model: Model, data: Trajectories, near: Callable[[Model], Model]) -> Model:
    """Return a model that is not linear in its learned parameters with formulas linearised at their estimate.

    `near` takes the rows of a model near its estimate, where they are linear only near one.

    Raises:
        InputError: See `Program.assemble`; parameters that do not settle.
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
    """Return the model at the estimate, or where that has no rows on the way to it."""
    spreads = {name: model.parameters[name].sd or 0.0 for name in found}
    found = {name: step_to(value, before[name], spreads[name]) for name, value in found.items()}
    for halving in range(MOST_HALVINGS + 1):
        share = 0.5**halving
        values = {name: before[name] + share * (found[name] - before[name]) for name in found}
        try:
            return near(model.at(values))
        except (InputError, np.linalg.LinAlgError):
            if halving == MOST_HALVINGS:
                raise
    return model


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
