"""Errors of sensors and inputs along a path, which is that of samples free of them.

The column of an error is its derivative near the errors so far. The effect of these on the rows is added again, each as
its size times its column: a coefficient is a whole error, and the next turn takes its column there.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.data.samples.clipping import seen_samples
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.regressors.regressors import FREE, Regressors
from bayes_greybox.discovery.sensor_errors import channels
from bayes_greybox.discovery.sensor_errors.bends import BEND_POWERS
from bayes_greybox.discovery.sensor_errors.channels import ErrorColumns, Rate, Sizes
from bayes_greybox.discovery.sensor_errors.sensors import bent_by, input_columns, sensor_columns
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.equation_rows import EquationRows
from bayes_greybox.physics.hidden_states import HiddenState, along
from bayes_greybox.physics.simulation.protocol import Simulation
from bayes_greybox.physics.terms import Term
from bayes_greybox.running.errors import InputError

from .near import Point

SCALED, PROPORTIONAL = 1.01, 1e-6
"""Factor of states in another unit, near one for them to stay where equations are defined, and relative tolerance."""


def freed(samples: Trajectories, equation: str, sensors: Sizes, clock: Trajectories) -> Trajectories:
    """Return samples without the errors of sensors and inputs, but for the delays of several sensors.

    Where the only sensor is late, the path is that of its clock, and inputs are taken as much later to it.
    """
    right, late = channels.calibrated(samples, equation, sensors, clock), Shifts.of(samples, sensors)
    if not np.all(seen := seen_samples(samples)):
        # Put right, a sensor at its end does not stay at one value.
        right = replace(right, unseen=~seen)
    moved = channels.shifted(right, late.inputs) if any(late.inputs.values()) else right
    return replace(moved, time=moved.time - late.clock) if late.clock else moved


def put_right(samples: Trajectories, equation: str, sensors: Sizes, clock: Trajectories) -> Trajectories:
    """Return samples without any errors, where all were measured; delays of several sensors are undone by splines."""
    right, late = freed(samples, equation, sensors, clock), Shifts.of(samples, sensors)
    moved = {*late.inputs.values(), *late.states.values()} - {0.0}
    # The very samples where nothing moved: their path is known.
    return channels.shifted(right, late.states).keep(channels.measured_at(samples, moved)) if moved else right


class Shifts(NamedTuple):
    """Shifts to later times that undo delays: of the clock, of inputs, and of states where several have sensors."""

    clock: float
    inputs: Mapping[str, float]
    states: Mapping[str, float]

    @classmethod
    def of(cls, samples: Trajectories, sensors: Sizes) -> "Shifts":
        """Return the shifts; the clock is that of the only sensor."""
        late, names = channels.delays_of(sensors), samples.state_names
        clock = late.get(names[0], 0.0) if len(names) == 1 else 0.0
        inputs = {name: late.get(name, 0.0) - clock for name in samples.input_names}
        return cls(clock, inputs, {name: late[name] for name in names if name in late and len(names) > 1})


class PathErrors(NamedTuple):
    """Errors of sensors, at the rows in the sensors' units, and of inputs, as forces at the nodes of the path.

    `shown` is the effect of the errors so far on the rows, each as its size times its column.
    """

    sensors: ErrorColumns
    inputs: ErrorColumns
    shown: Float[np.ndarray, " n_row"]
    nodes: Trajectories
    samples: Trajectories
    simulation: Simulation

    @classmethod
    def of(cls, model: Program, data: Trajectories, equation: str, point: Point, rate: Rate) -> "PathErrors":
        """Return the columns along a path."""
        simulation, samples, sizes = model.simulator(data), data.samples, point.sensors
        assert samples is not None
        rows, nodes = model.equation_rows(data, equation), model.rows.nodes(data, equation, simulation)
        assert rows.operator is not None
        modelled, late = _modelled(rows, data, point.added), Shifts.of(samples, sizes).states
        at_rows = _at_rows(rows, samples)
        sensors = [(error, column[at_rows]) for error, column in sensor_columns(samples, modelled, late)]
        step = float(np.median(np.diff(samples.time)[np.diff(samples.run) == 0]))
        # An input that drives other states as well is another force on each of them, which no column here is.
        driven = {equation, *(state.name for state in point.hidden)}
        others = [name for name in simulation.equations if name not in driven]
        alone = [u for u in nodes.input_names if not any(_drives(u, simulation, name, nodes) for name in others)]
        inputs = input_columns(nodes, alone, _followed(rate, point.hidden, alone), step)
        by_key = {error.key: size for error, size in sizes.items()}
        later = replace(nodes, time=nodes.time + step)
        dated = any(not np.array_equal(simulation.on(nodes, k), simulation.on(later, k)) for k in simulation.equations)
        if not (len(samples.state_names) > 1 or nodes.input_names or dated):
            # Nothing is late against anything: nothing was undone.
            by_key = {key: 0.0 if key.startswith(channels.DELAY) else size for key, size in by_key.items()}
        force = sum((by_key.get(error.key, 0.0) * column for error, column in inputs), np.zeros(nodes.n_obs))
        straight = [(error, column) for error, column in sensors if error.kind not in BEND_POWERS]
        shown = sum((by_key.get(error.key, 0.0) * column for error, column in straight), np.zeros(rows.n_row))
        # Straightened samples are bent again: noise at the ends of a range is that of the sensor again.
        shown = shown + bent_by(samples, sizes)[at_rows]
        # A delay is no product of size and column: the rest of a late sensor's reading is taken off.
        before = channels.shifted(modelled, {name: -by for name, by in late.items()})
        moved = [before.column(name) - modelled.column(name) for name in samples.state_names]
        shown = shown - np.concatenate(moved)[at_rows]
        shown = shown + rows.gain * rows.operator(force[:, None])[:, 0]
        return cls(sensors, inputs, shown, nodes, samples, simulation)

    def identifiable(self, regressors: Regressors) -> ErrorColumns:
        """Return the errors whose column no start of the path takes over to a thousandth, in the unit of the rows.

        Where nothing drives a system its clock may start at any time: a late sensor is another start.
        """
        gain, noise = regressors.rows.gain, regressors.rows.noise
        unitless = len(self.samples.state_names) == 1 and _unitless(regressors, self.nodes, self.simulation)
        return [
            (error, column / gain)
            for error, column in self.sensors
            if np.linalg.norm(noise.without_starts(column[:, None])) > 1e-3 * np.linalg.norm(column)
            and not (error.kind == channels.GAIN and unitless)
        ]


def _followed(rate: Rate, hidden: Sequence[HiddenState], inputs: Sequence[str]) -> Rate:
    """Return a rate whose hidden states follow the inputs along a path: a late input drives a lag, too."""
    if not any(name in state.symbols for state in hidden for name in inputs):
        return rate

    def at(data: Trajectories) -> np.ndarray:
        fresh = np.diff(data.run, prepend=-1) != 0
        (values,) = along([hidden], data.time, data.columns, fresh)
        return rate(replace(data, states={**data.states, **values}))

    return at


def _modelled(rows: EquationRows, data: Trajectories, added: Sequence[tuple[Term, float]]) -> Trajectories:
    """Return data whose sampled states are those of the model: the path itself follows the samples' noise."""
    samples = data.samples
    assert samples is not None and rows.operator is not None
    n_node = len(next(iter(rows.columns.values())))
    force = sum((value * np.asarray(term.evaluate(rows.columns)) for term, value in added), np.zeros(n_node))
    path, at_rows = np.concatenate([data.column(name) for name in samples.state_names]), _at_rows(rows, samples)
    moved = path[at_rows] - rows.gain * (rows.simulated + rows.operator(force[:, None])[:, 0])
    # Where a sensor was at its end nothing tells the two apart.
    path[at_rows] -= rows.noise.without_starts(moved[:, None])[:, 0]
    by_sensor = path.reshape(len(samples.state_names), -1)
    return replace(data, states={**data.states, **dict(zip(samples.state_names, by_sensor, strict=True))})


