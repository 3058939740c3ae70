"""Work in threads gives what it gives in a row, and its errors."""

import os
import threading

import pytest

from bayes_greybox.running.threads import in_threads


@pytest.mark.parametrize("cores", [1, 4])
def test_values_come_in_the_order_of_their_items(cores, monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    assert in_threads(lambda x: x**2, range(20)) == [x**2 for x in range(20)] and in_threads(str, []) == []


def test_items_are_worked_on_side_by_side(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    both = threading.Barrier(2, timeout=30)
    assert sorted(in_threads(lambda _: both.wait(), range(2))) == [0, 1]


def test_an_error_of_one_item_is_raised():
    with pytest.raises(ZeroDivisionError):
        in_threads(lambda x: 1 / x, [1, 0, 2])
