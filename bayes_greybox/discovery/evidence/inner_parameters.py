"""Refinement of the values of inner parameters of an effect, such as the width of a dead zone."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from bayes_greybox.physics.catalogue.effects import BoundEffect

from .clouds import Cloud, weights_of
from .columns import Column, at_values, limits, log_weights
from .evaluations import Evaluations
from .ties import first_of_best

SPANS = 0.2
"""Posterior probability of the likeliest value below which values are near enough for intervals to be smooth."""

ZOOMS, ZOOM_NODES = 4, 9
"""How often the grid over an inner parameter is refined around its best value, and by how many values."""

CLOUDS, STEPS = 3, 4
"""Clouds around the mode of several inner parameters, and steps towards it, at most."""

EFFECTIVE = 12.0
"""Effective number of values of several inner parameters, 1/Σp², from which on intervals are smooth."""

SHORTER = (1.0, 0.6, 0.35, 0.2, 0.1, 0.04)
"""Shares of a step that are tried: where the mode is far the evidence is no parabola."""

SIDE = 0.01
"""How far aside, in shares of their log ranges, slopes over inner parameters are taken, and how near the ends they
stay."""

FLAT = 12.0
"""Precision of a uniform prior, that of a normal one of the same variance: what bounds a cloud where data do not."""

WIDER = 1.5
"""Width of a cloud over that of the posterior as its slopes have it."""

THERE = 0.1
"""Squared length of a step, in posterior standard deviations, below which the mode is found."""

FAR = 30.0
"""Nats below what matters from which on one value stands for several inner parameters: a cloud around their mode gains
a few more than Laplace's approximation, which the mode alone has."""


def refine(
    evaluations: Evaluations, base: Sequence[int], group: Sequence[int], level: float = -math.inf
) -> tuple[int, ...]:
    """Refine the values of the inner parameters of an effect, or of a law, until their posterior spans several of them.

    Args:
        evaluations: Evidence; new columns are added to its statistics.
        base: Columns beside the effect.
        group: Columns of the effect.
        level: Log evidence of these columns together from which on it matters. Several inner parameters that stay far
            below it at their mode get that value alone.

    Returns:
        All columns of the effect, old and new.
    """
    column = evaluations.statistics.columns[group[0]]
    if not column.inner or column.shape is None:
        return tuple(group)
    if len(column.inner) == 1:
        return _zoomed(evaluations, base, group, column.shape)
    return _drawn(evaluations, base, group, column.shape, level)


def _zoomed(
    evaluations: Evaluations, base: Sequence[int], group: Sequence[int], effect: BoundEffect
) -> tuple[int, ...]:
    """The grid over one inner parameter, finer around its best value."""
    statistics, found = evaluations.statistics, list(group)
    (key,) = statistics.columns[found[0]].inner
    least, most = (float(end[0]) for end in limits(effect, statistics.rows.columns, statistics.path))
    for _ in range(ZOOMS):
        values = np.array([statistics.columns[i].inner[key] for i in found])
        log_z = np.array([v.all for v in evaluations.parametric([(*base, i) for i in found])])
        posterior = np.exp(log_z - np.logaddexp.reduce(log_z))
        # Of one value alone: what the others do on these data, other columns do as well.
        if np.max(posterior) < SPANS or len(values) == 1:
            break
        order = np.argsort(values)
        at = int(np.flatnonzero(order == first_of_best(log_z))[0])
        # The cells of the first and the last value reach to the ends of the prior.
        low = values[order[at - 1]] if at else least
        high = values[order[at + 1]] if at + 1 < len(order) else most
        fresh = np.setdiff1d(np.geomspace(low, high, ZOOM_NODES + 2)[1:-1], values)
        if not len(fresh):
            break
        # New weights for old and new values together: each is the width of its cell under the prior.
        merged = np.sort(np.concatenate([values, fresh]))
        weights = dict(zip(merged.tolist(), log_weights(merged, least, most).tolist(), strict=True))
        for i in found:
            statistics.columns[i] = replace(statistics.columns[i], log_weight=weights[statistics.columns[i].inner[key]])
        known, before = np.array([weights[value] for value in fresh]), len(statistics.columns)
        first = statistics.columns[found[0]]
        statistics.add(first.kind, at_values(effect, fresh[:, None], known, **_carried(first)))
        found += range(before, len(statistics.columns))
    return tuple(found)


