"""Finer values of nonlinear parameters where the posterior needs them, at the noise point of a hypothesis."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from bayes_greybox.discovery.grid.latent_force import LatentForce
from bayes_greybox.discovery.grid.log_evidence import Gram, discrepancy_basis, gram, log_evidences
from bayes_greybox.discovery.grid.points import LAW, MEMORY, NoisePoint
from bayes_greybox.discovery.grid.table import EFFECT, FREE, RegressorTable
from bayes_greybox.discovery.grid.weigh import Hypothesis, Weighed
from bayes_greybox.discovery.regressors.columns import (
    Cloud,
    Values,
    at_values,
    first_values,
    limits,
    log_weights,
    weights_of,
)
from bayes_greybox.discovery.regressors.regressors import Regressors
from bayes_greybox.running.threads import in_threads

from .near import MATTERS

LARGEST_SHARE = 0.2
"""Posterior probability of the likeliest value below which values are near enough for intervals to be smooth."""

MOST_ZOOMS, ZOOM_VALUES = 5, 9
"""Most refinements of the grid of one parameter around its best value, and new values each time."""

MOST_CLOUDS, ENOUGH_VALUES = 16, 12.0
"""Most clouds of values of several parameters, each at the mode after the one before and no narrower than half of it,
and effective number of values, 1/Σp², from which on intervals are smooth."""

CARRIED_SHARE, LEAST_KEPT, KEPT_NATS = 0.99, 8, 12.0
"""Share of the posterior that the kept values carry: without the rest the evidence loses 0.01 nats. At least so many
are kept within the nats behind the best, for rows that will move."""


class Ground(NamedTuple):
    """Table and noise points on which values are refined; the first point is white noise alone."""

    table: RegressorTable
    forces: Sequence[LatentForce]
    points: Sequence[NoisePoint]
    floor: float

    @classmethod
    def of(cls, weighed: Weighed) -> "Ground":
        """Return the table and the points of weighed hypotheses."""
        return cls(weighed.table, weighed.forces, weighed.grid.points, weighed.floor)

    def whiten(self, number: int, table: np.ndarray) -> np.ndarray:
        """Return a table whitened under one noise point."""
        point = self.points[number]
        white, _ = self.forces[point.shape].whiten_at(point, table)
        if point.kind in (LAW, MEMORY):
            return discrepancy_basis(self.table, point).whiten(white, point.ratio)
        return white


Company = tuple[str, tuple[str, ...]]
"""An effect, and the names beside it."""


def refined(
    regressors: Regressors,
    ground: Ground,
    hypotheses: Sequence[Hypothesis] = (),
    before: frozenset[Company] = frozenset(),
) -> tuple[dict[str, Values], frozenset[Company]]:
    """Return finer values of the effects that need them, by their labels, and the companies they were refined in.

    The likeliest value depends on the regressors beside an effect: it is refined alone first, then beside the
    likeliest.
    """
    searched: dict[str, list[_Context]] = {}
    companies = set(before)
    for label in dict.fromkeys(c.effect.label for c in regressors.columns if c.effect is not None and c.inner):
        contexts = _contexts(regressors, label, hypotheses)
        # Values are searched for in all of them anew: those of one context may carry nothing in another.
        if any((label, names) not in before for names in contexts):
            searched[label] = list(contexts.values())
            companies |= {(label, names) for names in contexts}
    rival = -np.inf
    if searched and not hypotheses:
        # The likeliest regressor beside the user's terms alone, at the first noise point.
        table, free = ground.table, ground.table.of_kind(FREE)
        singles = [(*free, i) for i in range(len(table.regressors)) if i not in free]
        precision = np.array([each.sd**-2.0 for each in table.regressors])
        products = replace(gram(table, ground.points[:1], ground.forces), log_det=np.zeros(1))
        rival = float(np.max(log_evidences(products, precision, singles, ground.floor), initial=-np.inf))
    found = in_threads(lambda label: _Search(regressors, ground, label, rival).values(searched[label]), searched)
    finer = {label: values for label, values in zip(searched, found, strict=True) if values is not None}
    return finer, frozenset(companies)


class _Context(NamedTuple):
    """Regressors beside an effect, at a noise point."""

    others: tuple[int, ...]
    point: int


def _contexts(regressors: Regressors, label: str, hypotheses: Sequence[Hypothesis]) -> dict[tuple[str, ...], _Context]:
    """Return the likeliest contexts of an effect by the names in them, none that is unlikely."""
    free, group = tuple(regressors.of_kind(FREE)), set(regressors.group(label))
    if not hypotheses:
        freed = [i for i, column in enumerate(regressors.columns) if column.called in regressors.freed]
        return {(): _Context((*free, *freed), 0)}
    contexts: dict[tuple[str, ...], _Context] = {}
    probability: dict[tuple[str, ...], float] = {}
    for hypothesis in hypotheses:
        if not group.intersection(hypothesis.members):
            continue
        others = tuple(i for i in hypothesis.members if i not in group)
        names = tuple(sorted(regressors.columns[i].called for i in others if i not in free))
        # The likeliest comes first.
        contexts.setdefault(names, _Context(others, hypothesis.point))
        probability[names] = probability.get(names, 0.0) + hypothesis.probability
    likely = sorted(contexts, key=lambda names: -probability[names])[:3]
    return {names: contexts[names] for names in likely if probability[names] > MATTERS}


class _Search:
    """Search for values of one effect's parameters, each time from the first ones, which stand for the whole prior.

    Values that were refined before stand for the posterior then: they say where to look now.
    """

    def __init__(self, regressors: Regressors, ground: Ground, label: str, rival: float) -> None:
        self.regressors, self.ground, self._rival = regressors, ground, rival
        group = [regressors.columns[i] for i in regressors.group(label)]
        shape = group[0].effect
        assert shape is not None
        self._shape, self._about = shape, {"nominal": group[0].nominal, "direction": group[0].direction}
        self._least, self._most = limits(shape, regressors.rows.columns, regressors.path)
        self.tabled = np.array([list(column.inner.values()) for column in group])
        self.first = first_values(shape, regressors.rows.columns, regressors.path)
        self._columns: dict[tuple[float, ...], tuple[np.ndarray, float] | None] = {}
        self._bases: dict[_Context, np.ndarray] = {}

    def values(self, contexts: Sequence[_Context]) -> Values | None:
        """Return finer values; None if those that there are stay, or a parameter is a share of nothing."""
        if self.first is None:
            return None
        first = self.first.points
        there = [context for context in contexts if np.any(np.isfinite(self._log_evidence(context, first)))]
        values, weights = (self._zoomed if self.tabled.shape[1] == 1 else self._drawn)(there, first)
        stay = np.zeros(len(values), bool)
        for context in there:
            stay |= carrying(self._log_evidence(context, values) + weights)
        if not there or np.array_equal(values[stay], self.tabled):
            return None
        return Values(values[stay], weights[stay])

    def _zoomed(self, contexts: Sequence[_Context], first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return values of one parameter, finer around the best ones, with their prior weights."""
        low, high = float(self._least[0]), float(self._most[0])
        best = [int(np.argmax(self._log_evidence(context, self.tabled))) for context in contexts]
        values = np.union1d(first[:, 0], np.clip(self.tabled[best, 0], low, high))
        for context in contexts:
            logs = self._log_evidence(context, values[:, None])
            for _ in range(MOST_ZOOMS):
                posterior = _shares(logs + log_weights(values, low, high))
                if not np.max(posterior) >= LARGEST_SHARE:
                    break
                at = int(np.argmax(posterior))
                # The cells of the first and the last value reach to the ends of the prior.
                left = values[at - 1] if at else low
                right = values[at + 1] if at + 1 < len(values) else high
                fresh = np.setdiff1d(np.geomspace(left, right, ZOOM_VALUES + 2)[1:-1], values)
                if not len(fresh):
                    break
                logs = np.concatenate([logs, self._log_evidence(context, fresh[:, None])])
                values = np.concatenate([values, fresh])
                order = np.argsort(values)
                values, logs = values[order], logs[order]
        return values[:, None], log_weights(values, low, high)

    def _drawn(self, contexts: Sequence[_Context], first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return values of several parameters, more of them drawn at the posterior mode, with their prior weights."""
        shares, known = self._shares_of_range(first), self._shares_of_range(self.tabled)
        unit, n_each = np.eye(shares.shape[1]), len(first) ** (1 / shares.shape[1])
        values, drawn = first, [None] * len(shares)
        for context in contexts:
            logs, tabled, cloud = self._log_evidence(context, values), self._log_evidence(context, self.tabled), None
            inside = logs
            for _ in range(MOST_CLOUDS):
                posterior = _shares(logs + weights_of(shares, drawn))
                behind = np.max(tabled) > np.max(logs)
                if not 1 / np.sum(posterior**2) <= ENOUGH_VALUES and not behind:
                    break
                # At a peak the best of a cloud is nearer to its top than to the cloud's middle.
                if cloud is not None and 2 * np.max(logs) - np.median(inside) < self._rival - KEPT_NATS:
                    break
                # Values that were refined before are in no cloud yet: one around them comes first.
                centre = known[int(np.argmax(tabled))] if behind else shares[int(np.argmax(posterior))]
                if cloud is None and behind:
                    # They may lie on a line, or be one: the cloud is at least a thousandth of the range wide.
                    away = known - centre
                    covariance = 1.5**2 * (away.T * _shares(tabled)) @ away + 1e-3**2 * unit
                elif cloud is None:
                    # Between neighbours of the first grid, which has as many values of each parameter.
                    covariance = (0.5 / n_each) ** 2 * unit
                else:
                    # Half of the cloud before at least: few values say little of a covariance.
                    away = shares - posterior @ shares
                    covariance = 0.25 * cloud.covariance + (0 if behind else 1.5**2 * (away.T * posterior) @ away)
                cloud = Cloud.around(centre, covariance)
                if not len(cloud.points):
                    break
                fresh = self._least * (self._most / self._least) ** cloud.points
                shares, values = np.vstack([shares, cloud.points]), np.vstack([values, fresh])
                drawn = drawn + [cloud] * len(cloud.points)
                inside = self._log_evidence(context, fresh)
                logs = np.concatenate([logs, inside])
        return values, weights_of(shares, drawn)

    def _shares_of_range(self, values: np.ndarray) -> np.ndarray:
        return np.clip(np.log(values / self._least) / np.log(self._most / self._least), 0.0, 1.0)

    def _log_evidence(self, context: _Context, values: np.ndarray) -> np.ndarray:
        """Return the log evidence of a context with the effect at each of some values; −∞ where it has no column."""
        logs, ground, first = np.full(len(values), -np.inf), self.ground, len(context.others)
        columns = self._evaluated(values)
        there = [k for k, column in enumerate(columns) if column is not None]
        if not there:
            return logs
        values_at_rows, sd = zip(*(column for column in columns if column is not None), strict=True)
        white = ground.whiten(context.point, np.column_stack(values_at_rows))
        Z = np.hstack([self._base(context), white])
        products = Gram((ground.points[context.point],), (Z.T @ Z)[None], np.zeros(1), float(len(Z)))
        size = ground.table.force.effect_size
        spread = np.array([*(ground.table.regressors[i].sd for i in context.others), *(size * np.array(sd))])
        sets = [(*range(first), first + j) for j in range(len(there))]
        logs[there] = log_evidences(products, spread**-2.0, sets, ground.floor)[:, 0]
        return logs

    def _base(self, context: _Context) -> np.ndarray:
        if context not in self._bases:
            table = self.ground.table
            rows = np.column_stack([table.target, table.columns[:, list(context.others)]])
            self._bases[context] = self.ground.whiten(context.point, rows)
        return self._bases[context]

    def _evaluated(self, values: np.ndarray) -> list[tuple[np.ndarray, float] | None]:
        """Return the effect at the rows and its prior standard deviation, None where it cannot serve."""
        keys = [tuple(map(float, value)) for value in values]
        fresh = [key for key in dict.fromkeys(keys) if key not in self._columns]
        if fresh:
            own = self.regressors
            more = Regressors(
                own.variables, own.centre, own.half_width, own.basis, path=own.path, rows=own.rows, held=own.held,
                kept=own.kept,
            )  # fmt: skip
            more.add(EFFECT, at_values(self._shape, Values(np.array(fresh), np.zeros(len(fresh))), **self._about))
            self._columns |= dict.fromkeys(fresh)
            self._columns |= {tuple(c.inner.values()): (more.values[:, k], c.sd) for k, c in enumerate(more.columns)}
        return [self._columns[key] for key in keys]


def _shares(logs: np.ndarray) -> np.ndarray:
    return np.exp(logs - np.logaddexp.reduce(logs))


def carrying(logs: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Return true for the values that carry the posterior."""
    order = np.argsort(-logs, kind="stable")
    needed = int(np.searchsorted(np.cumsum(_shares(logs)[order]), CARRIED_SHARE)) + 1
    stay = np.zeros(len(logs), bool)
    stay[order[: max(needed, LEAST_KEPT)]] = True
    return stay & (logs > np.max(logs) - KEPT_NATS)
