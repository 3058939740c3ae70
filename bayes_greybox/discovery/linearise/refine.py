"""Finer values of nonlinear parameters where the posterior needs them, at the noise point of a hypothesis."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from bayes_greybox.discovery.grid.latent_force import LatentForce
from bayes_greybox.discovery.grid.log_evidence import Gram, discrepancy_basis, log_evidences
from bayes_greybox.discovery.grid.points import LAW, MEMORY, NoisePoint
from bayes_greybox.discovery.grid.table import EFFECT, FREE, RegressorTable
from bayes_greybox.discovery.grid.weigh import Hypothesis
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

from .near import MATTERS

LARGEST_SHARE = 0.2
"""Posterior probability of the likeliest value below which values are near enough for intervals to be smooth."""

MOST_ZOOMS, ZOOM_VALUES = 5, 9
"""Largest number of times that the grid of one parameter is refined around its best value, and the number of new
values each time."""

MOST_CLOUDS, ENOUGH_VALUES = 16, 12.0
"""Largest number of clouds of values of several parameters, each at the posterior mode after the one before, and
effective number of values, 1/Σp², from which on intervals are smooth. A cloud is no narrower than half of the one
before: sixteen reach a millionth of the range, where a resonance is known to a few parts in ten thousand."""

LEAST_WIDTH = 1e-3
"""Least standard deviation, as a share of the range, of the first cloud around values refined before: they may lie on a
line, or be one."""

MOST_COMPANIONS = 3
"""Number of companions, likeliest first, beside which an effect's values are refined."""

CARRIED_SHARE, LEAST_KEPT, KEPT_NATS = 0.99, 8, 12.0
"""Share of the posterior that the kept values carry: with less, intervals are too narrow, and the evidence is too small
by what is left out. At least so many are kept within the nats behind the best, for rows that will move."""


