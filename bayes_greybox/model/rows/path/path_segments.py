"""Steps between samples, and the linear equation along them: the response of samples to forces and other starts."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.interpolate import CubicSpline

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.integration.adaptive_steps import between_samples, one_for_each
from bayes_greybox.physics.integration.sensitivity import Grid, Response, carried, forces, hermite, respond, triples

from .forced_rate import ForcedRate

START_WIDTH = 10.0
"""Prior standard deviation of a start, over the size of its state."""

MOST_GROWTH = 1e3
"""Growth of a change of its start at which a segment ends: beyond it nothing is linear, nor known."""

AtEnds = Float[np.ndarray, "n_segment n_end n_state"]
"""States at the ends of the steps of each segment."""


def points_at_ends(grid: Grid, ends: AtEnds) -> Float[np.ndarray, "n_segment n_end c"]:
    """Return time, states and inputs at the ends of steps."""
    return np.concatenate([grid.time[:, ::2, None], ends, grid.inputs[:, ::2]], axis=-1)


def points_at_nodes(
    grid: Grid, states: Float[np.ndarray, "n_segment n_node n_state"]
) -> Float[np.ndarray, "n_segment n_node c"]:
    """Return time, states and inputs at the ends and middles of steps."""
    return np.concatenate([grid.time[..., None], states, grid.inputs], axis=-1)


def grid_of(
    samples: Trajectories, runs: list[np.ndarray], steps: int, interpolation: str | tuple[str, ...] | None,
    usual_gap: float,
) -> tuple[Grid, np.ndarray]:  # fmt: skip
    """Return the nodes of all runs, and the run and the step's end of each sample.

    There are `steps` between two samples that are `usual_gap` apart, and more in longer gaps. Where an input with a
    zero-order hold changes, a step of no length leads from the value before to the value after: a step's end is the
    next one's start, and would have a sixth of its input too early.
    """
    times, inputs, end = [], [], np.zeros((samples.n_obs, 2), int)
    for r, rows in enumerate(runs):
        t = samples.time[rows]
        u = samples.matrix(samples.input_names)[rows]
        kinds = one_for_each(interpolation, u.shape[1]) if interpolation else between_samples(t, u)
        leaps = np.any(np.diff(u[:, [kind == "zoh" for kind in kinds]], axis=0) != 0, axis=1)
        count = np.maximum(np.ceil(steps * np.diff(t) / usual_gap - 1e-6), steps).astype(int)
        interval = np.repeat(np.arange(len(count)), count + leaps)
        place = np.concatenate([[0], np.cumsum(count + leaps)])
        # Where in its interval each step begins, in steps; one of no length begins where the interval ends.
        begun = np.arange(len(interval)) - place[interval]
        ends = np.append(t[interval] + np.diff(t)[interval] * begun / count[interval], t[-1])
        ends[place], ends[place[1:] - leaps] = t, t[1:]
        nodes = np.empty(2 * len(ends) - 1)
        nodes[::2], nodes[1::2] = ends, (ends[1:] + ends[:-1]) / 2
        times.append(nodes)
        of_node = np.append(np.repeat(interval, 2), len(t) - 1)
        held = {k: u[of_node, k] for k, kind in enumerate(kinds) if kind == "zoh"}
        leap = 2 * (place[1:] - leaps)[leaps] + 1
        for values in held.values():
            # A straight line from the value before to the value after: what is evaluated on it lies between them.
            values[leap] = (values[leap - 1] + values[leap + 1]) / 2
        smooth = {k: CubicSpline(t, u[:, k])(nodes) for k, kind in enumerate(kinds) if kind == "cubic"}
        columns = [{**held, **smooth}.get(k, np.interp(nodes, t, x)) for k, x in enumerate(u.T)]
        inputs.append(np.column_stack(columns) if columns else np.zeros((len(nodes), 0)))
        end[rows, 0], end[rows, 1] = r, place
    return Grid(_padded(times), _padded(inputs)), end


def split(grid: Grid, end: np.ndarray, ends: np.ndarray, pieces: int) -> tuple[Grid, np.ndarray, np.ndarray]:
    """Cut every run into pieces at samples; the steps from one piece to the next belong to none."""
    if pieces == 1:
        return grid, end, ends
    times, inputs, states, new_end = [], [], [], np.zeros_like(end)
    for r in range(len(grid.time)):
        for part in np.array_split(np.flatnonzero(end[:, 0] == r), pieces):
            if not len(part):
                continue
            first, last = end[part[0], 1], end[part[-1], 1]
            times.append(grid.time[r, 2 * first : 2 * last + 1])
            inputs.append(grid.inputs[r, 2 * first : 2 * last + 1])
            states.append(ends[r, first : last + 1])
            new_end[part, 0], new_end[part, 1] = len(times) - 1, end[part, 1] - first
    return Grid(_padded(times), _padded(inputs)), new_end, _padded(states)


def _padded(parts: list[np.ndarray]) -> np.ndarray:
    """Stack parts of different lengths; shorter ones go on with their last value."""
    longest = max(map(len, parts))
    return np.array([np.pad(x, [(0, longest - len(x)), (0, 0)][: x.ndim], mode="edge") for x in parts])


@dataclass(frozen=True, eq=False)
class Segments:
    """Segments of runs with a path along them and their steps of the linear equation near it.

    Shorter segments end in steps of no length. `slope` is that of the path's states, `driven` and `outputs` are the
    learned and the measured states, and `end` the segment and end of a step of each sample that is a row.
    """

    grid: Grid
    points: Float[np.ndarray, "n_segment n_node c"]
    slope: Float[np.ndarray, "n_segment n_node n_state"]
    response: Response
    driven: tuple[int, ...]
    outputs: tuple[int, ...]
    end: Int[np.ndarray, "n_sample 2"]

    def rows(self, ends: Float[np.ndarray, "n_segment n_end n_state k"]) -> Float[np.ndarray, "n_row k"]:
        """Return rows from changes of the states at the ends of steps."""
        at = ends[self.end[:, 0], self.end[:, 1]]
        return np.concatenate([at[:, k] for k in self.outputs])

    def respond_to(self, table: Float[np.ndarray, "n_node k"], learned: int = 0) -> Float[np.ndarray, "n_row k"]:
        """Return the response to forces on a learned state, by its number, that are known at the nodes."""
        by_node = table.reshape(*self.grid.time.shape, -1)
        return self._respond(lambda nodes: triples(by_node[:, nodes]), learned)

    def respond(
        self, evaluate: Callable[[Mapping[str, np.ndarray]], np.ndarray], columns: Mapping[str, np.ndarray],
        learned: int = 0,
    ) -> Float[np.ndarray, "n_row k"]:  # fmt: skip
        """Return the response to forces that are evaluated a stretch of all segments at a time, to bound the memory."""
        names, values = list(columns), np.stack(list(columns.values()), axis=-1)
        by_node = values.reshape(*self.grid.time.shape, -1)

        def at(points: np.ndarray) -> np.ndarray:
            return np.asarray(evaluate(dict(zip(names, points.T, strict=True))))

        return self._respond(lambda nodes: forces(at, by_node[:, nodes]), learned)

    def departure(self, rates: Callable[[np.ndarray], np.ndarray]) -> Float[np.ndarray, "n_segment n_step 3 n_state"]:
        """Return rates less the path's slope, at the start, the middle and the end of each step; see `departures`."""
        return departures(rates, self.points, self.slope)

    def _respond(self, forced: Callable[[slice], np.ndarray], learned: int) -> np.ndarray:
        n_segment, n_node = self.grid.time.shape
        n_step, span = (n_node - 1) // 2, max(1, 4096 // n_segment)
        b = self.response.b[..., self.driven[learned]]
        whole, delta = np.empty(()), None
        for first in range(0, n_step, span):
            last = min(first + span, n_step)
            jump = b[:, first:last] @ forced(slice(2 * first, 2 * last + 1))
            if delta is None:
                delta = np.zeros((n_segment, b.shape[2], jump.shape[-1]))
                whole = np.empty((len(self.end), len(self.outputs), jump.shape[-1]))
            ends = carried(self.response.M[:, first:last], delta, jump)
            delta = ends[:, -1]
            # Only what is measured, where it is measured, is kept.
            inside = (self.end[:, 1] >= first + (first > 0)) & (self.end[:, 1] <= last)
            whole[inside] = ends[self.end[inside, 0], self.end[inside, 1] - first][:, list(self.outputs)]
        return np.concatenate([whole[:, k] for k in range(len(self.outputs))])

    def responses_to_unit_starts(self, sizes: np.ndarray) -> Float[np.ndarray, "n_segment n_end n_state n_state"]:
        """Return the change of the path by one size of each state at the start of its segment."""
        n_segment, n_step, n_state = self.response.M.shape[:3]
        start = np.broadcast_to(np.diag(sizes), (n_segment, n_state, n_state))
        return carried(self.response.M, start, np.zeros((n_segment, n_step, n_state, n_state)))

    def pieces(self, sizes: np.ndarray) -> int:
        """Return the number of segments of a run in which no change of a start grows by more than `MOST_GROWTH`."""
        size = np.abs(self.responses_to_unit_starts(sizes) / sizes[:, None]).max(axis=(0, 1, 2, 3))
        largest = float(np.max(size)) if np.all(np.isfinite(size)) else math.inf
        if largest <= MOST_GROWTH:
            return 1
        return int(min(math.ceil(math.log(min(largest, 1e300)) / math.log(MOST_GROWTH)), 200))

    def responses_to_starts(self, sizes: np.ndarray) -> Float[np.ndarray, "n_row n_start"]:
        """Return the rows' change by one prior standard deviation of each start of each segment."""
        rows = self.rows(self.responses_to_unit_starts(START_WIDTH * sizes))
        segment = np.tile(self.end[:, 0], len(self.outputs))
        return np.hstack([np.where((segment == k)[:, None], rows, 0.0) for k in range(len(self.grid.time))])

    def gain(
        self, columns: Mapping[str, np.ndarray], starts: np.ndarray, sd: np.ndarray, sizes: Sequence[float]
    ) -> float:
        """Return the RMS response of rows, in what starts cannot take, to forces that are powers of the columns."""
        powers = [(name, k, float(np.sqrt(np.mean(x ** (2 * k))))) for name, x in columns.items() for k in (1, 2, 3)]
        scaled = [(name, k, size) for name, k, size in powers if size > 0]

        def powers_of(at: Mapping[str, np.ndarray]) -> np.ndarray:
            return np.column_stack([at[name] ** k / size for name, k, size in scaled])

        rows = np.hstack([large * self.respond(powers_of, columns, k) for k, large in enumerate(sizes)])
        Q, _ = np.linalg.qr(starts / sd[:, None])
        rows = rows - sd[:, None] * (Q @ (Q.T @ (rows / sd[:, None])))
        return float(np.sqrt(np.mean(rows**2)))

    def motion(self, sizes: Sequence[float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return, sample by sample, transitions, covariances by forces of unit intensity, and which is a first one."""
        M, end = self.response.M, self.end
        b = self.response.b[..., list(self.driven)].sum(axis=-2) * np.asarray(sizes)
        h = np.diff(self.grid.time[:, ::2], axis=1)
        eye = np.eye(M.shape[-1])
        fresh = np.diff(end[:, 0], prepend=-1) != 0
        moved, spread = np.tile(eye, (len(end), 1, 1)), np.zeros((len(end), *eye.shape))
        # All intervals at once, a step of each at a time.
        before = np.where(fresh, 0, np.concatenate([[0], end[:-1, 1]]))
        steps = end[:, 1] - before
        for k in range(int(steps.max(initial=0))):
            on = steps > k
            at = end[on, 0], before[on] + k
            step, push, length = M[at], b[at], h[at]
            pushed = push @ push.swapaxes(1, 2) / np.where(length > 0, length, np.inf)[:, None, None]
            moved[on] = step @ moved[on]
            spread[on] = step @ spread[on] @ step.swapaxes(1, 2) + pushed
        return moved, spread, fresh


def departures(
    rates: Callable[[np.ndarray], np.ndarray], points: Float[np.ndarray, "n_segment n_node c"],
    slope: Float[np.ndarray, "n_segment n_node n_state"],
) -> Float[np.ndarray, "n_segment n_step 3 n_state"]:  # fmt: skip
    """Return rates less the slope of a path, at the start, the middle and the end of each step."""
    # What is rough is judged by the size of the difference: a jump that is small beside the rates is most of it.
    n, least = points.shape[-1], 1e-3 * np.sqrt(np.mean(slope**2, axis=(0, 1)))
    both = np.concatenate([points, slope], axis=-1)
    return forces(lambda at: rates(at[:, :n]) - at[:, n:], both, least)


def segments_of(
    rate: ForcedRate, grid: Grid, ends: AtEnds, outputs: tuple[int, ...], end: np.ndarray | None = None
) -> Segments:
    """Return the path through given ends of steps, and the linear equation along it; `end` are those of the rows."""
    end = np.zeros((0, 2), int) if end is None else end
    rates = rate.rates(points_at_ends(grid, ends))
    path, _ = hermite(grid.time, ends, rates)
    # Where the path departs from the equations its slope does too: as much as on the steps before and after.
    middles = rate.rates(points_at_nodes(grid, path)[:, 1::2])
    driven = list(rate.driven)
    rates[..., driven] += _at_ends(grid.time, _lacking(grid.time, ends, rates, middles)[..., driven])
    path, slope = hermite(grid.time, ends, rates)
    points = points_at_nodes(grid, path)
    return Segments(grid, points, slope, respond(grid.time, rate.jacobian(points)), rate.driven, outputs, end)


def _lacking(time: np.ndarray, ends: np.ndarray, rates: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """Return what rates lack on average to lead from one end of a step to the next; as before where a step is none."""
    h = np.diff(time[:, ::2], axis=1)[..., None]
    chord = np.divide(np.diff(ends, axis=1), h, out=np.zeros_like(middles), where=h > 0)
    lacking = chord - (rates[:, :-1] + 4 * middles + rates[:, 1:]) / 6
    last = np.maximum.accumulate(np.where(h[..., 0] > 0, np.arange(h.shape[1]), 0), axis=1)
    return np.take_along_axis(lacking, last[..., None], axis=1)


def _at_ends(time: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Average values of steps to their ends; across a leap of an input, which takes no time, nothing is even."""
    counts = np.where(np.diff(time[:, ::2], axis=1) > 0, 1.0, np.finfo(float).tiny)[..., None]
    before, after = (np.pad(counts, ((0, 0), pad, (0, 0))) for pad in ((1, 0), (0, 1)))
    left, right = (np.pad(steps, ((0, 0), pad, (0, 0))) for pad in ((1, 0), (0, 1)))
    return (before * left + after * right) / (before + after)
