"""Errors of sensors and inputs as suspects along a path: the path is that of samples which are free of them.

A suspect's column is its derivative near the errors so far, and what these do to the rows is added again, each as its
size times its column: a coefficient is a whole error, and the next turn takes its column there.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.data.samples.clipping import seen_samples
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.regressors.regressors import FREE, Regressors
from bayes_greybox.discovery.sensor_errors.bends import POWERS
from bayes_greybox.discovery.sensor_errors.channels import (
    DELAY,
    GAIN,
    ChannelSuspect,
    Rate,
    calibrated,
    driven_later,
    measured_at,
    shifted,
    slope_along,
)
from bayes_greybox.discovery.sensor_errors.sensors import bent_by, input_columns, sensor_columns
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.equation_rows import EquationRows
from bayes_greybox.physics.hidden_states import HiddenState, along
from bayes_greybox.physics.simulation.protocol import Simulation
from bayes_greybox.physics.terms import Term
from bayes_greybox.running.errors import InputError

TOLD = 1e-3
"""Share of what an error of a sensor does that no start of the path does as well, at least; else nothing tells it."""

LARGER, SAME = 1.01, 1e-6
"""States in another unit, little enough to stay where equations are defined, and how far columns may be from
proportional to be the same."""


def freed(
    samples: Trajectories, equation: str, sensors: Mapping[ChannelSuspect, float], clock: Trajectories
) -> Trajectories:
    """Samples without what errors of sensors and inputs did.

    Where the only sensor is late, the path is that of its clock, and inputs are taken as much later to it; delays of
    several sensors stay in their samples.

    Args:
        samples: As they came.
        equation: The learned state.
        sensors: Errors of a unit of their size.
        clock: Data that drifts were found on.
    """
    right, late = calibrated(samples, equation, sensors, clock), Late.of(samples, sensors)
    if not np.all(seen := seen_samples(samples)):
        # Put right, a sensor at its end does not stay at one value.
        right = replace(right, unseen=~seen)
    moved = driven_later(right, late.inputs) if any(late.inputs.values()) else right
    return replace(moved, time=moved.time - late.clock) if late.clock else moved


def put_right(
    samples: Trajectories, equation: str, sensors: Mapping[ChannelSuspect, float], clock: Trajectories
) -> Trajectories:
    """The same without delays of several sensors too, by splines, and without rows that nothing is known of then.

    Args:
        samples: As they came.
        equation: The learned state.
        sensors: Errors of a unit of their size.
        clock: Data that drifts were found on.
    """
    right, late = freed(samples, equation, sensors, clock), Late.of(samples, sensors)
    moved = {*late.inputs.values(), *late.states.values()} - {0.0}
    # The very samples where nothing moved: their path is known.
    return shifted(right, late.states).keep(measured_at(samples, moved)) if moved else right


class Late(NamedTuple):
    """How much later everything has to be taken for delays to be undone: by state where several have sensors."""

    clock: float
    inputs: Mapping[str, float]
    states: Mapping[str, float]

    @classmethod
    def of(cls, samples: Trajectories, sensors: Mapping[ChannelSuspect, float]) -> "Late":
        """Tell the clock, which is that of the only sensor, from what is late against it."""
        late, names = _late(sensors), samples.state_names
        clock = late.get(names[0], 0.0) if len(names) == 1 else 0.0
        inputs = {name: late.get(name, 0.0) - clock for name in samples.input_names}
        return cls(clock, inputs, {name: late[name] for name in names if name in late and len(names) > 1})


def _late(sensors: Mapping[ChannelSuspect, float]) -> dict[str, float]:
    return {suspect.channel: size for suspect, size in sensors.items() if suspect.kind == DELAY}


class Suspected(NamedTuple):
    """Suspects on rows near a model, in samples that are free of their errors so far.

    `sensors` are columns at the rows, in the sensors' units, `inputs` forces along the path, at the `nodes`; `shown` is
    what the errors so far do to the rows, each as its size times its column, so that a coefficient is a whole error.
    """

    sensors: list[tuple[ChannelSuspect, Float[np.ndarray, " n_row"]]]
    inputs: list[tuple[ChannelSuspect, Float[np.ndarray, " n_node"]]]
    shown: Float[np.ndarray, " n_row"]
    nodes: Trajectories
    samples: Trajectories
    simulation: Simulation

    @classmethod
    def of(
        cls, near: Program, data: Trajectories, equation: str, added: Sequence[tuple[Term, float]],
        sizes: Mapping[ChannelSuspect, float], rate: Rate, hidden: Sequence[HiddenState] = (),
    ) -> "Suspected":  # fmt: skip
        """Take the columns along a path.

        Args:
            near: The model with rows near what was found.
            data: Samples that are free of the errors so far, with the path through them.
            equation: The learned state.
            added: What was found beside the simulation.
            sizes: The errors so far.
            rate: The whole modelled rate.
            hidden: Hidden states of what was found, which follow an input that moves.
        """
        simulation, samples = near.simulator(data), data.samples
        assert samples is not None
        rows, nodes = near.equation_rows(data, equation), near.rows.nodes(data, equation, simulation)
        assert rows.operator is not None
        modelled = _modelled(rows, data, added)
        late = Late.of(samples, sizes).states
        at_rows = _at_rows(rows, samples)
        sensors = [(suspect, column[at_rows]) for suspect, column in sensor_columns(samples, modelled, late)]
        step = float(np.median(np.diff(samples.time)[np.diff(samples.run) == 0]))
        # An input that drives other states as well is another force on each of them, which no column here is.
        own = {equation, *(state.name for state in hidden)}
        others = [name for name in simulation.equations if name not in own]
        alone = [u for u in nodes.input_names if not any(_drives(u, simulation, name, nodes) for name in others)]
        inputs = input_columns(nodes, alone, _followed(rate, hidden, alone), step)
        known = {suspect.key: size for suspect, size in sizes.items()}
        if not (len(samples.state_names) > 1 or nodes.input_names or _dated(simulation, nodes, step)):
            # Nothing is late against anything: nothing was undone.
            known = {key: 0.0 if key.startswith(DELAY) else size for key, size in known.items()}
        force = sum((known.get(suspect.key, 0.0) * column for suspect, column in inputs), np.zeros(nodes.n_obs))
        straight = [(suspect, column) for suspect, column in sensors if suspect.kind not in POWERS]
        shown = sum((known.get(suspect.key, 0.0) * column for suspect, column in straight), np.zeros(rows.n_row))
        # What was straightened is bent again as it was: noise at the ends of a range is that of the sensor again.
        shown = shown + bent_by(samples, sizes)[at_rows]
        # A delay is no product of size and column: what a late sensor shows beyond it is taken off.
        before = shifted(modelled, {name: -by for name, by in late.items()})
        moved = [before.column(name) - modelled.column(name) for name in samples.state_names]
        shown = shown - np.concatenate(moved)[at_rows]
        shown = shown + rows.gain * rows.operator(force[:, None])[:, 0]
        return cls(sensors, inputs, shown, nodes, samples, simulation)

    def told(self, regressors: Regressors) -> list[tuple[ChannelSuspect, Float[np.ndarray, " n_row"]]]:
        """Errors of sensors that samples can tell, in the unit of the rows.

        Where nothing drives a system its clock may start at any time: a late sensor is another start.

        Args:
            regressors: Of the rows.
        """
        gain, noise = regressors.rows.gain, regressors.rows.noise
        unitless = len(self.samples.state_names) == 1 and _unitless(regressors, self.nodes, self.simulation)
        return [
            (suspect, column / gain)
            for suspect, column in self.sensors
            if np.linalg.norm(noise.without_starts(column[:, None])) > TOLD * np.linalg.norm(column)
            and not (suspect.kind == GAIN and unitless)
        ]


def _followed(rate: Rate, hidden: Sequence[HiddenState], inputs: Sequence[str]) -> Rate:
    """A rate in which hidden states follow the inputs along a path that stays: a lag is driven by a late input too."""
    if not any(name in state.symbols for state in hidden for name in inputs):
        return rate

    def at(data: Trajectories) -> np.ndarray:
        fresh = np.diff(data.run, prepend=-1) != 0
        (values,) = along([hidden], data.time, data.columns, fresh)
        return rate(replace(data, states={**data.states, **values}))

    return at


def _modelled(rows: EquationRows, data: Trajectories, added: Sequence[tuple[Term, float]]) -> Trajectories:
    """Data whose sampled states are what the model says of them, without the unknown force that moves the path.

    The path follows the samples, noise and all: a gain of it would explain the samples by themselves.
    """
    samples = data.samples
    assert samples is not None and rows.operator is not None
    n_node = len(next(iter(rows.columns.values())))
    force = sum((value * np.asarray(term.evaluate(rows.columns)) for term, value in added), np.zeros(n_node))
    path, at_rows = np.concatenate([data.column(name) for name in samples.state_names]), _at_rows(rows, samples)
    moved = path[at_rows] - rows.gain * (rows.simulated + rows.operator(force[:, None])[:, 0])
    # Where a sensor was at its end nothing tells the two apart.
    path[at_rows] -= rows.noise.without_starts(moved[:, None])[:, 0]
    own = path.reshape(len(samples.state_names), -1)
    return replace(data, states={**data.states, **dict(zip(samples.state_names, own, strict=True))})


def _at_rows(rows: EquationRows, samples: Trajectories) -> Int[np.ndarray, " n_row"]:
    """Where the rows are among the samples of all sensors, one sensor after the other."""
    assert rows.operator is not None
    sensor = np.repeat(np.arange(len(samples.state_names)), rows.n_row // len(samples.state_names))
    return sensor * samples.n_obs + rows.operator.sample


def _unitless(regressors: Regressors, nodes: Trajectories, simulation: Simulation) -> bool:
    """Whether states in another unit are states of the same model with other coefficients, all of which are learned.

    A gain of the only sensor is then no more than its unit, and where it comes in it stands for something else.
    """
    larger = replace(nodes, states={name: LARGER * x for name, x in nodes.states.items()})

    def proportional(before: np.ndarray, after: np.ndarray) -> float | None:
        """Factor between them, if they are one up to a factor; zero is any factor of zero."""
        square = float(before @ before)
        if not square > 0:
            return None if np.any(after) else LARGER
        factor = float(before @ after) / square
        return (
            factor if np.allclose(after, factor * before, rtol=SAME, atol=SAME * float(np.max(np.abs(after)))) else None
        )

    def at_both(values: Callable[[Trajectories], np.ndarray]) -> float | None:
        return proportional(*(np.broadcast_to(np.asarray(values(at), float), at.n_obs) for at in (nodes, larger)))

    terms = [term for i in regressors.of_kind(FREE) if (term := regressors.columns[i].term) is not None]
    try:
        with np.errstate(all="ignore"):
            known = [at_both(lambda at, k=k: simulation.on(at, k)) for k in simulation.equations]
            free = [at_both(lambda at, term=term: np.asarray(term.evaluate(at.columns))) for term in terms]
    except InputError:
        # States in another unit leave the domain of the equations.
        return False
    return all(f is not None and abs(f - LARGER) < SAME for f in known) and None not in free


def _dated(simulation: Simulation, nodes: Trajectories, step: float) -> bool:
    """Whether time itself is in the rates."""
    later = replace(nodes, time=nodes.time + step)
    return any(not np.array_equal(simulation.on(nodes, k), simulation.on(later, k)) for k in simulation.equations)


def _drives(name: str, simulation: Simulation, equation: str, data: Trajectories) -> bool:
    slope = slope_along(data, lambda at: simulation.on(at, equation), name, np.ones(data.n_obs))
    return bool(np.any(slope != 0))
