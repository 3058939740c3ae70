"""Many runs of dx/dt = f(t, x, u) at once on fixed steps: candidates of an experiment under draws of a model.

The method is the classical one of Runge and Kutta, of order four (Kutta 1901). All runs take the same steps, so that
one evaluation of the rate serves thousands of them and nothing is compiled. The caller doubles the steps until they
are enough.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bayes_greybox.physics.formula.expressions import evaluate, parse_expression
from bayes_greybox.physics.hidden_states import HiddenState
from bayes_greybox.physics.simulation.protocol import Simulation
from bayes_greybox.physics.terms import Term

Rate = Callable[[Float[np.ndarray, "n_run n_draw d"], Float[np.ndarray, "n_run 1 p"], float], np.ndarray]
"""(states, inputs, time) -> rates of the states."""


def stage_times(times: Float[np.ndarray, " n"], steps: int) -> Float[np.ndarray, " n_stage"]:
    """Return the times at which inputs are needed: start, middle and end of each of the steps between two samples."""
    share = np.arange(2 * steps) / (2 * steps)
    inside = times[:-1, None] + np.diff(times)[:, None] * share
    return np.append(inside.ravel(), times[-1])


def side_by_side(
    rate: Rate, starts: Float[np.ndarray, "n_run n_draw d"], times: Float[np.ndarray, " n"],
    inputs: Float[np.ndarray, "n_run n_stage p"], limit: Float[np.ndarray, " d"],
) -> Float[np.ndarray, "n_run n_draw n d"]:  # fmt: skip
    """Integrate all runs at once; states are NaN from where a run has left its limits, which is a result and no error.

    `rate` is of all runs at once, `inputs` are those at the `stage_times`.
    """
    steps = (inputs.shape[1] - 1) // (2 * (len(times) - 1))
    states = np.full((*starts.shape[:2], len(times), starts.shape[2]), np.nan)
    states[:, :, 0] = x = np.array(starts, float)
    place = 0
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for i, (begin, length) in enumerate(zip(times[:-1], np.diff(times), strict=True)):
            h = length / steps
            for k in range(steps):
                t = begin + k * h
                first, middle, last = (inputs[:, None, place + j] for j in range(3))
                k1 = rate(x, first, t)
                k2 = rate(x + 0.5 * h * k1, middle, t + 0.5 * h)
                k3 = rate(x + 0.5 * h * k2, middle, t + 0.5 * h)
                k4 = rate(x + h * k3, last, t + h)
                x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
                place += 2
            x = np.where(np.all(np.abs(x) < limit, axis=-1, keepdims=True), x, np.nan)
            states[:, :, i + 1] = x
    return states


SAME_PATH, MOST_HALVED_STEPS = 1e-2, 32
"""Share of a state's range that twice as many steps may change, and most steps between two samples."""


def steps_needed(paths: Callable[[int], np.ndarray], range_: Float[np.ndarray, " d"]) -> tuple[int, list[bool]]:
    """Double the steps between samples until paths stay as they are; return the steps, and which runs they follow.

    `paths` returns states [n_run, ..., d] for a number of steps; `range_` is the range of each state.
    """
    steps, before = 4, paths(2)
    while True:
        now = paths(steps)
        near = (np.abs(now - before) <= SAME_PATH * range_) | (np.isnan(now) & np.isnan(before))
        same = np.all(near.reshape(len(near), -1), axis=1)
        if np.all(same) or steps >= MOST_HALVED_STEPS:
            return steps, same.tolist()
        before, steps = now, 2 * steps


class Added(NamedTuple):
    """Terms without jumps beside a simulation, each with the index of its state, and their coefficients by draw."""

    terms: Sequence[tuple[int, Term]]
    theta: Float[np.ndarray, "n_term n_draw"]


def run_with(
    simulation: Simulation, systems: Sequence[Added], starts: Sequence[np.ndarray], times: Float[np.ndarray, " n"],
    inputs: Float[np.ndarray, "n_run n_stage p"], limit: Float[np.ndarray, " d"],
) -> list[np.ndarray]:  # fmt: skip
    """Integrate a simulation with terms added to its rates by several systems, and with the hidden states of the terms.

    The simulation has no jumps, which an integrator cannot stay on. Starts [n_run, n_draw, d] and the paths that are
    returned [n_run, n_draw, n, d] are by system; hidden states start as they say. A run beyond its `limit` has failed.
    """
    paths: dict[int, np.ndarray] = {}
    hidden = [tuple(dict.fromkeys(s for _, term in system.terms for s in term.states)) for system in systems]
    for states in dict.fromkeys(hidden):
        # A step costs as much for one run as for hundreds: all with the same hidden states go together.
        alike = [k for k, each in enumerate(hidden) if each == states]
        ends = np.cumsum([0, *(starts[k].shape[1] for k in alike)])
        every: dict[tuple, tuple[int, Term, np.ndarray]] = {}
        for k, begin, end in zip(alike, ends[:-1], ends[1:], strict=True):
            for (i, term), values in zip(systems[k].terms, systems[k].theta, strict=True):
                every.setdefault((i, term.text, term.states), (i, term, np.zeros(ends[-1])))[2][begin:end] += values
        first = np.concatenate([starts[k] for k in alike], axis=1)
        together = _together(simulation, list(every.values()), first, (times, inputs, limit), states)
        paths |= dict(zip(alike, np.split(together, ends[1:-1], axis=1), strict=True))
    return [paths[k] for k in range(len(systems))]


def _together(
    simulation: Simulation, added: Sequence[tuple[int, Term, np.ndarray]], starts: np.ndarray,
    when: tuple[np.ndarray, np.ndarray, np.ndarray], hidden: Sequence[HiddenState],
) -> np.ndarray:  # fmt: skip
    """Return paths of all draws; a term adds nothing where its coefficient is zero."""
    names, d, (times, inputs, limit) = simulation.states, starts.shape[-1], when
    rates = [parse_expression(state.rate) for state in hidden]

    def rate(x: np.ndarray, u: np.ndarray, t: float) -> np.ndarray:
        u = np.broadcast_to(u, (*x.shape[:2], u.shape[-1]))
        columns = {name: x[..., i] for i, name in enumerate((*names, *(state.name for state in hidden)))}
        columns |= {name: u[..., i] for i, name in enumerate(simulation.inputs)}
        slopes = np.zeros_like(x)
        slopes[..., :d] = simulation.rates(np.full(x.shape[:2], t), x[..., :d], u)
        for i, term, value in added:
            slopes[..., i] += np.where(value != 0, value * term.evaluate(columns), 0.0)
        for j, expression in enumerate(rates, d):
            slopes[..., j] = evaluate(expression, columns)
        return slopes

    begin = [starts[..., names.index(s.start)] if s.start in names else 0 * starts[..., 0] for s in hidden]
    every = np.concatenate([starts, *(each[..., None] for each in begin)], axis=-1)
    return side_by_side(rate, every, times, inputs, np.append(limit, np.full(len(hidden), np.inf)))[..., :d]
