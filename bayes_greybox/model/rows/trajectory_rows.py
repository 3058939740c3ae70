"""Rows of a sensor's samples, by a model of the path that they sample.

A sample is y_i = h(x(t_i)) + e_i, with ẋ = g + e_k (Φθ + f) for a learned state k and x(t₀) unknown. Along a
reference path x̄ that follows g + Φθ̄ but for small defects, x = x̄ + δ and δ̇ = A δ + e_k (Φθ + f − Φθ̄) is linear, so

    y_i = h(x̄_i + response to the defects − response to Φθ̄) + V (Φθ + f) + S₀ δ₀ + e_i,

V the response to a force. Φ and f are evaluated along x̄, and the starts δ₀ of the segments, with a wide prior, belong
to the noise. Several learned states each have their own Φθ and V on the same rows: V Φθ is then a sum over them. The
reference is the smoothed path of a model in which an unknown force may act (see `integration.smoothing`), so it follows
the data whatever is missing. States that no sensor measures are part of x too.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.noise.protocol import RowNoise
from bayes_greybox.data.noise.starts_noise import StartsNoise
from bayes_greybox.data.noise.weighted import WeightedNoise, WhiteNoise
from bayes_greybox.data.samples.clipping import clipped_in_words, clipped_states
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.integration.sensitivity import carried, hermite
from bayes_greybox.physics.simulation.protocol import Simulation
from bayes_greybox.physics.terms import Term
from bayes_greybox.physics.units import with_rates
from bayes_greybox.running.errors import InputError

from .equation_rows import EquationRows, block_name
from .path.common import Common, ends_of_sensors
from .path.forced_rate import Force, ForcedRate
from .path.path_segments import departures, points_at_ends, points_at_nodes
from .path.reference_path import PathSettings, ReferencePath, follow_samples
from .row_kind import Remembered, RowKind, RowsOfRuns, checked_interpolation

_PATHS = Remembered()

Added = Callable[[Mapping[str, np.ndarray], int], Float[np.ndarray, "n n_learned"]]
"""From columns [n] and the number of a draw to what it adds to the rates of the learned states, user's units."""


