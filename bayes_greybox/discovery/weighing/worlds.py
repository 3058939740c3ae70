"""Explanations under every noise that the residuals speak for: one world for each noise, weighed against each other.

    P(explanation | y) ∝ Σ_R P(R) P(explanation) p(y | explanation, R) |R|^-½

The noise of a world was found on the residuals of an explanation (see `model.noise.suspicions`), and its explanations
are then weighed anew. Effects that white noise makes sure of may be nothing under the noise that the data have.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import log
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.noise.protocol import RowNoise
from bayes_greybox.discovery.evidence.evaluations import Evaluations, one_pattern
from bayes_greybox.discovery.evidence.odds import Odds
from bayes_greybox.discovery.evidence.ties import ranked
from bayes_greybox.model.estimate.evidence import coefficients, log_white
from bayes_greybox.model.noise.noise_model import PROCESS, NoiseModel, Suspicion
from bayes_greybox.model.noise.suspicions import suspicions

from .sets import RECALIBRATED, REST, Explanation, Sets

TRIED = -3.0
"""Log odds over the best explanation of all below which a noise is not looked at further."""

DEEPEST = 3
"""Suspects about the noise that a world has at most."""

PRICE = 10.0
"""Nats that parameters of a noise cost at most: one that was found elsewhere, and may not have paid, stays beyond."""

GAINED = 1.0
"""Nats that another suspect must gain before a third is looked for."""


class RestWeights(NamedTuple):
    """f = (ψ − B φ)ᵀ w, orthogonal to the columns φ at the rows; scaled.

    Attributes:
        mean: Of w.
        root: W with WᵀW the covariance of w.
        taken: B.
    """

    mean: Float[np.ndarray, " n_basis"]
    root: Float[np.ndarray, "n_basis n_basis"]
    taken: Float[np.ndarray, "n_column n_basis"]


@dataclass(frozen=True, eq=False)
class World:
    """Explanations under one noise.

    Attributes:
        model: The noise.
        evaluations: Evidence under it.
        explanations: Likeliest first.
        offset: What the noise adds to every log weight: its prior, its constant and −½ log|R|.
    """

    model: NoiseModel
    evaluations: Evaluations
    explanations: tuple[Explanation, ...]
    offset: float

    @cached_property
    def total(self) -> float:
        """Log evidence of the world, prior included."""
        return float(np.logaddexp.reduce([e.log_weight for e in self.explanations])) + self.offset

    @cached_property
    def always(self) -> frozenset[int]:
        """Suspects that are in every explanation."""
        return frozenset.intersection(*(frozenset(e.suspects) for e in self.explanations))

    @property
    def best(self) -> Explanation:
        """The likeliest explanation."""
        return self.explanations[0]

    @property
    def bare(self) -> Explanation:
        """The likeliest explanation with neither effects nor a rest."""
        return next(e for e in self.explanations if not e.effects and not e.leaves_rest)

    def leaves_rest(self, e: Explanation) -> bool:
        """Whether something remains beside an explanation's columns: f, a memory, or a process in time."""
        return e.leaves_rest or PROCESS in self.model.names

    def share_left(self, e: Explanation) -> float:
        """Share of the gap that no column of an explanation carries: a rest, or a process in time."""
        rest = e.share_left if e.leaves_rest else 0.0
        if not self.model.process_share:
            return rest
        noise = self.evaluations.statistics.rows.noise
        spread = float(np.mean(noise.without_starts(self.residual(e)[:, None]) ** 2))
        white = spread * (1 - self.model.process_share)
        in_time = np.clip(spread * self.model.process_share / max(self._gap - white, 1e-12), 0.0, 1.0)
        return float(1 - (1 - rest) * (1 - in_time))

    @cached_property
    def _gap(self) -> float:
        """Mean square of the target that neither starts nor free columns could be."""
        statistics = self.evaluations.statistics
        free = statistics.at_rows(statistics.of_kind("free"))
        target = statistics.rows.target / statistics.target_scale
        left = statistics.rows.noise.without_starts(np.column_stack([target, free]))
        own = left[:, 1:] @ np.linalg.lstsq(left[:, 1:], left[:, 0], rcond=1e-12)[0] if free.shape[1] else 0.0
        return float(np.mean((left[:, 0] - own) ** 2))

    def coefficients(self, e: Explanation) -> tuple[np.ndarray, np.ndarray]:
        """Posterior mean and covariance of an explanation's coefficients in its likeliest pattern, scaled.

        Those of a memory beside them are in the fit, and left out here.
        """
        mean, covariance = self._fitted(e)
        n = len(mean) - len(e.memory)
        return mean[:n], covariance[:n, :n]

    def _fitted(self, e: Explanation) -> tuple[np.ndarray, np.ndarray]:
        fitted = self.evaluations.parametric([(*e.columns, *e.memory)])[0]
        if e.kind == RECALIBRATED:
            pattern = 1 + int(np.argmax(fitted.by_pattern[1:]))
        elif e.effects or self.leaves_rest(e):
            pattern = int(np.argmax(fitted.by_pattern))
        else:
            pattern = 0
        return coefficients(*one_pattern(fitted, pattern))

    def sizes(self, e: Explanation) -> dict[int, float]:
        """RMS over the rows of what each column of an explanation contributes, by column, scaled."""
        indices = self.evaluations.indices(e.columns)
        parts = self.evaluations.statistics.at_rows(indices) * self.coefficients(e)[0]
        rms = np.sqrt(np.mean(parts**2, axis=0))
        return {i: float(size) for i, size in zip(indices, rms, strict=True) if i in e.columns}

    def residual(self, e: Explanation) -> Float[np.ndarray, " n_row"]:
        """Target less everything that an explanation explains, a rest's mean included; scaled, not whitened."""
        known, statistics, rows = self.evaluations, self.evaluations.statistics, self.evaluations.statistics.rows
        rest = rows.target / statistics.target_scale
        rest = rest - statistics.at_rows(known.indices((*e.columns, *e.memory))) @ self._fitted(e)[0]
        return rest - self.rest(e) if e.kind == REST else rest

    def rest_weights(self, e: Explanation, eta: Float[np.ndarray, " n_eta"] | None = None) -> RestWeights:
        """Posterior of f beside an explanation's columns, by its features.

        Args:
            e: The explanation.
            eta: Hyperparameters, packed; by default their mode.
        """
        known, statistics = self.evaluations, self.evaluations.statistics
        indices = known.indices(e.columns)
        eta = known.integrated(e.columns).mode if eta is None else eta
        mean, root = known.evaluator.weights(known.with_features(e.columns), eta)
        G = statistics.products[np.ix_(indices, indices)]
        taken = np.linalg.pinv(G, rcond=1e-12, hermitian=True) @ statistics.with_features[indices]
        return RestWeights(mean, root, taken)

    def rest(self, e: Explanation) -> Float[np.ndarray, " n_row"]:
        """Posterior mean of f beside an explanation's columns at the rows, scaled."""
        known, statistics = self.evaluations, self.evaluations.statistics
        weights = self.rest_weights(e)
        own = statistics.at_rows(known.indices(e.columns)) @ (weights.taken @ weights.mean)
        return statistics.explained(weights.mean) - own