def _drawn(
    evaluations: Evaluations, base: Sequence[int], group: Sequence[int], effect: BoundEffect, level: float
) -> tuple[int, ...]:
    """Values of several inner parameters, more of them drawn around their mode."""
    statistics, found = evaluations.statistics, list(group)
    ranges = _Ranges(effect, *limits(effect, statistics.rows.columns, statistics.path))
    first, mean, covariance, near = statistics.columns[found[0]], None, np.eye(len(ranges.names)), True
    for _ in range(CLOUDS):
        log_z = np.array([v.all for v in evaluations.parametric([(*base, i) for i in found])])
        posterior = np.exp(log_z - np.logaddexp.reduce(log_z))
        if 1 / np.sum(posterior**2) > EFFECTIVE or len(found) == 1:
            break
        known = np.array([ranges.shares(statistics.columns[i].inner) for i in found])
        if mean is None:
            alone = log_z - np.array([statistics.columns[i].log_weight for i in found])
            mean, covariance, likely = _mode(evaluations, base, ranges, known[first_of_best(alone)], first)
            near = max(likely, float(np.logaddexp.reduce(log_z))) >= level - FAR
            cloud = Cloud.around(mean, WIDER**2 * covariance) if near else Cloud.at(mean, covariance)
        else:
            # Where the first cloud says that the posterior is.
            mean = posterior @ known
            cloud = Cloud.around(mean, WIDER**2 * covariance)
        if not len(cloud.points):
            break
        at = np.vstack([known, cloud.points])
        drawn = [*(statistics.columns[i].drawn for i in found), *[cloud] * len(cloud.points)]
        weights = weights_of(at, drawn)
        for i, weight in zip(found, weights, strict=False):
            statistics.columns[i] = replace(statistics.columns[i], log_weight=float(weight))
        values, fresh, before = ranges.values(cloud.points), weights[len(found) :], len(statistics.columns)
        statistics.add(first.kind, at_values(effect, values, fresh, drawn=cloud, **_carried(first)))
        found += range(before, len(statistics.columns))
        if not near:
            break
    return tuple(found)


def _carried(column: Column) -> dict[str, Any]:
    """What all columns of an effect have in common."""
    return {name: getattr(column, name) for name in ("effect", "law", "memory", "nominal", "nearer")}


