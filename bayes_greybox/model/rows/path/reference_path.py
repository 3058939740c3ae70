"""The path that samples are linearised along, and the operator from forces on it to samples."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.interpolate import CubicSpline, make_smoothing_spline

from bayes_greybox.data.noise.forced_noise import Motion
from bayes_greybox.data.samples.clipping import seen_samples
from bayes_greybox.data.samples.sample_noise import sample_noise
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.rows.equation_rows import Acting, Unfollowed
from bayes_greybox.physics.integration.sensitivity import Grid, carried
from bayes_greybox.physics.integration.smoothing import Observed
from bayes_greybox.physics.simulation.protocol import Simulation
from bayes_greybox.running.errors import InputError

from .common import Common, sizes_of, steps_needed, usual_step
from .forced_rate import Force, ForcedRate
from .path_grid import grid_of, runs_of, split
from .path_segments import (
    WIDE,
    Segments,
    gain_of,
    motion_of,
    pieces_of,
    responses_to_starts,
    responses_to_unit_starts,
    segments_of,
)
from .smoothed_path import LOST, RATIOS, smoothest

FINEST = 1e-5
"""Noise of a sensor over the spread of its samples, at least: rounding, and what an integrator leaves."""


@dataclass(frozen=True, eq=False)
class ReferencePath:
    """A path through the samples, as rows need it.

    Rows are ordered by output, then by sample; forces are values on the nodes (ends and middles of steps) of all
    segments one after the other, in `columns`.

    Attributes:
        columns: States and inputs at the nodes.
        at_samples: States at the samples.
        ends: Segment and end of a step that each sample is at.
        learned: Size of the forces on each learned state, over the largest.
        rates: Rates of the learned states at the samples.
        sensor_sd: Noise of each output [n_output], user's units, as the smoother found it.
        simulated: Samples without any force, user's units [n_row].
        starts: Change of the rows by one prior standard deviation of each start [n_row, n_start].
        gain: RMS response of an output to a force of unit RMS: rows are over it, in the unit of the force.
        seen: Whether a sample is a row: where a sensor was at its end there is none.
        sample: Sample of each row.
        place: Node of each row.
        ratio: Chosen intensity of the unknown force, λ = q²/σ².
        own: Intensity of a force as large as the path's own.
        start_sd: Prior standard deviation of each state at the start of a segment.
        unfollowed: What the model does not follow.
        segments: With the linear equation along them.
        common: What further runs have in common with these.
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
    ratio: float
    own: float
    start_sd: Float[np.ndarray, " n_state"]
    unfollowed: Unfollowed
    segments: Segments = field(repr=False)
    common: Common
    acting_on: int = 0

    @property
    def pieces(self) -> int:
        """Segments of each run."""
        return self.common.pieces

    @property
    def n_segment(self) -> int:
        """Segments, each with a start of its own."""
        return len(self.segments.grid.time)

    def motion(self, unit: float) -> Motion:
        """How changes of the path go on from sample to sample.

        Args:
            unit: Standard deviation that variances are over.
        """
        M, G, fresh = motion_of(self.segments, list(self.learned.values()))
        return Motion(M, G / unit**2, fresh, self.segments.outputs, self.start_sd / unit, self.own * RATIOS)

    def __call__(self, table: Float[np.ndarray, "n_node k"]) -> Float[np.ndarray, "n_row k"]:
        """Response of the rows to forces."""
        return self.segments.respond_to(table, self.acting_on) / self.gain

    def of(
        self,
        evaluate: Callable[[Mapping[str, np.ndarray]], Float[np.ndarray, "n k"]],
        columns: Mapping[str, Float[np.ndarray, " n_node"]],
    ) -> Float[np.ndarray, "n_row k"]:
        """Response to forces that are evaluated a stretch of the path at a time."""
        return self.segments.respond(evaluate, columns, self.acting_on) / self.gain

    def acting(self) -> dict[str, Acting]:
        """The operator, and the size of forces, by the learned state that they act on."""
        return {name: Acting(replace(self, acting_on=k), size) for k, (name, size) in enumerate(self.learned.items())}


