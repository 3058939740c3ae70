"""Kinds of rows by name, and the kind that leaves the choice to the data."""

from collections.abc import Mapping
from dataclasses import dataclass

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.simulation.protocol import Simulation

from .derivative_rows import DerivativeRows
from .equation_rows import EquationRows
from .row_kind import RowKind
from .trajectory_rows import TrajectoryRows
from .weak_rows import WeakRows


@dataclass(frozen=True)
class AsMeasured(RowKind):
    """Rates at time stamps where the data have a rate or an output, and samples of a path where they have neither.

    A fit or a study chooses once, by its training data, and says what it chose.
    """

    def chosen(self, data: Trajectories) -> RowKind:
        """Return `DerivativeRows` or `TrajectoryRows`; completed data have rates, but they are the path's."""
        measured = data.samples is None and (data.derivative_names or data.output_names)
        return DerivativeRows() if measured else TrajectoryRows()

    def rows(self, data: Trajectories, equation: str, simulation: Simulation) -> EquationRows:
        """Return the rows of one equation; without a choice these are rates."""
        return DerivativeRows().rows(data, equation, simulation)


ROW_KINDS: Mapping[str, type] = {
    "as-measured": AsMeasured,
    "derivative": DerivativeRows,
    "trajectory": TrajectoryRows,
    "weak": WeakRows,
}
"""Kinds of rows by their names in files of fits and in configurations.

A kind that is listed here can be configured, saved and loaded. Its fields state their limits in their types.
"""
