"""The data as effects are weighed on them, and any other data of the same sensors made alike."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.evidence.evaluations import Evaluations
from bayes_greybox.discovery.suspects.channels import ChannelSuspect, Rate, calibrated, slope_along, undone
from bayes_greybox.discovery.suspects.late import Late
from bayes_greybox.discovery.suspects.samples import SampleNoise
from bayes_greybox.model.noise.noise_model import NoiseModel
from bayes_greybox.model.program import AnyProgram
from bayes_greybox.model.rows.row_kind import RowKind
from bayes_greybox.physics.hidden_states import HiddenState

from .sensor_rows import at_end, beyond, earlier, mended, usable
from .sets import Sets


@dataclass(frozen=True)
class Aligned:
    """Data and statistics that effects are weighed on.

    Attributes:
        data: Measurements with states smoothed and delays undone.
        sets: Sets under the noise that the rows come with, delays that were undone in each of them.
        delays: What was undone, by channel.
        probability: Of each of these delays when it was found.
        sample_noise: Noise on the samples of states.
        late: States that were late against the state that is their rate, which was undone first.
        clipped: Rows at which a channel's sensor was at its end, by channel.
        misread: Rows at which a state's or an input's sensor slipped, by channel.
        rate: The whole modelled rate.
        bare: That of the simulation, before anything was found.
        used: Rows of the data as they came that are weighed.
        smooth: Frees states of such data of the noise on their samples.
        rows: Rows near what was found, where rows are linear only near a model.
        noise: Noise that was found on the way; None where none was looked for.
        hidden: Hidden states of what was found, which `rows` need in the model.
    """

    data: Trajectories
    sets: Sets
    delays: Mapping[str, float] = field(default_factory=dict)
    probability: Mapping[str, float] = field(default_factory=dict)
    sample_noise: Mapping[str, SampleNoise] = field(default_factory=dict)
    late: Mapping[str, Late] = field(default_factory=dict)
    clipped: Mapping[str, np.ndarray] = field(default_factory=dict)
    misread: Mapping[str, np.ndarray] = field(default_factory=dict)
    rate: Rate = lambda data: np.zeros(data.n_obs)
    bare: Rate = lambda data: np.zeros(data.n_obs)
    used: Bool[np.ndarray, " n_obs"] = field(default_factory=lambda: np.ones(0, bool))
    smooth: Callable[[Trajectories], Trajectories] = lambda data: data
    rows: RowKind | None = None
    noise: NoiseModel | None = None
    hidden: tuple[HiddenState, ...] = ()

    @property
    def evaluations(self) -> Evaluations:
        """Evidence under the noise that the rows come with."""
        return self.sets.evaluations

    @property
    def rates_measured(self) -> bool:
        """Whether rates have a sensor of their own, which the samples of the states may contradict."""
        return self.data.filter is None

    @property
    def n_sensor(self) -> int:
        """Sensors whose samples are rows; measured rates are one."""
        return 1

    @property
    def spurious(self) -> float:
        """RMS of what the noise left on smoothed states does to the modelled rate, (Σ s_k² mean(∂G/∂x_k)²)^½."""
        ones = np.ones(self.data.n_obs)
        squares = [
            noise.left**2 * float(np.mean(slope_along(self.data, self.rate, name, ones) ** 2))
            for name, noise in self.sample_noise.items()
        ]
        return float(np.sqrt(sum(squares)))

    def corrected(self, data: Trajectories) -> Trajectories:
        """Any data of the same sensors, as the training data were corrected: states smoothed, delays undone."""
        if self._equation not in data.derivatives:
            return self._moved(data)
        better, slips = mended(data, self._equation, self.bare) if self.misread else (data, {})
        return self._moved(better, *at_end(data, self._equation).values(), *slips.values())

    def with_inputs(self, program: AnyProgram) -> AnyProgram:
        """A model with what inputs do between their samples as it was found: rows of rates do not ask.

        Args:
            program: Any model of the same equations.
        """
        return program

    def shown(self, name: str) -> Float[np.ndarray, " n_obs"]:
        """What the sensor of a state shows on the path that was followed."""
        return self.data.column(name)

    def put_right(
        self, data: Trajectories, sensors: Mapping[ChannelSuspect, float], clock: Trajectories
    ) -> Trajectories:
        """Such data without the gains, offsets and drifts that were found.

        Args:
            data: Any data of the same sensors.
            sensors: Errors of a unit of their size, as found.
            clock: Data that drifts were found on.
        """
        return calibrated(self.corrected(data), self._equation, sensors, clock)

    def moved(self, data: Trajectories) -> Trajectories:
        """Such data with the rows too at which a sensor was at its end or slipped."""
        return self._moved(mended(data, self._equation, self.bare)[0] if self.misread else data)

    @property
    def _equation(self) -> str:
        return self.evaluations.statistics.equation

    def _moved(self, data: Trajectories, *out: np.ndarray) -> Trajectories:
        moved = undone(earlier(self.smooth(data), self.late), self._equation, self.delays)
        return moved.keep(usable(data, self._equation, self.delays, (*out, *beyond(data, self.late))))
