"""The whole modelled rate: simulation and what was found."""

from collections.abc import Sequence

import numpy as np

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.sensor_errors.channels import Rate
from bayes_greybox.model.program import Program
from bayes_greybox.physics.terms import Term


def modelled_rate(model: Program, data: Trajectories, equation: str, added: Sequence[tuple[Term, float]]) -> Rate:
    """Return the simulation's rate and that of terms, on any data of the same columns.

    Args:
        model: The model before.
        data: Data with these columns.
        equation: The studied state.
        added: Terms and their coefficients.
    """
    simulation = model.simulator(data)

    def rate(data: Trajectories) -> np.ndarray:
        total = simulation.on(data, equation)
        for term, coefficient in added:
            total = total + coefficient * np.asarray(term.evaluate(data.columns))
        return total

    return rate
