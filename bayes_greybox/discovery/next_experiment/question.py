"""What is asked of candidates: the model before, the data, and the explanations that predict something."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.simulation.protocol import Simulation

from .explained import Component, Explained


@dataclass(frozen=True)
class Question:
    """What is asked of candidates.

    Attributes:
        simulation: Of the model before, its jumps rounded for an integrator.
        data: What was measured.
        explanations: Those that predict something.
        rates: Whether rows are of rates.
        outcomes: Simulated for each explanation.
        seed: Of everything random.
    """

    simulation: Simulation
    data: Trajectories
    explanations: Sequence[Explained]
    rates: bool
    outcomes: int
    seed: int

    @property
    def components(self) -> list[Component]:
        """Components of all explanations, one after another."""
        return [component for e in self.explanations for component in e.components]

    @property
    def of(self) -> Int[np.ndarray, " n_component"]:
        """The explanation of each component."""
        return np.repeat(np.arange(len(self.explanations)), [len(e.components) for e in self.explanations])
