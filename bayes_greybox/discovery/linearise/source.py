"""What makes rows near a point, whatever was measured, and puts data of the same sensors right."""

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.sensor_errors.channels import ChannelSuspect
from bayes_greybox.discovery.sensor_errors.late import Late
from bayes_greybox.discovery.sensor_errors.samples import SampleNoise
from bayes_greybox.model.program import AnyProgram
from bayes_greybox.model.rows.row_kind import RowKind

from .near import Point, Rows


@runtime_checkable
class Source(Protocol):
    """Rows of one equation."""

    @property
    def clipped(self) -> Mapping[str, Bool[np.ndarray, " n"]]:
        """Return the rows at which a channel's sensor was at its end."""
        ...

    @property
    def misread(self) -> Mapping[str, Bool[np.ndarray, " n"]]:
        """Return the rows at which a state's or an input's sensor slipped."""
        ...

    @property
    def late(self) -> Mapping[str, Late]:
        """Return the states that were late against the state that is their rate."""
        ...

    @property
    def sample_noise(self) -> Mapping[str, SampleNoise]:
        """Return the noise on samples that terms are evaluated at."""
        ...

    @property
    def n_sensor(self) -> int:
        """Return how many sensors the rows are of."""
        ...

    def near(self, point: Point) -> Rows:
        """Return rows near a point.

        Raises:
            InputError: No path of the model with what was found is near the samples.
        """
        ...

    def quantities(self, rows: Rows) -> dict[str, Float[np.ndarray, " n_row"]]:
        """Return what the noise of rows may grow with."""
        ...

    def put_right(
        self, data: Trajectories, point: Point, sensors: Mapping[ChannelSuspect, float], clock: Trajectories
    ) -> Trajectories:
        """Return data of the same sensors without their errors.

        Args:
            data: Any data of the same sensors.
            point: What the study ended at.
            sensors: Sizes of errors, in units of their own.
            clock: Data that drifts were found on.
        """
        ...

    def row_kind(self, point: Point) -> RowKind | None:
        """Return the rows near a point, where rows are linear only near one; None where they are linear."""
        ...

    def with_inputs(self, program: AnyProgram) -> AnyProgram:
        """Return a model with what inputs do between their samples as it was found."""
        ...

    def doubts(self, rows: Rows) -> list[str]:
        """Return what the rows themselves hold against any answer, in words."""
        ...
