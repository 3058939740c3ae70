"""Rows of a sensor's samples: what is modelled is the path that they are samples of.

A sample is y_i = h(x(t_i)) + e_i, with ẋ = g + e_k (Φθ + f) for a learned state k and x(t₀) unknown. Along a
reference path x̄ that follows g + Φθ̄ but for small defects, x = x̄ + δ and δ̇ = A δ + e_k (Φθ + f − Φθ̄) is linear, so

    y_i = h(x̄_i + response to the defects − response to Φθ̄) + V (Φθ + f) + S₀ δ₀ + e_i,

V the response to a force. These are rows as any others: Φ and f are evaluated along x̄, V is their operator, and the
starts δ₀ of the segments, with a wide prior, belong to the noise. Of several learned states each has its Φθ and its V,
on the same rows: V Φθ is then a sum over them. The reference is the smoothed path of a model in which an unknown force
may act (see `integration.smoothing`), so that it follows the data whatever is missing; where nothing is missing it is a
path that the model allows. States that no sensor measures are part of x all the same.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from bayes_greybox.data.noise.protocol import RowNoise
from bayes_greybox.data.noise.starts_noise import StartsNoise
from bayes_greybox.data.noise.weighted import WeightedNoise
from bayes_greybox.data.noise.white import WhiteNoise
from bayes_greybox.data.samples.clipping import clipped_in_words, clipped_states
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.rows.path.common import Common, ends_of_sensors
from bayes_greybox.model.rows.path.exact_path import exact_samples
from bayes_greybox.model.rows.path.forced_rate import Force, ForcedRate
from bayes_greybox.model.rows.path.reference_path import ReferencePath, follow_samples
from bayes_greybox.physics.integration.adaptive_steps import INTERPOLATIONS
from bayes_greybox.physics.simulation.protocol import Simulation
from bayes_greybox.physics.simulation.reading import named_states
from bayes_greybox.physics.terms import Term
from bayes_greybox.physics.units import with_rates
from bayes_greybox.running.errors import InputError

from .equation_rows import EquationRows, block_name
from .row_kind import RowKind

_KNOWN: WeakKeyDictionary[Trajectories, dict[Any, ReferencePath]] = WeakKeyDictionary()
"""Reference paths by the samples that they were found from, the latest `REMEMBERED`."""

REMEMBERED = 4
"""Paths of some samples that are kept: a study asks for the same one several times in a row."""


@dataclass(frozen=True)
class TrajectoryRows(RowKind):
    """Samples of sensors as rows, for data without measured rates; states of the simulation may have no sensor at all.

    Where a noisy sensor stays at the end of its range, samples are no rows: it shows less than there is.

    Attributes:
        substeps: Steps of the path between two samples; enough for the equations by default.
        interpolation: Of the inputs between samples: "linear", "zoh" (held) or "cubic"; by default each input's own.
        added: Terms and coefficients of the model that the rows are linear near: what a fit or a study has found.
        added_to: The learned state of each of these, where there are several.
        process_noise: Whether the path that rows are linear near may be moved by an unknown force, as strong as the
            samples ask for. Without, it is a path that the model allows.
        same_noise: Whether the noise of all sensors is known to be the same, in their common unit; else each has its
            own, which few samples tell poorly.
        force: Intensity λ = q²/σ² of an unknown force that is part of the noise, as `bg.Noise(force="fit")` finds it.
        at_rest: Hidden states that are at rest where a run starts, or nearly: zero give or take their size, each with
            the column that it is about as large as. Other hidden states may start anywhere.
        moving: Those of them that start about where a sampled column does, with that column.
        segment: Time that a segment of the path lasts at most: each has a start of its own. None: as long as a change
            of a start stays within bounds, which no segment exceeds.
    """

    substeps: int | None = None
    interpolation: str | None = None
    added: tuple[tuple[str, float], ...] = ()
    added_to: tuple[str, ...] = ()
    process_noise: bool = True
    same_noise: bool = False
    force: float = 0.0
    at_rest: tuple[tuple[str, str], ...] = ()
    moving: tuple[tuple[str, str], ...] = ()
    segment: float | None = None

    def __post_init__(self) -> None:
        # Files have lists for tuples.
        object.__setattr__(self, "added", tuple((str(text), float(value)) for text, value in self.added))
        object.__setattr__(self, "added_to", tuple(self.added_to))
        object.__setattr__(self, "at_rest", tuple((str(name), str(column)) for name, column in self.at_rest))
        object.__setattr__(self, "moving", tuple((str(name), str(column)) for name, column in self.moving))
        if self.substeps is not None and not 1 <= self.substeps <= 1000:
            raise InputError(f"TrajectoryRows(substeps={self.substeps}) must be between 1 and 1000.")
        if self.segment is not None and not self.segment > 0:
            raise InputError(f"TrajectoryRows(segment={self.segment!r}) must be a time above 0.")
        if not 0 <= self.force < math.inf:
            raise InputError(f"TrajectoryRows(force={self.force!r}) must be a number, 0 or above.")
        if self.interpolation not in (None, *INTERPOLATIONS):
            raise InputError(
                f"TrajectoryRows(interpolation={self.interpolation!r}) must be one of {', '.join(INTERPOLATIONS)}."
            )

    @property
    def rates_measured(self) -> bool:
        """No: rates are those of the path."""
        return False

    @property
    def integrated(self) -> bool:
        """Yes: a path goes where its coefficients lead it."""
        return True

    @property
    def starts(self) -> Mapping[str, str]:
        """Of hidden states that rest or move along with a column where a run starts."""
        return {**{name: "" for name, _ in self.at_rest}, **dict(self.moving)}

    @property
    def shared(self) -> bool:
        """Yes: each sample tells of all states."""
        return True

    def nodes(self, data: Trajectories, equation: str, simulation: Simulation, whole: bool = False) -> Trajectories:
        """States and inputs at the ends and middles of the path's steps; a segment is a run, or part of one."""
        path = self.path(data, (equation,), simulation)
        n_segment, n_node = path.segments.grid.time.shape
        run = np.arange(n_segment)
        if whole:
            run[path.ends[:, 0]] = (data.samples or data).run
        return replace(
            data,
            time=path.segments.grid.time.ravel(),
            run=np.repeat(run, n_node),
            states={name: path.columns[name] for name in simulation.states},
            inputs={name: path.columns[name] for name in simulation.inputs},
            derivatives={},
            noise={},
            run_names=tuple(str(k) for k in range(int(run[-1]) + 1)),
            samples=None,
        )

    def hidden(self, simulation: Any, data: Trajectories) -> tuple[str, ...]:
        """States of the simulation's expressions that the data lack."""
        return tuple(name for name in named_states(simulation) if name not in data.columns)

    def around(self, added: Sequence[tuple[Term, float]], to: Sequence[str] = ()) -> "TrajectoryRows":
        """Rows linear near the model with these terms."""
        return replace(self, added=tuple((term.text, float(value)) for term, value in added), added_to=tuple(to))

    def resting(self, states: Mapping[str, str], starts: Mapping[str, str]) -> "TrajectoryRows":
        """Rows with more hidden states that are at rest where a run starts, or move along with a column."""
        at_rest, moving = {**dict(self.at_rest), **states}, {**dict(self.moving), **starts}
        return replace(self, at_rest=tuple(at_rest.items()), moving=tuple(moving.items()))

    def moved_by(self, intensity: float) -> "TrajectoryRows":
        """Rows with an unknown force in their noise."""
        return replace(self, force=float(intensity))

    def in_words(self, data: Trajectories) -> str:
        """Samples, and of which states."""
        return f"samples of {', '.join((data.samples or data).state_names)} along a path"

    def left_out(self, data: Trajectories) -> tuple[str, ...]:
        """Samples of clipped sensors."""
        samples = data.samples or data
        if samples.unseen is not None:
            return (f"sensors are clipped at {int(samples.unseen.sum())} samples, which are left out",)
        return tuple(clipped_in_words(name, rows) for name, rows in clipped_states(samples).items())

    def unforced(self) -> "TrajectoryRows":
        """Rows without process noise."""
        return replace(self, process_noise=False)

    def segments(self, data: Trajectories) -> int:
        """Segments of each run that are asked for."""
        return 1 if self.segment is None else max(1, math.ceil(_longest(data) / self.segment * (1 - 1e-9)))

    def in_segments(self, segments: int, data: Trajectories) -> "TrajectoryRows":
        """Rows of a path in so many segments at least, and as long ones on other data."""
        return replace(self, segment=None if segments == 1 else _longest(data) / segments)

    def held(self) -> "TrajectoryRows":
        """Rows whose inputs are held."""
        return replace(self, interpolation="zoh")

    def complete(self, data: Trajectories, equation: str, simulation: Simulation) -> Trajectories:
        """Data with the reference path for states and its rate for the learned state's; samples go along."""
        return self.complete_all(data, (equation,), simulation)

    def complete_all(self, data: Trajectories, equations: tuple[str, ...], simulation: Simulation) -> Trajectories:
        """The same with the rates of several learned states."""
        path = self.path(data, equations, simulation)
        samples = data.samples or data
        noise = {} if data.samples is None else data.noise
        states = dict(zip(simulation.states, path.at_samples.T, strict=True))
        rates = dict(zip(equations, path.rates.T, strict=True))
        units = with_rates(data.units, {name: simulation.rate_name(name) for name in simulation.states})
        return replace(data, states=states, derivatives=rates, units=units, noise=noise, samples=samples)

    def rows(self, data: Trajectories, equation: str, simulation: Simulation) -> EquationRows:
        """The rows of one equation; see `RowKind.rows`."""
        return self.shared_rows(data, (equation,), simulation)

    def shared_rows(self, data: Trajectories, equations: tuple[str, ...], simulation: Simulation) -> EquationRows:
        """The rows that tell of all these equations; see `RowKind.shared_rows`."""
        path, samples = self.path(data, equations, simulation), data.samples or data
        # Noise of completed data was found on these rows; that of others is of rates.
        sensor = None if data.samples is None else data.noise.get(block_name(equations))
        return _rows_of(path, samples, equations, simulation, sensor, self.force)

    def of_runs(self, data: Trajectories, equations: tuple[str, ...], simulation: Simulation) -> "TrajectoryRuns":
        """Rows of further runs, with noise, sizes, steps and the unknown force as these samples have them."""
        common = self.path(data, equations, simulation).common
        return TrajectoryRuns(self, replace(common, clipped=ends_of_sensors(data.samples or data)))

    def path(self, data: Trajectories, equations: tuple[str, ...], simulation: Simulation) -> ReferencePath:
        """The reference path.

        Args:
            data: Samples, or completed data.
            equations: The learned states.
            simulation: The known rates of all states.

        Raises:
            InputError: A state without an equation; too few samples.
        """
        samples = data.samples or data
        # The force in the noise changes no path.
        key = (replace(self, force=0.0), equations, simulation.key)
        known = _KNOWN.setdefault(samples, {})
        if key not in known:
            while len(known) >= REMEMBERED:
                del known[next(iter(known))]
            known[key] = self.followed(samples, equations, simulation)
        return known[key]

    def followed(
        self, samples: Trajectories, equations: tuple[str, ...], simulation: Simulation, common: Common | None = None
    ) -> ReferencePath:
        """The path through samples.

        Args:
            samples: What the sensors showed.
            equations: The learned states.
            simulation: The known rates of all states.
            common: What other runs have in common with these; found from these if left out.
        """
        to = self.added_to or (equations[0],) * len(self.added)
        states = [simulation.states.index(name) for name in to]
        terms = [Force(Term(text), value, k) for (text, value), k in zip(self.added, states, strict=True)]
        return follow_samples(
            samples,
            equations,
            simulation,
            terms,
            self.substeps,
            self.interpolation,
            self.process_noise,
            self.same_noise,
            dict(self.at_rest),
            dict(self.moving),
            self.segments(samples),
            common,
        )