@dataclass(frozen=True)
class TrajectoryRows(RowKind):
    """Samples of sensors as rows, for data without measured rates; states of the simulation may have no sensor at all.

    Samples of a noisy sensor that stays at the end of its range are left out: it shows less than there is.

    Attributes:
        substeps: Number of steps of the path between two samples; by default enough for the equations.
        interpolation: Interpolation of the inputs between samples: "linear", "zoh" (zero-order hold) or "cubic", one
            for all, or one for each in their order; by default chosen for each input.
        added: Terms and coefficients of the model that the rows are linearised near: findings of a fit or study.
        added_to: Learned state of each of these, where there are several.
        process_noise: If true, an unknown force, as strong as the samples require, may move the path that rows are
            linearised near. Else the model allows that path.
        same_noise: If true, the noise of all sensors is known to be the same, in their common unit; else each has its
            own, which few samples determine poorly.
        force: Intensity λ = q²/σ² of an unknown force that is part of the noise, as `bg.Noise(force="fit")` finds it.
        at_rest: Hidden states that start a run at rest, or nearly: at zero give or take their size, each with a column
            of about that size. Other hidden states may start anywhere.
        moving: Those of `at_rest` that start about where a sampled column does, with that column.
        segment: Longest duration of a segment of the path: each has its own start. None: as long as a change of a start
            stays within bounds; no segment is longer.
    """

    linear = False
    shared = True
    follows_path = True

    substeps: int | None = None
    interpolation: str | tuple[str, ...] | None = None
    added: tuple[tuple[str, float], ...] = ()
    added_to: tuple[str, ...] = ()
    process_noise: bool = True
    same_noise: bool = False
    force: float = 0.0
    at_rest: tuple[tuple[str, str], ...] = ()
    moving: tuple[tuple[str, str], ...] = ()
    segment: float | None = None

    def __post_init__(self) -> None:
        # Files store tuples as lists.
        object.__setattr__(self, "added", tuple((str(text), float(value)) for text, value in self.added))
        object.__setattr__(self, "added_to", tuple(self.added_to))
        for name in ("at_rest", "moving"):
            object.__setattr__(self, name, tuple((str(state), str(column)) for state, column in getattr(self, name)))
        if self.substeps is not None and not 1 <= self.substeps <= 1000:
            raise InputError(f"TrajectoryRows(substeps={self.substeps}) must be between 1 and 1000.")
        if self.segment is not None and not self.segment > 0:
            raise InputError(f"TrajectoryRows(segment={self.segment!r}) must be a time above 0.")
        if not 0 <= self.force < math.inf:
            raise InputError(f"TrajectoryRows(force={self.force!r}) must be a number, 0 or above.")
        object.__setattr__(self, "interpolation", checked_interpolation("TrajectoryRows", self.interpolation))

    @property
    def starts(self) -> Mapping[str, str]:
        """Hidden states that start a run at rest (""), or along with a column."""
        return {**{name: "" for name, _ in self.at_rest}, **dict(self.moving)}

    def nodes(self, data: Trajectories, equation: str, simulation: Simulation, whole: bool = False) -> Trajectories:
        """Return states and inputs at the ends and middles of the path's steps; see `RowKind.nodes`."""
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

    def resting(self, states: Mapping[str, str], starts: Mapping[str, str]) -> "TrajectoryRows":
        """Return rows with more hidden states that start a run at rest, or move along with a column there."""
        at_rest, moving = {**dict(self.at_rest), **states}, {**dict(self.moving), **starts}
        return replace(self, at_rest=tuple(at_rest.items()), moving=tuple(moving.items()))

    def moved_by(self, intensity: float) -> "TrajectoryRows":
        """Return rows with an unknown force in their noise."""
        return replace(self, force=float(intensity))

    def in_words(self, data: Trajectories) -> str:
        """Return the names of the sampled states, in a few words."""
        return f"samples of {', '.join((data.samples or data).state_names)} along a path"

    def left_out(self, data: Trajectories) -> tuple[str, ...]:
        """Return sentences on samples of clipped sensors."""
        samples = data.samples or data
        if samples.unseen is not None:
            return (f"sensors are clipped at {int(samples.unseen.sum())} samples, which are left out",)
        return tuple(clipped_in_words(name, rows) for name, rows in clipped_states(samples).items())

    def unforced(self) -> "TrajectoryRows":
        """Return rows of a path that the model allows, without process noise."""
        return replace(self, process_noise=False)

    def segments(self, data: Trajectories) -> int:
        """Return the least number of segments that each run is to be cut into."""
        return 1 if self.segment is None else max(1, math.ceil(_longest(data) / self.segment * (1 - 1e-9)))

    def in_segments(self, segments: int, data: Trajectories) -> "TrajectoryRows":
        """Return rows of a path in at least this many segments on these data, as long on other data."""
        return replace(self, segment=None if segments == 1 else _longest(data) / segments)

    def between(self, interpolation: str | tuple[str, ...]) -> "TrajectoryRows":
        """Return rows with an interpolation of the inputs, one for all or for each."""
        return replace(self, interpolation=interpolation)

    def complete_all(self, data: Trajectories, equations: tuple[str, ...], simulation: Simulation) -> Trajectories:
        """Return the data with the reference path as states and its slopes as rates; samples are kept."""
        path = self.path(data, equations, simulation)
        samples = data.samples or data
        noise = {} if data.samples is None else data.noise
        states = dict(zip(simulation.states, path.at_samples.T, strict=True))
        rates = dict(zip(equations, path.rates.T, strict=True))
        units = with_rates(data.units, {name: simulation.rate_name(name) for name in simulation.states})
        return replace(data, states=states, derivatives=rates, units=units, noise=noise, samples=samples)

    def rows(self, data: Trajectories, equation: str, simulation: Simulation) -> EquationRows:
        """Return the rows of one equation."""
        return self.shared_rows(data, (equation,), simulation)

    def shared_rows(self, data: Trajectories, equations: tuple[str, ...], simulation: Simulation) -> EquationRows:
        """Return the rows that these equations share; see `RowKind.shared_rows`."""
        path, samples = self.path(data, equations, simulation), data.samples or data
        # Noise of completed data is that of these rows; otherwise it is that of rates.
        sensor = None if data.samples is None else data.noise.get(block_name(equations))
        return _rows_of(path, samples, equations, simulation, sensor, self.force)

    def of_runs(self, data: Trajectories, equations: tuple[str, ...], simulation: Simulation) -> RowsOfRuns:
        """Return a function that builds rows with the noise, sizes, steps and unknown force of these samples."""
        common = self.path(data, equations, simulation).common
        return partial(self._rows_like, replace(common, clipped=ends_of_sensors(data.samples or data)))

    def _rows_like(
        self, common: Common, data: Trajectories, equations: tuple[str, ...], simulation: Simulation
    ) -> EquationRows:
        path = self.followed(data, equations, simulation, common)
        return _rows_of(path, data, equations, simulation, None, self.force)

    def path(self, data: Trajectories, equations: tuple[str, ...], simulation: Simulation) -> ReferencePath:
        """Return the reference path through samples, or through those of completed data."""
        samples = data.samples or data
        # The force in the noise does not move paths.
        key = (replace(self, force=0.0), equations, simulation.key)
        return _PATHS.result(samples, key, lambda: self.followed(samples, equations, simulation))

    def followed(
        self, samples: Trajectories, equations: tuple[str, ...], simulation: Simulation, common: Common | None = None
    ) -> ReferencePath:
        """Return the path through samples; findings in `common` come from other runs."""
        to = self.added_to or (equations[0],) * len(self.added)
        states = [simulation.states.index(name) for name in to]
        terms = [Force(Term(text), value, k) for (text, value), k in zip(self.added, states, strict=True)]
        settings = PathSettings(
            self.substeps, self.interpolation, self.process_noise, self.same_noise, dict(self.at_rest),
            dict(self.moving), self.segments(samples),
        )  # fmt: skip
        driven = tuple(simulation.states.index(name) for name in equations)
        return follow_samples(samples, ForcedRate(simulation, driven, terms), settings, common)


