"""What contradictions among the samples take from the probability of an effect."""

import numpy as np
import pytest
from scipy.stats import norm

from bayes_greybox.discovery.answer.doubt import Doubt, artefact, contradicted, standing

SURE = Doubt(1.0, 0.2)


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
    assert artefact([], 0.1) == 0.0
    assert artefact([SURE, SURE], 0.4) == pytest.approx(0.75)


def test_only_the_studied_state_denies_an_answer_without_effects():
    found = {"no gap": 0.7, "recalibrate": 0.0}
    assert standing(found, [SURE, Doubt(0.6, 0.0, "effects")], 0.02) == found
    assert standing(found, [Doubt(0.6, 0.0, "no gap")], 0.02)["no gap"] == pytest.approx(0.7 * 0.4)
    assert standing({"no gap": 0.0}, [Doubt(1.0, 0.0, "no gap")], 0.02) == {"no gap": 0.0}


def test_answers_are_weighed_against_each_other_and_an_error_that_they_have_in_common():
    # P(k) p(motion | k), the error with its prior and a likelihood that is the largest of all.
    prior, p, q = 0.02, {"instrument": 0.5, "recalibrate": 0.3}, {"instrument": 1e-4, "recalibrate": 1e-3}
    odds = {kind: -np.e * value * np.log(value) for kind, value in q.items()}
    doubts = [Doubt(contradicted(value, prior), 0.1, kind) for kind, value in q.items()]
    joint = {kind: (1 - prior) * p[kind] / 0.8 * odds[kind] for kind in p}
    expected = {kind: 0.8 * value / (sum(joint.values()) + prior) for kind, value in joint.items()}
    assert standing(p, doubts, prior) == pytest.approx(expected)