def _at_rows(rows: EquationRows, samples: Trajectories) -> Int[np.ndarray, " n_row"]:
    """Return the places of the rows among the samples of all sensors, one sensor after the other."""
    assert rows.operator is not None
    sensor = np.repeat(np.arange(len(samples.state_names)), rows.n_row // len(samples.state_names))
    return sensor * samples.n_obs + rows.operator.sample


def _unitless(regressors: Regressors, nodes: Trajectories, simulation: Simulation) -> bool:
    """Return true if a gain of the only sensor is no more than its unit: learned coefficients make up for it."""
    scaled = replace(nodes, states={name: SCALED * x for name, x in nodes.states.items()})

    def factor(values: Callable[[Trajectories], np.ndarray]) -> float | None:
        """Return the factor between values in both units, None if there is none; any factor of zero is zero."""
        before, after = (np.broadcast_to(np.asarray(values(at), float), at.n_obs) for at in (nodes, scaled))
        square = float(before @ before)
        if not square > 0:
            return None if np.any(after) else SCALED
        ratio = float(before @ after) / square
        tolerance = PROPORTIONAL * float(np.max(np.abs(after)))
        return ratio if np.allclose(after, ratio * before, rtol=PROPORTIONAL, atol=tolerance) else None

    terms = [term for i in regressors.of_kind(FREE) if (term := regressors.columns[i].term) is not None]
    try:
        with np.errstate(all="ignore"):
            simulated = [factor(lambda at, k=k: simulation.on(at, k)) for k in simulation.equations]
            free = [factor(lambda at, term=term: np.asarray(term.evaluate(at.columns))) for term in terms]
    except InputError:
        # States in another unit leave the domain of the equations.
        return False
    return all(f is not None and abs(f - SCALED) < PROPORTIONAL for f in simulated) and None not in free


def _drives(name: str, simulation: Simulation, equation: str, data: Trajectories) -> bool:
    slope = channels.slope_along(data, lambda at: simulation.on(at, equation), name, np.ones(data.n_obs))
    return bool(np.any(slope != 0))
