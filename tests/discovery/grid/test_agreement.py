"""How often bagged records agree with the whole one."""

import numpy as np
import pytest

from bayes_greybox.discovery.grid.residuals import (
    BAGGED_RECORDS,
    FEWEST_BAGGED_BLOCKS,
    MOST_BAGGED_BLOCKS,
    bagged,
    blocks,
)


def test_one_hypothesis_is_always_agreed_on():
    assert bagged(np.random.default_rng(0).standard_normal((1, 30)), np.ones(1), 0) == pytest.approx(1.0)


def test_two_that_are_equal_share_equally():
    logs = np.tile(np.random.default_rng(0).standard_normal(30), (2, 1))
    np.testing.assert_allclose(bagged(logs, np.full(2, 0.5), 0), 0.5)


def test_blocks_that_all_say_the_same_agree():
    # Half a nat each: a record of fewer distinct blocks says it as surely.
    logs = np.array([np.full(30, 0.5), np.zeros(30)])
    p = 1 / (1 + np.exp(-15.0))
    np.testing.assert_allclose(bagged(logs, np.array([p, 1 - p]), 0), [p, 1 - p], atol=1e-9)


def test_blocks_that_contradict_each_other_agree_on_nothing():
    """By eight nats sure on the whole record, of blocks that say 20 each way."""
    logs = np.array([20.0 * (-1.0) ** np.arange(30), np.zeros(30)])
    p = 1 / (1 + np.exp(-8.0))
    agreement = bagged(logs, np.array([p, 1 - p]), 0)
    # The sum over a bagged record has standard deviation 20 √30 = 110: Φ(8/110), to two standard errors and a half.
    assert agreement[0] == pytest.approx(0.53, abs=2.5 * 0.5 / np.sqrt(BAGGED_RECORDS))
    assert agreement.sum() == pytest.approx(1.0)


def test_the_same_seed_draws_the_same_records():
    logs, p = np.random.default_rng(1).normal(0, 3, (3, 12)), np.array([0.6, 0.3, 0.1])
    np.testing.assert_array_equal(bagged(logs, p, 4), bagged(logs, p, 4))
    assert np.any(bagged(logs, p, 4) != bagged(logs, p, 5))


@pytest.mark.parametrize(("n", "count"), [(3, 3), (60, FEWEST_BAGGED_BLOCKS), (400, 16), (10_000, MOST_BAGGED_BLOCKS)])
def test_blocks_are_contiguous_and_of_equal_length(n, count):
    found = blocks(n)
    assert np.all(np.diff(found) >= 0) and found[0] == 0
    lengths = np.bincount(found)
    assert len(lengths) == count and np.ptp(lengths) <= 1
