"""Effects by themselves are weighed along paths of their own, those with memory only if no other leaves nothing."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_greybox.discovery.grid.sets import Reach, Window
from bayes_greybox.discovery.linearise import standing, visits
from bayes_greybox.discovery.linearise.near import Point
from bayes_greybox.discovery.linearise.standing import standing_visit

CUBE, LAG, DRAG = "cube", "lag", "drag"
FIRST = {(): -60.0, (CUBE,): -30.0, (DRAG,): -35.0, (LAG,): -10.0}
"""Log weights on the first rows."""


@dataclass(frozen=True)
class Table:
    """Log weights of hypotheses by their names on rows near a point."""

    logs: dict
    point: Point
    complete: bool = False
    log_unit: float = 0.0
    n_value: int = 1
    force: float = -100.0
    weighed: object = None
    likeliest: object = field(init=False)
    rows: object = field(init=False)
    regressors: object = field(init=False)

    def __post_init__(self):
        names = max(self.logs, key=self.logs.__getitem__)
        hypotheses = [SimpleNamespace(names=n, log_weight=w) for n, w in self.logs.items()]
        before = SimpleNamespace(names=(), members=(), log_weight=self.force)
        table = SimpleNamespace(columns=np.broadcast_to(0.0, self.n_value))
        without = SimpleNamespace(hypotheses=hypotheses, before=before, prior=None, table=table, forces=(), floor=0.0)
        without.outside = max(self.logs.values()) - 12.0
        without.grid, without.without_discrepancy = SimpleNamespace(points=()), lambda reach, seed: without
        effects = [SimpleNamespace(label=n, effect=SimpleNamespace(hidden=n == LAG)) for n in (CUBE, LAG, DRAG)]
        for name, value in {
            "likeliest": SimpleNamespace(
                names=names, members=names, complete=self.complete, log_weight=self.logs[names]
            ),
            "weighed": without,
            "rows": SimpleNamespace(point=self.point, model=SimpleNamespace(rows=SimpleNamespace(follows_path=True))),
            "regressors": SimpleNamespace(columns=[SimpleNamespace(effect=effect) for effect in effects]),
        }.items():
            object.__setattr__(self, name, value)

    @property
    def window(self):
        return Window(frozenset(self.likeliest.names), None, ())

    @property
    def log_evidence(self):
        return max(self.force, *self.logs.values())

    def log_weight_alone(self, label, reach):
        return self.logs.get((label,) if label else (), -np.inf)

    def names(self, hypothesis):
        return hypothesis.names

    def log_weights(self):
        return self.logs

    def point_of(self, hypothesis):
        return replace(self.point, added=tuple((name, 1.0) for name in hypothesis.names))


@pytest.fixture
def paths(monkeypatch):
    """Rows by what they are near: the first path says a lag, on its own path the cube is far ahead."""
    visited = []

    def near_to(_, point):
        near, window = tuple(name for name, _ in point.added), point.window and set(point.window.called)
        visited.append((near, window))
        own = {(): -90.0, (CUBE,): paths.cube, (DRAG,): -70.0, (LAG,): paths.lag}
        logs = {n: (own[n] if n == near else FIRST[n] - 50.0) if near else FIRST[n] for n in own}
        kept = {n: w for n, w in logs.items() if window is None or set(n) <= window}
        return Table(kept, point, complete=near in paths.stands)

    monkeypatch.setattr(visits.Weigher, "near", near_to)
    monkeypatch.setattr(standing, "refined", lambda *_: ({}, frozenset()))
    monkeypatch.setattr(standing, "Ground", SimpleNamespace(of=lambda weighed: None))
    paths.cube, paths.lag, paths.stands, paths.visited = -5.0, -40.0, {(CUBE,)}, visited
    return paths


def found(paths, **first):
    first = Table(FIRST | first.pop("logs", {}), Point(), **first)
    return standing_visit(first, visits.Weigher(None, None, Reach(), 0))


def test_the_effect_that_is_likeliest_along_its_own_path_is_found_though_the_first_path_says_another(paths):
    visit = found(paths)
    assert visit.hypothesis == (CUBE,) and visit.near.likeliest.complete
    # One without memory stands: paths of a memory are not looked for.
    assert all(window is None or LAG not in window for _, window in paths.visited)


def test_what_the_first_path_flattered_is_not_it_though_it_leaves_nothing(paths):
    # 30 nats less likely along its own path, where nothing remains either.
    paths.stands = {(CUBE,), (LAG,)}
    assert found(paths, complete=True).hypothesis == (CUBE,)


def test_what_is_as_likely_along_its_own_path_needs_no_search(paths):
    paths.cube, paths.stands = -9.0, {(CUBE,)}
    assert found(paths, logs={(CUBE,): -9.5, (LAG,): -20.0}, complete=True).hypothesis == (CUBE,)
    assert paths.visited == [((CUBE,), None)]


def test_another_one_that_is_the_likeliest_along_that_path_is_followed_before_all_are(paths):
    paths.lag, paths.stands = -90.0, {(CUBE,), (LAG,)}
    assert found(paths, complete=True).hypothesis == (CUBE,)
    assert paths.visited == [((LAG,), None), ((CUBE,), None)]


def test_two_that_lead_to_each_other_end_there(paths):
    """Along either's path the other one is likelier: every effect is tried by itself."""
    paths.lag, paths.cube, paths.stands = -90.0, -90.0, {(CUBE,), (LAG,)}
    found(paths, complete=True)
    assert paths.visited[:2] == [((LAG,), None), ((CUBE,), None)] and paths.visited[2][1] is not None


def test_on_a_large_table_only_what_is_likely_is_weighed_on_the_way_there(paths):
    paths.cube, paths.stands = -9.0, {(CUBE,)}
    found(paths, logs={(CUBE,): -9.5, (LAG,): -20.0}, complete=True, n_value=10**6)
    assert paths.visited == [((CUBE,), {CUBE})]


def test_effects_with_memory_are_followed_if_no_other_stands(paths):
    paths.cube, paths.stands = -80.0, {(LAG,)}
    assert found(paths).hypothesis == (LAG,)


def test_nothing_is_returned_where_something_remains_along_every_path(paths):
    paths.stands = set()
    assert found(paths) is None


def test_nothing_is_searched_where_nothing_is_missing(paths):
    assert found(paths, logs={(): -5.0}, complete=True) is None and not paths.visited


def followed_alone(paths):
    return {names[0] for names, window in paths.visited if names and window == {*names}}


@pytest.mark.parametrize(("drag", "followed"), [(-41.0, {CUBE, DRAG}), (-43.0, {CUBE})])
def test_an_effect_that_would_have_to_gain_more_than_any_before_is_not_followed(paths, monkeypatch, drag, followed):
    monkeypatch.setattr(standing, "FOLLOWED_TOGETHER", 1)
    # The cube gains one nat along its own path: with as much, the drag would be 11 nats behind, or 13.
    paths.cube = -29.0
    assert found(paths, logs={(DRAG,): drag}).hypothesis == (CUBE,)
    assert followed_alone(paths) == followed


def test_nothing_is_followed_far_where_an_unknown_force_is_far_ahead(paths, monkeypatch):
    monkeypatch.setattr(standing, "FOLLOWED_TOGETHER", 1)
    paths.stands = set()
    assert found(paths, force=1000.0) is None and followed_alone(paths) == {CUBE}
