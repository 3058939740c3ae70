"""What stands for parts of a model that a file cannot hold."""

from dataclasses import dataclass
from typing import Any

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.rows.equation_rows import EquationRows
from bayes_greybox.model.rows.row_kind import RowKind
from bayes_greybox.physics.simulation.protocol import Simulation
from bayes_greybox.running.errors import InputError


def lost_program(n_term: int) -> Any:
    """Refuse to sample from a prior that was a program.

    Args:
        n_term: Terms.

    Raises:
        InputError: Always.
    """
    raise InputError(
        "The model's prior was a Python program, which a file cannot hold: build the model again to sample from it."
    )


@dataclass(frozen=True)
class LostRows(RowKind):
    """Stands for rows of the user's own kind."""

    def rows(self, data: Trajectories, equation: str, simulation: Simulation) -> EquationRows:
        """Refuse."""
        raise InputError(
            "The model's rows were of a class of your own, which a file cannot hold: build the model again and fit it."
        )