@dataclass(frozen=True)
class TrajectoryRuns:
    """Rows of runs one by one, which together are those of all runs at once.

    Attributes:
        kind: The kind of rows.
        common: What the runs have in common.
    """

    kind: TrajectoryRows
    common: Common

    def shared_rows(self, data: Trajectories, equations: tuple[str, ...], simulation: Simulation) -> EquationRows:
        """The rows of some runs."""
        path = self.kind.followed(data, equations, simulation, self.common)
        return _rows_of(path, data, equations, simulation, None, self.kind.force)


def _rows_of(
    path: ReferencePath, samples: Trajectories, equations: tuple[str, ...], simulation: Simulation,
    sensor: RowNoise | None, force: float,
) -> EquationRows:  # fmt: skip
    """Rows along a path; the noise of the sensors is white where it is not known."""
    measured, run = samples.matrix(samples.state_names)[path.seen], samples.run[path.seen]
    n_seen, n_output = measured.shape
    lengths = tuple(np.bincount(run, minlength=samples.n_run).tolist()) * n_output
    # R is over σ², σ the noise of a typical sensor.
    typical = float(np.sqrt(np.mean(path.sensor_sd**2)))
    sensor = sensor or WeightedNoise(WhiteNoise(lengths), np.repeat(path.sensor_sd / typical, n_seen))
    noise = StartsNoise(sensor, path.starts / typical, cache(lambda: path.motion(typical)))
    return EquationRows(
        equation=block_name(equations),
        columns=path.columns,
        measured=measured.T.ravel() / path.gain,
        simulated=path.simulated / path.gain,
        noise=noise.forced(force) if force and sensor.independent else noise,
        time=np.tile(samples.time[path.seen], n_output),
        run=np.concatenate([run + k * samples.n_run for k in range(n_output)]),
        operator=path,
        gain=path.gain,
        unfollowed=path.unfollowed,
        learned=path.acting(),
        segments=path.pieces,
        exact=lambda added, starts: (
            exact_samples(path, ForcedRate(simulation, path.segments.driven, ()), added, starts * path.gain / typical)
            / path.gain
        ),
    )


def _longest(data: Trajectories) -> float:
    """Time that the longest run of the samples lasts."""
    samples = data.samples or data
    parts = np.split(samples.time, np.cumsum(samples.run_lengths)[:-1])
    return float(max(part[-1] - part[0] for part in parts))
