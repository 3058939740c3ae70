"""What contradictions among the samples take from the probability of an effect."""

import numpy as np
import pytest
from scipy.stats import norm

from bayes_greybox.discovery.answer.doubt import Doubt, artefact, contradicted, unexplained

SURE = Doubt(1.0, 0.2, own=False)


@pytest.mark.parametrize("p", [0.37, 0.5, 1.0])
def test_samples_that_agree_leave_the_prior_as_it_was(p):
    assert contradicted(p, 0.02) == pytest.approx(0.02)


def test_it_falls_with_p_down_to_certainty():
    found = [contradicted(p, 0.02) for p in (0.1, 1e-3, 1e-6, 1e-12, 0.0)]
    assert np.all(np.diff(found) > 0) and found[-1] == 1.0 and found[1] == pytest.approx(0.52, abs=0.01)


def test_no_alternative_of_decreasing_density_is_more_against_right_sensors():
    # Over beta(ξ, 1) alternatives for p the least odds are −e p ln p, at ξ = −1/ln p.
    p = 1e-3
    odds = [1 / (xi * p ** (xi - 1)) for xi in np.linspace(0.01, 1, 1000)]
    assert contradicted(p, 0.5) == pytest.approx(1 / (1 + min(odds)), rel=1e-4)
    assert norm.isf(p) == pytest.approx(3.09, abs=0.01)


@pytest.mark.parametrize(("size", "wrong"), [(0.1, 1.0), (0.2, 1.0), (0.4, 0.5), (2.0, 0.1), (0.0, 1.0)])
def test_an_effect_counts_by_its_size_over_that_of_the_error(size, wrong):
    assert artefact([SURE], size) == pytest.approx(wrong)


def test_doubts_add_up_and_none_takes_nothing():
    assert artefact([], 0.1) == 0.0 and unexplained([]) == 0.0
    assert artefact([SURE, SURE], 0.4) == pytest.approx(0.75)


def test_only_the_studied_state_denies_an_answer_without_effects():
    assert unexplained([SURE]) == 0.0 and unexplained([SURE, Doubt(0.6, 0.0, own=True)]) == pytest.approx(0.6)
