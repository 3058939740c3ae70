"""The grid of steps between the samples of runs."""

import numpy as np
from scipy.interpolate import CubicSpline

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.integration.adaptive_steps import between_samples
from bayes_greybox.physics.integration.sensitivity import Grid


def runs_of(samples: Trajectories) -> list[np.ndarray]:
    """Rows of each run."""
    return [np.flatnonzero(samples.run == r) for r in range(samples.n_run)]


def grid_of(
    samples: Trajectories, runs: list[np.ndarray], steps: int, interpolation: str | None, typical: float
) -> tuple[Grid, np.ndarray]:
    """Nodes of all runs, and the run and the step's end of each sample. Longer gaps have more steps.

    Where an input that is held changes, a step of no length leads from the value before to the value after: a step's
    end is the next one's start, and would have a sixth of its input too early.

    Args:
        samples: Of the runs.
        runs: Rows of each.
        steps: Between two samples that are as far apart as is usual.
        interpolation: Of the inputs between samples.
        typical: How far apart these are.
    """
    times, inputs, end = [], [], np.zeros((samples.n_obs, 2), int)
    for r, own in enumerate(runs):
        t = samples.time[own]
        u = samples.matrix(samples.input_names)[own]
        kinds = (interpolation,) * u.shape[1] if interpolation else between_samples(t, u)
        leaps = np.any(np.diff(u[:, [kind == "zoh" for kind in kinds]], axis=0) != 0, axis=1)
        count = np.maximum(np.ceil(steps * np.diff(t) / typical - 1e-6), steps).astype(int)
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
        inputs.append(np.column_stack(columns or [nodes]))
        end[own, 0], end[own, 1] = r, place
    longest = max(map(len, times))
    time = np.array([np.pad(t, (0, longest - len(t)), mode="edge") for t in times])
    u = np.array([np.pad(v, ((0, longest - len(v)), (0, 0)), mode="edge") for v in inputs])
    u = u if samples.input_names else u[..., :0]
    return Grid(time, u), end


def split(grid: Grid, end: np.ndarray, ends: np.ndarray, pieces: int) -> tuple[Grid, np.ndarray, np.ndarray]:
    """Every run cut into pieces at samples; the steps from one piece to the next belong to none."""
    if pieces == 1:
        return grid, end, ends
    time, inputs = grid.time, grid.inputs
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
    return Grid(time, u), fresh, x


def _between(t: np.ndarray, values: np.ndarray, at: np.ndarray, kind: str) -> np.ndarray:
    if kind == "cubic":
        return CubicSpline(t, values)(at)
    return np.interp(at, t, values)
