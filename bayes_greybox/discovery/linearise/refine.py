"""Finer values of nonlinear parameters where the posterior needs them, at the noise point of a hypothesis."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from bayes_greybox.discovery.grid.evidence.gram import Gram, discrepancy_basis
from bayes_greybox.discovery.grid.evidence.log_evidence import log_evidences
from bayes_greybox.discovery.grid.hypotheses.weigh import Hypothesis
from bayes_greybox.discovery.grid.noise.latent_force import LatentForce
from bayes_greybox.discovery.grid.noise.points import LAW, MEMORY, NoisePoint
from bayes_greybox.discovery.grid.table import RegressorTable
from bayes_greybox.discovery.regressors.clouds import Cloud, weights_of
from bayes_greybox.discovery.regressors.columns import Values, at_values, limits, log_weights
from bayes_greybox.discovery.regressors.regressors import EFFECT, FREE, Regressors
from bayes_greybox.physics.catalogue.effects import BoundEffect

from .near import MATTERS

LARGEST_SHARE = 0.2
"""Posterior probability of the likeliest value below which values are near enough for intervals to be smooth."""

ZOOMS, ZOOM_VALUES = 5, 9
"""How often the grid of one parameter is refined around its best value, and by how many values."""

CLOUDS = 5
"""Clouds of values of several parameters, each where the one before says that the posterior is."""

EFFECTIVE = 12.0
"""Effective number of values of several parameters, 1/Σp², from which on intervals are smooth."""

COMPANIES = 3
"""Companions that an effect's values are refined beside, likeliest first."""

KEPT, FAINT = 8, 12.0
"""Values that are kept of each refinement, likeliest first, and the nats behind the best within which they are."""


class Ground(NamedTuple):
    """What values are refined on.

    Attributes:
        table: Target and regressors.
        forces: The rows under each shape of the noise.
        points: Noise points; the first one is white noise alone.
        floor: Least variance of the noise.
    """

    table: RegressorTable
    forces: Sequence[LatentForce]
    points: Sequence[NoisePoint]
    floor: float


Company = tuple[str, tuple[str, ...]]
"""An effect, and what stands beside it."""


def refined(
    regressors: Regressors,
    ground: Ground,
    hypotheses: Sequence[Hypothesis] = (),
    known: frozenset[Company] = frozenset(),
) -> tuple[dict[str, Values], frozenset[Company]]:
    """Return finer values of the effects that need them, by their labels, and the companies that were looked at.

    What is likeliest depends on what stands beside an effect: its values are refined alone at first, then beside the
    likeliest companions that it has.

    Args:
        regressors: Of the equation.
        ground: Their table.
        hypotheses: Of it, likeliest first.
        known: Companies that were looked at before.
    """
    found, looked = {}, set(known)
    labels = dict.fromkeys(c.effect.label for c in regressors.columns if c.effect is not None and c.inner)
    free = tuple(regressors.of_kind(FREE))
    for label in labels:
        group = set(regressors.group(label))
        contexts: dict[tuple[str, ...], _Context] = {} if hypotheses else {(): _Context(free, 0)}
        if sum(h.probability for h in hypotheses if group.intersection(h.members)) < MATTERS and hypotheses:
            continue
        for hypothesis in hypotheses:
            if not group.intersection(hypothesis.members):
                continue
            others = tuple(i for i in hypothesis.members if i not in group)
            names = tuple(sorted(regressors.columns[i].called for i in others if i not in free))
            contexts.setdefault(names, _Context(others, hypothesis.point))
            if len(contexts) == COMPANIES:
                break
        contexts = {names: context for names, context in contexts.items() if (label, names) not in known}
        looked |= {(label, names) for names in contexts}
        search = _Search.of(regressors, ground, label)
        values = search.zoomed(contexts.values()) if search.one else search.drawn(contexts.values())
        if values is not None:
            found[label] = values
    return found, frozenset(looked)


class _Context(NamedTuple):
    """What stands beside an effect, at a noise point."""

    others: tuple[int, ...]
    point: int


