"""Rows of samples along a path, freed of the errors of their sensors."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.samples.clipping import clipped_states
from bayes_greybox.data.samples.sample_noise import sample_noise
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.grid.latent_force import gap_size
from bayes_greybox.discovery.grid.path_force import ForcedPath, PathSteps
from bayes_greybox.discovery.regressors.regressors import FREE, Regressors
from bayes_greybox.discovery.sensor_errors.channels import Sizes
from bayes_greybox.discovery.sensor_errors.memory import drift_columns, memory_columns
from bayes_greybox.discovery.sensor_errors.sensors import unit_of_rows
from bayes_greybox.model.assemble import with_rounding
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.path.reference_path import ReferencePath
from bayes_greybox.model.rows.row_kind import RowKind
from bayes_greybox.physics.catalogue.effects import BoundEffect
from bayes_greybox.physics.hidden_states import HiddenState
from bayes_greybox.running.errors import InputError

from .near import Point, Rows
from .path_sensors import PathErrors, freed, put_right
from .source import Source, modelled_rate, period_of, regressors_of, with_hidden_states


class SampleRows(Source):
    """Rows of one equation whose states were sampled; see `Source`."""

    def __init__(self, model: Program, train: Trajectories, equation: str, effects: Sequence[BoundEffect]) -> None:
        super().__init__(model, train, equation, effects)
        self._samples = train.samples or train
        self.clipped = clipped_states(self._samples)
        self.n_sensor = len(self._samples.state_names)
        # RMS of the gap as a force, and the sensors' noise, user's units, on the rows near the first point.
        self._gap: float | None = None
        self._noise: float | None = None

    def near(self, point: Point) -> Rows:
        """See `Source.near`."""
        train, equation, hidden = self.train, self.equation, point.hidden
        model = with_hidden_states(self.model.at(point.parameters), hidden, train)
        simulation = model.simulator(train)
        added = (*point.added, *self.model.named.slopes(equation, point.parameters))
        model = replace(model, rows=model.rows.around(added))
        right = freed(self._samples, equation, point.sensors, train) if point.sensors else train
        data = model.rows.complete(right, equation, simulation)
        rate = modelled_rate(model, data, equation, added)
        errors = PathErrors.of(model, data, equation, replace(point, added=added), rate)
        effects = [effect for effect in self.effects if point.weighs(effect.label)]
        regressors = regressors_of(model, data, equation, effects, point.values, errors.shown)
        identifiable = errors.identifiable(regressors)
        regressors.add_sensor_errors([each for each in identifiable if point.weighs(each[0].key)], at_rows=True)
        regressors.add_sensor_errors([each for each in errors.inputs if point.weighs(each[0].key)])
        # A hidden state is a memory itself.
        visible = replace(errors.nodes, states={name: errors.nodes.states[name] for name in self.model.states(train)})
        regressors.remember(chain(memory_columns(visible, point.weighs), drift_columns(visible, point.weighs)))
        scale = regressors.target_scale
        force, noise = _force(regressors, data, point)
        # Scales of effects and of starts are one, wherever rows are taken: else evidences near two hypotheses differ by
        # them. A path that a force moves leaves less noise.
        self._noise = self._noise or noise
        force = replace(force, start_sd=force.start_sd * noise / self._noise)
        if self._gap is None:
            free = regressors.at_rows(regressors.of_kind(FREE))
            self._gap = gap_size(force, regressors.target, free) * scale
        floor = with_rounding(regressors.rows.measured / scale, self.model.noise_floor) ** 2
        # In the unit of the samples as they came: those freed of a gain are over it.
        unit = math.log(scale * regressors.rows.gain) + unit_of_rows(right.samples or right, point.sensors)
        n_row, force = regressors.rows.n_row, replace(force, gap=self._gap / scale)
        return Rows(point, model, data, regressors, force, rate, np.arange(n_row), n_row, floor, unit)

    def quantities(self, rows: Rows) -> Mapping[str, Float[np.ndarray, " n_row"]]:
        """Return the columns along the path, of one sensor."""
        return rows.regressors.rows.at_rows() if self.n_sensor == 1 else {}

    def put_right(
        self, data: Trajectories, point: Point, sensors: Sizes, clock: Trajectories, hidden: Sequence[HiddenState] = ()
    ) -> Trajectories:
        """Return samples freed of errors, with the path through them that right inputs drive, and the path's states."""
        after = self._after(point)
        samples = put_right(data.samples or data, self.equation, sensors, clock)
        return after.rows.complete(samples, self.equation, after.simulator(samples))

    def row_kind(self, point: Point) -> RowKind | None:
        """See `Source.row_kind`."""
        return self._after(point).rows

    def doubts(self, rows: Rows) -> list[str]:
        """Return the sensors that were at their ends while the path stays within their ranges, in words."""
        samples = rows.data.samples or rows.data
        names = samples.state_names
        noise = dict(zip(names, sample_noise(samples.time, samples.matrix(names), samples.run_lengths), strict=True))
        doubts = []
        for name, at_end in self.clipped.items():
            end, path = samples.states[name][at_end], rows.data.column(name)[at_end]
            distance = np.where(end == np.max(samples.states[name]), end - path, path - end)
            # Inside by more than three standard deviations, at most of these samples.
            if np.mean(distance > 3.0 * noise[name]) > 0.5:
                doubts.append(name)
        text = "{} stays at the end of its sensor's range at samples where its path does not reach it"
        return [text.format(name) for name in doubts]

    def _after(self, point: Point) -> Program:
        """Return the model with rows near a point, or near the model before where that leads away from the samples."""
        model = with_hidden_states(self.model, point.hidden, self.train)
        values, equation = point.parameters, self.equation
        tangent = (*self.model.named.slopes(equation, values), *self.model.named.remainder(equation, values))
        after = replace(model, rows=model.rows.around((*point.added, *tangent)))
        try:
            after.rows.complete(self._samples, self.equation, after.simulator(self._samples))
        except InputError:
            return self.model
        return after


def _force(regressors: Regressors, data: Trajectories, point: Point) -> tuple[ForcedPath, float]:
    """Return the latent force that moves the path, in the scale of the target, and the noise of a typical sensor."""
    path = regressors.rows.operator
    assert isinstance(path, ReferencePath)
    segments, sensors = path.segments, len(path.segments.outputs)
    typical = float(np.sqrt(np.mean(path.sensor_sd**2)))
    relative = np.array(point.spread or path.sensor_sd / typical)
    steps = PathSteps(
        segments.response.M, segments.response.b[..., segments.driven[path.acting_on]] / path.gain,
        np.diff(segments.grid.time[:, ::2], axis=1), segments.end,
    )  # fmt: skip
    n = regressors.rows.n_row // sensors
    inside = np.diff(regressors.rows.time[:n])
    step = float(np.median(inside[inside > 0])) if np.any(inside > 0) else 1.0
    force = ForcedPath(
        steps, segments.outputs, path.start_sd / typical, np.repeat(relative, n), period_of(data, regressors.equation),
        step, typical / (path.gain * regressors.target_scale),
    )  # fmt: skip
    return force, typical
