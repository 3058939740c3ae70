"""Rows chosen by what the data have: rates or outputs where these were measured, else the samples themselves."""

from dataclasses import dataclass

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.simulation.protocol import Simulation

from .derivative_rows import DerivativeRows
from .equation_rows import EquationRows
from .row_kind import RowKind
from .trajectory_rows import TrajectoryRows


@dataclass(frozen=True)
class AsMeasured(RowKind):
    """Rates at time stamps where the data have a rate or an output, and samples of a path where they have neither.

    A fit or a study chooses once, by its training data, and says what it chose.
    """

    def chosen(self, data: Trajectories) -> RowKind:
        """`DerivativeRows` or `TrajectoryRows`; completed data have rates, but they are the path's."""
        measured = data.samples is None and (data.derivative_names or data.output_names)
        return DerivativeRows() if measured else TrajectoryRows()

    def rows(self, data: Trajectories, equation: str, simulation: Simulation) -> EquationRows:
        """The rows of one equation; see `RowKind.rows`. Asked for without a choice, these are rates."""
        return DerivativeRows().rows(data, equation, simulation)
