"""What every explanation predicts of candidates: simulated outcomes, and their products with all explanations.

Rows of rates are linear in the coefficients given the path, so that predictions are exact there: outcomes y are drawn
along paths that their own explanation takes, and weighed by p(y | path, explanation), as a study weighs them. Samples
are linear only near the mean of the coefficients: predictions have the path's derivatives there by central differences
over one standard deviation, outcomes the paths themselves.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.physics.side_by_side import stage_times

from .candidates import Candidate
from .explained import Component
from .information import FAR, Products, bounded, marginal_starts
from .paths import follow, inputs_at, starts_of, steps_needed
from .question import Question

AT_ONCE = 2_000_000
"""Numbers in the paths that are simulated side by side, and in what components say of rows, at most: memory."""

UNSEEN_START = 0.05
"""Standard deviation of the start of a state without a sensor, over its range in the data."""


class Outcomes(NamedTuple):
    """Draws of the coefficients behind simulated outcomes, the same for all candidates.

    Attributes:
        component: Of each outcome.
        truth: Explanation of each.
        theta: Coefficients by component [n_own, n_term].
    """

    component: Int[np.ndarray, " n_outcome"]
    truth: Int[np.ndarray, " n_outcome"]
    theta: list[np.ndarray]


@dataclass(frozen=True)
class Predicted:
    """One candidate under all explanations.

    Attributes:
        candidate: The candidate.
        products: Of its outcomes, by component.
        truth: Explanation of each outcome.
        responses: By channel, what the sensor would show without noise [n_outcome, n_row]; NaN after a failure.
        failed: Share of outcomes that failed, by explanation.
        reach: By state and input, how far outcomes go from the middle of the data's range over half of it.
        states: Largest and smallest value of each state [n_outcome, 2].
        resolved: Whether the steps were small enough.
    """

    candidate: Candidate
    products: Sequence[Products]
    truth: Int[np.ndarray, " n_outcome"]
    responses: Mapping[str, Float[np.ndarray, "n_outcome n_row"]]
    failed: Float[np.ndarray, " n_explanation"]
    reach: Mapping[str, Float[np.ndarray, " n_outcome"]]
    states: Mapping[str, Float[np.ndarray, "n_outcome 2"]]
    resolved: bool


def draw_outcomes(asked: Question) -> Outcomes:
    """Draws of every explanation's coefficients, its components by their weights."""
    rng = np.random.default_rng(asked.seed)
    components, of = asked.components, asked.of
    place, theta = [], [np.zeros((0, len(c.mean))) for c in components]
    for m in range(len(asked.explanations)):
        own = np.flatnonzero(of == m)
        cumulative = np.cumsum([components[c].weight for c in own])
        at = np.searchsorted(cumulative, (np.arange(asked.outcomes) + 0.5) / asked.outcomes * cumulative[-1])
        place += own[np.minimum(at, len(own) - 1)].tolist()
    component = np.array(place)
    for c, each in enumerate(components):
        z = rng.standard_normal((int(np.sum(component == c)), len(each.root)))
        theta[c] = each.mean + z @ each.root
    return Outcomes(component, of[component], theta)


