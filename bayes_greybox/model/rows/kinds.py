"""Kinds of rows by name."""

from collections.abc import Mapping

from .as_measured import AsMeasured
from .derivative_rows import DerivativeRows
from .trajectory_rows import TrajectoryRows
from .weak_rows import WeakRows

ROWS: Mapping[str, type] = {
    "as-measured": AsMeasured,
    "derivative": DerivativeRows,
    "trajectory": TrajectoryRows,
    "weak": WeakRows,
}
"""Kinds of rows by the name that files of fits and configurations have for them.

A kind that is listed here can be configured, saved and loaded. Its fields state their limits in their types.
"""
