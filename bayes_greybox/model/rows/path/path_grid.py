"""The grid of steps between the samples of runs."""

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.integration.adaptive_steps import between_samples
from bayes_greybox.physics.integration.sensitivity import Grid


def runs_of(samples: Trajectories) -> list[np.ndarray]:
    """Return the rows of each run."""
    return [np.flatnonzero(samples.run == r) for r in range(samples.n_run)]


def points_at_ends(
    grid: Grid, ends: Float[np.ndarray, "n_segment n_end n_state"]
) -> Float[np.ndarray, "n_segment n_end c"]:
    """Return time, states and inputs at the ends of steps."""
    return np.concatenate([grid.time[:, ::2, None], ends, grid.inputs[:, ::2]], axis=-1)


def points_at_nodes(
    grid: Grid, states: Float[np.ndarray, "n_segment n_node n_state"]
) -> Float[np.ndarray, "n_segment n_node c"]:
    """Return time, states and inputs at the ends and middles of steps."""
    return np.concatenate([grid.time[..., None], states, grid.inputs], axis=-1)


def grid_of(
    samples: Trajectories, runs: list[np.ndarray], steps: int, interpolation: str | None, usual_gap: float
) -> tuple[Grid, np.ndarray]:
    """Return the nodes of all runs, and the run and the step's end of each sample. Longer gaps have more steps.

    Where an input with a zero-order hold changes, a step of no length leads from the value before to the value after: a
    step's end is the next one's start, and would have a sixth of its input too early.

    Args:
        samples: Samples of the runs.
        runs: Rows of each run.
        steps: Number of steps between two samples that are `usual_gap` apart.
        interpolation: Interpolation of all inputs between samples; None: each input's own.
        usual_gap: Usual time between two samples.
    """
    times, inputs, end = [], [], np.zeros((samples.n_obs, 2), int)
    for r, rows in enumerate(runs):
        t = samples.time[rows]
        u = samples.matrix(samples.input_names)[rows]
        kinds = (interpolation,) * u.shape[1] if interpolation else between_samples(t, u)
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
        columns = [held.get(k, _between(t, u[:, k], nodes, kind)) for k, kind in enumerate(kinds)]
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


def _between(t: np.ndarray, values: np.ndarray, at: np.ndarray, kind: str) -> np.ndarray:
    if kind == "cubic":
        return CubicSpline(t, values)(at)
    return np.interp(at, t, values)
