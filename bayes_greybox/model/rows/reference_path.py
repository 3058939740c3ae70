"""The path that samples are linearised along, and the operator from forces on it to samples."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.interpolate import CubicSpline

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.sample_noise import sample_noise
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.integrate import between_samples
from bayes_greybox.physics.sensitivity import Grid, Response, carried, middles, respond, stepped
from bayes_greybox.physics.simulation import Simulation
from bayes_greybox.physics.smoothing import Observed, Smoothed, smooth, smoothest
from bayes_greybox.physics.terms import Term

STEP = 0.1
"""Steps are so short, over the fastest time scale of the equations along the path, or the steps that were asked for."""

MOST_STEPS = 50
"""Most steps between two samples."""

RATIOS = 10.0 ** np.arange(-10.0, 1.1)
"""Intensities of the unknown force that are tried, q² over that of a force as large as the path's own."""

PASSES = 3
"""Passes of the smoother at the intensity that was chosen."""

FINEST = 1e-5
"""Noise of a sensor over the spread of its samples, at least: rounding, and what an integrator leaves."""

WIDE = 10.0
"""Prior standard deviation of a start, over the size of its state."""

GROWTH = 1e3
"""A segment ends where a change of its start has grown this much: beyond it nothing is linear, nor known."""

CHUNK = 4096
"""Steps whose forces are evaluated at once."""


class ForcedRate:
    """Rate of all states with terms added to one: equal to any other with the same formulas, so compiled once.

    Args:
        simulation: Known rates.
        driven: Index of the learned state.
        terms: Added to its rate; their coefficients are the last argument of a call.
    """

    def __init__(self, simulation: Simulation, driven: int, terms: Sequence[Term]) -> None:
        self.simulation, self.driven, self.terms = simulation, driven, tuple(terms)
        self._key = (simulation.key, driven, tuple(term.text for term in terms))

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ForcedRate) and self._key == other._key

    def __call__(self, t: Array, x: Array, u: Array, coefficients: Array) -> Array:
        """Rates at one point; see `physics.sensitivity.Rate`."""
        rate = jnp.asarray(self.simulation.rate(t, x, u), float)
        columns = dict(zip((*self.simulation.states, *self.simulation.inputs), (*x, *u), strict=True))
        force = sum((c * term.evaluate(columns) for c, term in zip(coefficients, self.terms, strict=True)), 0.0 * t)
        return rate.at[self.driven].add(force)


@dataclass(frozen=True, eq=False)
class ReferencePath:
    """A path through the samples, as rows need it.

    Rows are ordered by output, then by sample; forces are values on the nodes (ends and middles of steps) of all
    segments one after the other, in `columns`.

    Attributes:
        columns: States and inputs at the nodes.
        at_samples: States at the samples.
        rate: Rate of the learned state at the samples.
        sensor_sd: Noise of each output [n_output], user's units, as the smoother found it.
        simulated: Samples without any force, user's units [n_row].
        starts: Change of the rows by one prior standard deviation of each start [n_row, n_start].
        gain: RMS response of an output to a force of unit RMS: rows are over it, in the unit of the force.
        sample: Sample of each row.
        ratio: Chosen intensity of the unknown force, λ = q²/σ².
        n_segment: Segments.
    """

    columns: Mapping[str, Float[np.ndarray, " n_node"]]
    at_samples: Float[np.ndarray, "n_sample n_state"]
    rate: Float[np.ndarray, " n_sample"]
    sensor_sd: Float[np.ndarray, " n_output"]
    simulated: Float[np.ndarray, " n_row"]
    starts: Float[np.ndarray, "n_row n_start"]
    gain: float
    sample: Int[np.ndarray, " n_row"]
    ratio: float
    segments: "Segments" = field(repr=False)

    @property
    def n_segment(self) -> int:
        """Segments, each with a start of its own."""
        return len(self.segments.grid.time)

    def __call__(self, table: Float[np.ndarray, "n_node k"]) -> Float[np.ndarray, "n_row k"]:
        """Response of the rows to forces."""
        return self.of(lambda columns: table[columns["node"].astype(int)], {"node": np.arange(len(table))})

    def of(
        self,
        evaluate: Callable[[Mapping[str, np.ndarray]], Float[np.ndarray, "n k"]],
        columns: Mapping[str, Float[np.ndarray, " n_node"]],
    ) -> Float[np.ndarray, "n_row k"]:
        """Response to forces that are evaluated a stretch of the path at a time."""
        return self.segments.respond(evaluate, columns) / self.gain


