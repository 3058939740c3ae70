"""Rows of samples along a path near what was found, freed of the errors of their sensors."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np
from jaxtyping import Bool, Float

from bayes_greybox.data.samples.clipping import clipped_states
from bayes_greybox.data.samples.sample_noise import sample_noise
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.grid.noise.gap_size import gap_size
from bayes_greybox.discovery.grid.noise.path_force import ForcedPath, Steps
from bayes_greybox.discovery.regressors.build import regressors_of
from bayes_greybox.discovery.regressors.regressors import FREE, Regressors
from bayes_greybox.discovery.sensor_errors.channels import ChannelSuspect
from bayes_greybox.discovery.sensor_errors.drift import drift_columns
from bayes_greybox.discovery.sensor_errors.late import Late
from bayes_greybox.discovery.sensor_errors.memory import memory_columns
from bayes_greybox.discovery.sensor_errors.samples import SampleNoise
from bayes_greybox.discovery.sensor_errors.sensors import unit_of_rows
from bayes_greybox.model.assemble import with_rounding
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.program import AnyProgram, Program
from bayes_greybox.model.rows.path.reference_path import ReferencePath
from bayes_greybox.model.rows.row_kind import RowKind
from bayes_greybox.physics.catalogue.effects import BoundEffect
from bayes_greybox.physics.hidden_states import HiddenState
from bayes_greybox.running.errors import InputError

from .modelled_rate import modelled_rate
from .near import Point, Rows
from .path_sensors import Suspected, freed, put_right
from .period import period_of

WITHIN, MOST_WITHIN = 3.0, 0.5
"""A path is within a sensor's range by more than so many standard deviations of its noise; it speaks against an answer
at more than this share of the samples at which the sensor was at its end."""


@dataclass(eq=False)
class SampleRows:
    """Makes rows of one equation whose states were sampled.

    Attributes:
        model: The model before.
        train: Samples as they came.
        equation: The studied state.
        effects: Effects bound to columns.
        _gap: RMS of the gap as a force, user's units, by the rows near the first point.
    """

    model: Program
    train: Trajectories
    equation: str
    effects: Sequence[BoundEffect]
    _gap: float | None = field(default=None, init=False, repr=False)

    def near(self, point: Point) -> Rows:
        """Return rows near a point.

        Raises:
            InputError: No path of the model with what was found is near the samples.
        """
        train, equation = self.train, self.equation
        own, hidden = self.model.states(train), point.hidden
        model = remembering(self.model, hidden, train)
        simulation, rows = model.simulator(train), model.rows.around(point.added)
        right = freed(train.samples or train, equation, point.sensors, train) if point.sensors else train
        near = replace(model, rows=rows)
        data = near.rows.complete(right, equation, simulation)
        rate = modelled_rate(near, data, equation, point.added)
        beside = Suspected.of(near, data, equation, point.added, point.sensors, rate, hidden)
        effects = [effect for effect in self.effects if point.weighs(effect.label)]
        found = regressors_of(near, data, equation, effects, point.values, beside.shown)
        found.suspect([each for each in beside.told(found) if point.weighs(each[0].key)], at_rows=True)
        found.suspect([each for each in beside.inputs if point.weighs(each[0].key)])
        # What a hidden state did before is what it is.
        shown = replace(beside.nodes, states={name: beside.nodes.states[name] for name in own})
        found.remember(chain(memory_columns(shown, point.weighs), drift_columns(shown, point.weighs)))
        force = _force(found, data, point)
        if self._gap is None:
            # The scale of effects is one, wherever rows are taken: else evidences near two hypotheses differ by it.
            free = found.at_rows(found.of_kind(FREE))
            self._gap = gap_size(force, found.target, free) * found.target_scale
        force = replace(force, gap=self._gap / found.target_scale)
        floor = with_rounding(found.rows.measured / found.target_scale, self.model.noise_floor) ** 2
        # Of the samples as they came: those freed of a gain are over it.
        unit = math.log(found.target_scale * found.rows.gain) + unit_of_rows(right.samples or right, point.sensors)
        n_row = found.rows.n_row
        return Rows(point, near, data, found, force, rate, np.arange(n_row), n_row, floor, unit)

    @property
    def clipped(self) -> dict[str, Bool[np.ndarray, " n"]]:
        """See `Source.clipped`."""
        return clipped_states(self.train.samples or self.train)

    @property
    def misread(self) -> dict[str, Bool[np.ndarray, " n"]]:
        """See `Source.misread`: noise of samples is the rows' own."""
        return {}

    @property
    def late(self) -> dict[str, Late]:
        """See `Source.late`: delays of several sensors are regressors."""
        return {}

    @property
    def sample_noise(self) -> dict[str, SampleNoise]:
        """See `Source.sample_noise`: that of samples is the rows' own."""
        return {}

    @property
    def n_sensor(self) -> int:
        """See `Source.n_sensor`."""
        return len((self.train.samples or self.train).state_names)

    def quantities(self, rows: Rows) -> dict[str, Float[np.ndarray, " n_row"]]:
        """See `Source.quantities`: the columns along the path."""
        return rows.regressors.rows.at_rows() if self.n_sensor == 1 else {}

    def put_right(
        self, data: Trajectories, point: Point, sensors: Mapping[ChannelSuspect, float], clock: Trajectories
    ) -> Trajectories:
        """See `Source.put_right`: samples freed of errors, with the path through them that right inputs drive."""
        after = self._after(point)
        samples = put_right(data.samples or data, self.equation, sensors, clock)
        return after.rows.complete(samples, self.equation, after.simulator(samples))

    def row_kind(self, point: Point) -> RowKind | None:
        """See `Source.row_kind`."""
        return self._after(point).rows

    def with_inputs(self, program: AnyProgram) -> AnyProgram:
        """See `Source.with_inputs`."""
        if program.rows.interpolation == self.model.rows.interpolation:
            return program
        return replace(program, rows=program.rows.held())

    def doubts(self, rows: Rows) -> list[str]:
        """See `Source.doubts`: a path that stays within the range of a sensor that was at its end."""
        samples = rows.data.samples or rows.data
        names = samples.state_names
        noise = dict(zip(names, sample_noise(samples.time, samples.matrix(names), samples.run_lengths), strict=True))
        said = []
        for name, at_end in self.clipped.items():
            end, path = samples.states[name][at_end], rows.data.column(name)[at_end]
            inside = np.where(end == np.max(samples.states[name]), end - path, path - end) > WITHIN * noise[name]
            if np.mean(inside) > MOST_WITHIN:
                said.append(
                    f"{name} stays at the end of its sensor's range at samples where its path does not reach it"
                )
        return said

    def _after(self, point: Point) -> Program:
        """Return the model with rows near a point, or near the model before where that leads away from the samples."""
        model = remembering(self.model, point.hidden, self.train)
        after = replace(model, rows=model.rows.around(point.added))
        samples = self.train.samples or self.train
        try:
            after.rows.complete(samples, self.equation, after.simulator(samples))
        except InputError:
            return self.model
        return after


