"""Rows of one equation near a point, whatever was measured, and other data of the same sensors without their errors."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.sensor_errors.channels import Rate, Sizes, run_slices
from bayes_greybox.discovery.sensor_errors.late import Late
from bayes_greybox.discovery.sensor_errors.samples import SampleNoise
from bayes_greybox.model.program import AnyProgram, Program
from bayes_greybox.model.rows.row_kind import RowKind
from bayes_greybox.physics.catalogue.effects import BoundEffect
from bayes_greybox.physics.terms import Term

from .near import Point, Rows


class Source(ABC):
    """Rows of one equation.

    Attributes:
        clipped: True at rows where a channel's sensor was at its end, by channel.
        misread: True at rows where a state's or an input's sensor slipped, by channel.
        late: States that were late against the state that is their rate; they are put right first.
        sample_noise: Noise on samples that terms are evaluated at.
        n_sensor: Number of sensors that the rows are of.
    """

    def __init__(self, model: Program, train: Trajectories, equation: str, effects: Sequence[BoundEffect]) -> None:
        self.model, self.train, self.equation, self.effects = model, train, equation, effects
        self.clipped: Mapping[str, Bool[np.ndarray, " n"]] = {}
        self.misread: Mapping[str, Bool[np.ndarray, " n"]] = {}
        self.late: Mapping[str, Late] = {}
        self.sample_noise: Mapping[str, SampleNoise] = {}
        self.n_sensor = 1

    @abstractmethod
    def near(self, point: Point) -> Rows:
        """Return rows near a point.

        Raises:
            InputError: No path of the model at that point is near the samples.
        """

    @abstractmethod
    def quantities(self, rows: Rows) -> Mapping[str, Float[np.ndarray, " n_row"]]:
        """Return the quantities that the noise of rows may grow with."""

    @abstractmethod
    def put_right(self, data: Trajectories, point: Point, sensors: Sizes, clock: Trajectories) -> Trajectories:
        """Return data of the same sensors without their errors."""

    def row_kind(self, point: Point) -> RowKind | None:
        """Return the rows near a point, where rows are linear only near one; None where they are linear."""
        return None

    def with_inputs(self, program: AnyProgram) -> AnyProgram:
        """Return a model whose inputs go between their samples as they do here."""
        return program

    def doubts(self, rows: Rows) -> list[str]:
        """Return contradictions between the rows and any answer, in words."""
        return []


def modelled_rate(model: Program, data: Trajectories, equation: str, added: Sequence[tuple[Term, float]]) -> Rate:
    """Return the whole modelled rate: that of the simulation and of terms, on any data of the same columns."""
    simulation = model.simulator(data)

    def rate(data: Trajectories) -> np.ndarray:
        total = simulation.on(data, equation)
        for term, coefficient in added:
            total = total + coefficient * np.asarray(term.evaluate(data.columns))
        return total

    return rate


TURN_SHARE = 0.1
"""Share of its range that a state moves between two turns; less is noise and no turn."""


def period_of(data: Trajectories, equation: str) -> float:
    """Return the time in which the studied state goes to and fro; the longest run if it does not."""
    names = [equation] if equation in data.state_names else list(data.state_names) or list(data.input_names)
    runs = run_slices(data.run)
    durations = [float(np.ptp(data.time[rows])) for rows in runs]
    turns = max((sum(_turns(data.column(name)[rows]) for rows in runs) for name in names), default=0)
    return float(min(2 * sum(durations) / turns, max(durations))) if turns else max(durations)


def _turns(values: np.ndarray) -> int:
    """Return the number of turns of values by more than a share of their range."""
    least = TURN_SHARE * np.ptp(values)
    if least <= 0:
        return 0
    turns, rising, extreme = 0, 0, values[0]
    for value in values.tolist():
        if rising >= 0 and value > extreme or rising <= 0 and value < extreme:
            if rising == 0 and abs(value - values[0]) < least:
                continue
            rising = rising or (1 if value > values[0] else -1)
            extreme = value
        elif rising and abs(value - extreme) > least:
            turns, rising, extreme = turns + 1, -rising, value
    return turns
