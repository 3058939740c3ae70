"""The path that samples are linearised along, and the operator from forces on it to samples."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import jax.numpy as jnp
import numpy as np
import sympy
from jaxtyping import Array, Float, Int
from scipy.interpolate import CubicSpline, make_smoothing_spline

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.sample_noise import sample_noise
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.expressions import evaluate
from bayes_greybox.physics.integrate import between_samples
from bayes_greybox.physics.sensitivity import Grid, Response, carried, jacobians, middles, rates_at, respond
from bayes_greybox.physics.simulation import Simulation
from bayes_greybox.physics.smoothing import Observed, Smoothed, filtered, linearised, smooth
from bayes_greybox.physics.terms import Term

STEP = 0.1
"""Steps are so short, over the fastest time scale of the equations along the path, or the steps that were asked for."""

MOST_STEPS = 50
"""Most steps between two samples."""

RATIOS = 10.0 ** np.arange(-10.0, 1.1)
"""Intensities of the unknown force that are tried, q² over that of a force as large as the path's own."""

MIDDLING = 1e-2
"""Intensity that a first path is smoothed at, before it is chosen."""

PASSES = 3
"""Passes of the smoother at the intensity that was chosen."""

MOST_TRIED = 500
"""Samples, evenly thinned, at which the time scales of the equations are looked at."""

FINEST = 1e-5
"""Noise of a sensor over the spread of its samples, at least: rounding, and what an integrator leaves."""

WIDE = 10.0
"""Prior standard deviation of a start, over the size of its state."""

GROWTH = 1e3
"""A segment ends where a change of its start has grown this much: beyond it nothing is linear, nor known."""

CHUNK = 4096
"""Steps whose forces are evaluated at once."""


Args = tuple[Array, ...]
"""Coefficient and numbers of each term."""