def remembering(model: Program, hidden: Sequence[HiddenState], train: Trajectories) -> Program:
    """Return the model with hidden states, on which no f that is weighed depends."""
    if not hidden:
        return model
    return replace(model, discrepancy=model.discrepancy or OrthogonalGP()).remembering(hidden, train)


def _force(found: Regressors, data: Trajectories, point: Point) -> ForcedPath:
    """Return how a latent force moves the path, in the scale of the target."""
    path = found.rows.operator
    assert isinstance(path, ReferencePath)
    segments, sensors = path.segments, len(path.segments.outputs)
    relative = np.array(point.spread or path.sensor_sd / np.sqrt(np.mean(path.sensor_sd**2)))
    typical = float(np.sqrt(np.mean(path.sensor_sd**2)))
    time = segments.grid.time[:, ::2]
    steps = Steps(
        segments.response.M, segments.response.b[..., segments.driven[path.acting_on]] / path.gain,
        np.diff(time, axis=1), segments.end,
    )  # fmt: skip
    n = found.rows.n_row // sensors
    inside = np.diff(found.rows.time[:n])
    step = float(np.median(inside[inside > 0])) if np.any(inside > 0) else 1.0
    return ForcedPath(
        steps, segments.outputs, path.start_sd / typical, np.repeat(relative, n), period_of(data, found.equation), step,
        typical / (path.gain * found.target_scale),
    )  # fmt: skip
