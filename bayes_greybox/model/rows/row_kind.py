"""What a kind of rows is: how the rows of an equation are built from data."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.simulation import Simulation
from bayes_greybox.physics.terms import Term

from .equation_rows import EquationRows


class RowKind(ABC):
    """A kind of rows: by default rates that are measured beside all states, linear in whatever is added to them."""

    @abstractmethod
    def rows(self, data: Trajectories, equation: str, simulation: Simulation) -> EquationRows:
        """The rows of one equation.

        Args:
            data: Measurements.
            equation: The learned state.
            simulation: The known rates.

        Raises:
            InputError: The data cannot give such rows.
        """

    @property
    def rates_measured(self) -> bool:
        """Whether rows are rates, measured apart from the states; else they are samples of a path."""
        return True

    def hidden(self, simulation: Any, data: Trajectories) -> tuple[str, ...]:
        """States that the user's simulation has and the data lack, in order; none where rows need every state.

        Args:
            simulation: As the user gave it.
            data: Measurements.
        """
        return ()

    def complete(self, data: Trajectories, equation: str, simulation: Simulation) -> Trajectories:
        """Data with every state and the equation's rate at every sample, which terms and maps are evaluated on.

        Args:
            data: Measurements.
            equation: The learned state.
            simulation: The known rates.
        """
        return data

    def nodes(self, data: Trajectories, equation: str, simulation: Simulation) -> Trajectories:
        """States and inputs where the terms of the rows are evaluated, as data.

        Args:
            data: Measurements.
            equation: The learned state.
            simulation: The known rates.
        """
        return data

    def around(self, added: Sequence[tuple[Term, float]], departs: bool = True) -> "RowKind":
        """The rows, if they are linear only near a model, near that with these terms and coefficients.

        Args:
            added: To the rate of the learned state, user's units.
            departs: Whether what the samples show may depart from that model.
        """
        return self