def predict(asked: Question, candidates: Sequence[Candidate]) -> list[Predicted]:
    """Predictions of candidates; those that are sampled at the same times are simulated side by side.

    Args:
        asked: What is asked of them.
        candidates: The candidates.
    """
    outcomes = draw_outcomes(asked)
    groups: dict[tuple[float, int], list[int]] = {}
    for i, candidate in enumerate(candidates):
        groups.setdefault((candidate.duration, candidate.rows), []).append(i)
    found: dict[int, Predicted] = {}
    for (_, rows), places in groups.items():
        needed, resolved = steps_needed(asked, [candidates[i] for i in places])
        followed = dict(zip(places, resolved.tolist(), strict=True))
        n = max(1, AT_ONCE // (len(outcomes.truth) * rows * len(asked.simulation.states)))
        for steps in np.unique(needed).tolist():
            alike = [i for i, its in zip(places, needed, strict=True) if its == steps]
            for some in (alike[k : k + n] for k in range(0, len(alike), n)):
                own, good = [candidates[i] for i in some], [followed[i] for i in some]
                found |= dict(zip(some, _together(asked, outcomes, own, steps, good, some[0]), strict=True))
    return [found[i] for i in range(len(candidates))]


def _together(
    asked: Question, outcomes: Outcomes, candidates: Sequence[Candidate], steps: int, resolved: Sequence[bool],
    group: int,
) -> list[Predicted]:  # fmt: skip
    times, components = candidates[0].times, asked.components
    begin = starts_of(asked, candidates)
    rng = np.random.default_rng([asked.seed, 1, group])
    spread = np.zeros_like(begin) if asked.rates else np.array([_start_sd(asked, c) for c in candidates])
    inputs = inputs_at(asked, candidates, stage_times(times, steps))
    paths = np.zeros((len(candidates), len(outcomes.truth), len(times), begin.shape[1]))
    slopes: list[list[np.ndarray]] = []
    order, parts, starts = [], [], []
    for c, component in enumerate(components):
        own = np.flatnonzero(outcomes.component == c)
        moved = spread[:, None] * rng.standard_normal((len(candidates), len(own), begin.shape[1]))
        order.append(own)
        parts.append((component, outcomes.theta[c]))
        starts.append(begin[:, None] + moved)
        if not asked.rates:
            slopes.append(_slopes(asked, component, begin, spread, times, inputs))
    paths[:, np.concatenate(order)] = follow(asked, parts, np.concatenate(starts, axis=1), times, inputs)
    found = []
    for i, candidate in enumerate(candidates):
        noise = np.random.default_rng([asked.seed, 2, group, i])
        # What is not finite is a run that failed, which is a result.
        with np.errstate(all="ignore"):
            if asked.rates:
                products, responses = _of_rates(asked, outcomes, candidate, paths[i], noise)
            else:
                products, responses = _of_samples(asked, outcomes, candidate, paths[i], [s[i] for s in slopes], noise)
        found.append(_predicted(asked, outcomes, candidate, products, responses, paths[i], resolved[i]))
    return found


def _of_rates(
    asked: Question, outcomes: Outcomes, candidate: Candidate, paths: np.ndarray, rng: np.random.Generator
) -> tuple[list[Products], dict[str, np.ndarray]]:
    """Outcomes along paths, against what each component says of the rates along the same paths."""
    components, (n_outcome, n_row, _) = asked.components, paths.shape
    found = [_nothing(n_outcome, len(component.root)) for component in components]
    noise = {equation: sd * rng.standard_normal((n_outcome, n_row)) for equation, sd in candidate.sensors.items()}
    responses = {equation: np.zeros((n_outcome, n_row)) for equation in noise}
    # Each row adds to the products of its own: long records go in pieces.
    piece = max(1, AT_ONCE // (n_outcome * sum(1 + len(c.root) for c in components)))
    for rows in (slice(i, i + piece) for i in range(0, n_row, piece)):
        columns, known = _along(asked, candidate, paths[:, rows], candidate.times[rows])
        for equation, sd in candidate.sensors.items():
            means, loads, added = _said_of(components, outcomes, equation, columns)
            responses[equation][:, rows] = added + known[..., asked.simulation.states.index(equation)]
            y = added + noise[equation][:, rows]
            sure = [np.isfinite(m) & np.all(np.abs(a / sd) < FAR, axis=-1) for m, a in zip(means, loads, strict=True)]
            good = np.all(sure, axis=0) & np.isfinite(y)
            for c, (mean, load) in enumerate(zip(means, loads, strict=True)):
                r = np.where(good, bounded((y - mean) / sd), 0.0)
                A = np.where(good[..., None], load / sd, 0.0)
                across = np.einsum("ork,or->ok", A, r)
                found[c] = found[c].beside(Products(np.sum(r**2, axis=1), across, np.swapaxes(A, 1, 2) @ A))
    return found, responses


def _nothing(n_outcome: int, n_latent: int) -> Products:
    """Products of no rows."""
    return Products(np.zeros(n_outcome), np.zeros((n_outcome, n_latent)), np.zeros((n_outcome, n_latent, n_latent)))


def _along(
    asked: Question, candidate: Candidate, paths: np.ndarray, times: np.ndarray
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Columns along paths, and what the simulation says of the rates there."""
    shape = paths.shape[:2]
    u = {name: np.broadcast_to(signal.value(times), shape) for name, signal in candidate.inputs.items()}
    inputs = [u[name] for name in asked.simulation.inputs]
    values = np.stack(inputs, axis=-1) if inputs else np.zeros((*shape, 0))
    columns = dict(zip(asked.simulation.states, np.moveaxis(paths, -1, 0), strict=True)) | u
    return columns, asked.simulation.rates(np.broadcast_to(times, shape), paths, values)


def _said_of(
    components: Sequence[Component], outcomes: Outcomes, equation: str, columns: dict[str, np.ndarray]
) -> tuple[list[np.ndarray], list[np.ndarray], np.ndarray]:
    """Of the rows of an equation, each component's means and loads on its latents, and what each outcome's own adds."""
    shape = next(iter(columns.values())).shape
    means, loads, added = [], [], np.full(shape, np.nan)
    known: dict[tuple[int, ...], tuple[list[int], np.ndarray]] = {}
    for c, component in enumerate(components):
        # Hyperparameters of one f share its features, which are many.
        key = id(component.terms), *map(id, component.features.values())
        if key not in known:
            known = {key: component.columns(equation, columns, shape)}
        own, Phi = known[key]
        means.append(Phi @ component.mean[own])
        loads.append(Phi @ component.root[:, own].T)
        mine = np.flatnonzero(outcomes.component == c)
        added[mine] = np.einsum("ort,ot->or", Phi[mine], outcomes.theta[c][:, own])
    return means, loads, added


def _of_samples(
    asked: Question, outcomes: Outcomes, candidate: Candidate, paths: np.ndarray, slopes: Sequence[np.ndarray],
    rng: np.random.Generator,
) -> tuple[list[Products], dict[str, np.ndarray]]:  # fmt: skip
    """Outcomes against the path of each component's mean, and its derivatives."""
    components, n_outcome = asked.components, len(paths)
    measured = [asked.simulation.states.index(name) for name in candidate.sensors]
    sd = np.array(list(candidate.sensors.values()))
    responses = {name: paths[..., i] for name, i in zip(candidate.sensors, measured, strict=True)}
    y = paths[..., measured] + sd * rng.standard_normal((*paths.shape[:2], len(sd)))
    # A row counts where no path has failed yet: what a failure itself would tell is not promised.
    alive = np.all([np.all(np.isfinite(s[..., measured]), axis=(0, 2)) for s in slopes], axis=0)
    sure = np.all([np.all(np.abs(s[1:][..., measured] / sd) < FAR, axis=(0, 2)) for s in slopes], axis=0)
    good = np.isfinite(y) & (alive & sure)[None, :, None]
    found = []
    for component, slope in zip(components, slopes, strict=True):
        centre, by = slope[0][..., measured], slope[1:][..., measured]
        r = np.where(good, bounded((y - centre) / sd), 0.0).reshape(n_outcome, -1)
        A = np.where(good[:, None], by / sd, 0.0).reshape(n_outcome, len(by), -1)
        parts = np.sum(r**2, axis=1), np.einsum("okr,or->ok", A, r), A @ np.swapaxes(A, 1, 2)
        found.append(Products(*marginal_starts(*parts, len(by) - len(component.root))))
    return found, responses


def _slopes(
    asked: Question, component: Component, begin: np.ndarray, spread: np.ndarray, times: np.ndarray, inputs: np.ndarray
) -> list[np.ndarray]:
    """By candidate, the path of the mean, and its derivatives by latents and by starts, each over one SD."""
    n_latent, n_state = len(component.root), begin.shape[1]
    at = np.vstack([np.zeros((1, n_latent)), np.eye(n_latent), -np.eye(n_latent), np.zeros((2 * n_state, n_latent))])
    moves = np.vstack([np.zeros((1 + 2 * n_latent, n_state)), np.eye(n_state), -np.eye(n_state)])
    theta = component.mean + at @ component.root
    starts = begin[:, None] + moves * spread[:, None]
    paths = follow(asked, [(component, theta)], starts, times, inputs)
    found = []
    for path in paths:
        first = 1 + 2 * n_latent
        by_latent = 0.5 * (path[1 : 1 + n_latent] - path[1 + n_latent : first])
        by_start = 0.5 * (path[first : first + n_state] - path[first + n_state :])
        found.append(np.concatenate([path[:1], by_latent, by_start]))
    return found


def _start_sd(asked: Question, candidate: Candidate) -> list[float]:
    """How well the start of an experiment is known: as its sensor shows it, or as well as such a state can be set."""
    range_ = {name: float(np.ptp(asked.data.states[name])) for name in asked.simulation.states}
    return [candidate.sensors.get(name, UNSEEN_START * size) for name, size in range_.items()]


def _predicted(
    asked: Question, outcomes: Outcomes, candidate: Candidate, products: Sequence[Products],
    responses: dict[str, np.ndarray], paths: np.ndarray, resolved: bool,
) -> Predicted:  # fmt: skip
    lost = ~np.all(np.isfinite(paths), axis=(1, 2))
    failed = np.array([np.mean(lost[outcomes.truth == m]) for m in range(len(asked.explanations))])
    reach, ends = {}, {}
    for i, name in enumerate(asked.simulation.states):
        low, high = np.nanmin(paths[..., i], axis=1), np.nanmax(paths[..., i], axis=1)
        ends[name] = np.stack([low, high], axis=1)
        reach[name] = _reach(asked.data.states[name], low, high)
    for name, signal in candidate.inputs.items():
        u = signal.value(candidate.times)
        reach[name] = np.full(len(paths), _reach(asked.data.inputs[name], np.min(u), np.max(u)))
    return Predicted(candidate, products, outcomes.truth, responses, failed, reach, ends, resolved)


def _reach(measured: np.ndarray, low: Any, high: Any) -> Any:
    middle, half = 0.5 * (np.min(measured) + np.max(measured)), 0.5 * np.ptp(measured)
    far = np.maximum(high - middle, middle - low)
    # What never moved has no range: any motion is beyond it.
    return far / half if half > 0 else np.where(far > 0, np.inf, 0.0)