class Ground(NamedTuple):
    """Table and noise points on which values are refined; the first point is white noise alone."""

    table: RegressorTable
    forces: Sequence[LatentForce]
    points: Sequence[NoisePoint]
    floor: float

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

    The likeliest value depends on the regressors beside an effect: its values are refined alone at first, then beside
    its likeliest companions.
    """
    finer, companies = {}, set(before)
    for label in dict.fromkeys(c.effect.label for c in regressors.columns if c.effect is not None and c.inner):
        contexts = _contexts(regressors, label, hypotheses)
        if not any((label, names) not in before for names in contexts):
            continue
        # Values are searched for in all of them anew: those of one context may carry nothing in another.
        companies |= {(label, names) for names in contexts}
        search = _Search(regressors, ground, label)
        values = (search.zoomed if search.tabled.shape[1] == 1 else search.drawn)(contexts.values())
        if values is not None:
            finer[label] = values
    return finer, frozenset(companies)


class _Context(NamedTuple):
    """Regressors beside an effect, at a noise point."""

    others: tuple[int, ...]
    point: int


def _contexts(regressors: Regressors, label: str, hypotheses: Sequence[Hypothesis]) -> dict[tuple[str, ...], _Context]:
    """Return the likeliest contexts of an effect by the names in them; none where the effect is unlikely."""
    free, group = tuple(regressors.of_kind(FREE)), set(regressors.group(label))
    if not hypotheses:
        return {(): _Context(free, 0)}
    holding = [h for h in hypotheses if group.intersection(h.members)]
    contexts: dict[tuple[str, ...], _Context] = {}
    if sum(h.probability for h in holding) < MATTERS:
        return contexts
    for hypothesis in holding:
        others = tuple(i for i in hypothesis.members if i not in group)
        names = tuple(sorted(regressors.columns[i].called for i in others if i not in free))
        contexts.setdefault(names, _Context(others, hypothesis.point))
        if len(contexts) == MOST_COMPANIONS:
            break
    return contexts


class _Search:
    """Search for values of one effect's parameters; columns are evaluated once, and bases whitened once.

    Every search begins at the first values, which stand for the whole prior. Values that were refined before stand for
    the posterior then: they say where to look now.
    """

    def __init__(self, regressors: Regressors, ground: Ground, label: str) -> None:
        self.regressors, self.ground = regressors, ground
        group = [regressors.columns[i] for i in regressors.group(label)]
        shape = group[0].effect
        assert shape is not None
        self._shape, self._about = shape, {"nominal": group[0].nominal, "direction": group[0].direction}
        self._least, self._most = limits(shape, regressors.rows.columns, regressors.path)
        self.tabled = np.array([list(column.inner.values()) for column in group])
        first = first_values(shape, regressors.rows.columns, regressors.path)
        self._first = self.tabled if first is None else first.points
        self._columns: dict[tuple[float, ...], tuple[np.ndarray, float] | None] = {}
        self._bases: dict[_Context, np.ndarray] = {}

    def zoomed(self, contexts: Iterable[_Context]) -> Values | None:
        """Return the values of one parameter, finer around the best ones; None if they stay."""
        low, high = float(self._least[0]), float(self._most[0])
        values, kept = np.union1d(self._first[:, 0], np.clip(self.tabled[:, 0], low, high)), set()
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
            kept |= set(values[carrying(logs + log_weights(values, low, high))].tolist())
        if np.array_equal(values, np.sort(self.tabled[:, 0])):
            return None
        stay = np.isin(values, list(kept))
        return Values(values[stay][:, None], log_weights(values, low, high)[stay])

    def drawn(self, contexts: Iterable[_Context]) -> Values | None:
        """Return the values of several parameters, more of them drawn at the posterior mode; None if they stay."""
        shares = self._shares_of_range(self._first)
        values, drawn, by_context = self._first, [None] * len(shares), []
        for context in contexts:
            logs, cloud = self._log_evidence(context, values), None
            for _ in range(MOST_CLOUDS):
                posterior = _shares(logs + weights_of(shares, drawn))
                if not 1 / np.sum(posterior**2) <= ENOUGH_VALUES:
                    break
                best = int(np.argmax(posterior))
                if cloud is None:
                    centre, covariance = self._begin(context, shares[best], logs[best])
                else:
                    away = shares - posterior @ shares
                    # Half of the cloud before at least: few values say little of a covariance.
                    centre, covariance = shares[best], 1.5**2 * (away.T * posterior) @ away + 0.25 * cloud.covariance
                cloud = Cloud.around(centre, covariance)
                if not len(cloud.points):
                    break
                fresh = self._least * (self._most / self._least) ** cloud.points
                shares, values = np.vstack([shares, cloud.points]), np.vstack([values, fresh])
                drawn = drawn + [cloud] * len(cloud.points)
                logs = np.concatenate([logs, self._log_evidence(context, fresh)])
            by_context.append(logs)
        if np.array_equal(values, self.tabled):
            return None
        weights, stay = weights_of(shares, drawn), np.zeros(len(values), bool)
        for logs in by_context:
            stay[: len(logs)] |= carrying(logs + weights[: len(logs)])
        return Values(values[stay], weights[stay])

    def _begin(self, context: _Context, best: np.ndarray, log: float) -> tuple[np.ndarray, np.ndarray]:
        """Return centre and covariance of the first cloud: around values refined before, where these are likelier."""
        logs, unit = self._log_evidence(context, self.tabled), np.eye(len(best))
        if not np.max(logs) > log:
            # Between neighbours of the first grid, which has as many values of each parameter.
            return best, (0.5 * len(self._first) ** (-1 / len(best))) ** 2 * unit
        before = self._shares_of_range(self.tabled)
        centre = before[int(np.argmax(logs))]
        away = before - centre
        return centre, 1.5**2 * away.T @ away / len(away) + LEAST_WIDTH**2 * unit

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
        gram = Gram((ground.points[context.point],), (Z.T @ Z)[None], np.zeros(1), float(len(Z)))
        gap = ground.table.force.gap
        spread = np.array([*(ground.table.regressors[i].sd for i in context.others), *(gap * np.array(sd))])
        sets = [(*range(first), first + j) for j in range(len(there))]
        logs[there] = log_evidences(gram, spread**-2.0, sets, ground.floor)[:, 0]
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
            more = Regressors(own.variables, own.centre, own.half_width, own.basis, path=own.path, rows=own.rows)
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
