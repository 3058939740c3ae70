"""The path that samples are linearised along, and the operator from forces on it to samples."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.interpolate import CubicSpline, make_smoothing_spline

from bayes_greybox.data.noise.starts_noise import Motion
from bayes_greybox.data.samples.clipping import seen_samples
from bayes_greybox.data.samples.sample_noise import sample_noise
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.rows.equation_rows import Acting, Columns, Evaluate, Unfollowed
from bayes_greybox.physics.integration.sensitivity import Grid, carried
from bayes_greybox.physics.integration.smoothing import Observed
from bayes_greybox.running.errors import InputError

from .common import Common, sizes_of, steps_needed
from .forced_rate import ForcedRate
from .path_segments import START_WIDTH, AtEnds, Segments, grid_of, segments_of, split
from .smoothed_path import FORCE_INTENSITIES, NO_PATH, PathSmoother


@dataclass(frozen=True, eq=False)
class ReferencePath:
    """A path through the samples, as rows need it.

    Rows are ordered by output, then by sample; forces are values on the nodes (ends and middles of steps) of all
    segments one after the other, in `columns`.

    Attributes:
        ends: Segment and end of a step that each sample is at.
        learned: Size of the forces on each learned state, over the largest.
        rates: Rates of the learned states at the samples.
        sensor_sd: Noise of each output, user's units, as the smoother found it.
        starts: Change of the rows by one prior standard deviation of each start.
        gain: RMS response of an output to a force of unit RMS: rows are over it, in the unit of the force.
        seen: Samples that are rows; where a sensor was at its end there is none.
        full_intensity: Intensity of a force as large as the path's own.
        acting_on: Number of the learned state that the forces of the operator act on.
    """

    columns: Mapping[str, Float[np.ndarray, " n_node"]]
    at_samples: Float[np.ndarray, "n_sample n_state"]
    ends: Int[np.ndarray, "n_sample 2"]
    learned: Mapping[str, float]
    rates: Float[np.ndarray, "n_sample n_learned"]
    sensor_sd: Float[np.ndarray, " n_output"]
    simulated: Float[np.ndarray, " n_row"]
    starts: Float[np.ndarray, "n_row n_start"]
    gain: float
    seen: Bool[np.ndarray, " n_sample"]
    sample: Int[np.ndarray, " n_row"]
    place: Int[np.ndarray, " n_row"]
    full_intensity: float
    start_sd: Float[np.ndarray, " n_state"]
    unfollowed: Unfollowed
    segments: Segments = field(repr=False)
    common: Common
    acting_on: int = 0

    @property
    def n_segment(self) -> int:
        """Number of segments, each with a start of its own."""
        return len(self.segments.grid.time)

    def motion(self, unit: float) -> Motion:
        """Return the changes of the path from sample to sample, with variances over the square of `unit`."""
        M, G, fresh = self.segments.motion(list(self.learned.values()))
        tried = self.full_intensity * FORCE_INTENSITIES
        return Motion(M, G / unit**2, fresh, self.segments.outputs, self.start_sd / unit, tried)

    def __call__(self, table: Float[np.ndarray, "n_node k"]) -> Float[np.ndarray, "n_row k"]:
        """Return the response of the rows to forces."""
        return self.segments.respond_to(table, self.acting_on) / self.gain

    def of(self, evaluate: Evaluate, columns: Columns) -> Float[np.ndarray, "n_row k"]:
        """Return the response to forces that are evaluated a stretch of the path at a time."""
        return self.segments.respond(evaluate, columns, self.acting_on) / self.gain

    def acting(self) -> dict[str, Acting]:
        """Return the operator, and the size of forces, by the learned state that they act on."""
        return {name: Acting(replace(self, acting_on=k), size) for k, (name, size) in enumerate(self.learned.items())}


@dataclass(frozen=True)
class PathSettings:
    """Settings of a path through samples, as in `TrajectoryRows`, and the least number of segments of each run."""

    substeps: int | None
    interpolation: str | tuple[str, ...] | None
    process_noise: bool
    same_noise: bool
    at_rest: Mapping[str, str]
    moving: Mapping[str, str]
    fewest: int


def follow_samples(
    samples: Trajectories, rate: ForcedRate, settings: PathSettings, shared: Common | None = None
) -> ReferencePath:
    """Smooth the samples, and take everything along the smoothed path; findings in `shared` are those of other runs."""
    sensors = _Sensors(samples, rate, settings, seen_samples(samples) if shared is None else shared.seen(samples))
    sensors.require_path(moving=shared is None)
    common = shared or sensors.first_look()
    first = sensors.first_path(common)
    if shared is None:
        steps = settings.substeps or steps_needed(rate, samples, first, np.array(common.first_sd))
        common = replace(common, steps=steps, step=samples.usual_step)
    grid, end = grid_of(samples, sensors.runs, common.steps, settings.interpolation, common.step)
    outputs, sizes, seen = sensors.outputs, np.array(common.sizes), sensors.seen
    largest = max(sizes[k] for k in rate.driven)
    learned = {rate.simulation.states[k]: float(sizes[k] / largest) for k in rate.driven}
    # An unknown force is as large as its state.
    E = np.eye(len(sizes))[:, list(rate.driven)] * list(learned.values())
    smoother = PathSmoother(rate, grid, sensors.observed(grid, end, common), outputs, largest**2 / common.slow, E)
    # A path that is lost may leave all bounds first; it is refused by name.
    with np.errstate(over="ignore", invalid="ignore"):
        both = None if shared is None else (shared.ratio, shared.passes)
        smoothed = smoother.smoothest(sensors.at_ends(grid, first), settings.process_noise, both)
        ends = smoothed.ends
        if shared is None:
            # How noisy each sensor is against the others, the smoother knows better than differences do.
            residual = (sensors.measured - ends[end[:, 0], end[:, 1]][:, list(outputs)])[seen]
            common = replace(common, sd=sensors.pooled(np.sqrt(np.mean(residual**2, axis=0))))
        segments = segments_of(rate, grid, ends, outputs, end[seen])
        pieces = sensors.pieces(segments.pieces(sizes), shared)
        if pieces > 1:
            grid, end, ends = split(grid, end, ends, pieces)
            segments = segments_of(rate, grid, ends, outputs, end[seen])
        common = replace(common, ratio=smoothed.ratio, passes=smoothed.passes, pieces=pieces)
        return _assembled(sensors, segments, end, learned, smoother.full_intensity, smoothed.gained, common)


@dataclass(frozen=True, eq=False)
class _Sensors:
    """Samples of sensors with the equations that they are followed along."""

    samples: Trajectories
    rate: ForcedRate
    settings: PathSettings
    seen: Bool[np.ndarray, " n_sample"]

    @cached_property
    def measured(self) -> Float[np.ndarray, "n_sample n_output"]:
        return self.samples.matrix(self.samples.state_names)

    @cached_property
    def outputs(self) -> tuple[int, ...]:
        return tuple(self.rate.simulation.states.index(name) for name in self.samples.state_names)

    @cached_property
    def runs(self) -> list[np.ndarray]:
        return self.samples.run_rows

    def require_path(self, moving: bool) -> None:
        """Refuse samples that no path can be followed through; if `moving`, those without any motion too."""
        samples, simulation = self.samples, self.rate.simulation
        learned = [simulation.states[k] for k in self.rate.driven]
        lacking = [name for name in simulation.states if name not in (*simulation.equations, *learned)]
        if lacking:
            raise InputError(
                f"The path of {lacking[0]!r} cannot be followed: the simulation has no equation for it. Give one, or "
                "give it as an input."
            )
        counts = np.bincount(samples.run[self.seen], minlength=samples.n_run)
        fewest, needed = int(np.min(counts)), 2 * len(simulation.states) + 2
        if fewest < needed:
            clipped = "" if np.all(self.seen) else " that no sensor clipped"
            name = samples.run_names[int(np.argmin(counts))]
            raise InputError(
                f'Run "{name}", or its held-out part, has {fewest} samples{clipped}, too few for a path of '
                f"{len(simulation.states)} states, which needs {needed}: hold out more rows, whole runs or none (in a "
                "file test_fraction and split_by), or leave the run out (in a file leave_out)."
            )
        if moving and not np.any(self.measured):
            names, verb = " and ".join(samples.state_names), "is" if len(self.outputs) == 1 else "are"
            raise InputError(
                f"{names} {verb} 0 at every sample: there is no motion to follow. Leave these rows out; of a record "
                "that ends at rest take less as held-out data."
            )

    def pooled(self, sd: np.ndarray) -> tuple[float, ...]:
        """Return the noise of each sensor, or what all have in common, not below what an integrator leaves."""
        sd = np.maximum(sd, 1e-5 * np.std(self.measured, axis=0))
        return tuple((np.full(len(sd), np.sqrt(np.mean(sd**2))) if self.settings.same_noise else sd).tolist())

    def first_look(self) -> Common:
        """Return sizes, time scale and noise as samples alone show them."""
        sizes, slow = sizes_of(self.samples, self.rate.simulation, self.settings.at_rest)
        shown = replace(self.samples, noise={}).keep(self.seen)
        sd = self.pooled(sample_noise(shown.time, self.measured[self.seen], shown.run_lengths))
        return Common({}, tuple(sizes.tolist()), slow, sd, sd)

    def first_path(self, common: Common) -> Float[np.ndarray, "n_sample n_state"]:
        """Return states at the samples to begin with; NaN for hidden states that are no sampled one's rate."""
        samples, simulation = self.samples, self.rate.simulation
        path = np.full((samples.n_obs, len(simulation.states)), np.nan)
        for k, name in enumerate(samples.state_names):
            for rows in self.runs:
                shown = rows[self.seen[rows]]
                t, x = samples.time[shown], samples.states[name][shown]
                # As stiff as the noise asks for, up to a tenth of the spread; what it misses the smoother finds.
                width = common.slow * min(1.0, 10 * common.first_sd[k] / max(float(np.std(x)), 1e-300))
                spline = make_smoothing_spline(t, x, lam=0.1 * width**4) if len(t) > 4 else CubicSpline(t, x)
                path[rows, simulation.states.index(name)] = spline(samples.time[rows])
                rate = simulation.rate_name(name)
                if rate is not None and rate not in samples.state_names:
                    path[rows, simulation.states.index(rate)] = spline.derivative()(samples.time[rows])
        return path

    def at_ends(self, grid: Grid, path: Float[np.ndarray, "n_sample n_state"]) -> AtEnds:
        """Return a path at the samples, at the ends of all steps."""
        time, at = grid.time[:, ::2], self.samples.time
        states = [[np.interp(time[r], at[rows], x) for x in path[rows].T] for r, rows in enumerate(self.runs)]
        return np.array(states).transpose(0, 2, 1)

    def observed(self, grid: Grid, end: Int[np.ndarray, "n_sample 2"], common: Common) -> Observed:
        """Return the samples at the ends of steps, with what is expected of each start."""
        simulation, names, measured = self.rate.simulation, self.samples.state_names, self.measured
        n_segment, n_node = grid.time.shape
        values = np.full((n_segment, n_node // 2 + 1, len(self.outputs)), np.nan)
        values[end[self.seen, 0], end[self.seen, 1]] = measured[self.seen]
        mean, hidden = np.zeros((n_segment, len(common.sizes))), []
        rates = {simulation.rate_name(name) for name in simulation.states}
        begins = np.array([measured[rows][0] for rows in self.runs])
        for k, name in enumerate(simulation.states):
            beside = self.settings.moving.get(name)
            if k in self.outputs:
                mean[:, k] = begins[:, self.outputs.index(k)]
            elif beside in names:
                mean[:, k] = begins[:, names.index(beside)]
            elif name not in self.settings.at_rest and name not in rates:
                # Nothing is known of it but that it is a state like the others.
                hidden.append(k)
                mean[:, k] = begins[:, 0]
        if hidden:
            start = np.concatenate([grid.time[:, :1], mean, grid.inputs[:, 0]], axis=-1)
            out = ~np.all(np.isfinite(self.rate.rates(start)), axis=-1)
            middle = np.array([np.median(measured[rows], axis=0) for rows in self.runs])
            mean[np.ix_(out, hidden)] = middle[out, :1]
        return Observed(values, np.array(common.first_sd) ** 2, mean, START_WIDTH * np.array(common.sizes))

    def pieces(self, needed: int, shared: Common | None) -> int:
        """Return the number of segments of each run: as many as are needed, and no fewer than were asked for."""
        fewest = self.settings.fewest
        asked = max(fewest, 1 if shared is None else shared.pieces)
        pieces = max(asked, needed)
        if pieces >= max(self.samples.run_lengths) and (shared is None or pieces > asked):
            raise InputError(
                f"{fewest} segments of a path leave no more than one sample to each: make TrajectoryRows(segment=...) "
                "longer, or leave it out."
                if fewest >= pieces
                else NO_PATH
            )
        return pieces


def _assembled(
    sensors: _Sensors, segments: Segments, every: np.ndarray, learned: Mapping[str, float], full_intensity: float,
    gained: float, common: Common,
) -> ReferencePath:  # fmt: skip
    """Return the path at `every` sample, and the rows that are seen."""
    rate, seen, outputs = sensors.rate, sensors.seen, segments.outputs
    sizes, s, gain = np.array(common.sizes), np.array(common.sd), common.gain
    end, driven, n_state = segments.end, list(segments.driven), len(rate.simulation.states)
    columns = dict(zip(rate.names, segments.points[..., 1:].reshape(-1, len(rate.names)).T, strict=True))
    states = segments.points[:, ::2, 1 : 1 + n_state]
    at = states[every[:, 0], every[:, 1]]
    # The path is not quite one of the equations, and what was added to them is for the coefficients to say again.
    unforced = segments.response.jumps(segments.departure(rate.known))[..., None]
    moved = carried(segments.response.M, np.zeros((len(states), n_state, 1)), unforced)
    simulated = np.concatenate([at[seen, k] for k in outputs]) + segments.rows(moved)[:, 0]
    starts = segments.responses_to_starts(sizes)
    # Rates are finite far from the samples too, where changes of a path are not.
    if not (np.all(np.isfinite(simulated)) and np.all(np.isfinite(starts))):
        raise InputError(NO_PATH)
    if math.isnan(gain):
        gain = segments.gain(columns, starts, np.repeat(s, len(end)), list(learned.values()))
    if not 0 < gain < math.inf:
        raise InputError(NO_PATH)
    spread = np.std(sensors.measured[seen], axis=0)
    return ReferencePath(
        columns=columns,
        at_samples=at,
        ends=every,
        learned=learned,
        rates=segments.slope[:, ::2, driven][every[:, 0], every[:, 1]],
        sensor_sd=s,
        simulated=simulated,
        starts=starts,
        gain=gain,
        seen=seen,
        sample=np.tile(np.flatnonzero(seen), len(outputs)),
        place=np.tile(end[:, 0] * segments.grid.time.shape[1] + 2 * end[:, 1], len(outputs)),
        full_intensity=full_intensity,
        start_sd=START_WIDTH * sizes,
        unfollowed=Unfollowed(gained, common.ratio, float(np.max(s / spread.clip(1e-300)))),
        segments=segments,
        common=replace(common, gain=gain),
    )