def _rows_of(
    path: ReferencePath, samples: Trajectories, equations: tuple[str, ...], simulation: Simulation,
    sensor: RowNoise | None, force: float,
) -> EquationRows:  # fmt: skip
    """Return rows along a path; the noise of the sensors is white where it is not known."""
    measured, run = samples.matrix(samples.state_names)[path.seen], samples.run[path.seen]
    n_seen, n_output = measured.shape
    lengths = tuple(np.bincount(run, minlength=samples.n_run).tolist()) * n_output
    # R is in units of σ², σ the noise of a typical sensor.
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
        segments=path.common.pieces,
        exact=lambda added, starts: (
            _exact_samples(path, ForcedRate(simulation, path.segments.driven, ()), added, starts * path.gain / typical)
            / path.gain
        ),
    )


def _longest(data: Trajectories) -> float:
    samples = data.samples or data
    parts = np.split(samples.time, np.cumsum(samples.run_lengths)[:-1])
    return float(max(part[-1] - part[0] for part in parts))


def _exact_samples(
    path: ReferencePath, rate: ForcedRate, added: Added, starts: Float[np.ndarray, "n_draw n_start"]
) -> Float[np.ndarray, "n_draw n_row"]:
    """Return samples of the paths that solve dx/dt = g + e_k (Φθ + f) for draws of coefficients and starts.

    Newton's method with the linear equation of the reference path: each correction answers what the path before still
    departs from the equations by, x ← x + δ with δ̇ = A δ + g(x) + e_k (Φ(x)θ + f(x)) − ẋ. The first gives what linear
    rows say. Starts of the segments are in prior standard deviations from the reference.

    Returns:
        Samples without noise, user's units; NaN where a path leaves the domain of its equations, or is not found.
    """
    segments, grid, n_state = path.segments, path.segments.grid, len(path.start_sd)
    shape = (len(starts), len(grid.time), n_state)
    reference = segments.points[:, ::2, 1 : 1 + n_state]
    aims = reference[None, :, 0] + starts.reshape(shape) * path.start_sd
    ends = np.tile(reference, (len(starts), 1, 1, 1))
    sd, moved = np.repeat(path.sensor_sd, len(segments.end)), np.zeros(len(starts))
    # A draw that leaves the domain of the equations has no path; it is said by NaN.
    with np.errstate(all="ignore"):
        for _ in range(12):
            jumps = np.stack([_jumps(path, rate, added, k, x) for k, x in enumerate(ends)], axis=-1)
            delta = carried(segments.response.M, np.moveaxis(aims - ends[:, :, 0], 0, -1), jumps)
            ends = ends + np.moveaxis(delta, -1, 0)
            moved = np.linalg.norm(segments.rows(delta) / sd[:, None], axis=0)
            # The norm of the change of all samples, over their noise.
            if not np.nanmax(moved, initial=0.0) > 0.1:
                break
    samples = segments.rows(np.moveaxis(ends, 0, -1)).T
    # A change up to half the noise will do where corrections no longer shrink: jumps are timed to parts of a step.
    samples[moved > 0.5] = np.nan
    return samples


def _jumps(path: ReferencePath, rate: ForcedRate, added: Added, draw: int, ends: np.ndarray) -> np.ndarray:
    """Return the change of δ after each step by the departure of a path from its equations."""
    grid, driven = path.segments.grid, list(path.segments.driven)

    def learned(points: np.ndarray) -> np.ndarray:
        columns = dict(zip(rate.names, points.reshape(-1, points.shape[-1])[:, 1:].T, strict=True))
        return added(columns, draw).reshape(*points.shape[:-1], len(driven))

    def rates(points: np.ndarray) -> np.ndarray:
        total = np.array(rate.known(points))
        total[..., driven] += learned(points)
        return total

    states, slope = hermite(grid.time, ends, rates(points_at_ends(grid, ends)))
    return path.segments.response.jumps(departures(rates, points_at_nodes(grid, states), slope))