def follow_samples(
    samples: Trajectories, equations: tuple[str, ...], simulation: Simulation, added: Sequence[Force],
    substeps: int | None, interpolation: str | None, process_noise: bool = True,
    same_noise: bool = False, at_rest: Mapping[str, str] | None = None, moving: Mapping[str, str] | None = None,
    fewest: int = 1, common: Common | None = None,
) -> ReferencePath:  # fmt: skip
    """Smooth the samples, and take everything along the smoothed path.

    Args:
        samples: What the sensors showed.
        equations: The learned states.
        simulation: Known rates of all states.
        added: Terms of the model, beside the simulation.
        substeps: Steps between two samples.
        interpolation: Of the inputs between samples.
        process_noise: Whether an unknown force may act, as strong as the samples say.
        same_noise: Whether the noise of all sensors is the same.
        at_rest: Hidden states that are at rest where a run starts, each with the column that it is as large as.
        moving: Those of them that start where a sampled column does, with that column.
        fewest: Segments that each run is cut into at least.
        common: What other runs have in common with these; found from these if left out.

    Raises:
        InputError: See `TrajectoryRows.path`.
    """
    seen = seen_samples(samples) if common is None else common.seen(samples)
    _check(samples, seen, equations, simulation)
    outputs = tuple(simulation.states.index(name) for name in samples.state_names)
    driven = tuple(simulation.states.index(name) for name in equations)
    rate = ForcedRate(simulation, driven, added)
    at_rest = at_rest or {}
    measured = samples.matrix(samples.state_names)
    finest = FINEST * np.std(measured, axis=0)
    if common is None and not np.any(measured):
        names, verb = " and ".join(samples.state_names), "is" if len(outputs) == 1 else "are"
        raise InputError(
            f"{names} {verb} 0 at every sample: there is no motion to follow. Leave these rows out; of a record that "
            "ends at rest take less as held-out data."
        )
    if common is None:
        sizes, slow = sizes_of(samples, simulation, at_rest)
        shown = replace(samples, noise={}).keep(seen)
        own_noise = sample_noise(shown.time, measured[seen], shown.run_lengths)
        s = _pooled(np.maximum(own_noise, finest), same_noise)
    else:
        sizes, slow, s = np.array(common.sizes), common.slow, np.array(common.first_sd)
    first_sd = s
    runs = runs_of(samples)
    first = _first_path(samples, seen, simulation, s, slow)
    if common is None:
        steps, step = substeps or steps_needed(rate, samples, first, s), usual_step(samples)
    else:
        steps, step = common.steps, common.step
    grid, end = grid_of(samples, runs, steps, interpolation, step)
    observed = _observed(rate, samples, seen, simulation, grid, end, outputs, s, sizes, at_rest, moving or {})
    largest = max(sizes[k] for k in driven)
    learned = {name: float(sizes[k] / largest) for name, k in zip(equations, driven, strict=True)}
    # An unknown force is as large as its state.
    E = np.eye(len(sizes))[:, list(driven)] * list(learned.values())
    own = largest**2 / slow
    smoother = partial(smoothest, rate, grid, observed, outputs, own, E)
    # A path that is lost may leave all bounds first; it is refused by name.
    with np.errstate(over="ignore", invalid="ignore"):
        known = None if common is None else (common.ratio, common.passes)
        ends, ratio, gained, passes = smoother(_at_ends(samples, runs, grid, first), process_noise, known)
        if common is None:
            # How noisy each sensor is against the others, the smoother knows better than differences do.
            residual = (measured - ends[end[:, 0], end[:, 1]][:, list(outputs)])[seen]
            s = _pooled(np.maximum(np.sqrt(np.mean(residual**2, axis=0)), finest), same_noise)
        else:
            s = np.array(common.sd)
        segments = segments_of(rate, grid, ends, outputs, end[seen])
        asked = max(fewest, 1 if common is None else common.pieces)
        pieces = max(asked, pieces_of(responses_to_unit_starts(segments, sizes), sizes))
        if pieces >= max(samples.run_lengths) and (common is None or pieces > asked):
            raise InputError(
                f"{fewest} segments of a path leave no more than one sample to each: make TrajectoryRows(segment=...) "
                "longer, or leave it out."
                if fewest >= pieces
                else LOST
            )
        if pieces > 1:
            grid, end, ends = split(grid, end, ends, pieces)
            segments = segments_of(rate, grid, ends, outputs, end[seen])
        spread = np.std(measured[seen], axis=0)
        found = Common(
            {} if common is None else common.clipped,
            tuple(sizes.tolist()), slow, tuple(first_sd.tolist()), tuple(s.tolist()), steps, step, ratio, passes,
            pieces, math.nan if common is None else common.gain,
        )  # fmt: skip
        return _assembled(simulation, rate, segments, end, seen, learned, spread, own, gained, found)


def _assembled(
    simulation: Simulation, rate: ForcedRate, segments: Segments, every: np.ndarray, seen: np.ndarray,
    learned: Mapping[str, float], spread: np.ndarray, own: float, gained: float, common: Common,
) -> ReferencePath:  # fmt: skip
    """The path at `every` sample, and the rows that are `seen`."""
    sizes, s, ratio, gain = np.array(common.sizes), np.array(common.sd), common.ratio, common.gain
    end, driven, n_state = segments.end, list(segments.driven), len(simulation.states)
    columns = dict(zip(rate.names, segments.points[..., 1:].reshape(-1, len(rate.names)).T, strict=True))
    states = segments.points[:, ::2, 1 : 1 + n_state]
    at = states[every[:, 0], every[:, 1]]
    # The path is not quite one of the equations, and what was added to them is for the coefficients to say again.
    unforced = segments.response.jumps(segments.departure(rate.known))[..., None]
    moved = carried(segments.response.M, np.zeros((len(states), n_state, 1)), unforced)
    simulated = np.concatenate([at[seen, k] for k in segments.outputs]) + segments.rows(moved)[:, 0]
    starts = responses_to_starts(segments, sizes)
    # Rates are finite far from the samples too, where changes of a path are not.
    if not (np.all(np.isfinite(simulated)) and np.all(np.isfinite(starts))):
        raise InputError(LOST)
    if math.isnan(gain):
        gain = gain_of(segments, columns, starts, np.repeat(s, len(end)), list(learned.values()))
    if not 0 < gain < math.inf:
        raise InputError(LOST)
    rates = segments.slope[:, ::2, driven]
    return ReferencePath(
        columns=columns,
        at_samples=at,
        ends=every,
        learned=learned,
        rates=rates[every[:, 0], every[:, 1]],
        sensor_sd=s,
        simulated=simulated,
        starts=starts,
        gain=gain,
        seen=seen,
        sample=np.tile(np.flatnonzero(seen), len(segments.outputs)),
        place=np.tile(end[:, 0] * segments.grid.time.shape[1] + 2 * end[:, 1], len(segments.outputs)),
        ratio=ratio,
        own=own,
        start_sd=WIDE * sizes,
        unfollowed=Unfollowed(gained, ratio, float(np.max(s / spread.clip(1e-300)))),
        segments=segments,
        common=replace(common, gain=gain),
    )