def worlds(
    first: Sets,
    quantities: Mapping[str, Float[np.ndarray, " n_row"]],
    report: Callable[[str], None] = lambda text: None,
    known: NoiseModel | None = None,
) -> list[World]:
    """Worlds that matter, likeliest first.

    Args:
        first: Sets under the noise that the rows come with.
        quantities: What the noise may grow with.
        report: Told in words what is being done.
        known: Noise that was found before.
    """
    base = first.statistics.rows.noise
    found = [_world(first, NoiseModel(base), report)]
    for _ in range(2):
        other = _likelier(found[0])
        if other is None:
            break
        found = [_world(under(first, NoiseModel(other)), NoiseModel(other), report)]
    if not base.error.independent:
        # Filtered rows carry a known correlation; what is left of it is judged by the checks.
        return found
    tried: set[tuple[str, ...]] = {()}
    if known is not None and known.names:
        # What was found on another path is weighed with the parameters, and their price, that this one says.
        found.append(_again(_world(under(first, known), known, report), first, quantities, anew=True))
        tried.add(tuple(sorted(known.names)))
    current = ranked(found, lambda w: w.total)[0]
    for _ in range(DEEPEST):
        fresh = []
        for suspicion, score in _suspected(current, base, quantities):
            names = tuple(sorted(suspicion.model.names))
            top = max(w.total for w in found)
            if score + current.total < top + TRIED or (names in tried):
                continue
            tried.add(names)
            report(f"weighing again with {suspicion.name}")
            fresh.append(_refitted(current, suspicion, first, quantities))
        if not fresh:
            break
        found += fresh
        best = ranked(fresh, lambda w: w.total)[0]
        if best.total < current.total + GAINED:
            break
        current = best
    return ranked(found, lambda w: w.total)


def under(sets: Sets, model: NoiseModel, evaluations: Evaluations | None = None) -> Sets:
    """Sets of the columns known so far, by default those of the first sets, under another noise."""
    known = evaluations or sets.evaluations
    again = Evaluations(
        known.statistics.with_noise(model.noise), known.odds, known.evaluator, known.importance_draws, known.seed
    )
    return Sets(again, sets.most, PROCESS in model.names, sets.always)