@dataclass(frozen=True, eq=False)
class Segments:
    """Segments of runs with their steps of the linear equation.

    Attributes:
        grid: Nodes; shorter segments end in steps of no length.
        response: Steps of the linear equation.
        outputs: Indices of the measured states.
        end: Index of the end of a step, segment by segment, at which each sample is [n_sample, 2].
    """

    grid: Grid
    response: Response
    outputs: tuple[int, ...]
    end: Int[np.ndarray, "n_sample 2"]

    def rows(self, ends: Float[np.ndarray, "n_segment n_end n_state k"]) -> Float[np.ndarray, "n_row k"]:
        """Rows from changes of the states at the ends of steps."""
        at = ends[self.end[:, 0], self.end[:, 1]]
        return np.concatenate([at[:, k] for k in self.outputs])

    def respond(
        self, evaluate: Callable[[Mapping[str, np.ndarray]], np.ndarray], columns: Mapping[str, np.ndarray]
    ) -> Float[np.ndarray, "n_row k"]:
        """Response to forces by nodes, a stretch of all segments at a time; memory is bounded by a stretch."""
        n_segment, n_node = self.grid.time.shape
        node = np.arange(n_segment * n_node).reshape(n_segment, n_node)
        n_step, span = (n_node - 1) // 2, max(1, CHUNK // n_segment)
        found, delta = [], None
        for first in range(0, n_step, span):
            last = min(first + span, n_step)
            index = node[:, 2 * first : 2 * last + 1]
            force = np.asarray(evaluate({name: column[index.ravel()] for name, column in columns.items()}))
            force = force.reshape(*index.shape, -1)
            if delta is None:
                delta = jnp.zeros((n_segment, self.response.M.shape[-1], force.shape[-1]))
            part = Response(*(steps[:, first:last] for steps in self.response))
            ends = np.asarray(carried(part, delta, jnp.asarray(force)))
            delta = jnp.asarray(ends[:, -1])
            # Only what is measured, where it is measured, is kept.
            inside = (self.end[:, 1] >= first + (first > 0)) & (self.end[:, 1] <= last)
            at = ends[self.end[inside, 0], self.end[inside, 1] - first][:, list(self.outputs)]
            found.append((np.flatnonzero(inside), at))
        values = np.empty((len(self.end), len(self.outputs), found[0][1].shape[-1]))
        for rows, at in found:
            values[rows] = at
        return np.concatenate([values[:, k] for k in range(len(self.outputs))])