class ForcedRate:
    """Rate of all states with terms added to one: equal to any other with the same formulas, so compiled once.

    Numbers within a formula, such as the width of a dead zone, are arguments of the rate and none of the formula's.

    Args:
        simulation: Known rates.
        driven: Index of the learned state.
        added: Terms added to its rate, with their coefficients.
    """

    def __init__(self, simulation: Simulation, driven: int, added: Sequence[tuple[Term, float]]) -> None:
        self.simulation, self.driven, self.terms = simulation, driven, tuple(term for term, _ in added)
        formulas, numbers = [], []
        for term, coefficient in added:
            within = sorted(term.expr.atoms(sympy.Float))
            names = {number: sympy.Symbol(f"number_{k}", real=True) for k, number in enumerate(within)}
            formulas.append(term.expr.xreplace(names))
            numbers.append([coefficient, *(float(number) for number in within)])
        self.formulas = tuple(formulas)
        self.args = tuple(jnp.array(each) for each in numbers)
        self._key = (simulation.key, driven, tuple(map(str, formulas)))

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ForcedRate) and self._key == other._key

    def __call__(self, t: Array, x: Array, u: Array, args: tuple[Array, ...]) -> Array:
        """Rates at one point; `args` has the coefficient and the numbers of each term."""
        rate = jnp.asarray(self.simulation.rate(t, x, u), float)
        columns = dict(zip((*self.simulation.states, *self.simulation.inputs), (*x, *u), strict=True))
        force = 0.0 * t
        for formula, (coefficient, *numbers) in zip(self.formulas, args, strict=True):
            known = {f"number_{k}": number for k, number in enumerate(numbers)}
            force = force + coefficient * evaluate(formula, {**columns, **known})
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
        return self.segments.respond(lambda node: table[node]) / self.gain

    def of(
        self,
        evaluate: Callable[[Mapping[str, np.ndarray]], Float[np.ndarray, "n k"]],
        columns: Mapping[str, Float[np.ndarray, " n_node"]],
    ) -> Float[np.ndarray, "n_row k"]:
        """Response to forces that are evaluated a stretch of the path at a time."""
        return self.segments.respond(_at_nodes(evaluate, columns)) / self.gain


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
        self, force: Callable[[Int[np.ndarray, " n"]], Float[np.ndarray, "n k"]]
    ) -> Float[np.ndarray, "n_row k"]:
        """Response to forces by node, a stretch of all segments at a time; memory is bounded by a stretch.

        Args:
            force: Forces at some nodes.
        """
        n_segment, n_node = self.grid.time.shape
        node = np.arange(n_segment * n_node).reshape(n_segment, n_node)
        n_step, span = (n_node - 1) // 2, max(1, CHUNK // n_segment)
        found, delta = [], None
        for first in range(0, n_step, span):
            last = min(first + span, n_step)
            index = node[:, 2 * first : 2 * last + 1]
            values = np.asarray(force(index.ravel())).reshape(*index.shape, -1)
            if delta is None:
                delta = jnp.zeros((n_segment, self.response.M.shape[-1], values.shape[-1]))
            part = Response(*(steps[:, first:last] for steps in self.response))
            ends = np.asarray(carried(part, delta, jnp.asarray(values)))
            delta = jnp.asarray(ends[:, -1])
            # Only what is measured, where it is measured, is kept.
            inside = (self.end[:, 1] >= first + (first > 0)) & (self.end[:, 1] <= last)
            at = ends[self.end[inside, 0], self.end[inside, 1] - first][:, list(self.outputs)]
            found.append((np.flatnonzero(inside), at))
        whole = np.empty((len(self.end), len(self.outputs), found[0][1].shape[-1]))
        for rows, at in found:
            whole[rows] = at
        return np.concatenate([whole[:, k] for k in range(len(self.outputs))])


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
    rate = ForcedRate(simulation, driven, added)
    args = rate.args
    sizes, slow = _sizes(samples, simulation)
    s = np.maximum(
        sample_noise(samples.time, samples.matrix(samples.state_names), samples.run_lengths),
        FINEST * np.std(samples.matrix(samples.state_names), axis=0),
    )
    runs = _runs(samples)
    first = _first_path(samples, simulation, s, slow)
    steps = substeps or _steps_needed(rate, samples, simulation, first, args)
    grid, end = _grid(samples, runs, steps, interpolation)
    observed = _observed(samples, simulation, grid, end, outputs, s, sizes)
    found, ratio = _smoothest(
        rate,
        grid,
        observed,
        outputs,
        args,
        own=sizes[driven] ** 2 / slow,
        first=_at_ends(samples, runs, grid, end, first),
    )
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
    samples: Trajectories, simulation: Simulation, rate: ForcedRate, args: Args, segments: Segments,
    ends: np.ndarray, sizes: np.ndarray, s: np.ndarray, ratio: float, driven: int,
) -> ReferencePath:  # fmt: skip
    grid, end = segments.grid, segments.end
    path = _nodes(rate, grid, ends, args)
    flat = path.reshape(-1, path.shape[-1])
    inputs = np.asarray(grid.inputs).reshape(len(flat), -1)
    columns = dict(zip((*simulation.states, *simulation.inputs), np.hstack([flat, inputs]).T, strict=True))
    steps = linearised(rate, grid, jnp.asarray(ends), driven, args)
    defects = np.einsum("snij,snj->sni", np.asarray(steps.M), ends[:, :-1]) + np.asarray(steps.c) - ends[:, 1:]
    response = segments.response
    response_to_defects = _moved_by(np.asarray(response.M), defects)
    at = ends[end[:, 0], end[:, 1]]
    simulated = np.concatenate([at[:, k] for k in segments.outputs])
    simulated = simulated + segments.rows(response_to_defects[..., None])[:, 0]
    terms = rate.terms
    if terms:
        coefficients = [float(each[0]) for each in args]

        def added(columns: Mapping[str, np.ndarray]) -> np.ndarray:
            values = [c * np.asarray(term.evaluate(columns)) for c, term in zip(coefficients, terms, strict=True)]
            return np.sum(np.broadcast_arrays(*values), axis=0)[:, None]

        simulated = simulated - segments.respond(_at_nodes(added, columns))[:, 0]
    starts = _starts(segments, sizes)
    gain = _gain(segments, columns, starts, np.repeat(s, len(end)))
    rates = np.asarray(rates_at(rate, grid, jnp.asarray(ends), args))[..., driven]
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


def _first_path(
    samples: Trajectories, simulation: Simulation, s: np.ndarray, slow: float
) -> Float[np.ndarray, "n_sample n_state"]:
    """States at the samples to begin with; NaN for hidden states that are no sampled one's rate."""
    path = np.full((samples.n_obs, len(simulation.states)), np.nan)
    for k, name in enumerate(samples.state_names):
        for own in _runs(samples):
            t, x = samples.time[own], samples.states[name][own]
            width = slow * min(1.0, 10 * s[k] / max(float(np.std(x)), 1e-300))
            # Shrunk as far as the noise asks for: a spline on a mean over neighbours.
            spline = make_smoothing_spline(t, x, lam=width**4 * 0.1) if len(t) > 4 else CubicSpline(t, x)
            path[own, simulation.states.index(name)] = spline(t)
            rate = simulation.rate_name(name)
            if rate is not None and rate not in samples.state_names:
                path[own, simulation.states.index(rate)] = spline.derivative()(t)
    return path