def _pooled(s: np.ndarray, same: bool) -> np.ndarray:
    return np.full(len(s), np.sqrt(np.mean(s**2))) if same else s


def _check(samples: Trajectories, seen: np.ndarray, equations: tuple[str, ...], simulation: Simulation) -> None:
    lacking = [name for name in simulation.states if name not in simulation.equations and name not in equations]
    if lacking:
        raise InputError(
            f"The path of {lacking[0]!r} cannot be followed: the simulation has no equation for it. Give one, or give "
            "it as an input."
        )
    fewest = int(np.min(np.bincount(samples.run[seen], minlength=samples.n_run)))
    if fewest < 2 * len(simulation.states) + 2:
        clipped = "" if np.all(seen) else " that no sensor clipped"
        raise InputError(f"A run has {fewest} samples{clipped}, too few for a path of {len(simulation.states)} states.")


def _observed(
    rate: ForcedRate, samples: Trajectories, seen: np.ndarray, simulation: Simulation, grid: Grid, end: np.ndarray,
    outputs: tuple[int, ...], s: np.ndarray, sizes: np.ndarray, at_rest: Mapping[str, str], moving: Mapping[str, str],
) -> Observed:  # fmt: skip
    n_segment, n_node = grid.time.shape
    values = np.full((n_segment, n_node // 2 + 1, len(outputs)), np.nan)
    values[end[seen, 0], end[seen, 1]] = samples.matrix(samples.state_names)[seen]
    every, runs = samples.matrix(samples.state_names), [samples.run == r for r in range(samples.n_run)]
    mean, hidden = np.zeros((n_segment, len(sizes))), []
    measured, middle = (np.array([f(every[own]) for own in runs]) for f in (lambda x: x[0], partial(np.median, axis=0)))
    for k, name in enumerate(simulation.states):
        if k in outputs:
            mean[:, k] = measured[:, outputs.index(k)]
        elif moving.get(name) in samples.state_names:
            mean[:, k] = measured[:, samples.state_names.index(moving[name])]
        elif name not in at_rest and not any(simulation.rate_name(m) == name for m in simulation.states):
            # Nothing is known of it but that it is a state like the others.
            hidden.append(k)
            mean[:, k] = measured[:, 0]
    if hidden:
        start = np.concatenate([grid.time[:, :1], mean, grid.inputs[:, 0]], axis=-1)
        out = ~np.all(np.isfinite(rate.rates(start)), axis=-1)
        mean[np.ix_(out, hidden)] = middle[out, :1]
    return Observed(values, s**2, mean, WIDE * sizes)


def _first_path(
    samples: Trajectories, seen: np.ndarray, simulation: Simulation, s: np.ndarray, slow: float
) -> Float[np.ndarray, "n_sample n_state"]:
    """States at the samples to begin with; NaN for hidden states that are no sampled one's rate."""
    path = np.full((samples.n_obs, len(simulation.states)), np.nan)
    for k, name in enumerate(samples.state_names):
        for own in runs_of(samples):
            shown = own[seen[own]]
            t, x = samples.time[shown], samples.states[name][shown]
            # As stiff as the noise asks for, up to a tenth of the spread; what it misses the smoother finds.
            width = slow * min(1.0, 10 * s[k] / max(float(np.std(x)), 1e-300))
            spline = make_smoothing_spline(t, x, lam=0.1 * width**4) if len(t) > 4 else CubicSpline(t, x)
            path[own, simulation.states.index(name)] = spline(samples.time[own])
            rate = simulation.rate_name(name)
            if rate is not None and rate not in samples.state_names:
                path[own, simulation.states.index(rate)] = spline.derivative()(samples.time[own])
    return path


def _at_ends(
    samples: Trajectories, runs: list[np.ndarray], grid: Grid, path: np.ndarray
) -> Float[np.ndarray, "n_segment n_end n_state"]:
    """A path at the samples, at the ends of all steps."""
    time = grid.time[:, ::2]
    return np.array(
        [[np.interp(time[r], samples.time[own], x) for x in path[own].T] for r, own in enumerate(runs)]
    ).transpose(0, 2, 1)
