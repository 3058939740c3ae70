"""What is set of an FMU at a point."""

from collections.abc import Mapping
from dataclasses import dataclass

Key = tuple[tuple[str, float], ...]
"""Parameters of an FMU."""


@dataclass(frozen=True)
class Ports:
    """Value references of what is set at a point.

    Attributes:
        inputs: Inputs.
        states: States, in order.
        starts: What sets the states where a Co-Simulation starts.
        step: Length of its steps.
    """

    inputs: tuple[int, ...]
    states: tuple[int, ...]
    starts: tuple[int, ...]
    step: float


def key_of(parameters: Mapping[str, float]) -> Key:
    """Parameters as what tells them from others.

    Args:
        parameters: By name.
    """
    return tuple(sorted((name, float(value)) for name, value in parameters.items()))