def _at_ends(
    samples: Trajectories, runs: list[np.ndarray], grid: Grid, end: np.ndarray, path: np.ndarray
) -> Float[np.ndarray, "n_segment n_end n_state"]:
    """A path at the samples, at the ends of all steps."""
    time = np.asarray(grid.time)[:, ::2]
    return np.array(
        [[np.interp(time[r], samples.time[own], x) for x in path[own].T] for r, own in enumerate(runs)]
    ).transpose(0, 2, 1)


def _smoothest(
    rate: ForcedRate, grid: Grid, observed: Observed, outputs: tuple[int, ...], args: Args, own: float,
    first: np.ndarray,
) -> tuple[Smoothed, float]:  # fmt: skip
    """The smoothed path at the likeliest intensity of the unknown force, and that.

    Args:
        rate: Of all states.
        grid: Nodes.
        observed: Samples.
        outputs: Indices of the measured states.
        args: Coefficients of the rate.
        own: Intensity of a force as large as the path's own.
        first: A path to begin with, NaN where there is none.
    """
    ends = jnp.asarray(first)
    if not np.all(np.isfinite(first)):
        ends = filtered(rate, grid, observed, outputs, rate.driven, jnp.asarray(own * MIDDLING), args)
    ratio, found = own * MIDDLING, None
    for turn in range(PASSES + 1):
        steps = linearised(rate, grid, ends, rate.driven, args)
        if turn == 1:
            logs = [float(smooth(steps, observed, outputs, jnp.asarray(own * r)).log_likelihood) for r in RATIOS]
            ratio = own * float(RATIOS[int(np.nanargmax(logs))]) if np.any(np.isfinite(logs)) else ratio
        found = smooth(steps, observed, outputs, jnp.asarray(ratio))
        ends = found.ends
    if found is None or not np.all(np.isfinite(np.asarray(found.ends))):
        raise InputError(
            "No path through the samples was found: the equations leave their domain near them. Check the simulation "
            "and the units, or give hidden states as data."
        )
    return found, ratio


def _steps_needed(rate: ForcedRate, samples: Trajectories, simulation: Simulation, path: np.ndarray, args: Args) -> int:
    """Steps between samples that resolve the equations along a path; hidden states that it lacks are as the others."""
    filled = np.where(np.isfinite(path), path, path[:, [simulation.states.index(samples.state_names[0])]])
    some = np.unique(np.linspace(0, samples.n_obs - 1, MOST_TRIED).astype(int))
    u = samples.matrix(samples.input_names)[some]
    A = np.asarray(jacobians(rate, jnp.asarray(samples.time[some]), jnp.asarray(filled[some]), jnp.asarray(u), args))
    A = A[np.all(np.isfinite(A), axis=(1, 2))]
    if not len(A):
        return 1
    fastest = float(np.quantile(np.abs(np.linalg.eigvals(A)).max(axis=-1), 0.99))
    step = float(np.median(np.diff(samples.time)[np.diff(samples.run) == 0]))
    return int(np.clip(math.ceil(fastest * step / STEP), 1, MOST_STEPS))


def _nodes(rate: ForcedRate, grid: Grid, ends: np.ndarray, args: Args) -> np.ndarray:
    """States on ends and middles of steps."""
    n_segment, n_end, n_state = ends.shape
    path = np.empty((n_segment, 2 * n_end - 1, n_state))
    path[:, ::2], path[:, 1::2] = ends, np.asarray(middles(rate, grid, jnp.asarray(ends), args))
    return path


def _segments(
    rate: ForcedRate, grid: Grid, ends: np.ndarray, outputs: tuple[int, ...], end: np.ndarray, driven: int, args: Args
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
    rows = segments.respond(lambda node: forces[node])
    Q, _ = np.linalg.qr(starts / sd[:, None])
    rows = rows - sd[:, None] * (Q @ (Q.T @ (rows / sd[:, None])))
    return float(np.sqrt(np.mean(rows**2)))


def _at_nodes(
    evaluate: Callable[[Mapping[str, np.ndarray]], np.ndarray], columns: Mapping[str, np.ndarray]
) -> Callable[[np.ndarray], np.ndarray]:
    return lambda node: evaluate({name: column[node] for name, column in columns.items()})


def _moved_by(M: np.ndarray, defects: np.ndarray) -> np.ndarray:
    """δ at the ends of steps from a jump after each."""
    delta = np.zeros((M.shape[0], M.shape[1] + 1, M.shape[-1]))
    for n in range(M.shape[1]):
        delta[:, n + 1] = np.einsum("sij,sj->si", M[:, n], delta[:, n]) + defects[:, n]
    return delta