def log_noise(model: NoiseModel, odds: Odds) -> float:
    """What a noise adds to every log weight under it: its prior, its constant and −½ log|R|.

    Args:
        model: The noise.
        odds: Prior odds.
    """
    suspects = sum(name != PROCESS for name in model.names)
    prior = suspects * log(odds.noise) + (3 - suspects) * float(np.log1p(-odds.noise))
    return prior + model.constant - 0.5 * model.noise.log_det


def _likelier(world: World) -> RowNoise | None:
    """The likeliest alternative of the rows' noise on a world's best residual, if it is likelier than theirs."""
    statistics = world.evaluations.statistics
    noise, residual = statistics.rows.noise, world.residual(world.best)[:, None]
    choices = (noise, *noise.alternatives())
    logs = [
        log_white(float(np.sum(n.whiten(residual) ** 2)), n.n_white, statistics.noise) - 0.5 * n.log_det
        for n in choices
    ]
    best = int(np.argmax(logs))
    return choices[best] if logs[best] > logs[0] + 1.0 else None


def _world(sets: Sets, model: NoiseModel, report: Callable[[str], None] = lambda text: None) -> World:
    return World(model, sets.evaluations, tuple(sets.weigh(report)), log_noise(model, sets.odds))


def _suspected(world: World, base: RowNoise, quantities: Mapping[str, np.ndarray]) -> list[tuple[Suspicion, float]]:
    """Suspects with the log odds that each would have over the world's total, from two explanations' residuals.

    What hangs together in time may be a process or the sensor: beside a process the sensor is weighed in its place.
    """
    statistics, odds = world.evaluations.statistics, world.evaluations.odds
    rows, found, known = statistics.rows, {}, _without_process(world.model, base)
    for e in dict.fromkeys((world.best, world.bare)):
        weight = e.log_weight + world.offset - world.total
        each = suspicions(world.residual(e), known, rows.time, rows.run, quantities, statistics.noise)
        if PROCESS in world.model.names:
            weight -= log(odds.remainder / 2) + sum(s.log_bayes_factor for s in each if s.name == PROCESS)
            each = [s for s in each if s.name != PROCESS]
        for s in each:
            prior = log(odds.remainder / 2) if s.name == PROCESS else log(odds.noise)
            score = weight + prior + s.log_bayes_factor
            if s.name not in found or score > found[s.name][1]:
                found[s.name] = (s, score)
    return ranked(found.values(), lambda item: item[1])


def _refitted(before: World, suspicion: Suspicion, first: Sets, quantities: Mapping[str, np.ndarray]) -> World:
    """The world of a suspect, its parameters found again on the residuals of its own best explanation."""
    world = _world(under(first, suspicion.model, before.evaluations), suspicion.model)
    return _again(world, first, quantities, _without_process(before.model, first.statistics.rows.noise))


def _again(
    world: World, first: Sets, quantities: Mapping[str, np.ndarray], before: NoiseModel | None = None,
    anew: bool = False,
) -> World:  # fmt: skip
    """A world with the parameters of its last suspect found on the residuals of its own best explanation.

    Args:
        world: The world.
        first: Sets under the noise that the rows come with.
        quantities: What the noise may grow with.
        before: Noise without that suspect; by default the noise that the rows come with.
        anew: Whether to find them however near they are: with the price that this path says.
    """
    statistics, name = world.evaluations.statistics, world.model.names[-1]
    rows = statistics.rows
    before = before or NoiseModel(first.statistics.rows.noise)
    if len(world.model.names) > len(before.names) + 1:
        return world
    again = suspicions(world.residual(world.best), before, rows.time, rows.run, quantities, statistics.noise)
    for s in again:
        if s.name == name and (anew or _differ(s.model.about[name], world.model.about[name])):
            other = _world(under(first, s.model, world.evaluations), s.model)
            kept = world.total - (PRICE if anew else 0.0)
            return world if kept > other.total else other
    return world


def _without_process(model: NoiseModel, base: RowNoise) -> NoiseModel:
    return NoiseModel(base) if PROCESS in model.names else model


def _differ(a: Mapping, b: Mapping) -> bool:
    """Whether two modes are apart by more than a grid's step."""
    for key in ("variable", "degrees", "exponent"):
        if a.get(key) != b.get(key):
            return True
    return any(
        abs(a.get(key, 0.0) - b.get(key, 0.0)) > 0.1 * abs(b.get(key, 1.0))
        for key in ("time_scale", "white", "intensity")
    )


def weights(found: Sequence[World]) -> Float[np.ndarray, " n_world"]:
    """Posterior probability of each world."""
    totals = np.array([w.total for w in found])
    return np.exp(totals - np.logaddexp.reduce(totals))