class _Ranges:
    """Inner parameters of an effect by the shares of their log ranges."""

    def __init__(self, effect: BoundEffect, least: np.ndarray, most: np.ndarray) -> None:
        self.effect, self.low, self.width = effect, np.log(least), np.log(most / least)
        self.names = tuple(each.name for each in effect.effect.inner)

    def shares(self, inner: Mapping[str, float]) -> Float[np.ndarray, " d"]:
        """Of values by name."""
        return (np.log([inner[name] for name in self.names]) - self.low) / self.width

    def values(self, shares: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n d"]:
        """Of shares."""
        return np.exp(self.low + self.width * shares)


def _mode(
    evaluations: Evaluations,
    base: Sequence[int],
    ranges: _Ranges,
    start: Float[np.ndarray, " d"],
    first: Column,
) -> tuple[Float[np.ndarray, " d"], Float[np.ndarray, "d d"], float]:
    """Where several inner parameters are likeliest, and their covariance there: by steps of Gauss and Newton.

    Near s the effect is θ (φ(s) + Σ_k δ_k ∂φ/∂s_k): linear in δ, as coefficients are, given θ. The last number is the
    log evidence of all values by Laplace's approximation, log L + ½ log |2πΣ|, which a uniform prior makes no larger
    than L, and the nats that one more step promises: next to none at a mode.
    """
    at, d = np.clip(start, SIDE, 1 - SIDE), len(start)
    # Where nothing can be said of it, it may be likely.
    information, promised, there = np.zeros((d, d)), math.inf, math.inf
    for turn in range(STEPS):
        sides = SIDE * np.where(at > 0.5, -1.0, 1.0)
        found = _slopes(evaluations, base, ranges, np.vstack([at, at + np.diag(sides)]), sides, first)
        if found is None:
            break
        information, pull, there = found
        step = np.linalg.solve(information + FLAT * np.eye(d), pull)
        promised = 0.5 * float(pull @ step)
        if step @ information @ step < THERE or turn == STEPS - 1:
            break
        tried = np.clip(at + np.outer(SHORTER, step), SIDE, 1 - SIDE)
        points = np.vstack([at, tried])
        with _Tried(evaluations, ranges, points, first) as columns:
            if columns is None:
                break
            log_z = [v.all for v in evaluations.parametric([(*base, i) for i in columns])]
        best = first_of_best(log_z)
        if best == 0:
            break
        at, there = points[best], log_z[best]
    covariance = np.linalg.inv(information + FLAT * np.eye(d))
    # Steps that ended early leave something to climb, and a narrow peak may weigh less than all other values.
    volume = 0.5 * float(np.linalg.slogdet(2 * math.pi * covariance)[1])
    return at, covariance, promised + there + min(volume, 0.0)


def _slopes(
    evaluations: Evaluations,
    base: Sequence[int],
    ranges: _Ranges,
    points: np.ndarray,
    sides: np.ndarray,
    first: Column,
) -> tuple[np.ndarray, np.ndarray, float] | None:
    """What the rows tell of steps of the inner parameters, where they pull, and the log evidence of the first point.

    None where the effect is nothing.
    """
    statistics = evaluations.statistics
    with _Tried(evaluations, ranges, points, first) as columns:
        if columns is None:
            return None
        own = [*statistics.of_kind("free"), *base]
        every = [*own, *columns]
        scale = np.array([statistics.columns[i].scale for i in columns])
        G, g = statistics.products[np.ix_(every, every)], statistics.with_target[every]
        square, n = statistics.square, statistics.n_obs
        (first_one,) = evaluations.parametric([(*base, columns[0])])
    # Columns in one unit, then the effect itself and its slopes.
    n_own, size = len(own), scale / scale[0]
    T = np.eye(len(every))
    T[n_own:, n_own:] = np.diag(size)
    turn = np.eye(len(every))
    turn[n_own, n_own + 1 :] = -1 / sides
    turn[n_own + 1 :, n_own + 1 :] = np.diag(1 / sides)
    T = T @ turn
    G, g = T.T @ G @ T, T.T @ g
    alone = slice(0, n_own + 1)
    theta = np.linalg.lstsq(G[alone, alone], g[alone], rcond=1e-10)[0]
    if theta[-1] == 0:
        return None
    variance = max(square - theta @ g[alone], 1e-12 * square) / n
    rest = slice(n_own + 1, len(every))
    taken = np.linalg.lstsq(G[alone, alone], G[alone, rest], rcond=1e-10)[0]
    information = theta[-1] ** 2 * (G[rest, rest] - G[rest, alone] @ taken) / variance
    pull = theta[-1] * (g[rest] - taken.T @ g[alone]) / variance
    return (information + information.T) / 2, pull, first_one.all


class _Tried:
    """Columns of an effect that are there for a moment; None if some of them cannot serve."""

    def __init__(self, evaluations: Evaluations, ranges: _Ranges, points: np.ndarray, first: Column) -> None:
        self._statistics, self._ranges, self._points = evaluations.statistics, ranges, points
        self._first, self._before = first, len(evaluations.statistics.columns)

    def __enter__(self) -> range | None:
        values = self._ranges.values(self._points)
        items = at_values(self._ranges.effect, values, np.zeros(len(values)), **_carried(self._first))
        self._statistics.add(self._first.kind, items)
        columns = range(self._before, len(self._statistics.columns))
        return columns if len(columns) == len(self._points) else None

    def __exit__(self, *_: object) -> None:
        self._statistics.forget(self._before)