def follow_samples(
    samples: Trajectories, equation: str, simulation: Simulation, added: Sequence[tuple[Term, float]],
    substeps: int | None, interpolation: str | None,
) -> ReferencePath:  # fmt: skip
    """Smooth the samples, and take everything along the smoothed path.

    Args:
        samples: What the sensors showed.
        equation: The learned state.
        simulation: Known rates of all states.
        added: Terms and coefficients of the model, beside the simulation.
        substeps: Steps between two samples.
        interpolation: Of the inputs between samples.

    Raises:
        InputError: See `TrajectoryRows.path`.
    """
    _check(samples, equation, simulation)
    outputs = tuple(simulation.states.index(name) for name in samples.state_names)
    driven = simulation.states.index(equation)
    rate = ForcedRate(simulation, driven, [term for term, _ in added])
    args = jnp.array([value for _, value in added])
    sizes, slow = _sizes(samples, simulation)
    s = np.maximum(
        sample_noise(samples.time, samples.matrix(samples.state_names), samples.run_lengths),
        FINEST * np.std(samples.matrix(samples.state_names), axis=0),
    )
    runs, steps = _runs(samples), substeps or 1
    while True:
        grid, end = _grid(samples, runs, steps, interpolation)
        observed = _observed(samples, simulation, grid, end, outputs, s, sizes)
        found, ratio = _smoothest(rate, grid, observed, outputs, driven, args, sizes, slow)
        if substeps is not None:
            break
        wanted = _steps_needed(rate, grid, found.ends, args, steps)
        if wanted <= steps:
            break
        steps = wanted
    # How noisy each sensor is against the others, the smoother knows better than differences do.
    residual = samples.matrix(samples.state_names) - np.asarray(found.ends)[end[:, 0], end[:, 1]][:, list(outputs)]
    s = np.maximum(np.sqrt(np.mean(residual**2, axis=0)), FINEST * np.std(samples.matrix(samples.state_names), axis=0))
    ends = np.asarray(found.ends)
    whole = _segments(rate, grid, ends, outputs, end, driven, args)
    grown = np.asarray(carried(whole.response, *_unit_starts(whole, sizes)))
    grid, end, ends = _split(grid, end, ends, _pieces_of(grown, sizes))
    segments = _segments(rate, grid, ends, outputs, end, driven, args)
    return _assembled(samples, simulation, rate, args, segments, ends, sizes, s, ratio, driven)


def _assembled(
    samples: Trajectories, simulation: Simulation, rate: ForcedRate, args: Array, segments: Segments,
    ends: np.ndarray, sizes: np.ndarray, s: np.ndarray, ratio: float, driven: int,
) -> ReferencePath:  # fmt: skip
    grid, end = segments.grid, segments.end
    path = _nodes(rate, grid, ends, args)
    flat = path.reshape(-1, path.shape[-1])
    inputs = np.asarray(grid.inputs).reshape(len(flat), -1)
    columns = dict(zip((*simulation.states, *simulation.inputs), np.hstack([flat, inputs]).T, strict=True))
    defects = np.asarray(stepped(rate, grid, jnp.asarray(ends[:, :-1]), args)) - ends[:, 1:]
    response = segments.response
    response_to_defects = _moved_by(np.asarray(response.M), defects)
    at = ends[end[:, 0], end[:, 1]]
    simulated = np.concatenate([at[:, k] for k in segments.outputs])
    simulated = simulated + segments.rows(response_to_defects[..., None])[:, 0]
    terms = rate.terms
    if terms:
        coefficients = np.asarray(args)

        def added(columns: Mapping[str, np.ndarray]) -> np.ndarray:
            values = [c * np.asarray(term.evaluate(columns)) for c, term in zip(coefficients, terms, strict=True)]
            return np.sum(np.broadcast_arrays(*values), axis=0)[:, None]

        simulated = simulated - segments.respond(added, columns)[:, 0]
    starts = _starts(segments, sizes)
    gain = _gain(segments, columns, starts, np.repeat(s, len(end)))
    rates = np.asarray(_rates(rate, grid, ends, args))[..., driven]
    # The unknown force is what the path departs by, over the step.
    h = np.diff(np.asarray(grid.time)[:, ::2], axis=1)
    force = np.divide(-defects[..., driven], h, out=np.zeros_like(h), where=h > 0)
    force = np.concatenate([force[:, :1], (force[:, 1:] + force[:, :-1]) / 2, force[:, -1:]], axis=1)
    sample = np.tile(np.arange(len(end)), len(segments.outputs))
    return ReferencePath(
        columns, at, (rates + force)[end[:, 0], end[:, 1]], s, simulated, starts, gain, sample, ratio, segments
    )


