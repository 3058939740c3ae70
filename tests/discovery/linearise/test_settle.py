"""Tests of rows near several hypotheses: the evidence that each tells the others."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_greybox.discovery.linearise.visits import Visit, best_of

WINDOW = 12.0
"""Nats behind the likeliest hypothesis within which others are kept."""


@dataclass(frozen=True)
class Table:
    """Hypotheses by their names, with log weights."""

    logs: dict
    log_unit: float = 0.0
    more: tuple = ()
    weighed: SimpleNamespace = field(init=False)
    regressors: SimpleNamespace = field(init=False)

    def __post_init__(self):
        hypotheses = [SimpleNamespace(names=names, log_weight=value) for names, value in self.logs.items()]
        outside = max(self.logs.values()) - WINDOW
        weighed = SimpleNamespace(hypotheses=hypotheses, reweighted=self.told, outside=outside)
        object.__setattr__(self, "weighed", weighed)
        called = {*self.more, *(name for names in self.logs for name in names)}
        columns = [SimpleNamespace(called=name) for name in called]
        object.__setattr__(self, "regressors", SimpleNamespace(columns=columns))

    def told(self, shifts, seed):
        return {names: value + more for (names, value), more in zip(self.logs.items(), shifts, strict=True)}

    def names(self, hypothesis):
        return hypothesis.names

    def log_weights(self):
        return dict(self.logs)


@pytest.fixture(autouse=True)
def replaced(monkeypatch):
    def another(near, weighed):
        return Table(weighed, near.log_unit)

    monkeypatch.setattr("bayes_greybox.discovery.linearise.visits.replace", another)


NOTHING, CUBE, LAG = (), ("cube",), ("lag",)


def test_each_hypothesis_has_the_weight_that_it_has_on_rows_of_its_own():
    # Near either the other one looks likelier: in turns neither would ever stay.
    near_cube = Visit(Table({CUBE: 10.0, LAG: 12.0, NOTHING: 0.0}), CUBE)
    near_lag = Visit(Table({CUBE: 11.0, LAG: 9.0, NOTHING: 0.0}), LAG)
    for visits in ([near_cube, near_lag], [near_lag, near_cube]):
        best = best_of(visits, 0)
        assert best.hypothesis == CUBE
        assert best.near.logs == {CUBE: 10.0, LAG: 9.0, NOTHING: 0.0}


def test_no_gap_is_told_too():
    first = Visit(Table({NOTHING: 3.0, CUBE: 8.0}), NOTHING)
    then = Visit(Table({NOTHING: -50.0, CUBE: 10.0}), CUBE)
    assert best_of([first, then], 0).near.logs == {NOTHING: 3.0, CUBE: 10.0}


def test_rows_in_another_unit_are_compared_in_that_of_the_readings():
    near_cube = Visit(Table({CUBE: 110.0, LAG: 112.0}, log_unit=100.0), CUBE)
    near_lag = Visit(Table({CUBE: 11.0, LAG: 9.0}), LAG)
    assert best_of([near_cube, near_lag], 0).near.logs == {CUBE: 110.0, LAG: 109.0}


def test_rows_near_no_known_hypothesis_are_left_for_any_others():
    start = Visit(Table({CUBE: 20.0, LAG: 30.0}))
    assert start.log_weight == -np.inf
    then = Visit(Table({CUBE: 5.0, LAG: 4.0}), CUBE)
    assert best_of([start, then], 0).near.logs == {CUBE: 5.0, LAG: 4.0}


def test_what_is_no_longer_kept_near_itself_is_no_likelier_than_what_is_not_kept():
    # Nothing at all is kept wherever it stands, and says nothing of others.
    visit = Visit(Table({LAG: 9.0, NOTHING: -200.0}), CUBE)
    assert visit.log_weight == 9.0 - WINDOW


def test_a_table_keeps_its_own_hypotheses_alone():
    here, there = Visit(Table({CUBE: 10.0}), CUBE), Visit(Table({LAG: 3.0, CUBE: 1.0}), LAG)
    assert best_of([here, there], 0).near.logs == {CUBE: 10.0}


def test_one_with_a_further_effect_has_its_weight_from_the_rows_of_what_it_adds_to():
    # On rows near nothing, whose path follows noise, a lag looks likely with anything beside it.
    flattered = Visit(Table({NOTHING: 6.0, LAG: 15.0, (*LAG, *CUBE): 14.0, CUBE: 3.0}), NOTHING)
    own = Visit(Table({LAG: -30.0, NOTHING: -40.0}, more=CUBE), LAG, turn=1)
    # Lag and cube are not kept there.
    assert best_of([flattered, own], 0).near.logs == {
        NOTHING: 6.0,
        LAG: -30.0,
        (*LAG, *CUBE): -30.0 - WINDOW,
        CUBE: 3.0,
    }
    # What was not weighed there is not known.
    narrow = Visit(Table({LAG: -30.0, NOTHING: -40.0}), LAG, turn=1)
    assert best_of([flattered, narrow], 0).near.logs[*LAG, *CUBE] == 14.0
    # In an earlier visit values were coarser: only its own hypothesis is known from there.
    earlier = own._replace(turn=0)
    assert best_of([earlier, flattered._replace(turn=1)], 0).near.logs[*LAG, *CUBE] == 14.0
