"""Paths of candidates under draws of the explanations' coefficients, side by side, and the steps that they need."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from bayes_greybox.physics.formula.expressions import evaluate, parse_expression
from bayes_greybox.physics.hidden_states import HiddenState
from bayes_greybox.physics.side_by_side import side_by_side, stage_times
from bayes_greybox.physics.terms import Term

from .candidates import Candidate
from .explained import Component
from .nameless import Features
from .question import Question

LOST = 1e3
"""A run has failed once a state is larger than so many times its largest value in the data."""

SAME_PATH = 1e-2
"""Paths by twice as many steps may differ by this share of a state's range: outcomes and what is said of them share it.

A step of an input lies between two steps of the integrator, which makes the error one of first order.
"""

MOST_STEPS = 64
"""Steps between two samples, at most."""

Part = tuple[Component, np.ndarray]
"""A component with draws of its coefficients [n_draw, n_term]."""


def follow(
    asked: Question,
    parts: Sequence[Part],
    starts: Float[np.ndarray, "n_candidate n_draw d"],
    times: Float[np.ndarray, " n"],
    inputs: Float[np.ndarray, "n_candidate n_stage p"],
) -> Float[np.ndarray, "n_candidate n_draw n d"]:
    """States under draws of several components' coefficients, the draws one component after another.

    Args:
        asked: What is asked.
        parts: The components with their draws.
        starts: Of each candidate and draw.
        times: Of the samples.
        inputs: At the `stage_times`.
    """
    found = np.full((*starts.shape[:2], len(times), starts.shape[2]), np.nan)
    ends = np.cumsum([len(theta) for _, theta in parts])
    places = [np.arange(end - len(theta), end) for end, (_, theta) in zip(ends, parts, strict=True)]
    # A step costs as much for one run as for hundreds. What has states of its own goes alone.
    alone = [i for i, (component, _) in enumerate(parts) if any(term.states for term in component.terms)]
    for group in ([i for i in range(len(parts)) if i not in alone], *([i] for i in alone)):
        if group:
            own = np.concatenate([places[i] for i in group])
            found[:, own] = _at_once(asked, [parts[i] for i in group], starts[:, own], times, inputs)
    return found


def inputs_at(
    asked: Question, candidates: Sequence[Candidate], times: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n_candidate n p"]:
    """Inputs of candidates at times."""
    found = np.zeros((len(candidates), len(times), len(asked.simulation.inputs)))
    for i, candidate in enumerate(candidates):
        for j, name in enumerate(asked.simulation.inputs):
            found[i, :, j] = candidate.inputs[name].value(times)
    return found


def steps_needed(
    asked: Question, candidates: Sequence[Candidate]
) -> tuple[Int[np.ndarray, " n_candidate"], Bool[np.ndarray, " n_candidate"]]:
    """Steps between samples that follow the means of all explanations, and whether they do, by candidate."""
    first = [int(np.flatnonzero(asked.of == m)[0]) for m in range(len(asked.explanations))]
    range_ = np.array([np.ptp(asked.data.states[name]) or 1.0 for name in asked.simulation.states])
    needed, resolved = np.zeros(len(candidates), int), np.zeros(len(candidates), bool)
    open_, steps, before = np.arange(len(candidates)), 2, None
    while len(open_):
        own = [candidates[i] for i in open_.tolist()]
        begin, times = starts_of(asked, own), own[0].times
        inputs = inputs_at(asked, own, stage_times(times, steps))
        means = [(asked.components[c], asked.components[c].mean[None]) for c in first]
        now = follow(asked, means, np.repeat(begin[:, None], len(means), axis=1), times, inputs)
        ended = np.zeros(len(own), bool)
        if before is not None:
            with np.errstate(all="ignore"):
                close = np.abs(now - before) / range_ <= SAME_PATH
            last = steps >= MOST_STEPS
            # Long steps alone may make a run fail: that it does is believed of the shortest.
            close |= last & np.isnan(now) & np.isnan(before)
            same = np.all(close, axis=(1, 2, 3))
            ended = same | last
            needed[open_], resolved[open_] = np.where(same & (not last), steps // 2, steps), same
        before, open_, steps = now[~ended], open_[~ended], 2 * steps
    return needed, resolved


def starts_of(asked: Question, candidates: Sequence[Candidate]) -> Float[np.ndarray, "n_candidate d"]:
    """States at the start of candidates."""
    return np.array([[c.start[name] for name in asked.simulation.states] for c in candidates], float)


def _at_once(
    asked: Question, parts: Sequence[Part], starts: np.ndarray, times: np.ndarray, inputs: np.ndarray
) -> np.ndarray:
    """States under draws of components that have the same hidden states, if any."""
    simulation, d = asked.simulation, starts.shape[-1]
    hidden: dict[str, HiddenState] = {s.name: s for component, _ in parts for t in component.terms for s in t.states}
    rates = [(parse_expression(s.rate), d + j) for j, s in enumerate(hidden.values())]
    sums, rests = _sums(asked, parts), _rests(asked, parts)
    names = (*simulation.states, *hidden)

    def rate(x: np.ndarray, u: np.ndarray, t: float) -> np.ndarray:
        u = np.broadcast_to(u, (*x.shape[:2], u.shape[-1]))
        found = np.zeros_like(x)
        found[..., :d] = simulation.rates(np.full(x.shape[:2], t), x[..., :d], u)
        columns: dict[str, Any] = {name: x[..., i] for i, name in enumerate(names)}
        columns |= {name: u[..., i] for i, name in enumerate(simulation.inputs)}
        for term, place, draws, value in sums:
            found[:, draws, place] += value * term.evaluate({name: columns[name][:, draws] for name in term.symbols})
        for features, place, draws, weights in rests:
            own = {name: columns[name][:, draws] for name in features.variables}
            found[:, draws, place] += features.summed(own, weights)
        for expression, place in rates:
            found[..., place] = evaluate(expression, columns)
        return found

    known = dict(zip(simulation.states, np.moveaxis(starts, -1, 0), strict=True))
    rest = [known[s.start] if s.start in known else np.zeros(starts.shape[:2]) for s in hidden.values()]
    limit = LOST * np.array([np.max(np.abs(asked.data.states[name])) or 1.0 for name in simulation.states])
    begin = np.concatenate([starts, *(each[..., None] for each in rest)], axis=-1)
    limits = np.concatenate([limit, np.full(len(hidden), np.inf)])
    return side_by_side(rate, begin, times, inputs, limits)[..., :d]


def _sums(asked: Question, parts: Sequence[Part]) -> list[tuple[Term, int, Any, np.ndarray]]:
    """Each term once: the state whose rate it is in, the draws that have it, and their coefficients."""
    found: dict[tuple[int, str], tuple[Term, list[np.ndarray], list[np.ndarray]]] = {}
    before = 0
    for component, theta in parts:
        draws = np.arange(before, before + len(theta))
        before += len(theta)
        of_terms = theta.T[: len(component.terms)]
        for term, equation, values in zip(component.terms, component.equations, of_terms, strict=True):
            place = asked.simulation.states.index(equation)
            # An integrator cannot stay on a jump.
            entry = found.setdefault((place, str(term.expression)), (term.rounded(asked.data.columns), [], []))
            if entry[1] and entry[1][-1] is draws:
                entry[2][-1] = entry[2][-1] + values
                continue
            entry[1].append(draws)
            entry[2].append(values)
    sums = []
    for (place, _), (term, draws, values) in found.items():
        own = np.concatenate(draws)
        whole = len(own) > 0 and own[-1] - own[0] + 1 == len(own)
        sums.append((term, place, slice(own[0], own[-1] + 1) if whole else own, np.concatenate(values)))
    return sums


def _rests(asked: Question, parts: Sequence[Part]) -> list[tuple[Features, int, slice, np.ndarray]]:
    """Features of discrepancies: the state whose rate they are in, the draws that have them, and their weights."""
    found, before = [], 0
    for component, theta in parts:
        draws = slice(before, before + len(theta))
        before = draws.stop
        # A component that is unlikely may have no draw.
        for equation, features in component.features.items() if len(theta) else ():
            weights = features.spread_out(theta[:, component.places(equation)[1]])
            found.append((features, asked.simulation.states.index(equation), draws, weights))
    return found
