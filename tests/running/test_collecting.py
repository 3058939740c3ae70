"""How often Python looks for garbage: seldom within some work, and afterwards as before."""

import gc

import pytest

import bayes_greybox as bg
from bayes_greybox.running.collecting import SELDOM, seldom_collected


def test_work_within_work_leaves_the_outer_one_seldom_and_the_process_as_it_was():
    before = gc.get_threshold()
    with seldom_collected():
        with seldom_collected():
            assert gc.get_threshold() == SELDOM
        assert gc.get_threshold() == SELDOM
    assert gc.get_threshold() == before


def test_of_two_works_side_by_side_the_one_that_began_first_ends_it():
    before = gc.get_threshold()
    first, second = seldom_collected(), seldom_collected()
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    second.__exit__(None, None, None)
    assert gc.get_threshold() == before


def test_a_fit_that_is_refused_leaves_it_as_it_was():
    before = gc.get_threshold()
    data = bg.systems.oscillator().simulate([0.0, 0.5, 1.0, 1.5], noise=0.0, seed=0)
    with pytest.raises(bg.InputError):
        bg.GreyBox({"nothing": ["y"]}).fit(data, draws=1, tune=1, chains=1, progress=False)
    assert gc.get_threshold() == before
