"""The search for a hypothesis that leaves nothing, each along a path of its own.

A path that an unknown force moves follows the noise of its samples, and so do regressors along it: a law or a memory of
the states fits that noise, as no effect of an input can, and its evidence is too large. The smoother finds no force
along the path of a hypothesis that leaves nothing. So hypotheses are weighed on rows near themselves, the simplest
first.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bayes_greybox.discovery.grid.sets import Reach, Window
from bayes_greybox.discovery.odds import Odds
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.threads import in_threads

from .near import Near, Point
from .refine import Ground, refined
from .source import Source
from .visits import MOST_OUTER_ITERATIONS, SMALL_TABLE, Visit, weighed_on

LIKELIER = 1.0
"""Nats of log evidence that make a difference to a search: six coefficients that move by 0.6 standard deviations do so.
It ends searches, and decides no name."""

NO_EFFECT = ""
"""Label of the hypothesis with corrections alone, among those of effects."""


def standing_visit(near: Near, source: Source, odds: Odds, reach: Reach, seed: int) -> Visit | None:
    """Return rows near a hypothesis without discrepancy, if the likeliest on them has none either.

    The likeliest that leaves nothing on the first rows is taken if on rows near itself it is the likeliest, leaves
    nothing, and has lost less than a nat: else the first path flattered it. Then every effect is weighed by
    itself, those with memory, whose paths take longest, only if no other stands. If something remains along the best of
    these paths, the likeliest hypotheses there are followed, each on rows near the one before. A wrong one leaves
    something along its path, and a discrepancy is likelier: then no rows are returned.
    """
    complete = near.likeliest.complete
    nothing = complete and near.likeliest.members == near.weighed.before.members
    if nothing or not near.rows.model.rows.follows_path:
        return None
    search = _Standing(source, odds, reach, seed, Window(frozenset(), near.weighed.prior, (), complete=True))
    leaving_nothing = near if complete else replace(near, weighed=near.weighed.without_discrepancy(reach, seed))
    # A large table is weighed whole at the end anyway: on the way there what is likely is enough.
    large = near.weighed.table.columns.size > SMALL_TABLE
    likely = near.window._replace(called=near.window.called | leaving_nothing.window.called) if large else None
    if (visit := search.step(leaving_nothing, likely)) is not None:
        here = Visit(leaving_nothing, visit.hypothesis)
        if _stands(visit) and visit.log_weight > here.log_weight - LIKELIER:
            return visit
    effects = {c.effect.label: c.effect for c in near.regressors.columns if c.effect is not None}
    plain = [label for label, effect in effects.items() if not effect.effect.hidden]
    visits: list[Visit] = []
    best: Visit | None = None
    for labels in ([NO_EFFECT, *plain], [label for label in effects if label not in plain]):
        rival = max((visit.log_weight for visit in visits), default=-np.inf)
        alone = in_threads(partial(search.by_itself, near.rows.point, rival=rival), labels)
        visits += [visit for visit in alone if visit is not None]
        first = max(visits, key=lambda each: each.log_weight, default=None)
        if first is None or best is not None and first.hypothesis == best.hypothesis:
            continue
        best = search.whole(first)
        if best is not None and _stands(best):
            return best
    return search.followed(near if best is None else best.near)


def _stands(visit: Visit) -> bool:
    """Return true if the hypothesis that rows are near is the likeliest on them, and leaves nothing."""
    likeliest = visit.near.likeliest
    return likeliest.complete and visit.near.names(likeliest) == visit.hypothesis


@dataclass(frozen=True)
class _Standing:
    source: Source
    odds: Odds
    reach: Reach
    seed: int
    window: Window

    def weighed(self, point: Point) -> Near:
        """Return all hypotheses on rows near a point."""
        return weighed_on(self.source.near(point), self.odds, self.reach, self.seed)

    def by_itself(self, point: Point, label: str, rival: float) -> Visit | None:
        """Return rows near the likeliest hypothesis with one effect, and no discrepancy.

        It is None if the effect is in no likely hypothesis, and if no path follows the samples. Steps end early where
        one more that gains as much as the last, which steps to a mode do not, would stay behind a rival's log weight.
        """
        called = frozenset({label, *(error.key for error in point.sensors)})
        try:
            near = self.weighed(replace(point, window=self.window._replace(called=called)))
        except (InputError, np.linalg.LinAlgError):
            return None
        visit: Visit | None = None
        for _ in range(MOST_OUTER_ITERATIONS):
            has = label in (NO_EFFECT, *near.names(near.likeliest))
            following = self.step(near, near.rows.point.window) if has else None
            if following is None:
                return None
            before, visit, near = visit, following, following.near
            gain = np.inf if before is None else visit.log_weight - before.log_weight
            if abs(gain) < LIKELIER or visit.log_weight + gain < rival - self.reach.window:
                break
        return visit

    def whole(self, visit: Visit) -> Visit | None:
        """Return the same rows with all hypotheses on them."""
        try:
            return visit._replace(near=self.weighed(replace(visit.near.rows.point, window=None)))
        except (InputError, np.linalg.LinAlgError):
            return None

    def step(self, near: Near, window: Window | None) -> Visit | None:
        """Return rows near the likeliest hypothesis; None if no path of it follows the samples."""
        try:
            there = self.weighed(replace(_following(near), window=window))
            return Visit(there, near.names(near.likeliest), near)
        except (InputError, np.linalg.LinAlgError):
            return None

    def followed(self, near: Near) -> Visit | None:
        """Return rows near one of the likeliest hypotheses without discrepancy, each followed from the one before."""
        names: list[tuple[str, ...]] = []
        for _ in range(MOST_OUTER_ITERATIONS):
            alone = replace(near, weighed=near.weighed.without_discrepancy(self.reach, self.seed))
            names.append(alone.names(alone.likeliest))
            # Two that lead to each other lead nowhere.
            visit = None if names[-1] in names[:-2] else self.step(alone, None)
            if visit is None or _stands(visit):
                return visit
            near = visit.near
        return None


def _following(near: Near) -> Point:
    """Return the point at the likeliest hypothesis, with values of parameters that were refined beside it."""
    finer, _ = refined(near.regressors, Ground.of(near.weighed), near.weighed.hypotheses)
    point = near.point_of(near.likeliest)
    return replace(point, values={**point.values, **finer})