def _check(samples: Trajectories, equation: str, simulation: Simulation) -> None:
    lacking = [name for name in simulation.states if name not in simulation.equations and name != equation]
    if lacking:
        raise InputError(
            f"The path of {lacking[0]!r} cannot be followed: the simulation has no equation for it. Give one, or give "
            "it as an input."
        )
    if min(samples.run_lengths) < 2 * len(simulation.states) + 2:
        raise InputError(
            f"A run has {min(samples.run_lengths)} samples, too few for a path of {len(simulation.states)} states."
        )


def _sizes(samples: Trajectories, simulation: Simulation) -> tuple[np.ndarray, float]:
    """Typical size of each state, and the time in which the slowest sensor's signal changes by half its spread."""
    times = []
    for x in samples.states.values():
        spread, lag = float(np.std(x)), 1
        for lag in range(1, max(2, min(samples.run_lengths) // 2)):
            inside = samples.run[lag:] == samples.run[:-lag]
            if np.sqrt(np.mean((x[lag:] - x[:-lag])[inside] ** 2)) >= 0.5 * spread:
                break
        times.append(lag * float(np.median(np.diff(samples.time)[np.diff(samples.run) == 0])))
    slow = min(times)
    known = {name: float(np.sqrt(np.mean(x**2))) for name, x in samples.states.items()}
    largest = max(known.values())
    for name in simulation.states:
        # A hidden state that is a measured one's rate changes it by its spread in that time.
        source = [m for m, x in samples.states.items() if simulation.kinematic(m) and simulation.rate_name(m) == name]
        known.setdefault(name, float(np.std(samples.states[source[0]])) / slow if source else largest)
    return np.array([known[name] if known[name] > 0 else largest for name in simulation.states]), slow


def _runs(samples: Trajectories) -> list[np.ndarray]:
    return [np.flatnonzero(samples.run == r) for r in range(samples.n_run)]


def _grid(
    samples: Trajectories, runs: list[np.ndarray], steps: int, interpolation: str | None
) -> tuple[Grid, np.ndarray]:
    """Nodes of all runs, and the run and the step's end of each sample. Longer gaps have more steps."""
    times, inputs, end = [], [], np.zeros((samples.n_obs, 2), int)
    typical = float(np.median(np.diff(samples.time)[np.diff(samples.run) == 0]))
    for r, own in enumerate(runs):
        t = samples.time[own]
        count = np.maximum(np.ceil(steps * np.diff(t) / typical - 1e-6), steps).astype(int)
        place = np.concatenate([[0], np.cumsum(count)])
        ends = np.interp(np.arange(place[-1] + 1), place, t)
        nodes = np.empty(2 * len(ends) - 1)
        nodes[::2], nodes[1::2] = ends, (ends[1:] + ends[:-1]) / 2
        times.append(nodes)
        u = samples.matrix(samples.input_names)[own]
        kinds = (interpolation,) * u.shape[1] if interpolation else between_samples(t, u)
        inputs.append(np.column_stack([_between(t, u[:, k], nodes, kind) for k, kind in enumerate(kinds)] or [nodes]))
        end[own, 0], end[own, 1] = r, place
    longest = max(map(len, times))
    time = np.array([np.pad(t, (0, longest - len(t)), mode="edge") for t in times])
    u = np.array([np.pad(v, ((0, longest - len(v)), (0, 0)), mode="edge") for v in inputs])
    u = u if samples.input_names else u[..., :0]
    return Grid(jnp.asarray(time), jnp.asarray(u)), end


def _between(t: np.ndarray, values: np.ndarray, at: np.ndarray, kind: str) -> np.ndarray:
    if kind == "cubic":
        return CubicSpline(t, values)(at)
    if kind == "zoh":
        return values[np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 1)]
    return np.interp(at, t, values)


def _observed(
    samples: Trajectories, simulation: Simulation, grid: Grid, end: np.ndarray, outputs: tuple[int, ...],
    s: np.ndarray, sizes: np.ndarray,
) -> Observed:  # fmt: skip
    n_segment, n_node = grid.time.shape
    values = np.full((n_segment, n_node // 2 + 1, len(outputs)), np.nan)
    values[end[:, 0], end[:, 1]] = samples.matrix(samples.state_names)
    first = np.array([np.flatnonzero(samples.run == r)[0] for r in range(samples.n_run)])
    mean = np.zeros((n_segment, len(sizes)))
    measured = samples.matrix(samples.state_names)[first]
    for k, name in enumerate(simulation.states):
        if k in outputs:
            mean[:, k] = measured[:, outputs.index(k)]
        elif not any(simulation.rate_name(m) == name for m in simulation.states):
            # Nothing is known of it but that it is a state like the others.
            mean[:, k] = measured[:, 0]
    return Observed(jnp.asarray(values), jnp.asarray(s**2), jnp.asarray(mean), jnp.asarray(WIDE * sizes))


def _smoothest(
    rate: ForcedRate, grid: Grid, observed: Observed, outputs: tuple[int, ...], driven: int, args: Array,
    sizes: np.ndarray, slow: float,
) -> tuple[Smoothed, float]:  # fmt: skip
    own, nowhere = sizes[driven] ** 2 / slow, jnp.zeros((*observed.values.shape[:2], len(sizes)))

    def pass_at(ratio: float, around: Any) -> Smoothed:
        path = nowhere if around is None else around
        return smooth(
            rate, grid, observed, outputs, driven, jnp.asarray(ratio), path, jnp.asarray(around is not None), args
        )

    found, ratio = smoothest(pass_at, own * RATIOS, PASSES)
    if not np.all(np.isfinite(np.asarray(found.ends))):
        raise InputError(
            "No path through the samples was found: the equations leave their domain near them. Check the simulation "
            "and the units, or give hidden states as data."
        )
    return found, ratio


def _steps_needed(rate: ForcedRate, grid: Grid, ends: Array, args: Array, steps: int) -> int:
    """Steps between samples that resolve the equations along the path."""
    response = respond(rate, grid, jnp.asarray(_nodes(rate, grid, np.asarray(ends), args)), rate.driven, args)
    h = np.diff(np.asarray(grid.time)[:, ::2], axis=1)
    M = np.asarray(response.M) - np.eye(response.M.shape[-1])
    with np.errstate(divide="ignore", invalid="ignore"):
        fastest = np.abs(np.linalg.eigvals(M)).max(axis=-1)
    typical = float(np.quantile(fastest[h > 0], 0.99))
    return int(np.clip(math.ceil(steps * typical / STEP), steps, MOST_STEPS))


def _nodes(rate: ForcedRate, grid: Grid, ends: np.ndarray, args: Array) -> np.ndarray:
    """States on ends and middles of steps."""
    n_segment, n_end, n_state = ends.shape
    path = np.empty((n_segment, 2 * n_end - 1, n_state))
    path[:, ::2], path[:, 1::2] = ends, np.asarray(middles(rate, grid, jnp.asarray(ends), args))
    return path


def _rates(rate: ForcedRate, grid: Grid, ends: np.ndarray, args: Array) -> Array:
    each = jax.vmap(jax.vmap(rate, (0, 0, 0, None)), (0, 0, 0, None))
    return each(grid.time[:, ::2], jnp.asarray(ends), grid.inputs[:, ::2], args)


def _segments(
    rate: ForcedRate, grid: Grid, ends: np.ndarray, outputs: tuple[int, ...], end: np.ndarray, driven: int, args: Array
) -> Segments:
    path = jnp.asarray(_nodes(rate, grid, ends, args))
    return Segments(grid, respond(rate, grid, path, driven, args), outputs, end)


def _unit_starts(segments: Segments, sizes: np.ndarray) -> tuple[Array, Array]:
    """δ₀ = one size of each state, and no force."""
    n_segment, n_node = segments.grid.time.shape
    start = jnp.broadcast_to(jnp.diag(jnp.asarray(sizes)), (n_segment, len(sizes), len(sizes)))
    return start, jnp.zeros((n_segment, n_node, len(sizes)))


def _pieces_of(grown: np.ndarray, sizes: np.ndarray) -> int:
    """Segments that a run is cut into, so that no change of a start grows by more than `GROWTH` within one."""
    size = np.abs(grown / sizes[:, None]).max(axis=(0, 1, 2, 3))
    largest = float(np.max(size)) if np.all(np.isfinite(size)) else math.inf
    return 1 if largest <= GROWTH else int(min(math.ceil(math.log(min(largest, 1e300)) / math.log(GROWTH)), 200))


def _split(grid: Grid, end: np.ndarray, ends: np.ndarray, pieces: int) -> tuple[Grid, np.ndarray, np.ndarray]:
    """Every run cut into pieces at samples; the steps from one piece to the next belong to none."""
    if pieces == 1:
        return grid, end, ends
    time, inputs = np.asarray(grid.time), np.asarray(grid.inputs)
    times, us, xs, fresh = [], [], [], np.zeros_like(end)
    for r in range(len(time)):
        own = np.flatnonzero(end[:, 0] == r)
        for part in np.array_split(own, pieces):
            if not len(part):
                continue
            first, last = end[part[0], 1], end[part[-1], 1]
            times.append(time[r, 2 * first : 2 * last + 1])
            us.append(inputs[r, 2 * first : 2 * last + 1])
            xs.append(ends[r, first : last + 1])
            fresh[part, 0], fresh[part, 1] = len(times) - 1, end[part, 1] - first
    longest = max(map(len, times))
    time = np.array([np.pad(t, (0, longest - len(t)), mode="edge") for t in times])
    u = np.array([np.pad(v, ((0, longest - len(v)), (0, 0)), mode="edge") for v in us])
    x = np.array([np.pad(v, ((0, longest // 2 + 1 - len(v)), (0, 0)), mode="edge") for v in xs])
    return Grid(jnp.asarray(time), jnp.asarray(u)), fresh, x


def _starts(segments: Segments, sizes: np.ndarray) -> np.ndarray:
    """Rows' change by one prior standard deviation of each start of each segment."""
    start, force = _unit_starts(segments, WIDE * sizes)
    rows = segments.rows(np.asarray(carried(segments.response, start, force)))
    own = np.tile(segments.end[:, 0], len(segments.outputs))
    n_segment = len(segments.grid.time)
    return np.hstack([np.where((own == k)[:, None], rows, 0.0) for k in range(n_segment)])


def _gain(segments: Segments, columns: Mapping[str, np.ndarray], starts: np.ndarray, sd: np.ndarray) -> float:
    """RMS response, in what starts cannot take, of rows to forces that are powers of the path's columns."""
    forces = np.column_stack([x**k for x in columns.values() for k in (1, 2, 3)])
    forces = forces / np.sqrt(np.mean(forces**2, axis=0)).clip(1e-300)
    rows = segments.respond(lambda part: forces[part["node"].astype(int)], {"node": np.arange(len(forces))})
    Q, _ = np.linalg.qr(starts / sd[:, None])
    rows = rows - sd[:, None] * (Q @ (Q.T @ (rows / sd[:, None])))
    return float(np.sqrt(np.mean(rows**2)))


def _moved_by(M: np.ndarray, defects: np.ndarray) -> np.ndarray:
    """δ at the ends of steps from a jump after each."""
    delta = np.zeros((M.shape[0], M.shape[1] + 1, M.shape[-1]))
    for n in range(M.shape[1]):
        delta[:, n + 1] = np.einsum("sij,sj->si", M[:, n], delta[:, n]) + defects[:, n]
    return delta