@dataclass(frozen=True)
class _Search:
    """Search for values of one effect's parameters.

    Attributes:
        regressors: Of the equation.
        ground: Their table.
        shape: The effect.
        about: What its columns carry beside: the simulation's own coefficient, and the direction of its input.
        least: Least values of its parameters.
        most: Largest ones.
        known: Values that are in the table.
    """

    regressors: Regressors
    ground: Ground
    shape: BoundEffect
    about: Mapping[str, Any]
    least: np.ndarray
    most: np.ndarray
    known: np.ndarray

    @classmethod
    def of(cls, regressors: Regressors, ground: Ground, label: str) -> "_Search":
        """Return the search for values of one effect."""
        group = regressors.group(label)
        column = regressors.columns[group[0]]
        shape = column.effect
        assert shape is not None
        least, most = limits(shape, regressors.rows.columns, regressors.path)
        known = np.array([list(regressors.columns[i].inner.values()) for i in group])
        about = {"nominal": column.nominal, "direction": column.direction}
        return cls(regressors, ground, shape, about, least, most, known)

    @property
    def one(self) -> bool:
        """Return whether the effect has one parameter."""
        return self.known.shape[1] == 1

    def log_evidence(self, context: _Context, columns: "_Columns", values: np.ndarray) -> np.ndarray:
        """Return the log evidence of a context with the effect at each of some values."""
        ground, first = self.ground, len(context.others)
        white, sd, there = columns.at(values, context.point)
        logs = np.full(len(values), -np.inf)
        if not len(there):
            return logs
        Z = np.hstack([columns.base(context), white])
        gram = Gram((ground.points[context.point],), (Z.T @ Z)[None], np.zeros(1), float(len(Z)))
        spread = np.array([*(ground.table.regressors[i].sd for i in context.others), *sd])
        sets = [(*range(first), first + j) for j in range(len(there))]
        logs[there] = log_evidences(gram, spread**-2.0, sets, ground.floor)[:, 0]
        return logs

    def zoomed(self, contexts: Iterable[_Context]) -> Values | None:
        """Return the values of one parameter, finer around the best ones."""
        low, high, columns = float(self.least[0]), float(self.most[0]), _Columns(self)
        values, kept = np.sort(self.known[:, 0]), set(self.known[:, 0].tolist())
        for context in contexts:
            logs = self.log_evidence(context, columns, values[:, None])
            for _ in range(ZOOMS):
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
                more = self.log_evidence(context, columns, fresh[:, None])
                values, logs = np.concatenate([values, fresh]), np.concatenate([logs, more])
                order = np.argsort(values)
                values, logs = values[order], logs[order]
            kept |= set(values[_carry(logs + log_weights(values, low, high))].tolist())
        if len(values) == len(self.known):
            return None
        stay = np.isin(values, list(kept))
        return Values(values[stay][:, None], log_weights(values, low, high)[stay])

    def drawn(self, contexts: Iterable[_Context]) -> Values | None:
        """Return the values of several parameters, more of them drawn where the posterior is."""
        width, columns = np.log(self.most / self.least), _Columns(self)
        shares = np.clip(np.log(self.known / self.least) / width, 0.0, 1.0)
        values, drawn, found = self.known, [None] * len(shares), []
        for context in contexts:
            logs = self.log_evidence(context, columns, values)
            # Between neighbours of the first grid, which has as many values of each parameter.
            covariance = (0.5 * len(self.known) ** (-1 / width.size)) ** 2 * np.eye(width.size)
            for turn in range(CLOUDS):
                posterior = _shares(logs + weights_of(shares, drawn))
                if not 1 / np.sum(posterior**2) <= EFFECTIVE:
                    break
                if turn:
                    away = shares - posterior @ shares
                    # Half of the cloud before at least: few values say little of a covariance.
                    covariance = 1.5**2 * (away.T * posterior) @ away + 0.25 * covariance
                cloud = Cloud.around(shares[int(np.argmax(posterior))], covariance)
                if not len(cloud.points):
                    break
                fresh = np.exp(np.log(self.least) + width * cloud.points)
                shares, values = np.vstack([shares, cloud.points]), np.vstack([values, fresh])
                drawn = drawn + [cloud] * len(cloud.points)
                logs = np.concatenate([logs, self.log_evidence(context, columns, fresh)])
            found.append(logs)
        if len(values) == len(self.known):
            return None
        weights, stay = weights_of(shares, drawn), np.zeros(len(values), bool)
        for logs in found:
            stay[: len(logs)] |= _carry(logs + weights[: len(logs)])
        return Values(values[stay], weights[stay])


class _Columns:
    """Columns of an effect at values, each evaluated once and whitened under each noise point once."""

    def __init__(self, search: _Search) -> None:
        self._search, self._known, self._whiten = search, {}, {}
        self._bases: dict[_Context, np.ndarray] = {}

    def at(self, values: np.ndarray, point: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return whitened columns, their prior standard deviations, and which of the values have one."""
        keys = [tuple(map(float, value)) for value in values]
        self._evaluate([key for key in dict.fromkeys(keys) if key not in self._known])
        there = np.array([k for k, key in enumerate(keys) if self._known[key] is not None], dtype=int)
        if not len(there):
            return np.zeros((0, 0)), np.zeros(0), there
        columns = [self._known[keys[k]] for k in there]
        white = self._at_point(point)(np.column_stack([column for column, _ in columns]))
        gap = self._search.ground.table.force.gap
        return white, np.array([sd for _, sd in columns]) * gap, there

    def base(self, context: _Context) -> np.ndarray:
        """Return the whitened target and what stands beside the effect."""
        if context not in self._bases:
            table = self._search.ground.table
            rows = np.column_stack([table.target, table.columns[:, list(context.others)]])
            self._bases[context] = self._at_point(context.point)(rows)
        return self._bases[context]

    def _at_point(self, point: int) -> "_AtPoint":
        if point not in self._whiten:
            self._whiten[point] = _AtPoint(self._search.ground, point)
        return self._whiten[point]

    def _evaluate(self, keys: list[tuple[float, ...]]) -> None:
        if not keys:
            return
        own, search = self._search.regressors, self._search
        fresh = Regressors(own.rows, own.variables, own.centre, own.half_width, own.basis, path=own.path)
        fresh.add(EFFECT, at_values(search.shape, Values(np.array(keys), np.zeros(len(keys))), **search.about))
        self._known |= dict.fromkeys(keys)
        self._known |= {tuple(c.inner.values()): (fresh.values[:, k], c.sd) for k, c in enumerate(fresh.columns)}


@dataclass(frozen=True)
class _AtPoint:
    """Whitening under one noise point."""

    ground: Ground
    number: int

    def __call__(self, table: Float[np.ndarray, "n_row k"]) -> Float[np.ndarray, "n_white k"]:
        ground, point = self.ground, self.ground.points[self.number]
        white, _ = ground.forces[point.shape].whiten_at(point, table)
        if point.kind not in (LAW, MEMORY):
            return white
        return discrepancy_basis(ground.table, point).whiten(white, point.ratio)


def _shares(logs: np.ndarray) -> np.ndarray:
    return np.exp(logs - np.logaddexp.reduce(logs))


def _carry(logs: np.ndarray) -> np.ndarray:
    """Return which values carry the posterior."""
    stay = np.zeros(len(logs), bool)
    stay[np.argsort(-logs, kind="stable")[:KEPT]] = True
    return stay & (logs > np.max(logs) - FAINT)
