"""What rounding makes different is a tie, in a stated order."""

import numpy as np
import pandas as pd
import pytest

from bayes_greybox.discovery.ties import TIE, likeliest_first, ranked, sorted_by_probability

ROUNDING = 1e-10
"""As much of the evidence as kernels of two processors differ by."""


@pytest.mark.parametrize("rounding", [-ROUNDING, 0.0, ROUNDING])
def test_ties_stay_in_their_order(rounding):
    nats = {"a": -900.0, "b": -3.0, "c": -3.0 + rounding, "d": 0.5, "e": -np.inf, "f": -np.inf}
    assert ranked(nats, lambda name: nats[name]) == ["d", "b", "c", "a", "e", "f"]
    p = {"a": 0.1, "b": 0.4, "c": 0.4 * (1 + rounding), "d": 0.0, "e": -ROUNDING}
    assert likeliest_first(p, lambda name: p[name]) == ["b", "c", "a", "d", "e"]
    table = pd.DataFrame({"probability": p})
    assert list(sorted_by_probability(table).index) == ["b", "c", "a", "d", "e"]
    assert ranked([], float) == [] and likeliest_first({}, float) == []


def test_what_is_no_tie_is_sorted():
    nats = np.random.default_rng(0).normal(size=50)
    nats[7] = nats[3] + 2 * TIE
    assert ranked(range(50), lambda i: nats[i]) == sorted(range(50), key=lambda i: -nats[i])
