"""The search for a hypothesis that leaves nothing, each along a path of its own.

A path that an unknown force moves follows the noise of its samples, and so do regressors along it: a law or a memory of
the states fits that noise, as no effect of an input can, and its evidence is too large. The smoother finds no force
along the path of a hypothesis that leaves nothing. So hypotheses are weighed on rows near themselves, the simplest
first.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from bayes_greybox.discovery.grid.sets import SetPrior, Window
from bayes_greybox.discovery.ties import ranked
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.threads import in_threads

from .near import Near, Point
from .refine import Ground, refined
from .visits import MOST_OUTER_ITERATIONS, SMALL_TABLE, Visit, Weigher

LIKELIER = 1.0
"""Nats of log evidence below which a search gains nothing; it ends searches, and decides no name."""

FOLLOWED_TOGETHER = 4
"""Number of effects that are followed before the next are compared with them, whatever the cores are."""

NO_EFFECT = ""
"""Label of the hypothesis with corrections alone, among those of effects."""


def standing_visit(near: Near, weigher: Weigher) -> Visit | None:
    """Return rows near a hypothesis without discrepancy, if the likeliest on them has none either.

    The likeliest that leaves nothing is followed from one set of rows to the next. Where none stands, every effect is
    weighed by itself, those with memory, whose paths take longest, only if no other stands; if something remains along
    the best of these paths, the likeliest hypotheses there are followed. A wrong one leaves something along its path.
    """
    complete = near.likeliest.complete
    nothing = complete and near.likeliest.members == near.weighed.before.members
    if nothing or not near.rows.model.rows.follows_path:
        return None
    search = Standing(weigher, near.weighed.prior)
    leaving_nothing = near if complete else search.without_discrepancy(near)
    # A large table is weighed whole at the end anyway: on the way there what is likely is enough.
    large = near.weighed.table.columns.size > SMALL_TABLE
    likely = near.window._replace(called=near.window.called | leaving_nothing.window.called) if large else None
    visit, gains = search.from_one_to_the_next(leaving_nothing, likely)
    if visit is not None:
        return visit
    effects = {c.effect.label: c.effect for c in near.regressors.columns if c.effect is not None}
    plain = [label for label, effect in effects.items() if not effect.effect.hidden]
    alone: list[_Alone] = []
    best: Visit | None = None
    for labels in ([NO_EFFECT, *plain], [label for label in effects if label not in plain]):
        alone += search.each_by_itself(near, labels, alone)
        first = max(alone, key=lambda each: each.visit.log_weight).visit if alone else None
        if first is None or best is not None and first.hypothesis == best.hypothesis:
            continue
        whole = weigher.tried(replace(first.near.rows.point, window=None))
        best = None if whole is None else first._replace(near=whole)
        if best is not None and _stands(best):
            return best
    gains += [each.gain for each in alone]
    return search.followed(near if best is None else best.near, gains)


def _stands(visit: Visit) -> bool:
    """Return true if the hypothesis that rows are near is the likeliest on them, and leaves nothing."""
    likeliest = visit.near.likeliest
    return likeliest.complete and visit.near.names(likeliest) == visit.hypothesis


class _Alone(NamedTuple):
    """Rows near a hypothesis with one effect, and its log weight on the first rows, which it was followed from."""

    visit: Visit
    before: float

    @property
    def gain(self) -> float:
        return self.visit.log_weight - self.before


@dataclass(frozen=True)
class Standing:
    """Search for a hypothesis that leaves nothing; the prior is that of all hypotheses on the first rows."""

    weigher: Weigher
    prior: SetPrior

    def without_discrepancy(self, near: Near) -> Near:
        """Return the hypotheses on the same rows that leave nothing, weighed among themselves."""
        return replace(near, weighed=near.weighed.without_discrepancy(self.weigher.reach, self.weigher.seed))

    def from_one_to_the_next(self, near: Near, window: Window | None) -> tuple[Visit | None, list[float]]:
        """Return rows near the first that stands and has not lost a nat, by which a path flatters, and all gains."""
        gains: list[float] = []
        followed: set[tuple[str, ...]] = set()
        for _ in range(MOST_OUTER_ITERATIONS):
            if not near.likeliest.complete or near.names(near.likeliest) in followed:
                break
            followed.add(near.names(near.likeliest))
            visit = self.step(near, window)
            if visit is None:
                break
            gains.append(visit.log_weight - Visit(near, visit.hypothesis).log_weight)
            if _stands(visit) and gains[-1] > -LIKELIER:
                return visit, gains
            near = visit.near
        return None, gains

    def each_by_itself(self, near: Near, labels: Sequence[str], others: Sequence[_Alone]) -> list[_Alone]:
        """Return rows near the likeliest hypotheses with one effect each, the likeliest on the first rows first.

        One that would have to gain more than any before, to catch up with these or an unknown force alone, is left out.
        """
        weights = {label: near.log_weight_alone(label, self.weigher.reach) for label in labels}
        in_order, found = ranked(labels, weights.__getitem__), list(others)
        force = near.weighed.before.log_weight - near.log_unit
        for at in range(0, len(in_order), FOLLOWED_TOGETHER):
            rival = max([force, *(each.visit.log_weight for each in found)])
            gain = max((each.gain for each in found), default=np.inf)
            least, together = rival - self.weigher.reach.window, in_order[at : at + FOLLOWED_TOGETHER]
            worth = [label for label in together if weights[label] + gain > least]
            followed = in_threads(partial(self.by_itself, near.rows.point, rival=rival), worth)
            found += [_Alone(visit, weights[label]) for label, visit in zip(worth, followed, strict=True) if visit]
        return found[len(others) :]

    def by_itself(self, point: Point, label: str, rival: float) -> Visit | None:
        """Return rows near the likeliest hypothesis with one effect and no discrepancy; None without it or a path.

        Steps end early where one more that gains as much as the last would stay behind a rival's log weight.
        """
        called = frozenset({label, *(error.key for error in point.sensors)})
        near = self.weigher.tried(replace(point, window=Window(called, self.prior, (), complete=True)))
        visit: Visit | None = None
        if near is None:
            return None
        for _ in range(MOST_OUTER_ITERATIONS):
            has = label in (NO_EFFECT, *near.names(near.likeliest))
            following = self.step(near, near.rows.point.window) if has else None
            if following is None:
                return None
            before, visit, near = visit, following, following.near
            gain = np.inf if before is None else visit.log_weight - before.log_weight
            if abs(gain) < LIKELIER or visit.log_weight + gain < rival - self.weigher.reach.window:
                break
        return visit

    def step(self, near: Near, window: Window | None) -> Visit | None:
        """Return rows near the likeliest hypothesis; None if no path of it follows the samples."""
        try:
            finer, _ = refined(near.regressors, Ground.of(near.weighed), near.weighed.hypotheses)
            point = near.point_of(near.likeliest)
        except (InputError, np.linalg.LinAlgError):
            return None
        there = self.weigher.tried(replace(point, values={**point.values, **finer}, window=window))
        return None if there is None else Visit(there, near.names(near.likeliest), near)

    def followed(self, near: Near, gains: Sequence[float]) -> Visit | None:
        """Return rows near one of the likeliest hypotheses without discrepancy, each followed from the one before.

        It ends where one would have to gain more than any before, to catch up with an unknown discrepancy.
        """
        names: list[tuple[str, ...]] = []
        gain = max(gains, default=np.inf)
        for _ in range(MOST_OUTER_ITERATIONS):
            alone = self.without_discrepancy(near)
            names.append(alone.names(alone.likeliest))
            before = alone.likeliest.log_weight - near.log_unit
            # Two that lead to each other lead nowhere.
            if names[-1] in names[:-2] or before + gain < near.log_evidence - self.weigher.reach.window:
                return None
            visit = self.step(alone, None)
            if visit is None or _stands(visit):
                return visit
            near, gain = visit.near, max(gain, visit.log_weight - before)
        return None
